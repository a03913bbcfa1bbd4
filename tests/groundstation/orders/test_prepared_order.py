"""An order that is computed again while its first paths are still being computed."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from groundstation.orders.forecast_process import ForecastFailed
from groundstation.orders.grammar import parse
from groundstation.orders.prepared_order import PreparedOrder
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient


class FailingForecaster:
    """Computes nothing."""

    async def forecast(self, fleet: Any, legs: Any, *, is_takeoff: bool = False) -> Any:
        raise ForecastFailed("the process ended")


@pytest.mark.parametrize("is_shown", [True, False])
def test_a_failure_counts_for_the_paths_that_are_shown_only(is_shown: bool) -> None:
    changes: list[str] = []
    client: Any = SimpleNamespace(now_ns=lambda: 0, state=SimpleNamespace(vehicles={}))
    intent: Any = SimpleNamespace(verb="move")
    order = PreparedOrder(
        fleet=SimpleNamespace(),  # type: ignore[arg-type]
        client=client,
        intent=intent,
        forecaster=FailingForecaster(),
        start=lambda preview: None,
        on_change=lambda: changes.append("changed"),
    )
    first: Any = SimpleNamespace(intent=intent, legs={}, reasons=())
    order.preview = first
    if not is_shown:
        order.preview = SimpleNamespace(intent=intent, legs={}, reasons=())  # type: ignore[assignment]

    asyncio.run(order.compute(first))

    assert order.is_computing is not is_shown
    assert order.reasons == (("the process ended",) if is_shown else ())
    assert changes == (["changed"] if is_shown else [])


HOLD = {"taken_order_kind": "hold", "taken_order_from": "olga"}


def _prepared(fleet: FleetConfig, client: Any) -> PreparedOrder:
    """A move of mav0 whose paths nobody computes."""
    return PreparedOrder(
        fleet=fleet,
        client=client,
        intent=parse("move mav0 0 1 1", fleet),
        forecaster=FailingForecaster(),
        start=lambda preview: None,
        on_change=lambda: None,
    )


def test_a_persons_stop_stays_a_reason_after_the_vehicle_has_taken_another_order(
    fleet: FleetConfig,
) -> None:
    client = FakeClient(fleet)
    client.hear("mav0", state="flying", is_airborne=True, is_armed=True)
    prepared = _prepared(fleet, client)
    prepared.begin()
    assert not prepared.reasons

    client.hear("mav0", state="holding", is_airborne=True, taken_order_id="ground-2-1", **HOLD)
    assert prepared.check() is None
    reasons = tuple(prepared.reasons)
    assert "olga has ordered hold mav0 meanwhile" in reasons[0]

    client.hear("mav0", state="flying", is_airborne=True, is_armed=True,
                taken_order_id="ground-2-2", taken_order_kind="move")  # fmt: skip
    prepared.begin("the fleet has moved")
    assert prepared.reasons == reasons


@pytest.mark.parametrize("whose", ["own, on its way", "own, later", "of this ground's mission"])
def test_an_order_that_was_on_its_way_or_is_of_a_mission_is_no_persons_stop(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch, whose: str
) -> None:
    client = FakeClient(fleet)
    client.hear("mav0", state="flying", is_airborne=True, is_armed=True)
    order_id = "ground-1-later"
    if whose == "own, on its way":
        order_id = client.submit_now("hold mav0").planned.orders["mav0"].order_id
    prepared = _prepared(fleet, client)
    prepared.begin()
    if whose == "of this ground's mission":
        monkeypatch.setattr(client, "is_of_mission", lambda one: one == order_id)

    client.hear("mav0", state="flying", is_airborne=True, is_armed=True, taken_order_id=order_id,
                **HOLD)  # fmt: skip
    prepared.begin()
    assert bool(prepared.reasons) is (whose == "own, later")
