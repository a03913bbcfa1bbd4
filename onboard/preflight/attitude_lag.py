"""Lag of the attitude by PX4's version and parameters: whether the values of a fleet file hold for
this PX4. Pure.
"""

from __future__ import annotations

from collections.abc import Mapping

from onboard.autopilot import Version

_DEFAULT_P_1_S = ((1, 17), 6.5, 4.0)  # MC_ROLL_P and MC_PITCH_P before this version, and from it on
_FILTERED_SINCE: Version = (1, 18)
_FILTER_RAD_S = 50.0  # MC_REF_W_N: critically damped filter of attitude setpoints
_FILTER_RAD = 2.2  # measured: its delay times its natural frequency
GAINS = ("MC_ROLL_P", "MC_PITCH_P")


def lag_s(version: Version, px4_params: Mapping[str, float]) -> float:
    """Return the lag of the slower of roll and pitch [s], as far as PX4's attitude control makes
    it.

    Args:
        version: of PX4.
        px4_params: values that are known; the others count as PX4's defaults.
    """
    since, before, after = _DEFAULT_P_1_S
    default_1_s = before if version < since else after
    slowest_1_s = max(0.1, min(float(px4_params.get(name, default_1_s)) for name in GAINS))
    filter_rad_s = max(1.0, float(px4_params.get("MC_REF_W_N", _FILTER_RAD_S)))
    return 1.0 / slowest_1_s + (_FILTER_RAD / filter_rad_s if version >= _FILTERED_SINCE else 0.0)
