"""Two folders of evidence beside each other: the same campaign on another machine. Pure.

On another machine the last digits of a calculation may differ, so flights do, and the digest. What
has to agree are the figures: the share of wrong flights of each row lies in the exact interval of
the other machine, both ways, and what was flown farther than the other machine's contingency volume
is no more than chance.
"""

from __future__ import annotations

from typing import NamedTuple

from groundstation.evidence.evidence_summary import Evidence
from groundstation.evidence.intervals import two_sided


class Agreement(NamedTuple):
    """One figure of two folders."""

    figure: str
    here: str
    there: str
    is_within: bool


def compared(here: Evidence, there: Evidence) -> list[Agreement]:
    """Return every figure of both folders, and whether each lies in the other's interval."""
    rows_there = {row.key: row for row in there.matrix}
    figures = []
    for row in here.matrix:
        other = rows_there.get(row.key)
        if other is None or not row.flights or not other.flights:
            continue
        figures.append(
            _share(row.key, (row.wrong_flights, row.flights), (other.wrong_flights, other.flights))
        )

    beyond_here = sum(one > there.volumes.excursion_m for one in here.excursions_m)
    beyond_there = sum(one > here.volumes.excursion_m for one in there.excursions_m)
    figures.append(
        _share(
            "flights beyond the other's contingency volume",
            (beyond_here, len(here.excursions_m)),
            (beyond_there, len(there.excursions_m)),
        )
    )
    return figures


def _share(figure: str, here: tuple[int, int], there: tuple[int, int]) -> Agreement:
    interval_here = two_sided(*here)
    interval_there = two_sided(*there)
    is_within = interval_there.holds(here[0] / max(here[1], 1))
    is_within = is_within and interval_here.holds(there[0] / max(there[1], 1))
    return Agreement(
        figure=figure,
        here=f"{here[0]} of {here[1]}",
        there=f"{there[0]} of {there[1]}",
        is_within=is_within,
    )
