"""A ground that is cut off, slow, starved, stopped or killed: nobody comes near because of it.

Every vehicle has a direct endpoint, so a ground that blames an agent could land it past the law.
"""

from __future__ import annotations

import itertools
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from groundstation.missions.conditions import FleetMoment, fails
from sitl.lockstep.flight import GROUND
from tests.sitl.lockstep.grounds import (
    GROUND_FAULTS,
    GroundCase,
    direct_fleet,
    directly_landed,
    exchange,
    fly,
)

_MOMENTS_S = (4.0, 7.0, 9.0, 11.0, 13.0, 15.0, 17.0, 20.0)
# from the take-off to the landing
_EVERY_HALF_SECOND_S = tuple(4.0 + 0.5 * number for number in range(33))

SOME = [
    GroundCase("cut for good", 3, 4.0),  # while the vehicles arm
    GroundCase("hung for 3 s", 3, 13.0, seed=4),
    GroundCase("starved", 3, 11.0, seed=3),
    GroundCase("killed", 3, 12.0),
]
ALL = [
    GroundCase(fault, count, at_s, seed=number)
    for fault, count in itertools.product(GROUND_FAULTS, (3, 6, 8))
    for number, at_s in enumerate(_MOMENTS_S)
]
EVERY_HALF_SECOND = [
    GroundCase(fault, count, at_s)
    for fault, count, at_s in itertools.product(
        ("cut for 4 s", "slow", "hung for 3 s", "killed"), (3, 6), _EVERY_HALF_SECOND_S
    )
]


@pytest.mark.long
@pytest.mark.parametrize("case", SOME, ids=str)
def test_whatever_happens_to_the_ground_nobody_comes_near(case: GroundCase) -> None:
    assert fly(case).wrong == []


@pytest.mark.long
@pytest.mark.parametrize("case", ALL, ids=str)
def test_whatever_happens_to_the_ground_at_any_moment_nobody_comes_near(case: GroundCase) -> None:
    assert fly(case).wrong == []


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_ground_that_fails_at_every_half_second_brings_nobody_near() -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        flights = list(pool.map(fly, EVERY_HALF_SECOND))

    print(min(flights, key=lambda one: one.nearest_m))
    assert [f"{one.case}: {'; '.join(one.wrong)}" for one in flights if one.wrong] == []


@pytest.mark.long
def test_a_step_sent_into_the_silence_is_sent_again_and_the_mission_goes_on(lockstep) -> None:
    fleet = direct_fleet(3)
    verdict = lockstep(fleet, seed=1).fly(exchange(fleet))
    landing_begins_s = 1.0 + sum(step.duration_s for step in verdict.steps[:2])

    flight = lockstep(fleet, seed=1)
    flight.at(landing_begins_s - 0.3, lambda: GROUND_FAULTS["cut for 4 s"](flight, ""))
    verdict = flight.fly(exchange(fleet))

    assert verdict.exit_status == 0, verdict.summary
    assert all(step.is_done for step in verdict.steps)
    assert directly_landed(flight) == []


@pytest.mark.long
def test_what_a_cut_ground_cannot_hear_fails_nobody(lockstep) -> None:
    """A mission's `fails` asks about vehicles, and none of them has failed."""
    fleet = direct_fleet(3)
    flight = lockstep(fleet, seed=2)
    flight.takeoff(1.0)
    begin_ns = flight.client.now_ns()
    flight.bus.partition([GROUND])

    for _ in range(100):
        flight.run(0.05)
        moment = FleetMoment(flight.state, flight.client.now_ns(), begin_ns)
        assert not fails().holds(moment), fails().value(moment)

    flight.bus.heal()
    flight.run(8.0)
    flight.agents["mav1"].kill()
    flight.run(3.0)
    assert fails().value(FleetMoment(flight.state, flight.client.now_ns(), begin_ns)) == "mav1"
