"""Guided search for the lie of one member that brings *others* nearest to each other.

Random tries hardly ever find such a lie: it has to come at the right moment, from the right side
and with the right size (SwarmFuzz guides its search by the distances, too). So this is
an evolution strategy: of each generation the best few are kept, and the next one is
drawn around their mean with their own spread, all flights of a generation as one compiled batch. It
begins anew several times, each time from many random lies over several flights.

What flies here is the law alone: no agent judges whether a neighbour's word can be true, and no
failsafe holds or lands. The distances are therefore those that the law keeps by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array
from sitl.monte_carlo import batch_flight, scenarios
from sitl.monte_carlo.campaign_settings import Setup
from sitl.monte_carlo.member_lie import LieKind, MemberLie

# of each number of a lie: what may be searched; the places are those of MemberLie
BOUNDS = {
    "start_s": (0.0, 6.0),
    "lasts_s": (0.5, 10.0),
    "size_m": (0.3, 5.0),
    "direction_rad": (0.0, 2.0 * np.pi),
    "rise_s": (0.02, 3.0),
    "swings_hz": (0.0, 1.0),
}
SCENARIO = "swap8"
KINDS: tuple[LieKind, ...] = ("spoof", "lie")
_RESTARTS = 2  # of each kind
_FIRST_SHARE = 0.3  # of the flights of a restart are random
_GENERATION = 25
_KEPT = 6
_LEAST_SPREAD = 0.03  # of a bound's range
_FIRST_SEED = 7000


class Found(NamedTuple):
    """The worst lie of a kind."""

    lie: MemberLie
    seed: int  # of the flight
    others_m: float  # smallest distance of two others


@dataclass(frozen=True, slots=True)
class SearchReport:
    """What a search has found."""

    tries: int
    promised_m: float
    body_m: float  # two that are nearer touch
    honest_m: float  # the same flights without a lie, at their smallest
    worst: dict[LieKind, Found]
    random_m: float  # the worst of all that were random

    @property
    def is_right(self) -> bool:
        """Whether no two others touched: how far below the promise they came, the lines say."""
        return all(found.others_m >= self.body_m for found in self.worst.values())

    def as_mapping(self) -> dict[str, object]:
        """Return the report for programs."""
        worst = {
            kind: {**found.lie._asdict(), "seed": found.seed, "others_m": found.others_m}
            for kind, found in self.worst.items()
        }
        return {
            "tries": self.tries,
            "promised_m": self.promised_m,
            "honest_m": self.honest_m,
            "random_m": self.random_m,
            "worst": worst,
        }

    @property
    def lines(self) -> list[str]:
        """The report for people."""
        lines = [
            f"{self.tries} spoofings and lies of one of eight vehicles: the others promise "
            f"{self.promised_m:.2f} m, keep {self.honest_m:.2f} m without any, and "
            f"{self.random_m:.2f} m with those that were random."
        ]
        for found in self.worst.values():
            lines.append(
                f"  the worst: {found.others_m:.2f} m by {found.lie.words} (seed {found.seed})"
            )
        return lines


def search(
    setup: Setup, *, tries: int, seed: int = 1, say: Callable[[str], None] = lambda _: None
) -> SearchReport:
    """Search the lies with which the others come nearest to each other.

    Args:
        setup: fleet, law and perturbation.
        tries: how many flights.
        seed: of the search.
        say: gets the progress, a line each.
    """
    rng = np.random.default_rng(seed)
    each = tries // (_RESTARTS * len(KINDS))
    worst: dict[LieKind, Found] = {}
    flown = 0
    random_m = np.inf
    honest_m = np.inf

    for kind in KINDS:
        for restart in range(_RESTARTS):
            flight_seed = _FIRST_SEED + restart
            plan = scenarios.plan(SCENARIO, flight_seed)
            honest_m = min(honest_m, _distances_m([plan], setup)[0])

            first = round(_FIRST_SHARE * each)
            places = rng.uniform(size=(first, len(BOUNDS) + 1))
            distances_m = _distances_m([_with_lie(plan, kind, one) for one in places], setup)
            random_m = min(random_m, float(distances_m.min()))
            flown += first

            while len(places) < each:
                best = places[np.argsort(distances_m)[:_KEPT]]
                spread = np.maximum(best.std(axis=0), _LEAST_SPREAD)
                drawn = rng.normal(best.mean(axis=0), spread, (_GENERATION, len(BOUNDS) + 1))
                # the member is no number between others: it is one of the best's
                drawn[:, 0] = rng.choice(best[:, 0], _GENERATION)
                drawn = np.clip(drawn, 0.0, 1.0)
                new_m = _distances_m([_with_lie(plan, kind, one) for one in drawn], setup)
                places = np.vstack([places, drawn])
                distances_m = np.concatenate([distances_m, new_m])
                flown += _GENERATION

            at = int(distances_m.argmin())
            found = Found(_lie(kind, places[at], plan.count), flight_seed, float(distances_m[at]))
            say(f"{found.others_m:.2f} m between others by {found.lie.words}")
            if kind not in worst or found.others_m < worst[kind].others_m:
                worst[kind] = found

    limits = setup.fleet(scenarios.vehicle_count(SCENARIO)).fleet
    return SearchReport(
        tries=flown,
        promised_m=limits.safety_distance_m,
        body_m=limits.body_diameter_m,
        honest_m=float(honest_m),
        worst=worst,
        random_m=float(random_m),
    )


def _distances_m(plans: list[scenarios.FlightPlan], setup: Setup) -> Array:
    flown = batch_flight.fly(plans, setup)
    return np.array([one.outcome.min_separation_m for one in flown])


def _with_lie(plan: scenarios.FlightPlan, kind: LieKind, place: Array) -> scenarios.FlightPlan:
    return replace(plan, lie=_lie(kind, place, plan.count))


def _lie(kind: LieKind, place: Array, count: int) -> MemberLie:
    """Return the lie at a place of the search, whose numbers lie in [0, 1]."""
    low, high = np.array(list(BOUNDS.values())).T
    numbers = low + place[1:] * (high - low)
    values = dict(zip(BOUNDS, numbers.tolist(), strict=True))
    member = min(int(place[0] * count), count - 1)
    return MemberLie(member=member, kind=kind, **values)
