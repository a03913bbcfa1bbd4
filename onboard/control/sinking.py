"""Descent without poses: brake, and sink by vertical speed.

Dead reckoning is good for a few seconds, and each of them costs accuracy. So the vehicle sinks at
once and as fast as it can stop again, and slowly only where the ground may be: its height is PX4's,
which is wrong by up to a third of a metre, and by satellites by more. It returns to no setpoint:
both speeds are tracked and no position is, so that a vehicle which the law has pushed aside stays
there.

Time: as in trajectory.py, the motion is that for which a command given now acts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.prediction import Motion
from onboard.control.trajectory import TrajectoryMemory
from onboard.types import GRAVITY_M_S2, Goal, TrajectorySetpoint
from onboard.vectors import Vec3

FAST_M_S = 2.0  # slower than the air that the rotors push down, into which a vehicle must not sink
SLOW_M_S = 0.8  # which a vehicle survives that meets the ground unseen

# Height up to which the ground may be: the error of the height, and a reserve. PX4 compares its own
# with the poses as long as they come; by satellites it is worse.
SLOW_BELOW_M = 0.45
SLOW_BELOW_WITHOUT_MOCAP_M = 1.2

_BRAKE = 1.6  # times as hard as on a leg

# It uses more of its lift than otherwise, up to a bound. Above the ground it slows down with a
# share of that, so that the rest can correct.
_LIFT_SHARE = 0.75
_VERTICAL_M_S2 = 3.5
_RISE_SHARE = 0.6

_STEP_S = 0.02


class SinkingParams(NamedTuple):
    """Numbers of a descent without poses."""

    brake_m_s2: float  # horizontal
    vertical_m_s2: float  # up and down, the largest
    rise_m_s2: float  # upwards, with which it slows down above the ground
    slow_below_m: float  # height up to which it is slow


def sinking_params(
    max_acceleration_m_s2: float, hover_frac: float, *, has_mocap: bool
) -> SinkingParams:
    """Return the numbers of a vehicle.

    Args:
        max_acceleration_m_s2: of its legs.
        hover_frac: throttle that carries its weight.
        has_mocap: whether poses of a motion capture have shown how wrong PX4's height is.
    """
    lift_reserve_m_s2 = (1.0 / hover_frac - 1.0) * GRAVITY_M_S2
    vertical_m_s2 = min(_VERTICAL_M_S2, _LIFT_SHARE * lift_reserve_m_s2)
    return SinkingParams(
        brake_m_s2=_BRAKE * max_acceleration_m_s2,
        vertical_m_s2=vertical_m_s2,
        rise_m_s2=_RISE_SHARE * vertical_m_s2,
        slow_below_m=SLOW_BELOW_M if has_mocap else SLOW_BELOW_WITHOUT_MOCAP_M,
    )


def sink_speed_m_s(height_m: float, params: SinkingParams) -> float:
    """Return the speed of sinking from which the vehicle is still slow in time.

    Args:
        height_m: above the ground.
        params: accelerations, and where it has to be slow.
    """
    above_m = max(0.0, height_m - params.slow_below_m)
    return min(FAST_M_S, math.sqrt(SLOW_M_S * SLOW_M_S + 2.0 * params.rise_m_s2 * above_m))


def sinking_s(height_m: float, params: SinkingParams) -> float:
    """Return the duration [s] of a descent from rest to the ground.

    Args:
        height_m: above the ground.
        params: accelerations.
    """
    duration_s = 0.0
    speed_m_s = 0.0
    left_m = height_m
    while left_m > 0.0:
        faster_m_s = speed_m_s + params.vertical_m_s2 * _STEP_S
        speed_m_s = min(faster_m_s, sink_speed_m_s(left_m, params))
        left_m -= speed_m_s * _STEP_S
        duration_s += _STEP_S
    return duration_s


def step(
    leg: TrajectoryMemory,
    ahead: Motion,
    goal: Goal,
    params: SinkingParams,
    limit_m_s: float,
    dt_s: float,
) -> tuple[TrajectoryMemory, TrajectorySetpoint]:
    """Return the memory and the setpoint after one tick.

    Args:
        leg: memory of the last tick; of its motion the horizontal speed is used.
        ahead: own motion at t + L.
        goal: its height is that of the ground; a new sequence begins from the own motion.
        params: accelerations.
        limit_m_s: of the speed of sinking, because of others below; infinite without any.
        dt_s: length of the tick.
    """
    position = ahead.position_enu_m
    before = leg.start_velocity_enu_m_s
    if goal.sequence != leg.sequence:
        before = ahead.velocity_enu_m_s

    speed_m_s = math.sqrt(before.x * before.x + before.y * before.y)
    kept = max(0.0, speed_m_s - params.brake_m_s2 * dt_s) / max(speed_m_s, 1e-9)
    braking_1_s = params.brake_m_s2 / max(speed_m_s, 1e-9) if kept > 0.0 else 0.0

    # on the way from fast to slow the setpoint slows down, too
    height_m = position.z - goal.position_enu_m.z
    sink_m_s = sink_speed_m_s(height_m, params)
    rise_m_s2 = params.rise_m_s2 if SLOW_M_S < sink_m_s < FAST_M_S else 0.0
    is_fast_already = -ahead.velocity_enu_m_s.z > sink_m_s
    if not is_fast_already:
        rise_m_s2 = 0.0

    velocity = Vec3(kept * before.x, kept * before.y, -min(sink_m_s, limit_m_s))
    acceleration = Vec3(-braking_1_s * before.x, -braking_1_s * before.y, rise_m_s2)

    # the begin of a leg of which no time has passed, so that the next one continues this motion
    after = TrajectoryMemory(
        start_position_enu_m=position,
        start_velocity_enu_m_s=velocity,
        start_acceleration_enu_m_s2=acceleration,
        via_position_enu_m=position,
        goal_position_enu_m=position,
        first_duration_s=1.0,
        second_duration_s=0.0,
        elapsed_s=0.0,
        clock_rate=1.0,
        sequence=goal.sequence,
    )
    return after, TrajectorySetpoint(position, velocity, acceleration)
