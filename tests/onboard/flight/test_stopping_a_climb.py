"""A landing or a hold that ends a climb, a descent or a hover: hardly any way on, and no tilt for
millimetres.
"""

from __future__ import annotations

import math

import pytest

from onboard import agent_commands
from onboard.bus.schema import OrderKind
from onboard.flight.types import FlightStep
from onboard.frames import body_up
from tests.onboard.agent.rig import Rig, hovering_rig, ready_rig

HEIGHT_M = 1.0
NO_FARTHER_M = 0.3


def _climbing(ticks: int) -> Rig:
    rig = ready_rig()
    rig.order("takeoff", height_m=HEIGHT_M)
    for _ in range(400):
        if rig.core.flight.step is FlightStep.CLIMB:
            rig.run(0.02 * ticks)
            return rig
        rig.step()
    raise AssertionError("it does not climb")


def _highest_m(rig: Rig, seconds: float = 4.0) -> float:
    highest_m = float(rig.position[2])
    for _ in range(round(seconds / 0.02)):
        rig.step()
        highest_m = max(highest_m, float(rig.position[2]))
    return highest_m


@pytest.mark.parametrize("kind", ["land", "hold"])
@pytest.mark.parametrize("ticks", range(0, 120, 30))
def test_what_is_stopped_in_the_climb_rises_hardly_and_never_above_the_ordered_height(
    kind: OrderKind, ticks: int
) -> None:
    rig = _climbing(ticks)
    before_m = float(rig.position[2])
    assert rig.order(kind, order_id="stop").is_accepted
    assert _highest_m(rig) < min(before_m + NO_FARTHER_M, HEIGHT_M + 0.01)
    rig.run(4.0)
    assert rig.outcomes()["stop"] == "done"
    assert rig.count(agent_commands.Px4Land) == 0


def test_a_fast_climb_that_a_landing_ends_is_no_landing_that_rises() -> None:
    rig = _climbing(30)
    rig.velocity[2] = 3.0  # outdoors there is room for more than half a metre of braking
    rig.order("land", order_id="stop")
    before_m = float(rig.position[2])
    assert _highest_m(rig, 1.5) > before_m + 0.5
    rig.until("landed")
    assert rig.outcomes()["stop"] == "done"
    assert rig.count(agent_commands.Px4Land) == 0


def test_a_landing_that_goes_on_rising_is_left_to_px4() -> None:
    rig = _climbing(30)

    def rise() -> None:
        rig.velocity[2] = 0.8

    rig.order("land")
    rig.after_move = rise
    rig.run(2.5)
    assert rig.core.flight.step is FlightStep.PX4_LANDING


@pytest.mark.parametrize("low_m", [0.4, 1.2])
def test_a_hold_in_a_move_up_or_down_goes_on_hardly_and_not_past_its_goal(low_m: float) -> None:
    for ticks in range(10, 110, 45):
        rig = hovering_rig()
        rig.order("move", position_enu_m=(0.0, 0.0, 1.6 + 0.8 * (1.0 if low_m > 1.0 else -1.0)))
        rig.run(0.02 * ticks)
        before_m = float(rig.position[2])
        rig.order("hold", order_id="stop")
        heights_m = []
        for _ in range(200):
            rig.step()
            heights_m.append(float(rig.position[2]))
        goal_m = rig.core.flight.goal_position_enu_m[2]
        assert max(heights_m) < before_m + NO_FARTHER_M, ticks
        assert min(heights_m) > before_m - NO_FARTHER_M, ticks
        assert abs(heights_m[-1] - goal_m) < 0.02
        assert rig.outcomes()["stop"] == "done"


def test_a_hold_in_hover_and_a_move_by_millimetres_ask_for_hardly_any_tilt() -> None:
    for kind, fields in (("hold", {}), ("move", {"position_enu_m": (0.004, 0.0, 1.0)})):
        rig = hovering_rig()
        rig.run(1.0)
        rig.position[0] += 0.004
        rig.run(0.1)
        rig.order(kind, **fields)  # type: ignore[arg-type]
        tilts_deg = []
        for _ in range(100):
            rig.step()
            assert rig.setpoint is not None
            tilts_deg.append(
                math.degrees(math.acos(min(1.0, body_up(rig.setpoint.quaternion_wxyz)[2])))
            )
        assert max(tilts_deg) < 1.5, kind
