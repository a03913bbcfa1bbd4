"""An order that is computed again while its first paths are still being computed."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from groundstation.orders.forecast_process import ForecastFailed
from groundstation.orders.prepared_order import PreparedOrder


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
