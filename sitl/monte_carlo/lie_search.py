"""Guided search for the lie of one member that brings *others* nearest to each other.

Random lies hardly ever do that, because a lie needs the right moment, side and size. (SwarmFuzz
guides its search by the distances, too.) Therefore this is an evolution strategy. The best few lies
of all so far are kept, and the next generation is drawn from a normal distribution with their mean
and spread. All flights of a generation are one compiled batch. The search is restarted several
times, each time with many random lies.

Only the law flies here: no agent checks whether a neighbour's messages are plausible, and no
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

# the range of each number of a lie that is searched; the keys are fields of MemberLie
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
_RESTARTS = 2  # restarts for each kind of lie
_FIRST_SHARE = 0.3  # share of the flights of a restart whose lies are random
_GENERATION = 25  # lies in a generation
_KEPT = 6  # best lies, from which the next generation is drawn
_MIN_SPREAD = 0.03  # smallest standard deviation of a generation, as a share of the range
_FIRST_SEED = 7000


class Found(NamedTuple):
    """The worst lie of a kind."""

    lie: MemberLie
    seed: int  # seed of the flight
    others_m: float  # smallest distance of two other vehicles


@dataclass(frozen=True, slots=True)
class SearchReport:
    """The results of a search. Distances are smallest distances of two other vehicles."""

    tries: int  # number of flights with a lie
    promised_m: float  # the safety distance
    body_m: float  # body diameter: closer vehicles touch
    honest_m: float  # in the same flights without a lie
    worst: dict[LieKind, Found]
    random_m: float  # over all flights with a random lie

    @property
    def is_right(self) -> bool:
        """Whether no two other vehicles touched; they may come closer than the safety distance."""
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

    In the search a lie is a point in the unit cube: its first coordinate stands for the member, and
    the others for the numbers of BOUNDS.

    Args:
        setup: fleet, law and perturbation.
        tries: number of flights.
        seed: the seed of the search.
        say: called with each line of progress.
    """
    rng = np.random.default_rng(seed)
    tries_of_restart = tries // (_RESTARTS * len(KINDS))
    worst: dict[LieKind, Found] = {}
    flown = 0
    random_m = np.inf
    honest_m = np.inf

    for kind in KINDS:
        for restart in range(_RESTARTS):
            flight_seed = _FIRST_SEED + restart
            plan = scenarios.plan(SCENARIO, flight_seed)
            (without_lie_m,) = _distances_m([plan], setup)
            honest_m = min(honest_m, without_lie_m)

            random_count = round(_FIRST_SHARE * tries_of_restart)
            points = rng.uniform(size=(random_count, len(BOUNDS) + 1))
            distances_m = _distances_m([_with_lie(plan, kind, point) for point in points], setup)
            random_m = min(random_m, float(distances_m.min()))
            flown += random_count

            # each pass draws and flies one generation
            while len(points) < tries_of_restart:
                best = points[np.argsort(distances_m)[:_KEPT]]
                spread = np.maximum(best.std(axis=0), _MIN_SPREAD)
                drawn = rng.normal(best.mean(axis=0), spread, (_GENERATION, len(BOUNDS) + 1))
                # The first coordinate is the member. It has no mean, so take it from one of the
                # best lies.
                drawn[:, 0] = rng.choice(best[:, 0], _GENERATION)
                drawn = np.clip(drawn, 0.0, 1.0)
                new_m = _distances_m([_with_lie(plan, kind, point) for point in drawn], setup)
                points = np.vstack([points, drawn])
                distances_m = np.concatenate([distances_m, new_m])
                flown += _GENERATION

            worst_index = int(distances_m.argmin())
            found = Found(
                lie=_lie(kind, points[worst_index], plan.count),
                seed=flight_seed,
                others_m=float(distances_m[worst_index]),
            )
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
    """Fly plans; return for each the smallest distance of two vehicles that do not lie."""
    flown = batch_flight.fly(plans, setup)
    return np.array([flight.outcome.min_separation_m for flight in flown])


def _with_lie(plan: scenarios.FlightPlan, kind: LieKind, point: Array) -> scenarios.FlightPlan:
    return replace(plan, lie=_lie(kind, point, plan.count))


def _lie(kind: LieKind, point: Array, count: int) -> MemberLie:
    """Return the lie at a point of the search, whose coordinates lie in [0, 1]."""
    low, high = np.array(list(BOUNDS.values())).T
    member_coordinate = point[0]
    numbers = low + point[1:] * (high - low)
    values = dict(zip(BOUNDS, numbers.tolist(), strict=True))
    member = min(int(member_coordinate * count), count - 1)
    return MemberLie(member=member, kind=kind, **values)
