"""Vehicles that do not fly although they were ordered to, and the cause that is named for each."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from groundstation.fleet.state import FleetState, fold, initial
from groundstation.verdict.other_ends import LastOrder, other_ends
from onboard.bus.schema import Event, Severity
from onboard.config.fleet import FleetConfig

MS = 1_000_000
ORDER = LastOrder("hold mav1", leaves_flying=True, done_ns=10 * MS)


def event(severity: Severity, sentence: str, vehicle: str = "mav1") -> Event:
    return Event(vehicle=vehicle, stamp_ns=0, severity=severity, code="failsafe", sentence=sentence)


def named_cause(state: FleetState) -> str:
    (sentence,) = other_ends({"mav1": ORDER}, state).values()
    return sentence.removeprefix("mav1 is down, though its last finished order was 'hold mav1': ")


@pytest.mark.parametrize(
    ("changes", "end"),
    [
        ({"state": "holding"}, None),
        ({"state": "failed"}, "has failed"),
        ({"state": "failed", "order_kind": "kill"}, None),
        ({"state": "landing"}, "is landing"),
        ({"state": "landing", "order_id": "ground-7", "order_kind": "land"}, None),
        ({"state": "landed", "is_airborne": False}, "is down"),
    ],
)
def test_a_vehicle_that_has_failed_or_lands_without_an_order_is_named_in_the_air_too(
    fleet: FleetConfig, make_telemetry: Any, changes: dict[str, Any], end: str | None
) -> None:
    values = {"is_airborne": True, "reason": "PX4 silent.", **changes}
    state = fold(initial(fleet), make_telemetry("mav1", **values), 10 * MS)

    sentences = other_ends({"mav1": ORDER}, state)
    if end is None:
        assert not sentences
    else:
        assert sentences == {
            "mav1": f"mav1 {end}, though its last finished order was 'hold mav1': PX4 silent."
        }
        landing = msgspec.structs.replace(ORDER, leaves_flying=False)
        assert not other_ends({"mav1": landing}, state)


def test_what_landed_a_vehicle_is_the_cause_and_no_warning_on_its_way_down(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    down = make_telemetry("mav1", is_airborne=False, reason="It stands.")
    state = fold(initial(fleet), down, 10 * MS)
    assert named_cause(state) == "It stands."

    state = fold(state, event("critical", "Of an earlier order."), 9 * MS)
    assert named_cause(state) == "It stands."

    state = fold(state, event("warning", "Battery low: going on."), 11 * MS)
    assert named_cause(state) == "Battery low: going on."

    state = fold(state, event("critical", "Attitude does not follow: PX4 lands."), 12 * MS)
    state = fold(state, event("warning", "Own position jumped: going on."), 13 * MS)
    state = fold(state, event("critical", "Of another one.", vehicle="mav0"), 14 * MS)
    assert named_cause(state) == "Attitude does not follow: PX4 lands."
