"""Computes the lag of PX4's attitude control from its version and parameters. Pure.

A preflight rule compares the lag for the fleet file's PX4 version with the lag of the actual PX4.
"""

from __future__ import annotations

from collections.abc import Mapping

from onboard.autopilot import Version

GAINS = ("MC_ROLL_P", "MC_PITCH_P")
# default gains [1/s] before PX4 1.17, and since then
_DEFAULT_CHANGED_SINCE: Version = (1, 17)
_DEFAULT_BEFORE_1_S = 6.5
_DEFAULT_SINCE_1_S = 4.0
_MIN_GAIN_1_S = 0.1

# since this version PX4 filters attitude setpoints with a critically damped filter
_FILTERED_SINCE: Version = (1, 18)
_FILTER_RAD_S = 50.0  # default of MC_REF_W_N, the filter's natural frequency
_FILTER_RAD = 2.2  # the filter's delay times its natural frequency (measured)
_MIN_FILTER_RAD_S = 1.0


def lag_s(version: Version, px4_params: Mapping[str, float]) -> float:
    """Return the lag [s] of PX4's attitude control: the larger lag of roll and pitch.

    Args:
        version: version of PX4.
        px4_params: name -> value of the known parameters; others count as PX4's defaults.
    """
    default_1_s = _DEFAULT_SINCE_1_S
    if version < _DEFAULT_CHANGED_SINCE:
        default_1_s = _DEFAULT_BEFORE_1_S
    slowest_1_s = min(float(px4_params.get(name, default_1_s)) for name in GAINS)
    control_s = 1.0 / max(_MIN_GAIN_1_S, slowest_1_s)
    if version < _FILTERED_SINCE:
        return control_s

    filter_rad_s = float(px4_params.get("MC_REF_W_N", _FILTER_RAD_S))
    return control_s + _FILTER_RAD / max(_MIN_FILTER_RAD_S, filter_rad_s)
