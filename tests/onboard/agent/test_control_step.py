"""In which control modes a vehicle waits for another one."""

from __future__ import annotations

import pytest

from onboard.agent.control_step import ControlStep
from onboard.config.fleet import load_fleet
from onboard.control import router
from onboard.control.control_mode import ControlMode
from onboard.frames import yaw_from_quaternion
from onboard.rollout.rows import zero
from onboard.types import Goal, Neighbour, State
from onboard.vectors import Vec3

TICK_S = 0.02
RIVAL_INDEX = 3


@pytest.mark.parametrize(
    ("mode", "waits_for"),
    [(ControlMode.FLYING, RIVAL_INDEX), (ControlMode.LANDING, router.NOBODY)],
)
def test_a_vehicle_waits_for_a_rival_in_flight_but_not_in_a_landing(
    mode: ControlMode, waits_for: int
) -> None:
    """A vehicle that lands would sink to the ground at full speed on the way to a refuge."""
    control = ControlStep(load_fleet("configs/fleets/paper.toml"), "mav0")
    own: State = zero(State)
    own = own._replace(position_enu_m=Vec3(-0.45, 0.0, 1.0))
    goal = Goal(Vec3(0.0, 0.0, -0.3), 4.0, sequence=1)
    rival: Neighbour = zero(Neighbour)
    rival = rival._replace(
        position_enu_m=Vec3(0.45, 0.0, 1.0),
        predicted_position_enu_m=Vec3(0.45, 0.0, 1.0),
        intent_enu_m_s=Vec3(-0.45, 0.0, -0.5),
        is_cooperative=True,
        table_index=RIVAL_INDEX,
    )
    for _ in range(round(5.0 / TICK_S)):
        control.run(own, goal, mode, [rival], TICK_S)
    assert control.waits_for == waits_for


def test_a_level_attitude_keeps_the_heading() -> None:
    control = ControlStep(load_fleet("configs/fleets/paper.toml"), "mav0")
    standing: State = zero(State)
    standing = standing._replace(yaw_rad=2.1)
    goal = Goal(Vec3(0.0, 0.0, 1.0), 4.0, sequence=1)
    control.run(standing, goal, ControlMode.GROUND, [], TICK_S)
    assert yaw_from_quaternion(control.level().quaternion_wxyz) == pytest.approx(2.1)
