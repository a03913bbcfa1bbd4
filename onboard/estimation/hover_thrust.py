"""Slow and bounded estimate of the hover throttle.

Thrust is linear in throttle: a_z + g = (throttle/hover) g cos(tilt). The hover throttle changes
over tens of seconds as the battery voltage falls, so the estimate has a time constant of a few
seconds. The disturbance observer compensates faster changes. The equation does not hold near the
ground (ground effect, contact) and while the throttle saturates. Then the estimate is frozen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.constants import GRAVITY_M_S2

MIN_HEIGHT_M = 0.3  # nearer to the ground, the estimate is frozen


class HoverThrustParams(NamedTuple):
    """Time constants and bounds of the estimate, and the limits beyond which it is frozen."""

    configured_frac: float  # hover throttle of the fleet file
    max_deviation: float = 0.2  # largest deviation from the configured value, as a share of it
    time_constant_s: float = 4.0  # time constant of the estimate
    motor_lag_s: float = 0.05  # time constant from throttle to thrust

    # outside these limits the estimate is frozen
    min_height_m: float = MIN_HEIGHT_M  # in the fleet frame
    max_acceleration_m_s2: float = 2.0  # vertical
    min_cos_tilt: float = 0.5
    min_thrust_frac: float = 0.1
    max_thrust_frac: float = 0.97


class HoverThrustMemory(NamedTuple):
    """The estimate and the state of the motors."""

    hover_thrust_frac: float
    effective_thrust_frac: float  # throttle after the motor lag


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
        memory: memory of the last tick.
        thrust_frac: throttle that was sent at the last tick [-]. If it is not finite, the motors'
            throttle stays unchanged.
        cos_tilt: cosine of the tilt of the flown attitude [-].
        vertical_acceleration_m_s2: estimated acceleration, up positive, without gravity. If it is
            not finite, the hover throttle is frozen.
        height_m: height in the fleet frame. If it is not finite, the hover throttle is frozen.
        params: time constants and bounds.
        dt_s: length of the tick.
        is_flying: whether the law flies the vehicle freely. On the ground, at lift-off, in a
            descent and without poses the hover throttle is frozen, but not the motors' throttle.
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
        and cos_tilt > params.min_cos_tilt
        and params.min_thrust_frac < effective_frac < params.max_thrust_frac
    ):
        lift_m_s2 = GRAVITY_M_S2 + vertical_acceleration_m_s2
        measured_frac = effective_frac * cos_tilt * GRAVITY_M_S2 / lift_m_s2
        hover_frac += dt_s / params.time_constant_s * (measured_frac - hover_frac)

    lowest_frac = (1.0 - params.max_deviation) * params.configured_frac
    highest_frac = (1.0 + params.max_deviation) * params.configured_frac
    hover_frac = min(max(hover_frac, lowest_frac), highest_frac)
    return HoverThrustMemory(hover_frac, effective_frac), hover_frac
