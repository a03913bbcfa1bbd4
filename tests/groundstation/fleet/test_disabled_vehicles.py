"""A vehicle that the fleet file disables and that is heard all the same: shown, counted, and to be
brought down.
"""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from groundstation.alarms.alarm_table import GroundCondition
from groundstation.alarms.alarms import conditions
from groundstation.client.client import FleetClient
from groundstation.client.direct_mavlink import DirectCommand, DirectResult
from groundstation.client.one_order import order_once
from groundstation.fleet import state as fleet_state
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.intents import INTENTS, Kill, Land
from groundstation.orders.plan import plan_order
from groundstation.orders.result import VehicleResult
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from tests.groundstation.conftest import FakeBus
from tests.groundstation.console.fake import telemetry


def _fleet() -> FleetConfig:
    whole = load_fleet("configs/fleets/paper.toml")
    off = msgspec.structs.replace(whole.vehicles["mav2"], enabled=False)
    return msgspec.structs.replace(whole, vehicles={**whole.vehicles, "mav2": off})


def test_it_is_shown_counted_and_alarmed_as_soon_as_it_is_heard() -> None:
    fleet = _fleet()
    state = fleet_state.initial(fleet)
    assert list(state.vehicles) == ["mav0", "mav1"]
    state = fleet_state.fold(
        state, telemetry("mav0", sequence=1, position_enu_m=(0.0, 0.0, 1.0)), 5
    )
    flying = telemetry(
        "mav2", sequence=1, position_enu_m=(0.9, 0.0, 1.0), is_airborne=True, is_armed=True
    )
    state = fleet_state.fold(state, flying, 5)
    assert state.smallest is not None
    assert (state.smallest.first, state.smallest.second) == ("mav0", "mav2")
    assert state.smallest.distance_m == pytest.approx(0.9)
    assert [
        one.subject
        for one in conditions(state, fleet, 5)
        if one.kind is GroundCondition.DISABLED_FLIES
    ] == ["mav2"]


def test_it_may_be_brought_down_and_not_flown() -> None:
    fleet = _fleet()
    for verb, is_sent in (
        ("land", True),
        ("kill", True),
        ("hold", True),
        ("takeoff", False),
        ("arm", False),
    ):
        intent = INTENTS[verb](vehicles=("mav2",))
        planned = plan_order(intent, fleet, None, held=HeldFormation(None), author="me", now_ns=1)
        assert ("mav2" in planned.orders) is is_sent, verb
        assert ("mav2" in planned.refusals) is not is_sent, verb


async def _ordered_once(intent: Land | Kill, *, is_heard: bool) -> tuple[VehicleResult, float]:
    """Give mav2 one order; return how it ended, and how long mav2 had been heard before [s]."""
    loop = asyncio.get_running_loop()
    bus: Any = FakeBus(load_fleet("configs/fleets/paper.toml"))

    async def send(_: DirectCommand) -> DirectResult:
        return DirectResult(False, False, "PX4 did not answer", has_answered=False)

    client = FleetClient(_fleet(), author="script", bus=bus, send=send)
    if is_heard:
        loop.call_later(0.2, lambda: bus.tell("mav2", state="flying", is_airborne=True))
    else:
        bus.misbehave = {"mav2": "silent"}

    begin_s = loop.time()
    order = bus.order

    def timed(vehicle: str, *words: Any, **options: Any) -> None:
        nonlocal begin_s
        begin_s = loop.time() - begin_s - 0.2
        order(vehicle, *words, **options)

    bus.order = timed
    results = await asyncio.wait_for(order_once(client, intent, 8.0, lambda _: None), 12.0)
    return results["mav2"], begin_s


@pytest.mark.parametrize("intent", [Land(vehicles=("mav2",)), Kill(vehicles=("mav2",))])
async def test_an_order_that_brings_it_down_waits_until_it_is_heard(intent: Land | Kill) -> None:
    result, heard_s = await _ordered_once(intent, is_heard=True)
    assert result.is_done, result.sentence
    assert heard_s >= 0.0


async def test_an_order_that_brings_it_down_ends_in_words_when_nobody_hears_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("groundstation.client.one_order._SILENT_S", 0.05)
    result, _ = await _ordered_once(Land(vehicles=("mav2",)), is_heard=False)
    assert result.phase == "failed"
    assert "did not answer within 1 s" in result.sentence


@pytest.mark.parametrize(
    "step",
    [
        {"do": "land", "vehicles": "mav2"},
        {"do": "wait", "until": {"landed": "mav2"}},
        {"do": "wait", "until": {"reached": {"mav2": [0, 0, 1]}}},
    ],
)
def test_a_step_of_a_mission_that_names_it_is_refused_before_the_flight(
    step: dict[str, Any],
) -> None:
    steps = [{"do": "takeoff", "height_m": 1.0}, step]
    with pytest.raises(ConfigError, match="mav2 is not enabled in the fleet file"):
        mission_from_mapping({"schema": 1, "step": steps}, path="t.toml", fleet=_fleet())
