"""Times in which the ground did not know how far a vehicle was from the others. Pure.

A distance that nobody saw is no distance that was kept. A vehicle is seen while its true position
or its telemetry is younger than KNOWN_S. When it is seen again, or when the flight is judged, what
it may have done meanwhile follows from where it and the others were and from how fast they can fly:
that bound is kept for the nearest of the others.
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from onboard.config.pair_separation import separation_m
from onboard.tuples import Xyz

KNOWN_S = 0.5  # a position that is older is not known any more
MAX_KEPT = 200  # times; of more, those in which two may have come nearest
# The fastest that vehicles were seen to fly, as a share of max_speed_m_s: the law uses more than
# the plain speed to keep distances.
FASTEST_SHARE = 1.6


class UnknownTime(Struct, frozen=True):
    """A time in which the distance between two vehicles was not known."""

    vehicle: str  # the one that was not seen
    other: str  # the one to which it may have come nearest
    begin_ns: int  # when it was seen last, on the ground's clock
    end_ns: int
    possible_m: float  # separation that the two cannot have fallen below, as far as is known

    @property
    def duration_s(self) -> float:
        """Its length [s]."""
        return (self.end_ns - self.begin_ns) * 1e-9


class Sighting(Struct, frozen=True):
    """The place and time at which one vehicle was seen last."""

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
        before: state in which the vehicle was last seen.
        after: where it is seen now; None while it is still unseen.
        others: the last sightings of all other vehicles.
        now_ns: the end of the time, on the ground's clock [ns].
        top_speed_m_s: the fastest that any of them flies [m/s].
        height_share: weight of a metre of height in a separation.

    Returns:
        The time with the other vehicle that it may have come nearest to; None when it was seen
        all the time, or stood.
    """
    if _is_seen(before, now_ns):
        return None

    # who stands is where it was
    flew = before.is_flying or (after is not None and after.is_flying)
    if not flew:
        return None

    nearest: UnknownTime | None = None
    for other in others:
        position_enu_m = before.position_enu_m
        if _is_seen(other, now_ns):
            # from where this one was to where the other is
            approach_ns = now_ns - before.seen_ns
        elif after is None:
            # both are still unseen: each flies on from where it was
            approach_ns = (now_ns - before.seen_ns) + (now_ns - other.seen_ns)
        else:
            # from where the other was to where this one is, and back to when both were seen
            position_enu_m = after.position_enu_m
            begin_ns = min(before.seen_ns, other.seen_ns)
            approach_ns = (now_ns - begin_ns) + (other.seen_ns - begin_ns)

        distance_m = separation_m(position_enu_m, other.position_enu_m, height_share)
        possible_m = max(0.0, distance_m - top_speed_m_s * approach_ns * 1e-9)

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
    """Return times and one more; of too many the one whose bound is the largest is left out.

    Args:
        times: oldest first.
        time: the newest one.
    """
    if len(times) < MAX_KEPT:
        return (*times, time)

    mildest = max(times, key=lambda one: one.possible_m)
    if mildest.possible_m <= time.possible_m:
        return times
    return (*(one for one in times if one is not mildest), time)


def _is_seen(sighting: Sighting, now_ns: int) -> bool:
    return now_ns - sighting.seen_ns <= KNOWN_S * 1e9
