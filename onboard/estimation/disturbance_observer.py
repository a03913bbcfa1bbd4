"""Disturbance observer: estimates the acceleration that commands and drag do not explain.

A model applies the vehicle's commands through the attitude lag, and predicts the velocity. The
difference between the measured and the predicted velocity gives the disturbance s_b. The model uses
the commands, not the measured attitude, so s_b includes static attitude-loop errors and tilt bias.
The vehicle is commanded the acceleration ``u - s_b + c V``: u is the desired acceleration, c the
drag and V the velocity (line O in avoidance/README.md).

The observer is the integral action of the control. It uses the command after all limits, so it does
not wind up when a limit or the avoidance law changes the command.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.vectors import ZERO_3, Vec3, add_scaled, bounded, finite_or, subtract

HISTORY_TICKS = 8  # number of past commands kept; together they must cover more than the delay


class ObserverParams(NamedTuple):
    """Model of the response to commands, and the observer's bandwidth."""

    bandwidth_rad_s: float = 4.0  # w; both poles are at -w

    # horizontal response: dead time and second order
    delay_s: float = 0.04
    wn_rad_s: float = 11.0
    zeta: float = 0.6

    vertical_lag_s: float = 0.06  # time constant of the first-order vertical response
    drag_1_s: float = 0.0

    max_disturbance_m_s2: float = 1.5  # bound of each axis
    mean_time_s: float = 2.0  # time constant of the mean disturbance
    # Bound of the difference between disturbance and mean, per axis. A larger difference is
    # clipped, because it comes from a jump of the poses, not from wind.
    max_miss_m_s2: float = 0.8


class ObserverMemory(NamedTuple):
    """State of the observer and of the lag model."""

    velocity_enu_m_s: Vec3  # observer's own velocity, which follows the measured one
    disturbance_enu_m_s2: Vec3  # s_b
    # mean of s_b over the last seconds, which is used instead of s_b at lift-off and without poses
    mean_enu_m_s2: Vec3
    response_enu_m_s2: Vec3  # model's acceleration in response to the commands
    response_rate_enu_m_s3: Vec3  # its derivative
    commands_enu_m_s2: tuple[Vec3, ...]  # last HISTORY_TICKS commands, newest first, no gravity


class _Axis(NamedTuple):
    """One axis of the memory."""

    velocity_m_s: float
    disturbance_m_s2: float
    response_m_s2: float
    rate_m_s3: float  # derivative of the response


_NO_COMMANDS = (ZERO_3,) * HISTORY_TICKS


def initial(velocity_enu_m_s: Vec3) -> ObserverMemory:
    """Return the memory of a vehicle at a velocity [m/s], ENU, without disturbance and commands."""
    return ObserverMemory(
        velocity_enu_m_s=velocity_enu_m_s,
        disturbance_enu_m_s2=ZERO_3,
        mean_enu_m_s2=ZERO_3,
        response_enu_m_s2=ZERO_3,
        response_rate_enu_m_s3=ZERO_3,
        commands_enu_m_s2=_NO_COMMANDS,
    )


def step(
    memory: ObserverMemory,
    velocity_enu_m_s: Vec3,
    command_enu_m_s2: Vec3,
    params: ObserverParams,
    dt_s: float,
    is_frozen: bool,
) -> tuple[ObserverMemory, Vec3]:
    """Return memory and disturbance after a tick.

    The observer is x' = a_model - c v + s_b + 2 w (v - x), s_b' = w^2 (v - x). Here x is its own
    velocity, v the measured velocity and w the bandwidth.

    Args:
        memory: memory of the last tick.
        velocity_enu_m_s: present estimate [m/s], ENU. A component that is not finite is replaced by
            the observer's own velocity.
        command_enu_m_s2: acceleration commanded since the last tick, after every limit and without
            gravity [m/s^2], ENU. Its horizontal part comes from the attitude, its vertical part
            from the throttle. A component that is not finite is replaced by the last command.
        params: model and bandwidth.
        dt_s: length of the tick.
        is_frozen: whether s_b is kept, and only the model is updated: on the ground, at lift-off,
            or without a position.
    Returns:
        Memory, and s_b [m/s^2], ENU.
    Properties: yaw-rotation-equivariant; s_b is zero for a vehicle that moves like the model.
    """
    measured = finite_or(velocity_enu_m_s, memory.velocity_enu_m_s)
    command = finite_or(command_enu_m_s2, memory.commands_enu_m_s2[0])
    commands = (command,) + memory.commands_enu_m_s2[:-1]  # noqa: RUF005  numba compiles no unpacking

    # Interpolate the command one dead time ago linearly between two ticks. The bound keeps the
    # index whole + 1 within the list.
    ticks = min(params.delay_s / dt_s, HISTORY_TICKS - 1.000001)
    whole = int(ticks)
    share = ticks - whole
    newer = commands[whole]
    older = commands[whole + 1]
    delayed_x = newer.x + share * (older.x - newer.x)
    delayed_y = newer.y + share * (older.y - newer.y)

    v = memory.velocity_enu_m_s
    s = memory.disturbance_enu_m_s2
    a = memory.response_enu_m_s2
    r = memory.response_rate_enu_m_s3
    x = _horizontal(_Axis(v.x, s.x, a.x, r.x), measured.x, delayed_x, params, dt_s)
    y = _horizontal(_Axis(v.y, s.y, a.y, r.y), measured.y, delayed_y, params, dt_s)
    z = _vertical(_Axis(v.z, s.z, a.z, r.z), measured.z, command.z, params, dt_s)

    if is_frozen:
        velocity = measured
        disturbance = memory.disturbance_enu_m_s2
        mean = memory.mean_enu_m_s2
    else:
        velocity = Vec3(x.velocity_m_s, y.velocity_m_s, z.velocity_m_s)
        disturbance = Vec3(x.disturbance_m_s2, y.disturbance_m_s2, z.disturbance_m_s2)
        miss = bounded(subtract(disturbance, memory.mean_enu_m_s2), params.max_miss_m_s2)
        mean = add_scaled(memory.mean_enu_m_s2, dt_s / params.mean_time_s, miss)

    after = ObserverMemory(
        velocity_enu_m_s=velocity,
        disturbance_enu_m_s2=disturbance,
        mean_enu_m_s2=mean,
        response_enu_m_s2=Vec3(x.response_m_s2, y.response_m_s2, z.response_m_s2),
        response_rate_enu_m_s3=Vec3(x.rate_m_s3, y.rate_m_s3, z.rate_m_s3),
        commands_enu_m_s2=commands,
    )
    return after, disturbance


