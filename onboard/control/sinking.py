"""Descent without poses: the vehicle brakes horizontally, and sinks with a bounded speed.

Dead reckoning loses accuracy with every second. So the vehicle sinks at once, and as fast as it can
still slow down in time. It sinks slowly only where the ground may be. Its height comes from PX4,
which is wrong by up to a third of a metre, and by more if it comes from satellites. Horizontal and
vertical speeds are tracked, but no position is. So a vehicle that the law has pushed aside does not
return.

As in trajectory.py, a setpoint refers to the time at which a command given now acts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.prediction import Motion
from onboard.control.trajectory import TrajectoryMemory
from onboard.types import GRAVITY_M_S2, Goal, TrajectorySetpoint
from onboard.vectors import Vec3

# fastest descent; the rotors push the air down faster, and a vehicle must not sink into that air
FAST_M_S = 2.0
SLOW_M_S = 0.8  # a vehicle survives a touchdown at this speed

# Below this height the ground may be: error of the height, and a reserve. With a mocap, PX4's
# height was compared with the poses while they came. A height from satellites is less accurate.
SLOW_BELOW_M = 0.45
SLOW_BELOW_WITHOUT_MOCAP_M = 1.2

_BRAKE_FACTOR = 1.6  # horizontal braking, relative to the acceleration of a usual flight

# The largest vertical acceleration, and its share of the lift reserve. Above the ground the vehicle
# slows down with a part of it, so that the rest can correct errors.
_VERTICAL_M_S2 = 3.5
_LIFT_SHARE = 0.75
_RISE_SHARE = 0.6

_STEP_S = 0.02  # time step in which the duration of a descent is summed up


class SinkingParams(NamedTuple):
    """Numbers of a descent without poses."""

    brake_m_s2: float  # horizontal braking
    vertical_m_s2: float  # largest acceleration up and down
    rise_m_s2: float  # upwards, to slow down above the ground
    slow_below_m: float  # height below which the vehicle sinks slowly


def sinking_params(
    max_acceleration_m_s2: float, hover_frac: float, *, has_mocap: bool
) -> SinkingParams:
    """Return the numbers of a vehicle's descent without poses.

    Args:
        max_acceleration_m_s2: acceleration of its usual flight.
        hover_frac: throttle that carries its weight.
        has_mocap: whether poses of a motion capture have shown the error of PX4's height.
    """
    lift_reserve_m_s2 = (1.0 / hover_frac - 1.0) * GRAVITY_M_S2
    vertical_m_s2 = min(_VERTICAL_M_S2, _LIFT_SHARE * lift_reserve_m_s2)
    return SinkingParams(
        brake_m_s2=_BRAKE_FACTOR * max_acceleration_m_s2,
        vertical_m_s2=vertical_m_s2,
        rise_m_s2=_RISE_SHARE * vertical_m_s2,
        slow_below_m=SLOW_BELOW_M if has_mocap else SLOW_BELOW_WITHOUT_MOCAP_M,
    )


def sink_speed_m_s(height_m: float, params: SinkingParams) -> float:
    """Return the largest speed of sinking [m/s] from which the vehicle still slows down in time.

    Args:
        height_m: height above the ground.
        params: accelerations, and the height below which the vehicle has to be slow.
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
        leg: memory of the last tick; its horizontal velocity is used.
        ahead: own motion at t + L.
        goal: its height is that of the ground. A new sequence begins from the own velocity.
        params: accelerations.
        limit_m_s: limit of the speed of sinking, because of neighbours below; infinite without any.
        dt_s: length of the tick.
    """
    position = ahead.position_enu_m
    before = leg.start_velocity_enu_m_s
    if goal.sequence != leg.sequence:
        before = ahead.velocity_enu_m_s

    speed_m_s = math.sqrt(before.x * before.x + before.y * before.y)
    kept_share = max(0.0, speed_m_s - params.brake_m_s2 * dt_s) / max(speed_m_s, 1e-9)
    braking_1_s = params.brake_m_s2 / max(speed_m_s, 1e-9) if kept_share > 0.0 else 0.0

    # Where the allowed speed falls with the height, a vehicle at that speed needs the upward
    # acceleration in its setpoint, too.
    height_m = position.z - goal.position_enu_m.z
    sink_m_s = sink_speed_m_s(height_m, params)
    rise_m_s2 = params.rise_m_s2 if SLOW_M_S < sink_m_s < FAST_M_S else 0.0
    is_fast_already = -ahead.velocity_enu_m_s.z > sink_m_s
    if not is_fast_already:
        rise_m_s2 = 0.0

    velocity = Vec3(kept_share * before.x, kept_share * before.y, -min(sink_m_s, limit_m_s))
    acceleration = Vec3(-braking_1_s * before.x, -braking_1_s * before.y, rise_m_s2)

    # a leg that has just begun with this motion, so that the next leg continues it
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
