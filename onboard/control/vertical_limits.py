"""The largest vertical accelerations of a vehicle: of the baseline, and of the motion it follows.

A vehicle with little lift reserve accelerates upwards much less than sideways. What it follows is
planned with less than the baseline can give, so that the rest corrects errors.
"""

from __future__ import annotations

from onboard.constants import GRAVITY_M_S2

_MAX_M_S2 = 2.5  # limit of the baseline, also with a large reserve
_BASELINE_SHARE = 0.4  # share of the lift reserve; the rest stays for separation
_PLANNED_SHARE = 0.9  # share of the baseline's limit for legs and paths


def lift_reserve_m_s2(hover_thrust_frac: float) -> float:
    """Return the largest upward acceleration of a level vehicle [m/s²].

    Args:
        hover_thrust_frac: throttle at which the vehicle hovers.
    """
    return (1.0 / hover_thrust_frac - 1.0) * GRAVITY_M_S2


def baseline_m_s2(hover_thrust_frac: float) -> float:
    """Return the limit of the baseline's vertical acceleration, up and down [m/s²].

    Args:
        hover_thrust_frac: throttle at which the vehicle hovers.
    """
    return min(_MAX_M_S2, _BASELINE_SHARE * lift_reserve_m_s2(hover_thrust_frac))


def planned_m_s2(hover_thrust_frac: float) -> float:
    """Return the limit of the vertical acceleration of legs and paths [m/s²].

    Args:
        hover_thrust_frac: throttle at which the vehicle hovers.
    """
    return _PLANNED_SHARE * baseline_m_s2(hover_thrust_frac)
