"""The fix of a satellite receiver: in words, and compared with what a fleet requires. Pure."""

from __future__ import annotations

from typing import Literal

from onboard.autopilot import Snapshot
from onboard.config.corrections import CorrectionsConfig

DemandedFix = Literal["any", "rtk_float", "rtk_fixed"]

# Index: MAVLink's GPS_FIX_TYPE.
FIX_WORDS = (
    "no receiver",
    "no fix",
    "2D",
    "3D",
    "DGPS",
    "RTK float",
    "RTK fixed",
    "static",
    "PPP",
)
_FLOAT = 5
_FIXED = 6
_ENOUGH: dict[DemandedFix, frozenset[int]] = {
    "any": frozenset(range(len(FIX_WORDS))),
    "rtk_float": frozenset((_FLOAT, _FIXED)),
    "rtk_fixed": frozenset((_FIXED,)),
}
DEMAND_WORDS: dict[DemandedFix, str] = {
    "any": "any fix",
    "rtk_float": "RTK float or better",
    "rtk_fixed": "RTK fixed",
}


def words_of(fix_type: int) -> str:
    """Return a fix in words.

    Args:
        fix_type: MAVLink's GPS_FIX_TYPE.
    """
    if 0 <= fix_type < len(FIX_WORDS):
        return FIX_WORDS[fix_type]
    return f"fix {fix_type}"


def is_enough(fix_type: int, demanded: DemandedFix) -> bool:
    """Whether a fix is at least as good as a fleet requires.

    Args:
        fix_type: MAVLink's GPS_FIX_TYPE.
        demanded: worst fix that the fleet file allows.
    """
    return fix_type in _ENOUGH[demanded]


def is_below(snapshot: Snapshot, corrections: CorrectionsConfig | None, now_ns: int) -> bool:
    """Whether PX4's receiver has a worse fix than the fleet requires, or reports none.

    Args:
        snapshot: newest snapshot of PX4.
        corrections: table of the fleet file; None for a vehicle that uses no corrections.
        now_ns: the time.
    """
    if corrections is None or corrections.fix == "any":
        return False
    if not snapshot.sees_satellites(now_ns):
        return True
    return not is_enough(snapshot.fix_type, corrections.fix)
