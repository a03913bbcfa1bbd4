"""Periods in which the ground did not know how far a vehicle was from the others. Pure.

A distance that was not observed must not count as kept. A vehicle is seen while its true position
or its telemetry is younger than KNOWN_S. When it is seen again, or when the flight is judged, a
lower bound of its distance from each other vehicle is computed: from the positions at which both
were seen, and from their top speed. The smallest of these bounds is kept.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from onboard.config.pair_separation import separation_m
from onboard.tuples import Xyz

KNOWN_S = 0.5  # age of a position up to which it counts as known
MAX_KEPT = 200  # most periods that are kept: those with the smallest bounds
FASTEST_SHARE = 1.6  # largest observed speed over max_speed_m_s, which the law may exceed


class UnknownTime(Struct, frozen=True):
    """A period in which the distance between two vehicles was not known."""

    vehicle: str  # the vehicle that was not seen
    other: str  # the vehicle to which it may have come nearest
    begin_ns: int  # time at which it was last seen, on the ground's clock
    end_ns: int
    possible_m: float  # smallest separation that the two can have had

    @property
    def duration_s(self) -> float:
        """The length of the period [s]."""
        return (self.end_ns - self.begin_ns) * 1e-9


class Sighting(Struct, frozen=True):
    """The position and the time at which one vehicle was last seen."""

    vehicle: str
    position_enu_m: Xyz
    seen_ns: int
    is_flying: bool


def unknown_time(
    before: Sighting,
    after: Sighting | None,
    others: Iterable[Sighting],
    now_ns: int,
    *,
    top_speed_m_s: float,
    height_share: float,
) -> UnknownTime | None:
    """Return how near a vehicle may have come to any other while it was not seen.

    Args:
        before: last sighting of the vehicle before the period.
        after: sighting at the end of the period; None while the vehicle is still unseen.
        others: last sightings of all other vehicles.
        now_ns: end of the period, on the ground's clock [ns].
        top_speed_m_s: largest speed of any vehicle [m/s].
        height_share: weight of a metre of height in a separation.

    Returns:
        The period, with the other vehicle to which this one may have come nearest; None if this
        vehicle was seen all the time, or stood on the ground.
    """
    if _is_seen(before, now_ns):
        return None

    # A vehicle that stands has not moved.
    flew = before.is_flying or (after is not None and after.is_flying)
    if not flew:
        return None

    nearest: UnknownTime | None = None
    for other in others:
        position_enu_m = before.position_enu_m
        if _is_seen(other, now_ns):
            # Only the vehicle has moved since its last sighting.
            flown_ns = now_ns - before.seen_ns
        elif after is None:
            # Both have moved since their last sightings.
            flown_ns = (now_ns - before.seen_ns) + (now_ns - other.seen_ns)
        else:
            # The vehicle is seen again, the other is not. At worst they met at the earlier one of
            # their last sightings, and both flew away from there to where they were seen next.
            position_enu_m = after.position_enu_m
            meeting_ns = min(before.seen_ns, other.seen_ns)
            flown_ns = (now_ns - meeting_ns) + (other.seen_ns - meeting_ns)

        distance_m = separation_m(position_enu_m, other.position_enu_m, height_share)
        possible_m = max(0.0, distance_m - top_speed_m_s * flown_ns * 1e-9)

        if nearest is None or possible_m < nearest.possible_m:
            nearest = UnknownTime(
                vehicle=before.vehicle,
                other=other.vehicle,
                begin_ns=before.seen_ns,
                end_ns=now_ns,
                possible_m=possible_m,
            )
    return nearest


def with_time(times: tuple[UnknownTime, ...], time: UnknownTime) -> tuple[UnknownTime, ...]:
    """Return the periods with one more; if there are too many, drop the one with the largest bound.

    Args:
        times: periods so far, oldest first.
        time: the newest period.
    """
    if len(times) < MAX_KEPT:
        return (*times, time)

    farthest = max(times, key=lambda stored: stored.possible_m)
    if farthest.possible_m <= time.possible_m:
        return times
    return (*(stored for stored in times if stored is not farthest), time)


def _is_seen(sighting: Sighting, now_ns: int) -> bool:
    return now_ns - sighting.seen_ns <= KNOWN_S * 1e9