def lifting_off(
    memory: ObserverMemory,
    velocity_enu_m_s: Vec3,
    acceleration_enu_m_s2: Vec3,
    params: ObserverParams,
) -> ObserverMemory:
    """Return the memory with the horizontal disturbance that the estimated acceleration shows.

    The observer is frozen at lift-off, because the ground holds the vehicle. An observer that then
    began at zero would need half a second to learn the wind, and the vehicle would be blown aside
    by more than a metre in a strong one.

    Args:
        memory: memory of this tick.
        velocity_enu_m_s: present estimate [m/s], ENU.
        acceleration_enu_m_s2: present estimate [m/s^2], ENU. A component that is not finite leaves
            the disturbance unchanged.
        params: model and bound.
    """
    before = memory.disturbance_enu_m_s2
    without_drag = add_scaled(acceleration_enu_m_s2, params.drag_1_s, velocity_enu_m_s)
    unexplained = finite_or(subtract(without_drag, memory.response_enu_m_s2), before)
    disturbance = bounded(unexplained, params.max_disturbance_m_s2)

    return ObserverMemory(
        velocity_enu_m_s=memory.velocity_enu_m_s,
        disturbance_enu_m_s2=Vec3(disturbance.x, disturbance.y, before.z),
        mean_enu_m_s2=memory.mean_enu_m_s2,
        response_enu_m_s2=memory.response_enu_m_s2,
        response_rate_enu_m_s3=memory.response_rate_enu_m_s3,
        commands_enu_m_s2=memory.commands_enu_m_s2,
    )


def expecting(
    memory: ObserverMemory, push_enu_m_s2: Vec3, params: ObserverParams
) -> ObserverMemory:
    """Return the memory of a vehicle on the ground that expects a push after its lift-off.

    Args:
        memory: memory of the last tick.
        push_enu_m_s2: expected push of the wind [m/s^2], ENU, finite.
        params: bound.
    """
    push = bounded(push_enu_m_s2, params.max_disturbance_m_s2)
    return memory._replace(mean_enu_m_s2=push)


def _horizontal(
    axis: _Axis, measured_m_s: float, command_m_s2: float, params: ObserverParams, dt_s: float
) -> _Axis:
    """Return a horizontal axis after a tick of its second-order response.

    The response is integrated by the implicit midpoint rule, which is stable for any tick length.
    """
    wn = params.wn_rad_s
    half = 0.5 * dt_s
    push = wn * wn * (command_m_s2 - axis.response_m_s2)
    damping = 1.0 + 2.0 * half * params.zeta * wn + half * half * wn * wn
    middle = (axis.rate_m_s3 + half * push) / damping  # the rate in the middle of the tick

    response = axis.response_m_s2 + dt_s * middle
    rate = 2.0 * middle - axis.rate_m_s3
    return _observed(axis, measured_m_s, response, rate, params, dt_s)


def _vertical(
    axis: _Axis, measured_m_s: float, command_m_s2: float, params: ObserverParams, dt_s: float
) -> _Axis:
    """Return the vertical axis after a tick of the motors' first-order lag."""
    blend = 1.0 - math.exp(-dt_s / params.vertical_lag_s)
    response = axis.response_m_s2 + blend * (command_m_s2 - axis.response_m_s2)
    return _observed(axis, measured_m_s, response, 0.0, params, dt_s)


def _observed(
    axis: _Axis,
    measured_m_s: float,
    response_m_s2: float,
    rate_m_s3: float,
    params: ObserverParams,
    dt_s: float,
) -> _Axis:
    """Return the axis with velocity and disturbance corrected by the measured velocity.

    The gains put both discrete poles at exp(-w T), with the bandwidth w and the tick T.
    """
    acting = 0.5 * (response_m_s2 + axis.response_m_s2)  # response in the middle of the tick
    net = acting - params.drag_1_s * measured_m_s + axis.disturbance_m_s2
    forecast = axis.velocity_m_s + dt_s * net
    miss = measured_m_s - forecast

    decay = math.exp(-params.bandwidth_rad_s * dt_s)
    velocity = forecast + (1.0 - decay * decay) * miss
    disturbance = axis.disturbance_m_s2 + (1.0 - decay) * (1.0 - decay) / dt_s * miss
    bound = params.max_disturbance_m_s2
    return _Axis(
        velocity_m_s=velocity,
        disturbance_m_s2=min(max(disturbance, -bound), bound),
        response_m_s2=response_m_s2,
        rate_m_s3=rate_m_s3,
    )
