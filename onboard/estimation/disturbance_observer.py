"""Disturbance observer: the acceleration that the own commands and the drag do not explain.

A model of the own commands through the attitude lag predicts the velocity; the rest is the
disturbance s_b. The model starts from the commands and not from the measured attitude, so that a
static error of the attitude loop and a tilt bias are part of s_b. The vehicle is commanded ``u -
s_b + c V`` (line O in avoidance/README.md). The command really sent enters here, after all limits,
so that neither saturation nor the avoidance law charges the observer: it is the baseline's integral
action.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.vectors import ZERO_3, Vec3, add_scaled, bounded, subtract

HISTORY_TICKS = 8  # commands kept; longer than the delay


class ObserverParams(NamedTuple):
    """Model of the response to commands, and the observer's speed."""

    bandwidth_rad_s: float = 4.0  # both poles
    delay_s: float = 0.04  # dead time of the horizontal response
    wn_rad_s: float = 11.0  # second order of the horizontal response
    zeta: float = 0.6
    vertical_lag_s: float = 0.06  # first order of the vertical response
    drag_1_s: float = 0.0
    max_disturbance_m_s2: float = 1.5  # per axis
    mean_time_s: float = 2.0
    max_mean_m_s2: float = 0.8  # per axis


class ObserverMemory(NamedTuple):
    """State of the observer and of the lag model."""

    velocity_enu_m_s: Vec3
    disturbance_enu_m_s2: Vec3  # s_b
    mean_enu_m_s2: (
        # of s_b over the last seconds, bounded: worth more than its last value once nothing is
        # measured
        Vec3
    )
    response_enu_m_s2: Vec3  # acceleration that the model of the commands has now
    response_rate_enu_m_s3: Vec3
    commands_enu_m_s2: tuple[Vec3, ...]  # HISTORY_TICKS of them, newest first, without gravity


class _Axis(NamedTuple):
    """The memory of one axis."""

    velocity_m_s: float
    disturbance_m_s2: float
    response_m_s2: float
    rate_m_s3: float


_NO_COMMANDS = (ZERO_3,) * HISTORY_TICKS


def initial(velocity_enu_m_s: Vec3) -> ObserverMemory:
    """Return the memory of a vehicle at a velocity [m/s], ENU: no disturbance known, commands so
    far zero.
    """
    return ObserverMemory(velocity_enu_m_s, ZERO_3, ZERO_3, ZERO_3, ZERO_3, _NO_COMMANDS)


def step(
    memory: ObserverMemory,
    velocity_enu_m_s: Vec3,
    command_enu_m_s2: Vec3,
    params: ObserverParams,
    dt_s: float,
    is_frozen: bool,
) -> tuple[ObserverMemory, Vec3]:
    """One tick of x' = a_model - c v + s_b + 2 w (v - x), s_b' = w^2 (v - x).

    Args:
        memory: of the last tick.
        velocity_enu_m_s: estimated now [m/s], ENU; a component that is not finite keeps the
            observer's own.
        command_enu_m_s2: acceleration commanded since the last tick, after every limit, without
            gravity [m/s^2], ENU (horizontal: the attitude's; vertical: throttle less gravity); not
            finite: as before.
        params: model and bandwidth.
        dt_s: length of the tick.
        is_frozen: keeps s_b (on the ground, at lift-off, without a position) while the model
            follows.
    Returns:
        Memory, and s_b [m/s^2], ENU: the acceleration beside commands and drag.
    Properties: yaw-rotation-equivariant; an obedient vehicle shows no disturbance.
    """
    measured = _finite_or(velocity_enu_m_s, memory.velocity_enu_m_s)
    command = _finite_or(command_enu_m_s2, memory.commands_enu_m_s2[0])
    commands = (command,) + memory.commands_enu_m_s2[:-1]  # noqa: RUF005  numba compiles no unpacking
    ticks = min(params.delay_s / dt_s, HISTORY_TICKS - 1.000001)
    whole = int(ticks)
    newer, older, share = commands[whole], commands[whole + 1], ticks - whole
    v, s, a, r = (
        memory.velocity_enu_m_s, memory.disturbance_enu_m_s2, memory.response_enu_m_s2, memory.response_rate_enu_m_s3,
    )  # fmt: skip
    x = _horizontal(
        _Axis(v.x, s.x, a.x, r.x), measured.x, newer.x + share * (older.x - newer.x), params, dt_s
    )
    y = _horizontal(
        _Axis(v.y, s.y, a.y, r.y), measured.y, newer.y + share * (older.y - newer.y), params, dt_s
    )
    z = _vertical(_Axis(v.z, s.z, a.z, r.z), measured.z, command.z, params, dt_s)
    velocity = Vec3(x.velocity_m_s, y.velocity_m_s, z.velocity_m_s)
    disturbance = Vec3(x.disturbance_m_s2, y.disturbance_m_s2, z.disturbance_m_s2)
    mean = memory.mean_enu_m_s2
    if is_frozen:
        velocity, disturbance = measured, memory.disturbance_enu_m_s2
    else:
        miss = subtract(bounded(disturbance, params.max_mean_m_s2), mean)
        mean = add_scaled(mean, dt_s / params.mean_time_s, miss)
    response = Vec3(x.response_m_s2, y.response_m_s2, z.response_m_s2)
    rate = Vec3(x.rate_m_s3, y.rate_m_s3, z.rate_m_s3)
    return ObserverMemory(velocity, disturbance, mean, response, rate, commands), disturbance


