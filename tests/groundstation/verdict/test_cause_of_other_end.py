"""The cause that a verdict names for a vehicle that is down although it was ordered to fly."""

from __future__ import annotations

from typing import Any

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
    return sentence.removeprefix("mav1 is down, though its last order was 'hold mav1': ")


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
