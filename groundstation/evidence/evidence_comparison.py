"""The comparison of two folders of evidence: the same campaign, flown on two machines. Pure.

The last digits of a calculation may differ between machines, and then the flights and their digest
differ, too. The figures must still agree: the share of wrong flights of each row lies in the exact
interval of the other machine, in both directions, and so does the share of flights that leave the
other machine's contingency volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from groundstation.evidence.evidence_summary import Evidence
from groundstation.evidence.volumes import Volumes
from onboard.confidence_intervals import two_sided

_ROUNDING_M = 0.001  # distances in the two folders are rounded to millimetres


class Agreement(NamedTuple):
    """One figure in two folders."""

    figure: str
    here: str
    there: str
    is_within: bool  # whether each lies in the other's interval


def compared(here: Evidence, there: Evidence, *, half_body_m: float) -> list[Agreement]:
    """Return every figure of both folders, and whether each lies in the other's interval.

    Args:
        here: evidence of this machine.
        there: evidence of the other machine, of the same fleet.
        half_body_m: half the diameter of the fleet's vehicles.
    """
    rows_there = {row.key: row for row in there.matrix}
    figures = []
    for row in here.matrix:
        other = rows_there.get(row.key)
        if other is None or not row.flights or not other.flights:
            continue
        figures.append(
            _share(row.key, (row.wrong_flights, row.flights), (other.wrong_flights, other.flights))
        )

    beyond_here = _flights_beyond(there.volumes, here.excursions_m, half_body_m)
    beyond_there = _flights_beyond(here.volumes, there.excursions_m, half_body_m)
    figures.append(
        _share(
            "flights beyond the other's contingency volume",
            (beyond_here, len(here.excursions_m)),
            (beyond_there, len(there.excursions_m)),
        )
    )
    return figures


def _flights_beyond(volumes: Volumes, excursions_m: Sequence[float], half_body_m: float) -> int:
    """Return the number of flights in which a vehicle left the contingency volume.

    The excursions are those of the vehicles' centres; the volume holds the whole vehicles.
    """
    largest_m = volumes.excursion_m + _ROUNDING_M
    return sum(excursion_m + half_body_m > largest_m for excursion_m in excursions_m)


def _share(figure: str, here: tuple[int, int], there: tuple[int, int]) -> Agreement:
    """Compare two shares, each given as the number of events and the number of flights."""
    events_here, flights_here = here
    events_there, flights_there = there
    interval_here = two_sided(events_here, flights_here)
    interval_there = two_sided(events_there, flights_there)

    # without flights the share is 0
    is_within = interval_there.holds(events_here / max(flights_here, 1))
    is_within = is_within and interval_here.holds(events_there / max(flights_there, 1))
    return Agreement(
        figure=figure,
        here=f"{events_here} of {flights_here}",
        there=f"{events_there} of {flights_there}",
        is_within=is_within,
    )
