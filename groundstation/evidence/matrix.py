"""The matrix: each question of an authority, answered by the flights of a campaign. Pure.

A row is **shown** if flights were flown for it, none of them is judged wrong, and the failsafe
table does what is claimed. It is **wrong** if a flight is judged wrong or the failsafe table does
something else. It is **not shown** if nothing was flown for it, for instance because the fleet does
not use satellites, or because the question is about others and no two vehicles were in the air.
This is evidence for the faults, the fleet and the mission that were flown; the authority decides
whether it suffices.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import msgspec

from groundstation.evidence.hazards import HAZARDS, Hazard
from groundstation.evidence.kept_flights import FlownCase, digest
from onboard.confidence_intervals import two_sided, upper_bound
from onboard.safety.failsafe_table import TABLE, WORDS, Condition, Situation

SHOWN = "shown"
WRONG = "wrong"
NOT_SHOWN = "not shown"


class FailsafeRow(msgspec.Struct, frozen=True, kw_only=True):
    """One condition of the failsafe table, as a row of the matrix names it."""

    condition: str
    action: str  # claimed action of a flying vehicle, in words
    flights_noticed: int  # flights of this row in which the condition held
    tests: tuple[str, ...]  # names of Covey's own tests that show it
    wrong: str = ""  # how the failsafe table differs from the claim; empty: it does not


class MatrixRow(msgspec.Struct, frozen=True, kw_only=True):
    """One question with its evidence."""

    key: str
    question: str
    asked_by: tuple[str, ...]
    status: str
    rows: tuple[FailsafeRow, ...]
    faults: dict[str, int]  # fault -> number of flights
    not_flown: tuple[str, ...]  # faults without a flight that counts
    flights: int
    wrong_flights: int
    upper_bound: float  # one-sided bound of the share of wrong flights, 95 %, exact
    low: float  # ends of its two-sided interval, 95 %, exact
    high: float
    seeds: tuple[int, int]  # lowest and highest seed
    smallest_m: float | None  # smallest distance of pairs that the law flies
    digest: str
    reasons: tuple[str, ...]  # why the row is wrong
    remains: str  # what these flights do not show
    needs_pair: bool = False  # whether only flights with two vehicles in the air count


def matrix(flights: Sequence[FlownCase], tests: Mapping[str, Sequence[str]]) -> list[MatrixRow]:
    """Return the matrix.

    Args:
        flights: flights of the campaign.
        tests: condition -> names of Covey's own tests that show it.
    """
    return [_row(hazard, flights, tests) for hazard in HAZARDS]


def _row(
    hazard: Hazard, flights: Sequence[FlownCase], tests: Mapping[str, Sequence[str]]
) -> MatrixRow:
    own_flights = [flight for flight in flights if flight.case.fault in hazard.faults]
    wrong_alone: list[FlownCase] = []  # named, but in no number of the row
    if hazard.needs_pair:
        wrong_alone = [
            flight for flight in own_flights if not flight.had_pair and not flight.is_right
        ]
        own_flights = [flight for flight in own_flights if flight.had_pair]
    rows = tuple(_failsafe_rows(hazard, own_flights, tests))
    wrong_flights = [flight for flight in own_flights if not flight.is_right]
    reasons = [f"{row.condition}: {row.wrong}" for row in rows if row.wrong]
    for flight in (*wrong_flights, *wrong_alone):
        reasons += _reasons(flight)

    status = SHOWN
    if not own_flights:
        status = NOT_SHOWN
    if reasons:
        status = WRONG

    flown_faults = {}
    for fault in hazard.faults:
        count = sum(flight.case.fault == fault for flight in own_flights)
        if count:
            flown_faults[fault] = count

    interval = two_sided(len(wrong_flights), len(own_flights))
    seeds = [flight.case.seed for flight in own_flights]
    distances_m = [flight.smallest_m for flight in own_flights if flight.smallest_m is not None]
    return MatrixRow(
        key=hazard.key,
        question=hazard.question,
        asked_by=hazard.asked_by,
        status=status,
        rows=rows,
        faults=flown_faults,
        not_flown=tuple(fault for fault in hazard.faults if fault not in flown_faults),
        flights=len(own_flights),
        wrong_flights=len(wrong_flights),
        upper_bound=round(upper_bound(len(wrong_flights), len(own_flights)), 4),
        low=round(interval.low, 4),
        high=round(interval.high, 4),
        seeds=(min(seeds, default=0), max(seeds, default=0)),
        smallest_m=min(distances_m, default=None),
        digest=digest(own_flights),
        reasons=tuple(reasons),
        remains=hazard.remains,
        needs_pair=hazard.needs_pair,
    )


def _failsafe_rows(
    hazard: Hazard, own_flights: Sequence[FlownCase], tests: Mapping[str, Sequence[str]]
) -> Iterable[FailsafeRow]:
    """Yield the rows of the failsafe table that a hazard names, each compared with the claim."""
    for condition, claimed in hazard.claims.items():
        actual = TABLE.get((Situation.FLYING, condition))
        wrong = ""
        if actual is None:
            wrong = f"'{WORDS[claimed]}' is claimed, and the failsafe table has no such row"
        elif actual is not claimed:
            wrong = f"'{WORDS[claimed]}' is claimed, and the failsafe table says '{WORDS[actual]}'"
        yield FailsafeRow(
            condition=condition.value,
            action=WORDS[claimed],
            flights_noticed=sum(condition.value in flight.seen for flight in own_flights),
            tests=tuple(tests.get(condition.value, ())),
            wrong=wrong,
        )


def _reasons(flight: FlownCase) -> list[str]:
    """Return the sentences about what went wrong in a flight, each with the case of the flight."""
    case = flight.case
    victim = f", {case.victim}" if case.victim else ""
    case_words = f"{case.fault}{victim} at {case.at_s:.2f} s, seed {case.seed}"
    return [f"{case_words}: {sentence}" for sentence in flight.wrong]


def conditions_never_seen(flights: Sequence[FlownCase]) -> list[str]:
    """Return the conditions of the failsafe table that held in no flight of the campaign."""
    seen = {condition for flight in flights for condition in flight.seen}
    return [condition.value for condition in Condition if condition.value not in seen]
