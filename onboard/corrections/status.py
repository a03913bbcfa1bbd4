"""State of a vehicle's corrections, for preflight rules, failsafes and telemetry. Pure."""

from __future__ import annotations

import math
from enum import Enum

from msgspec import Struct

STEADY_S = 30.0  # before a take-off, a base must have been steady for this time


class BaseFault(Enum):
    """Reason why a base is not trusted. The value continues a sentence about the base."""

    NOWHERE = "says that it is nowhere on Earth"
    ELSEWHERE = "is not where it was surveyed"
    MOVED = "has moved in flight"
    REPLACED = "is another one than at the start of the flight"


class BaseJudgement(Struct, frozen=True):
    """Result of the check of a base's position."""

    fault: BaseFault | None = None  # None: the base is trusted
    by_m: float = 0.0  # distance from where it should be

    @property
    def words(self) -> str:
        """The fault in words; empty for a base that is trusted."""
        if self.fault is None:
            return ""
        if self.fault is BaseFault.NOWHERE:
            return str(self.fault.value)
        return f"{self.fault.value}, by {self.by_m:.1f} m"


class CorrectionsStatus(Struct, frozen=True):
    """State of a vehicle's corrections at one tick."""

    age_s: float = math.inf  # age of the newest observations sent to PX4; inf: none yet
    base_id: int = -1  # trusted station; -1: none
    base_distance_m: float = math.nan  # distance of the base from the vehicle; NaN: not known
    base: BaseJudgement = BaseJudgement()  # about the newest position that the base has reported
    unsteady_s: float | None = None  # time since the base moved; None: long ago, or never
    has_several_sources: bool = False  # two nodes publish corrections
    too_long_bytes: int = 0  # length of a frame that is too long for PX4; 0: none lately
