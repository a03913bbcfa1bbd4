"""How long a climb after take-off and a landing take: gently near the ground, faster where they are
long. Pure.
"""

from __future__ import annotations

_SLOW_M_S, _SLOW_M = 0.4, 4.0  # on average, and over how much of the way
# on average over the rest: peaks at 1.5 m/s, at which PX4 descends by itself (MPC_Z_V_AUTO_DN)
_FAST_M_S = 0.8
# of the vehicle's top speed, on average at most: the peak of a quintic is 1.9 times its mean
_SPEED_SHARE = 0.5


def vertical_s(way_m: float, max_speed_m_s: float) -> float:
    """Return the duration of a climb from the ground or of a descent to it.

    Both end slowly, as quintics do: with 1 m/s at most, the last metre of 30 m takes 10 s.

    Args:
        way_m: height difference [m]; below 0 counts as 0.
        max_speed_m_s: of the vehicle.

    Returns:
        Time [s].
    """
    slow_m, mean_m_s = min(max(0.0, way_m), _SLOW_M), _SPEED_SHARE * max_speed_m_s
    return slow_m / min(_SLOW_M_S, mean_m_s) + max(0.0, way_m - _SLOW_M) / min(_FAST_M_S, mean_m_s)
