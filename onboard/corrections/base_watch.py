"""Check of the position that the base of the corrections reports. Pure.

A receiver calculates its vehicle's position from the position that the base reports for itself. If
the base's reported position is wrong by ten metres, the positions of all vehicles are wrong by ten
metres. So a base is not trusted if it reports a position other than the surveyed one. A base that
moves, or is replaced by another base, while this vehicle flies is not trusted either. On the
ground, a new position is accepted, but no vehicle takes off until that position has been steady for
a while.
"""

from __future__ import annotations

import math

from onboard.config.corrections import CorrectionsConfig
from onboard.config.earth import Origin, east_north_m
from onboard.corrections.rtcm import BasePosition
from onboard.corrections.status import STEADY_S, BaseFault, BaseJudgement

FINE = BaseJudgement()


class BaseWatch:
    """Checks the positions that a base reports.

    Args:
        corrections: table of corrections of the fleet file.
    """

    def __init__(self, corrections: CorrectionsConfig) -> None:
        self.base: BasePosition | None = None  # the position that is trusted
        self.base_deg: tuple[float, float] = (math.nan, math.nan)  # its latitude and longitude
        self.judgement = FINE  # result for the newest reported position
        self._corrections = corrections
        self._moved_ns: int | None = None  # when the trusted position last changed

    def hear(self, position: BasePosition, now_ns: int, *, is_on_ground: bool) -> bool:
        """Check a position; return whether it is trusted.

        Args:
            position: position as the base reports it.
            now_ns: the time.
            is_on_ground: whether this vehicle stands on the ground, disarmed.
        """
        self.judgement = self._judge(position, is_on_ground=is_on_ground)
        if self.judgement.fault is not None:
            return False

        is_first = self.base is None
        if is_first or self._is_another(position):
            self.base = position
            latitude_deg, longitude_deg, _ = position.latitude_longitude_height
            self.base_deg = (latitude_deg, longitude_deg)
            if not is_first:
                self._moved_ns = now_ns
        return True

    def unsteady_s(self, now_ns: int) -> float | None:
        """Return how long ago the base moved, if that is too recent for a take-off."""
        if self._moved_ns is None:
            return None
        moved_s = (now_ns - self._moved_ns) * 1e-9
        if moved_s >= STEADY_S:
            return None
        return max(0.0, moved_s)

    def _is_another(self, position: BasePosition) -> bool:
        """Whether a position differs from the trusted position, or is from another station."""
        assert self.base is not None
        moved_m = math.dist(position.ecef_m, self.base.ecef_m)
        is_moved = moved_m > self._corrections.base_tolerance_m
        return is_moved or position.station != self.base.station

    def _judge(self, position: BasePosition, *, is_on_ground: bool) -> BaseJudgement:
        """Return whether a position is trusted, and if not, why."""
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
        """Return the distance from the surveyed position; 0 if the base was not surveyed."""
        surveyed_deg = self._corrections.base_deg
        if surveyed_deg is None:
            return 0.0

        latitude_deg, longitude_deg = surveyed_deg
        surveyed = Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg, altitude_m=0)
        latitude_deg, longitude_deg, height_m = position.latitude_longitude_height
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