def _finite_or(vector: Vec3, before: Vec3) -> Vec3:
    """Return the vector with the components that are not finite as they were before."""
    return Vec3(
        vector.x if math.isfinite(vector.x) else before.x,
        vector.y if math.isfinite(vector.y) else before.y,
        vector.z if math.isfinite(vector.z) else before.z,
    )


def _horizontal(
    axis: _Axis, measured_m_s: float, command_m_s2: float, params: ObserverParams, dt_s: float
) -> _Axis:
    """One tick of a horizontal axis: second order by the implicit midpoint rule, stable for every
    tick length.
    """
    wn, half = params.wn_rad_s, 0.5 * dt_s
    push = wn * wn * (command_m_s2 - axis.response_m_s2)
    middle = (axis.rate_m_s3 + half * push) / (
        1.0 + 2.0 * half * params.zeta * wn + half * half * wn * wn
    )
    response = axis.response_m_s2 + dt_s * middle
    return _observed(axis, measured_m_s, response, 2.0 * middle - axis.rate_m_s3, params, dt_s)


def _vertical(
    axis: _Axis, measured_m_s: float, command_m_s2: float, params: ObserverParams, dt_s: float
) -> _Axis:
    """One tick of the vertical axis: the motors' first-order lag."""
    response = axis.response_m_s2 + (1.0 - math.exp(-dt_s / params.vertical_lag_s)) * (
        command_m_s2 - axis.response_m_s2
    )
    return _observed(axis, measured_m_s, response, 0.0, params, dt_s)


def _observed(
    axis: _Axis,
    measured_m_s: float,
    response_m_s2: float,
    rate_m_s3: float,
    params: ObserverParams,
    dt_s: float,
) -> _Axis:
    """Return the axis corrected by its velocity; the gains put both discrete poles on exp(-w T)."""
    acting = 0.5 * (response_m_s2 + axis.response_m_s2)
    forecast = axis.velocity_m_s + dt_s * (
        acting - params.drag_1_s * measured_m_s + axis.disturbance_m_s2
    )
    miss = measured_m_s - forecast
    decay = math.exp(-params.bandwidth_rad_s * dt_s)
    disturbance = axis.disturbance_m_s2 + (1.0 - decay) * (1.0 - decay) / dt_s * miss
    bound = params.max_disturbance_m_s2
    return _Axis(
        forecast + (1.0 - decay * decay) * miss,
        min(max(disturbance, -bound), bound),
        response_m_s2,
        rate_m_s3,
    )
