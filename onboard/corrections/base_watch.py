"""Where the base of the corrections is, and whether it may be there. Pure.

A receiver places its vehicle by the place that the base says it has: a base that says a place ten
metres aside moves all vehicles by ten metres. So a base that is elsewhere than where it was
surveyed is not believed, and neither is one that moves, or is replaced by another one, while this
vehicle flies. On the ground a new place is taken; nobody takes off until it has been steady for a
while.
"""

from __future__ import annotations

import math

from onboard.config.corrections import CorrectionsConfig
from onboard.config.earth import Origin, east_north_m
from onboard.corrections.rtcm import BasePosition
from onboard.corrections.status import STEADY_S, BaseFault, BaseJudgement

FINE = BaseJudgement()


class BaseWatch:
    """Judges the positions of a base.

    Args:
        corrections: of the fleet file.
    """

    def __init__(self, corrections: CorrectionsConfig) -> None:
        self.base: BasePosition | None = None  # the one that is believed
        self.base_deg: tuple[float, float] = (math.nan, math.nan)  # its latitude and longitude
        self.judgement = FINE  # of the newest position
        self._corrections = corrections
        self._moved_ns: int | None = None  # when the believed position changed last

    def hear(self, position: BasePosition, now_ns: int, *, is_on_ground: bool) -> bool:
        """Judge a position; return whether it is believed.

        Args:
            position: as the base says it.
            now_ns: the time.
            is_on_ground: whether this vehicle stands, disarmed.
        """
        self.judgement = self._judge(position, is_on_ground=is_on_ground)
        if self.judgement.fault is not None:
            return False

        if self.base is not None and self._is_another(position):
            self._moved_ns = now_ns
        if self.base is None or self._is_another(position):
            self.base = position
            latitude_deg, longitude_deg, _ = position.latitude_longitude_height
            self.base_deg = (latitude_deg, longitude_deg)
        return True

    def unsteady_s(self, now_ns: int) -> float | None:
        """Return how long ago the base moved, while that is too recent for a take-off."""
        if self._moved_ns is None:
            return None
        moved_s = (now_ns - self._moved_ns) * 1e-9
        if moved_s >= STEADY_S:
            return None
        return max(0.0, moved_s)

    def _is_another(self, position: BasePosition) -> bool:
        assert self.base is not None
        moved_m = math.dist(position.ecef_m, self.base.ecef_m)
        is_moved = moved_m > self._corrections.base_tolerance_m
        return is_moved or position.station != self.base.station

    def _judge(self, position: BasePosition, *, is_on_ground: bool) -> BaseJudgement:
        if not position.is_on_earth:
            return BaseJudgement(BaseFault.NOWHERE)

        off_m = self._off_m(position)
        if off_m > self._corrections.base_tolerance_m:
            return BaseJudgement(BaseFault.ELSEWHERE, off_m)

        if self.base is None or is_on_ground:
            return FINE
        moved_m = math.dist(position.ecef_m, self.base.ecef_m)
        if moved_m > self._corrections.base_tolerance_m:
            return BaseJudgement(BaseFault.MOVED, moved_m)
        if position.station != self.base.station:
            return BaseJudgement(BaseFault.REPLACED, moved_m)
        return FINE

    def _off_m(self, position: BasePosition) -> float:
        """Return how far a base is from where it was surveyed; 0 where nobody has surveyed it."""
        surveyed_deg = self._corrections.base_deg
        if surveyed_deg is None:
            return 0.0

        latitude_deg, longitude_deg, height_m = position.latitude_longitude_height
        surveyed = Origin(latitude_deg=surveyed_deg[0], longitude_deg=surveyed_deg[1], altitude_m=0)
        east_m, north_m = east_north_m(surveyed, latitude_deg, longitude_deg)
        up_m = 0.0
        if self._corrections.base_height_m is not None:
            up_m = height_m - self._corrections.base_height_m
        return math.hypot(east_m, north_m, up_m)


def distance_m(base_deg: tuple[float, float], vehicle_deg: tuple[float, float]) -> float:
    """Return the distance on the ground between a base and a vehicle.

    Args:
        base_deg: latitude and longitude of the base.
        vehicle_deg: latitude and longitude of the vehicle.
    """
    latitude_deg, longitude_deg = vehicle_deg
    vehicle = Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=0.0)
    return math.hypot(*east_north_m(vehicle, *base_deg))
