"""State of a vehicle's corrections: for rules, failsafes and telemetry. Pure."""

from __future__ import annotations

import math
from enum import Enum

from msgspec import Struct

STEADY_S = 30.0  # for so long a base stays where it is before somebody takes off


class BaseFault(Enum):
    """Reason why a base is not believed."""

    NOWHERE = "says that it is nowhere on Earth"
    ELSEWHERE = "is not where it was surveyed"
    MOVED = "has moved in flight"
    REPLACED = "is another one than at the start of the flight"


class BaseJudgement(Struct, frozen=True):
    """Judgement of a base's position."""

    fault: BaseFault | None = None
    by_m: float = 0.0  # distance from where it should be

    @property
    def words(self) -> str:
        """The fault in words; empty for a base that is believed."""
        if self.fault is None:
            return ""
        if self.fault is BaseFault.NOWHERE:
            return str(self.fault.value)
        return f"{self.fault.value}, by {self.by_m:.1f} m"


class CorrectionsStatus(Struct, frozen=True):
    """State of a vehicle's corrections at one tick."""

    age_s: float = math.inf  # since the newest observations that PX4 was given; inf: never
    base_id: int = -1  # station that is believed; -1: none
    base_distance_m: float = math.nan  # from the vehicle; NaN: not known
    base: BaseJudgement = BaseJudgement()  # of where the base says that it is
    unsteady_s: float | None = None  # how long ago it moved, while that is too recent
    has_several_sources: bool = False
    too_long_bytes: int = 0  # of a frame that no fragments hold; 0: none lately
