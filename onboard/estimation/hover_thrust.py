"""Estimate of the throttle that carries the weight, slow and bounded.

Thrust is linear in throttle: a_z + g = (throttle/hover) g cos(tilt). The battery's sag and a wrong
mass change the hover throttle within tens of seconds, so the estimate follows with seconds; the
disturbance observer does what is faster. Near the ground (ground effect, contact) and while the
throttle saturates the equation does not hold: frozen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.types import GRAVITY_M_S2


class HoverThrustParams(NamedTuple):
    """Speed and bounds of the estimate, and the limits beyond which it is frozen."""

    configured_frac: float  # the vehicle's own value
    max_deviation: float = 0.2  # share of the configured value that the estimate may leave it by
    time_constant_s: float = 4.0  # of the estimate
    motor_lag_s: float = 0.05  # of the throttle's effect

    # beyond these the estimate is frozen
    min_height_m: float = 0.3
    max_acceleration_m_s2: float = 2.0  # beyond, the model is coarse
    min_thrust_frac: float = 0.1
    max_thrust_frac: float = 0.97


class HoverThrustMemory(NamedTuple):
    """The estimate and the state of the motors."""

    hover_thrust_frac: float
    effective_thrust_frac: float  # throttle behind the motor lag


def initial(params: HoverThrustParams) -> HoverThrustMemory:
    """Return the memory before the first flight: the configured value, motors off."""
    return HoverThrustMemory(params.configured_frac, 0.0)


def step(
    memory: HoverThrustMemory,
    thrust_frac: float,
    cos_tilt: float,
    vertical_acceleration_m_s2: float,
    height_m: float,
    params: HoverThrustParams,
    dt_s: float,
    is_flying: bool,
) -> tuple[HoverThrustMemory, float]:
    """Return memory and hover throttle after a tick.

    Args:
        memory: of the last tick.
        thrust_frac: throttle sent on the last tick [-]; not finite: the motors stay as they are.
        cos_tilt: cosine of the tilt of the attitude flown [-].
        vertical_acceleration_m_s2: estimated, up positive, without gravity; not finite: frozen.
        height_m: above the ground; not finite: frozen.
        params: speed and bounds.
        dt_s: length of the tick.
        is_flying: False (on the ground, lifting off) freezes the estimate; the motors are followed
            all the same.
    Returns:
        Memory, and the hover throttle [-]: within max_deviation of the configured value, always
        finite.
    Properties: homogeneous in throttle.
    """
    effective_frac = memory.effective_thrust_frac
    if math.isfinite(thrust_frac):
        blend = 1.0 - math.exp(-dt_s / params.motor_lag_s)
        effective_frac += blend * (thrust_frac - effective_frac)

    hover_frac = memory.hover_thrust_frac
    if (
        is_flying
        and height_m > params.min_height_m
        and abs(vertical_acceleration_m_s2) < params.max_acceleration_m_s2
        and cos_tilt > 0.5
        and params.min_thrust_frac < effective_frac < params.max_thrust_frac
    ):
        lift_m_s2 = GRAVITY_M_S2 + vertical_acceleration_m_s2
        measured_frac = effective_frac * cos_tilt * GRAVITY_M_S2 / lift_m_s2
        hover_frac += dt_s / params.time_constant_s * (measured_frac - hover_frac)

    lowest_frac = (1.0 - params.max_deviation) * params.configured_frac
    highest_frac = (1.0 + params.max_deviation) * params.configured_frac
    hover_frac = min(max(hover_frac, lowest_frac), highest_frac)
    return HoverThrustMemory(hover_frac, effective_frac), hover_frac
