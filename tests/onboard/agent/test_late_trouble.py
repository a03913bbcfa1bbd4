"""Trouble in the moments between others: armed, without poses, in a landing, after a kill."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from onboard.agent.loop import AgentProcess
from onboard.autopilot import Landed
from onboard.flight.types import FlightStep
from tests.onboard.agent.rig import Rig, hovering_rig, ready_rig


def test_hold_in_a_gap_of_the_poses_is_obeyed_when_they_return() -> None:
    rig = hovering_rig()
    assert rig.order("move", position_enu_m=(2.0, 0.0, 1.0)).is_accepted
    rig.run(0.6)
    rig.has_mocap = False
    rig.run(0.35)
    assert rig.core.flight.step is FlightStep.COASTING
    assert rig.order("hold", order_id="stop").is_accepted

    rig.run(0.1)
    rig.has_mocap = True
    rig.run(3.0)
    assert rig.core.flight.step is FlightStep.HOLDING
    assert rig.outcomes()["stop"] == "done"
    assert rig.position[0] < 1.0


def test_a_long_time_without_mocap_before_the_flight_does_not_count_in_flight() -> None:
    rig = Rig()
    rig.has_mocap = False
    rig.run(30.0)
    rig.has_mocap = True
    rig.fly()
    rig.run(5.0)
    assert rig.order("move", position_enu_m=(2.0, 0.0, 1.0), order_id="go").is_accepted
    rig.run(0.6)
    rig.has_mocap = False
    rig.run(0.4)
    rig.has_mocap = True
    rig.run(8.0)
    assert rig.outcomes()["go"] == "done"


def _high_rig() -> Rig:
    rig = hovering_rig()
    assert rig.order("move", position_enu_m=(0.0, 0.0, 2.8)).is_accepted
    rig.run(6.0)
    assert rig.position[2] > 2.7
    return rig


def _stop_motors(rig: Rig) -> None:
    """Disarm as a kill switch does. PX4 reports the ground of whoever is disarmed."""
    rig.is_armed = False
    rig.landed_report = Landed.ON_GROUND


def test_a_vehicle_whose_motors_stop_in_its_landing_has_not_landed_as_ordered() -> None:
    rig = _high_rig()
    assert rig.order("land", order_id="down").is_accepted
    rig.run(0.5)
    _stop_motors(rig)
    rig.run(2.0)
    assert rig.outcomes()["down"] == "failed"
    (said,) = [event for event in rig.events if event.code == "disarmed-in-flight"]
    assert said.severity == "critical"
    assert rig.core.flight.has_fallen

    rig.run(2.0)
    assert rig.core.flight.state == "landed"


def test_whoever_falls_after_a_kill_is_not_on_the_ground_yet() -> None:
    rig = _high_rig()
    rig.order("kill")
    rig.landed_report = Landed.ON_GROUND
    heights_m = []

    def listen() -> None:
        if rig.core.flight.step is FlightStep.LANDED:
            heights_m.append(rig.position[2])

    rig.after_move = listen
    rig.run(3.0)
    assert heights_m
    assert max(heights_m) == 0.0


def test_an_armed_vehicle_does_not_take_off_with_what_would_have_refused_it_before() -> None:
    rig = ready_rig()
    assert rig.order("arm").is_accepted
    rig.until("armed")
    rig.run(1.0)
    rig.battery_frac = 0.22
    rig.run(2.0)
    refusal = rig.order("takeoff", height_m=1.0)
    assert not refusal.is_accepted
    assert "Battery at 22 %" in refusal.reason

    rig.battery_frac = 0.9
    rig.run(2.0)
    assert rig.order("takeoff", height_m=1.0).is_accepted


def test_many_parts_of_paths_do_not_make_a_repeated_order_a_new_one() -> None:
    rig = hovering_rig()
    first = rig.order("hold", order_id="stop")
    for number in range(300):
        rig.order("load_path", order_id=f"part{number}")
    event_count = len(rig.events)
    assert rig.order("hold", order_id="stop") == first
    assert len(rig.events) == event_count


@pytest.mark.parametrize(
    ("step", "is_by_hand", "is_landed"),
    [
        (FlightStep.LEG, False, True),
        (FlightStep.LEG, True, False),
        (FlightStep.FAILED, False, False),
        (FlightStep.READY, False, False),
    ],
)
def test_an_agent_whose_ticks_fail_lands_only_what_it_flies(
    step: FlightStep, is_by_hand: bool, is_landed: bool
) -> None:
    landed: list[bool] = []
    snapshot = SimpleNamespace(is_flown_by_hand=lambda now_ns: is_by_hand)
    link = SimpleNamespace(snapshot=lambda: snapshot, land=lambda: landed.append(True))
    loop: Any = SimpleNamespace(
        _link=link, _core=SimpleNamespace(flight=SimpleNamespace(step=step))
    )
    AgentProcess._land_by_px4(loop, 0)
    assert bool(landed) is is_landed
