"""Estimate of the throttle that carries the weight, slow and bounded.

Thrust is linear in throttle: a_z + g = (throttle/hover) g cos(tilt). The battery's sag and a wrong mass change the
hover throttle within tens of seconds, so the estimate follows with seconds; the disturbance observer does what is
faster. Near the ground (ground effect, contact) and while the throttle saturates the equation does not hold: frozen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from onboard.types import GRAVITY_M_S2, Array, BoolArray, light


@dataclass(frozen=True, slots=True)
class HoverThrustParams:
    """configured_frac (...): the vehicle's own value. max_deviation: share of it that the estimate may leave it by.

    time_constant_s: of the estimate. motor_lag_s: of the throttle's effect. min_height_m: frozen below.
    max_acceleration_m_s2: frozen beyond, where the model is coarse. min/max_thrust_frac: frozen at these.
    """

    configured_frac: Array | float
    max_deviation: float = 0.2
    time_constant_s: float = 4.0
    motor_lag_s: float = 0.05
    min_height_m: float = 0.3
    max_acceleration_m_s2: float = 2.0
    min_thrust_frac: Array | float = 0.1
    max_thrust_frac: Array | float = 0.97


@light
@dataclass(frozen=True, slots=True)
class HoverThrustMemory:
    """hover_thrust_frac (...): the estimate. effective_thrust_frac (...): throttle behind the motor lag."""

    hover_thrust_frac: Array
    effective_thrust_frac: Array


def initial(shape: tuple[int, ...] = (), *, params: HoverThrustParams) -> HoverThrustMemory:
    """The configured value, for a batch of ``shape``."""
    configured = np.broadcast_to(np.asarray(params.configured_frac, dtype=np.float64), shape).copy()
    return HoverThrustMemory(configured, np.zeros(shape))


def step(
    memory: HoverThrustMemory,
    thrust_frac: Array,
    cos_tilt: Array,
    vertical_acceleration_m_s2: Array,
    height_m: Array,
    *,
    params: HoverThrustParams,
    dt_s: float,
    is_flying: BoolArray | bool = True,
) -> tuple[HoverThrustMemory, Array]:
    """One tick.

    Args:
        thrust_frac: (...) throttle sent on the last tick. cos_tilt: (...) of the attitude flown.
        vertical_acceleration_m_s2: (...) estimated, up positive, without gravity. height_m: (...) above the ground.
        is_flying: (...) False (on the ground, lifting off) freezes the estimate; the motors are followed all the same.
    Returns:
        memory and hover_thrust_frac (...), within max_deviation of the configured value, always finite.
    """
    if memory.hover_thrust_frac.ndim == 0:
        values = (float(thrust_frac), float(cos_tilt), float(vertical_acceleration_m_s2), float(height_m))
        return _step_one(memory, values, params, dt_s, bool(is_flying))
    blend = 1.0 - np.exp(-dt_s / params.motor_lag_s)
    sent = np.where(np.isfinite(thrust_frac), thrust_frac, memory.effective_thrust_frac)
    effective = memory.effective_thrust_frac + blend * (sent - memory.effective_thrust_frac)
    acceleration = np.where(np.isfinite(vertical_acceleration_m_s2), vertical_acceleration_m_s2, np.inf)
    usable = (
        np.asarray(is_flying)
        & (height_m > params.min_height_m)
        & (np.abs(acceleration) < params.max_acceleration_m_s2)
        & (cos_tilt > 0.5)
        & (effective > params.min_thrust_frac)
        & (effective < params.max_thrust_frac)
    )
    lift_m_s2 = GRAVITY_M_S2 + np.where(usable, acceleration, 0.0)
    seen = effective * np.where(usable, cos_tilt, 1.0) * GRAVITY_M_S2 / lift_m_s2
    rate = np.where(usable, dt_s / params.time_constant_s, 0.0)
    hover = memory.hover_thrust_frac + rate * (seen - memory.hover_thrust_frac)
    low, high = 1.0 - params.max_deviation, 1.0 + params.max_deviation
    hover = np.minimum(np.maximum(hover, low * params.configured_frac), high * params.configured_frac)
    return replace(memory, hover_thrust_frac=hover, effective_thrust_frac=effective), hover


def _step_one(
    memory: HoverThrustMemory, values: tuple[float, float, float, float], params: HoverThrustParams, dt_s: float,
    is_flying: bool,
) -> tuple[HoverThrustMemory, Array]:  # fmt: skip
    """:func:`step` for one vehicle, in floats."""
    sent, cos_tilt, acceleration, height_m = values
    hover, effective = float(memory.hover_thrust_frac), float(memory.effective_thrust_frac)
    if math.isfinite(sent):
        effective += (1.0 - math.exp(-dt_s / params.motor_lag_s)) * (sent - effective)
    if (
        is_flying
        and height_m > params.min_height_m
        and abs(acceleration) < params.max_acceleration_m_s2
        and cos_tilt > 0.5
        and float(params.min_thrust_frac) < effective < float(params.max_thrust_frac)
    ):
        seen = effective * cos_tilt * GRAVITY_M_S2 / (GRAVITY_M_S2 + acceleration)
        hover += dt_s / params.time_constant_s * (seen - hover)
    configured = float(params.configured_frac)
    hover = min(max(hover, (1.0 - params.max_deviation) * configured), (1.0 + params.max_deviation) * configured)
    found = np.array(hover)
    return HoverThrustMemory(found, np.array(effective)), found
