"""The duration of a climb after take-off and of a landing: slow near the ground, faster above.

A leg's quintic ends slowly. At 1 m/s at most, the last metre of 30 m takes 10 s.
"""

from __future__ import annotations

# mean speed near the ground, and the height up to which the vehicle is that slow
_SLOW_M_S = 0.4
_SLOW_M = 4.0

# Mean speed above that height. The peak is then 1.5 m/s, as in PX4's own descent (MPC_Z_V_AUTO_DN).
_FAST_M_S = 0.8

# Largest mean speed, as a share of the vehicle's top speed: a quintic peaks at 1.9 times its mean.
_SPEED_SHARE = 0.5


def climb_duration_s(height_m: float, max_speed_m_s: float) -> float:
    """Return the duration [s] of a climb from the ground or of a descent to it.

    Args:
        height_m: difference of the heights; a negative one counts as 0.
        max_speed_m_s: top speed of the vehicle.
    """
    mean_m_s = _SPEED_SHARE * max_speed_m_s

    low_m = min(max(0.0, height_m), _SLOW_M)
    low_s = low_m / min(_SLOW_M_S, mean_m_s)

    high_m = max(0.0, height_m - _SLOW_M)
    high_s = high_m / min(_FAST_M_S, mean_m_s)
    return low_s + high_s
