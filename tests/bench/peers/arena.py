"""Flights of contestants in the simulated campaigns, with a contestant's controller in the place of
the product's.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

from onboard.arrays import Array
from sitl.monte_carlo import batch_flight, campaign_settings, scenarios
from tests.bench.peers.contestants import Contestant
from tests.bench.peers.report import Outcome

MIX = scenarios.MIX


@dataclass(frozen=True, slots=True)
class Flights:
    """Outcomes of one contestant in one scenario, and the cost of its law, interpreted as on a
    drone.
    """

    outcomes: tuple[Outcome, ...]
    busy_s: float  # in the law, for so many calls
    calls: int


def size(scenario: str) -> int:
    """Number of vehicles."""
    return scenarios.vehicle_count(scenario)


def fly(
    contestant: Contestant,
    scenario: str,
    seeds: Sequence[int],
    *,
    errors: str = "mocap",
    types: str | None = None,
) -> Flights:
    """The flights of a scenario, one for each seed; ``types`` are given to the vehicles in turn
    (None: sih).

    The first one is flown once more where the contestant's law is compiled otherwise, to time it.
    """
    law = contestant.law()
    interpreted = functools.partial(contestant.interpreted, law)
    if contestant.is_compiled:
        flown = _flown(contestant, scenario, seeds, errors, contestant.controller, types=types)
        _flown(contestant, scenario, seeds[:1], errors, interpreted, types=types)
    else:
        flown = _flown(contestant, scenario, seeds, errors, interpreted, types=types)
    outcomes = [
        Outcome(
            scenario=scenario,
            seed=one.plan.seed,
            success=one.outcome.is_success,
            min_separation_m=one.outcome.min_separation_m,
            violation_s=one.outcome.violation_s,
            collision=one.outcome.is_collision,
            ratio=one.outcome.makespan_s / one.straight_line_s
            if math.isfinite(one.straight_line_s)
            else math.nan,
            relaxed_share=one.outcome.relaxed_share,
            slew_m_s3=one.outcome.slew_rms_m_s3,
            max_speed_m_s=one.outcome.max_speed_m_s,
        )
        for one in flown
    ]
    return Flights(tuple(outcomes), law.busy_s, law.calls)


def trace(
    contestant: Contestant,
    scenario: str,
    seed: int,
    *,
    errors: str = "mocap",
    sets: Sequence[str] = (),
    types: str | None = None,
) -> tuple[Array, Array]:
    """One flight: time (T,), true positions (T, N, 3)."""
    chosen = dataclasses.replace(contestant, sets=(*contestant.sets, *sets))
    (one,) = _flown(
        chosen, scenario, [seed], errors, chosen.controller, types=types, has_trace=True
    )
    if one.outcome.trace is None:
        raise RuntimeError("The campaign has kept no trace although it was asked to.")
    return one.outcome.trace.t_s, one.outcome.trace.position_enu_m


def _flown(
    contestant: Contestant,
    scenario: str,
    seeds: Sequence[int],
    errors: str,
    controller: batch_flight.MakeController,
    *,
    types: str | None = None,
    has_trace: bool = False,
) -> list[batch_flight.Flown]:
    setup = campaign_settings.setup_for(
        law=contestant.built_in, types=types, errors=errors, changes=contestant.sets
    )
    plans = [scenarios.plan(scenario, seed) for seed in seeds]
    flown = batch_flight.fly(plans, setup, controller=controller, has_trace=has_trace)
    for one in flown:
        if one.law_refusal:
            raise RuntimeError(
                f"{one.law_refusal} in {scenario} seed {one.plan.seed}: Covey's law went on, "
                "so that these are no figures of that method."
            )
    return flown
