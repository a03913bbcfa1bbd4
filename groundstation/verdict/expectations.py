"""The expectations of a mission about its flight, and their comparison with the flight. Pure.

A mission declares them in ``[expect]`` of its file, in a step ``do = "expect"``, or in ``EXPECT``
of a Python mission.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from groundstation.fleet.state import Separation
from groundstation.verdict.observations import Arrival
from onboard.config.fleet import FleetConfig

# An expectation above these bounds is a mistake, for instance in its unit.
EXPECT_MOST_M = {"min_separation_m": 100.0, "arrived_within_m": 10.0}


class Expect(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Expectations: a step checks the flight so far, ``[expect]`` the whole mission."""

    min_separation_m: float | None = None  # no two centres came nearer than this
    # each vehicle was at most this far from its goal when its order was done
    arrived_within_m: float | None = None
    # true: all vehicles are down and disarmed; false: at least one is not
    all_landed: bool | None = None


class ExpectationResult(msgspec.Struct, frozen=True):
    """One expectation and whether it came true."""

    name: str
    has_come_true: bool
    sentence: str
    limit_m: float | None = None  # the expected distance; None: the expectation has none


def check(
    expect: Expect,
    fleet: FleetConfig,
    closest: Separation | None,
    arrivals: Sequence[Arrival],
    landed: Mapping[str, bool],
    collided: Sequence[str] = (),
    fallen: Sequence[str] = (),
) -> list[ExpectationResult]:
    """Compare each declared expectation with the flight.

    Args:
        expect: the expectations.
        fleet: the fleet file.
        closest: smallest separation; None if none was measured.
        arrivals: distances from goals at the end of orders.
        landed: whether each vehicle is landed and disarmed: those that take part, and others that
            the fleet file lacks.
        collided: vehicles that touched another one.
        fallen: vehicles that came to the ground by a fall.

    Returns:
        One result for each declared expectation.
    """
    results = []
    if expect.min_separation_m is not None:
        results.append(_check_separation(expect.min_separation_m, fleet, closest, collided))
    if expect.arrived_within_m is not None:
        results.append(_check_arrivals(expect.arrived_within_m, arrivals))
    if expect.all_landed is not None:
        if not expect.all_landed:  # one of the mission's own is up
            landed = {name: landed[name] for name in landed if name in fleet.vehicles}
        results.append(_check_landed(expect.all_landed, landed, fallen))
    return results


def _check_separation(
    limit_m: float, fleet: FleetConfig, closest: Separation | None, collided: Sequence[str]
) -> ExpectationResult:
    if closest is not None:
        is_met = closest.distance_m >= limit_m and not collided
        outcome = f"{closest.first} and {closest.second} came to {closest.distance_m:.3f} m"
        if collided:
            outcome += f". {' and '.join(collided)} collided"
    elif len(fleet.enabled_names) < 2:
        is_met = True
        outcome = "there is only one vehicle"
    else:
        is_met = False
        outcome = "no separation was measured"

    sentence = f"At least {_limit_words(limit_m)} between all: {outcome}."
    return ExpectationResult("min_separation_m", is_met, sentence, limit_m)


def _check_arrivals(limit_m: float, arrivals: Sequence[Arrival]) -> ExpectationResult:
    """Compare distances from goals; a mission without any goal has not met this expectation."""
    within_count = sum(1 for arrival in arrivals if arrival.distance_m <= limit_m)
    is_met = 0 < within_count == len(arrivals)

    outcome = "no goal was flown to"
    worst = max(arrivals, key=lambda arrival: arrival.distance_m, default=None)
    if worst is not None:
        outcome = (
            f"{within_count} of {len(arrivals)}; furthest off was {worst.vehicle}, "
            f"{metres(worst.distance_m)} at '{worst.step}'"
        )

    sentence = f"Goals reached within {_limit_words(limit_m)}: {outcome}."
    return ExpectationResult("arrived_within_m", is_met, sentence, limit_m)


def _check_landed(
    is_expected: bool, landed: Mapping[str, bool], fallen: Sequence[str]
) -> ExpectationResult:
    """Compare who is on the ground and disarmed; a fall is named, and judged by the verdict."""
    flying = [name for name, has_landed in landed.items() if not has_landed]
    are_landed = not flying

    outcome = "all"
    if flying:
        outcome = f"not {', '.join(flying)}"
    if fallen:
        outcome += f"; by a fall: {', '.join(fallen)}"
    return ExpectationResult(
        "all_landed", are_landed == is_expected, f"Landed and disarmed: {outcome}."
    )


def _limit_words(limit_m: float) -> str:
    """Return a limit in words: as it was declared, with two decimals at least.

    A rounded limit could seem to be kept where it was not, or broken where it was kept.
    """
    words = f"{limit_m:.2f}"
    if float(words) != limit_m:
        words = f"{limit_m}"
    return f"{words} m"


def metres(value: float) -> str:
    """Return a distance in words."""
    if not math.isfinite(value):
        return "an unknown distance"
    return f"{value:.3f} m"
