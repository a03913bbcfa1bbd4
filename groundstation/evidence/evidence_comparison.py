"""The comparison of two folders of evidence: the same campaign, flown on two machines. Pure.

The last digits of a calculation may differ between machines, and then the flights and their digest
differ, too. The figures must still agree: the share of wrong flights of each row lies in the exact
interval of the other machine, in both directions. Each machine's contingency volume is said to hold
further flights but for a share; the flights of the other machine, in metres of the same frame, may
not contradict that. A row that one machine has not flown is not comparable, and does not agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from groundstation.evidence.evidence_summary import Evidence, share_beyond
from groundstation.evidence.kept_flights import FlownCase
from groundstation.evidence.volumes import Volumes, distance_outside_m
from onboard.confidence_intervals import two_sided

WITHIN = "within"
OUTSIDE = "outside"
NOT_COMPARABLE = "not comparable"
_ROUNDING_M = 0.001  # volumes are rounded to millimetres


class Agreement(NamedTuple):
    """One figure in two folders."""

    figure: str
    here: str
    there: str
    result: str  # WITHIN: each is possible with the other; OUTSIDE; or NOT_COMPARABLE

    @property
    def is_within(self) -> bool:
        """Whether each figure is possible with the other."""
        return self.result == WITHIN


def compared(
    here: Evidence,
    there: Evidence,
    *,
    flights_here: Sequence[FlownCase],
    flights_there: Sequence[FlownCase],
    half_body_m: float,
) -> list[Agreement]:
    """Return every figure of both folders, and whether they agree.

    Args:
        here: evidence of this machine.
        there: evidence of the other machine, of the same fleet, mission and wind.
        flights_here: flights of this machine.
        flights_there: flights of the other machine.
        half_body_m: half the diameter of the fleet's vehicles.
    """
    wrong_here = {row.key: (row.wrong_flights, row.flights) for row in here.matrix}
    wrong_there = {row.key: (row.wrong_flights, row.flights) for row in there.matrix}
    figures = []
    for key in dict.fromkeys([*wrong_here, *wrong_there]):
        figure = _row(key, wrong_here.get(key, (0, 0)), wrong_there.get(key, (0, 0)))
        if figure is not None:
            figures.append(figure)

    beyond_here = _flights_beyond(there.volumes, flights_here, half_body_m)
    beyond_there = _flights_beyond(here.volumes, flights_there, half_body_m)
    figures.append(
        _beyond(
            (beyond_here, len(flights_here)),
            (beyond_there, len(flights_there)),
            share_here=share_beyond(here.flights),
            share_there=share_beyond(there.flights),
        )
    )
    return figures


def _flights_beyond(volumes: Volumes, flights: Sequence[FlownCase], half_body_m: float) -> int:
    """Return the number of flights in which a vehicle left the contingency volume.

    Positions are those of the vehicles' centres; the volume holds the whole vehicles.
    """
    most_outside_m = volumes.excursion_m - half_body_m + _ROUNDING_M
    highest_m = volumes.contingency_height_m - half_body_m + _ROUNDING_M
    count = 0
    for flight in flights:
        outside_m = [distance_outside_m(volumes.geography, point) for point in flight.hull_m]
        is_wider = max(outside_m, default=0.0) > most_outside_m
        if is_wider or flight.highest_m > highest_m:
            count += 1
    return count


def _row(key: str, here: tuple[int, int], there: tuple[int, int]) -> Agreement | None:
    """Compare the wrong flights of a row, each given as their number and that of all flights.

    Returns None for a row that nobody has flown.
    """
    wrong_here, flights_here = here
    wrong_there, flights_there = there
    if not flights_here and not flights_there:
        return None
    if not flights_here or not flights_there:
        return _agreement(key, here, there, NOT_COMPARABLE)

    result = OUTSIDE
    interval_here = two_sided(wrong_here, flights_here)
    interval_there = two_sided(wrong_there, flights_there)
    is_here_possible = interval_there.holds(wrong_here / flights_here)
    is_there_possible = interval_here.holds(wrong_there / flights_there)
    if is_here_possible and is_there_possible:
        result = WITHIN
    return _agreement(key, here, there, result)


def _beyond(
    here: tuple[int, int], there: tuple[int, int], *, share_here: float, share_there: float
) -> Agreement:
    """Compare the flights beyond the other's volume with the share that each volume leaves out."""
    result = OUTSIDE
    is_here_possible = two_sided(*here).low <= share_there
    is_there_possible = two_sided(*there).low <= share_here
    if is_here_possible and is_there_possible:
        result = WITHIN
    return _agreement("flights beyond the other's contingency volume", here, there, result)


def _agreement(
    figure: str, here: tuple[int, int], there: tuple[int, int], result: str
) -> Agreement:
    return Agreement(figure=figure, here=_words(here), there=_words(there), result=result)


def _words(share: tuple[int, int]) -> str:
    events, flights = share
    if not flights:
        return "not flown"
    return f"{events} of {flights}"
