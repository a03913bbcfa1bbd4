"""Descent without poses: the vehicle brakes horizontally, and sinks with a bounded speed.

Dead reckoning loses accuracy with every second. So the vehicle sinks at once, and as fast as still
allows it to slow down in time. It sinks slowly only where the ground may be. Its height comes from
PX4, which is wrong by up to a third of a metre, and by more if it comes from satellites. Horizontal
and vertical speeds are tracked, but no position. So a vehicle that the law has pushed aside does
not return.

As in trajectory.py, a setpoint refers to the time at which a command given now acts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.avoidance.prediction import Motion
from onboard.control.trajectory import TrajectoryMemory, leg_begun_with
from onboard.control.vertical_limits import lift_reserve_m_s2
from onboard.types import Goal, TrajectorySetpoint
from onboard.vectors import Vec3

# fastest descent; the rotors push the air down faster than this, and a vehicle must not sink into
# that air
FAST_M_S = 2.0
SLOW_M_S = 0.8  # a vehicle survives a touchdown at this speed

# Below this height above the expected ground the vehicle may touch the real ground at any moment.
# The number is the error of PX4's height plus a reserve. With a mocap that error is small, because
# PX4's height was compared with the poses while they came.
SLOW_BELOW_M = 0.45
SLOW_BELOW_WITHOUT_MOCAP_M = 1.2

_BRAKE_FACTOR = 1.6  # horizontal braking, relative to the acceleration of a usual flight

# Limits of the vertical acceleration; the smaller one counts.
_VERTICAL_M_S2 = 3.5
_LIFT_SHARE = 0.75  # share of the lift reserve

# Share of the vertical acceleration that the vehicle plans for slowing down above the ground. The
# rest is for correcting errors.
_RISE_SHARE = 0.6

_STEP_S = 0.02  # step of the simulated descent that gives its duration


class SinkingParams(NamedTuple):
    """Numbers of a descent without poses."""

    brake_m_s2: float  # horizontal braking
    vertical_m_s2: float  # largest acceleration up and down
    rise_m_s2: float  # upwards, for slowing down above the ground
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
    vertical_m_s2 = min(_VERTICAL_M_S2, _LIFT_SHARE * lift_reserve_m_s2(hover_frac))
    slow_below_m = SLOW_BELOW_WITHOUT_MOCAP_M
    if has_mocap:
        slow_below_m = SLOW_BELOW_M
    return SinkingParams(
        brake_m_s2=_BRAKE_FACTOR * max_acceleration_m_s2,
        vertical_m_s2=vertical_m_s2,
        rise_m_s2=_RISE_SHARE * vertical_m_s2,
        slow_below_m=slow_below_m,
    )


def sink_speed_m_s(height_m: float, params: SinkingParams) -> float:
    """Return the largest sink speed [m/s] from which the vehicle can still slow down in time.

    Args:
        height_m: height above the ground.
        params: accelerations, and the height below which the vehicle must be slow.
    """
    above_m = max(0.0, height_m - params.slow_below_m)
    return min(FAST_M_S, math.sqrt(SLOW_M_S * SLOW_M_S + 2.0 * params.rise_m_s2 * above_m))


def sinking_s(height_m: float, params: SinkingParams) -> float:
    """Return the duration [s] of a descent from rest to the ground.

    Args:
        height_m: height above the ground.
        params: accelerations.
    """
    duration_s = 0.0
    speed_m_s = 0.0
    remaining_m = height_m
    while remaining_m > 0.0:
        faster_m_s = speed_m_s + params.vertical_m_s2 * _STEP_S
        speed_m_s = min(faster_m_s, sink_speed_m_s(remaining_m, params))
        remaining_m -= speed_m_s * _STEP_S
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
        ahead: our own motion at t + L.
        goal: its height is that of the ground. A new sequence starts from our own velocity.
        params: accelerations.
        limit_m_s: limit of the sink speed because of neighbours below; infinite if there are none.
        dt_s: length of the tick.
    """
    position = ahead.position_enu_m
    last_velocity = leg.start_velocity_enu_m_s
    if goal.sequence != leg.sequence:
        last_velocity = ahead.velocity_enu_m_s

    # The horizontal velocity keeps its direction and loses speed at the braking deceleration. The
    # last velocity is multiplied by both factors below; 1e-9 avoids a division by zero.
    speed_m_s = math.sqrt(last_velocity.x * last_velocity.x + last_velocity.y * last_velocity.y)
    remaining_share = max(0.0, speed_m_s - params.brake_m_s2 * dt_s) / max(speed_m_s, 1e-9)
    braking_1_s = 0.0
    if remaining_share > 0.0:
        braking_1_s = params.brake_m_s2 / max(speed_m_s, 1e-9)

    # Between its two bounds, the allowed speed falls with the height. If the vehicle is already too
    # fast there, its setpoint also needs an upward acceleration.
    height_m = position.z - goal.position_enu_m.z
    sink_m_s = sink_speed_m_s(height_m, params)
    must_slow_down = SLOW_M_S < sink_m_s < FAST_M_S
    is_too_fast = -ahead.velocity_enu_m_s.z > sink_m_s
    rise_m_s2 = 0.0
    if must_slow_down and is_too_fast:
        rise_m_s2 = params.rise_m_s2

    velocity = Vec3(
        remaining_share * last_velocity.x,
        remaining_share * last_velocity.y,
        -min(sink_m_s, limit_m_s),
    )
    acceleration = Vec3(-braking_1_s * last_velocity.x, -braking_1_s * last_velocity.y, rise_m_s2)

    after = leg_begun_with(position, velocity, acceleration, goal.sequence, 1.0)
    return after, TrajectorySetpoint(position, velocity, acceleration)
