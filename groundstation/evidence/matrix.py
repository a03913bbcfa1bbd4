"""The matrix: each question of an authority, with what the flights of a campaign say to it. Pure.

A row is **shown** when flights were flown for it, none is judged wrong, and the failsafe table
does what is claimed; **wrong** when one of them is not so; **not shown** when nothing was flown for
it, for instance because the fleet has no satellites. That is evidence for the faults, the fleet
and the mission that were flown; whether it suffices is the authority's to say.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from groundstation.evidence.hazards import HAZARDS, Hazard
from groundstation.evidence.intervals import two_sided, upper_bound
from groundstation.evidence.kept_flights import FlownCase, digest
from onboard.safety.failsafe_table import TABLE, WORDS, Condition, Situation

SHOWN = "shown"
WRONG = "wrong"
NOT_SHOWN = "not shown"


class FailsafeRow(msgspec.Struct, frozen=True, kw_only=True):
    """One condition of the failsafe table, as a row of the matrix names it."""

    condition: str
    action: str  # of a flying vehicle, in words
    flights_noticed: int  # flights of this row in which it held
    tests: tuple[str, ...]  # of Covey's own, that show it
    wrong: str = ""  # what the failsafe table says instead


class MatrixRow(msgspec.Struct, frozen=True, kw_only=True):
    """One question with its evidence."""

    key: str
    question: str
    asked_by: tuple[str, ...]
    status: str
    rows: tuple[FailsafeRow, ...]
    faults: dict[str, int]  # flights by what was broken
    not_flown: tuple[str, ...]  # faults that this fleet or mission cannot have
    flights: int
    wrong_flights: int
    upper_bound: float  # of the share of wrong flights, 95 %, exact
    low: float  # two-sided, 95 %, exact
    high: float
    seeds: tuple[int, int]  # the lowest and the highest
    smallest_m: float | None
    digest: str
    reasons: tuple[str, ...]  # why it is wrong
    remains: str


def matrix(flights: Sequence[FlownCase], tests: Mapping[str, Sequence[str]]) -> list[MatrixRow]:
    """Return the matrix.

    Args:
        flights: of the campaign.
        tests: names of Covey's own tests by the condition that they show.
    """
    return [_row(hazard, flights, tests) for hazard in HAZARDS]


def _row(
    hazard: Hazard, flights: Sequence[FlownCase], tests: Mapping[str, Sequence[str]]
) -> MatrixRow:
    mine = [one for one in flights if one.case.fault in hazard.faults]
    rows = tuple(_failsafe_rows(hazard, mine, tests))
    wrong = [one for one in mine if not one.is_right]
    reasons = [f"{row.condition}: {row.wrong}" for row in rows if row.wrong]
    reasons += [reason for one in wrong for reason in _reasons(one)]

    status = SHOWN
    if not mine:
        status = NOT_SHOWN
    if reasons:
        status = WRONG

    flown_faults = {
        fault: sum(one.case.fault == fault for one in mine)
        for fault in hazard.faults
        if any(one.case.fault == fault for one in mine)
    }
    interval = two_sided(len(wrong), len(mine))
    seeds = [one.case.seed for one in mine]
    distances_m = [one.smallest_m for one in mine if one.smallest_m is not None]
    return MatrixRow(
        key=hazard.key,
        question=hazard.question,
        asked_by=hazard.asked_by,
        status=status,
        rows=rows,
        faults=flown_faults,
        not_flown=tuple(fault for fault in hazard.faults if fault not in flown_faults),
        flights=len(mine),
        wrong_flights=len(wrong),
        upper_bound=round(upper_bound(len(wrong), len(mine)), 4),
        low=round(interval.low, 4),
        high=round(interval.high, 4),
        seeds=(min(seeds, default=0), max(seeds, default=0)),
        smallest_m=min(distances_m, default=None),
        digest=digest(mine),
        reasons=tuple(reasons),
        remains=hazard.remains,
    )


def _failsafe_rows(
    hazard: Hazard, mine: Sequence[FlownCase], tests: Mapping[str, Sequence[str]]
) -> Iterable[FailsafeRow]:
    """Yield the rows of the failsafe table that a hazard names, each compared with the claim."""
    for condition, claimed in hazard.claims.items():
        is_action = TABLE.get((Situation.FLYING, condition))
        wrong = ""
        if is_action is None:
            wrong = f"'{WORDS[claimed]}' is claimed, and the failsafe table has no such row"
        elif is_action is not claimed:
            wrong = (
                f"'{WORDS[claimed]}' is claimed, and the failsafe table says '{WORDS[is_action]}'"
            )
        yield FailsafeRow(
            condition=condition.value,
            action=WORDS[claimed],
            flights_noticed=sum(condition.value in one.seen for one in mine),
            tests=tuple(tests.get(condition.value, ())),
            wrong=wrong,
        )


def _reasons(one: FlownCase) -> list[str]:
    case = one.case
    who = f", {case.victim}" if case.victim else ""
    flight = f"{case.fault}{who} at {case.at_s:.2f} s, seed {case.seed}"
    return [f"{flight}: {sentence}" for sentence in one.wrong]


def conditions_never_seen(flights: Sequence[FlownCase]) -> list[str]:
    """Return the rows of the failsafe table that no flight of the campaign has brought about."""
    seen = {condition for one in flights for condition in one.seen}
    return [condition.value for condition in Condition if condition.value not in seen]
