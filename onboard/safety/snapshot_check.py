"""Checks whether the numbers that PX4 sends are possible, before anything uses them. Pure."""

from __future__ import annotations

import math

from onboard.autopilot import Snapshot

_LARGEST_M = 1e5
_LARGEST_M_S = 1e3


def nonsense(snapshot: Snapshot) -> str:
    """Return a sentence that names an impossible number in a snapshot; empty if there is none.

    Args:
        snapshot: newest snapshot of one PX4.
    """
    length = math.hypot(*snapshot.quaternion_enu_flu_wxyz)
    away_m = math.hypot(*snapshot.position_local_ned_m)
    speed_m_s = math.hypot(*snapshot.velocity_local_ned_m_s)

    # comparisons with NaN are False, so that NaN is impossible, too
    if not 0.95 < length < 1.05:
        return (
            "PX4 sends an attitude that is no rotation "
            f"(its quaternion has the length {length:.3g})."
        )
    if not away_m < _LARGEST_M:
        return f"PX4 says that it is {away_m * 1e-3:.0f} km from its origin."
    if not speed_m_s < _LARGEST_M_S:
        return f"PX4 says that it moves with {speed_m_s:.0f} m/s."
    return ""
