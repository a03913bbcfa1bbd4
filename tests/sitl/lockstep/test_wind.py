"""Fleets in wind: what they say of it, how much of it they fly in, and how they come down."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.fleet.state import FleetState
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.feasibility.lift_off import blown_aside_m
from sitl.emulator.emulator import Environment
from sitl.physics.wind import WindSettings
from tests.bench.wind import Row, fly, fly_ramp, fly_row
from tests.sitl.lockstep.suite import Case
from tests.sitl.lockstep.suite import fly as fly_case

PAPER_MISSION = "configs/missions/paper.toml"


def blowing(east_m_s: float, gust_m_s: float = 0.0) -> Environment:
    return Environment(WindSettings((east_m_s, 0.0, 0.0), gust_m_s))


@pytest.mark.long
def test_telemetry_tells_the_wind_within_1_m_s(lockstep, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=2, environment=blowing(4.0, 0.6))
    flight.takeoff(1.0)
    flight.run(4.0)

    # each value is a mean over 2 s only, in which gusts of 0.6 m/s leave up to 1.2 m/s
    told_m_s = []
    for _ in range(8):
        flight.run(0.5)
        views = flight.state.vehicles.values()
        told_m_s.append([view.telemetry.wind_enu_m_s for view in views])

    for mean_m_s in np.mean(told_m_s, axis=0):
        assert mean_m_s == pytest.approx((4.0, 0.0), abs=1.0)
    for view in flight.state.vehicles.values():
        assert 0.0 < view.telemetry.gust_m_s < 1.5


def test_the_wind_is_not_known_to_a_vehicle_without_a_drag(lockstep, paper: FleetConfig) -> None:
    without = {
        name: replace(vehicle, drag_1_s=0.0, enabled=name == "mav0")
        for name, vehicle in paper.vehicles.items()
    }
    flight = lockstep(replace(paper, vehicles=without), environment=blowing(4.0))
    flight.takeoff(1.0)
    telemetry = flight.state.vehicles["mav0"].telemetry
    assert math.isnan(telemetry.wind_enu_m_s[0])
    assert math.isnan(telemetry.max_wind_m_s)


@pytest.mark.long
def test_a_take_off_to_a_height_is_blown_aside_no_further_than_a_low_one(
    lockstep, paper: FleetConfig
) -> None:
    high = replace(paper.fleet.geofence_m, z=(0.0, 12.0))
    flight = lockstep(
        replace(paper, fleet=replace(paper.fleet, geofence_m=high)),
        seed=1,
        environment=blowing(4.0),
    )
    aside_m: list[float] = []

    def look(state: FleetState) -> None:
        for name, view in state.vehicles.items():
            if view.truth is not None:
                start_m = paper.vehicles[name].start_enu_m[:2]
                aside_m.append(math.dist(view.truth.position_enu_m[:2], start_m))

    flight.client.add_listener(look)
    flight.takeoff(8.0)
    assert max(aside_m) < 0.8


@pytest.mark.long
@pytest.mark.parametrize(("name", "wind_m_s"), [("paper", 4.0), ("paper", 8.0), ("sih", 3.0)])
def test_one_that_takes_off_is_blown_aside_as_far_as_check_says(
    lockstep, name: str, wind_m_s: float
) -> None:
    fleet = load_fleet(f"configs/fleets/{name}.toml")
    alone = fleet.vehicles["mav0"]
    flight = lockstep(
        replace(fleet, vehicles={"mav0": alone}),
        seed=3,
        environment=blowing(wind_m_s, 0.15 * wind_m_s),
    )
    aside_m = [0.0]

    def look(state: FleetState) -> None:
        truth = state.vehicles["mav0"].truth
        if truth is not None:
            aside_m.append(truth.position_enu_m[0] - alone.start_enu_m[0])

    flight.client.add_listener(look)
    flight.ready()
    flight.wait_for(flight.fleet.takeoff(1.0))
    assert max(aside_m) == pytest.approx(blown_aside_m(alone, wind_m_s), abs=0.15)


@pytest.mark.long
@pytest.mark.parametrize(
    ("fleet", "wind_m_s", "by", "seed"),
    [("paper", 6.5, 1, 16), ("paper", 6.5, 1, 1), ("paper", 7.7, 0, 1), ("paper", 7.7, 0, 7)],
)
def test_a_row_along_the_wind_takes_off_and_keeps_the_distance(
    fleet: str, wind_m_s: float, by: int, seed: int
) -> None:
    flown = fly_row(fleet, wind_m_s, 0.15 * wind_m_s, seed, Row(apart_m=1.5, by=by))
    assert flown.min_separation_m > 0.80


@pytest.mark.long
@pytest.mark.failsafe("wind above its limit", step="flying")
def test_nobody_sets_out_in_a_wind_above_the_limit(lockstep, paper: FleetConfig) -> None:
    careful = replace(paper, fleet=replace(paper.fleet, max_wind_m_s=2.6))
    flight = lockstep(careful, seed=1, environment=blowing(3.0))
    verdict = flight.fly(PAPER_MISSION)
    assert not verdict.passed
    # no two vehicles have the same drag, hence each feels another wind
    refusal = r"feels a wind of (2\.[6-9]|3\.[0-4]) m/s, its limit is 2\.6 m/s .*nobody sets out"
    assert re.search(refusal, " ".join(verdict.sentences))
    assert not [event for event in flight.events if "formation" in event.sentence]
    # neighbours start at 1.5 m, and are blown aside at lift-offs that are moments apart
    assert flight.min_separation_m > 1.1


@pytest.mark.long
@pytest.mark.failsafe("wind near its limit", step="flying")
@pytest.mark.failsafe("wind above its limit", step="flying")
def test_a_wind_that_rises_to_twice_the_limit_brings_all_down_inside_the_fence() -> None:
    flown = fly_ramp("sih", 2.0, seed=1)
    assert flown.has_passed
    assert flown.collisions == 0
    assert flown.outside_m == 0.0
    assert flown.spare_s > 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize(
    ("fleet", "mean_m_s"), [("paper", 4.0), ("paper", 5.0), ("sih", 2.0), ("sih", 3.0)]
)
def test_the_promise_is_kept_in_winds_that_check_allows(
    fleet: str, mean_m_s: float, seed: int
) -> None:
    flown = fly(fleet, mean_m_s, 0.15 * mean_m_s, seed)
    assert flown.collisions == 0
    assert flown.min_separation_m > 0.8


@pytest.mark.long
@pytest.mark.parametrize("seed", [102, 117, 118])
def test_the_promise_is_kept_in_gusts_that_are_strong_for_their_wind(seed: int) -> None:
    # the crossing begins a few seconds after the take-off, so that few gusts are known
    flown = fly("paper", 3.3, 1.2, seed)
    assert flown.collisions == 0
    assert flown.min_separation_m > 0.8


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 11))
@pytest.mark.parametrize("fleet", ["paper", "sih"])
def test_ramps_of_wind_end_on_the_ground(fleet: str, seed: int) -> None:
    flown = fly_ramp(fleet, 2.0, seed)
    assert flown.has_passed
    assert flown.collisions == 0
    assert flown.outside_m == 0.0


@pytest.mark.long
@pytest.mark.parametrize(("fleet", "seed"), [("sih", 7), ("paper", 3), ("paper", 8)])
def test_vehicles_that_a_wind_rising_within_5_s_carries_along_come_down_apart(
    fleet: str, seed: int
) -> None:
    # it has taken all of the tilt before they are down, so some are carried out of the fence
    flown = fly_ramp(fleet, 2.0, seed, ramp_s=5.0)
    assert flown.has_passed
    assert flown.collisions == 0
    assert flown.min_separation_m > 1.0


@pytest.mark.long
def test_two_that_exchange_heights_keep_the_distance_after_a_lull_of_the_gusts() -> None:
    # what breaks has nothing to do with it: the gusts of two heights differ, and push them together
    case = Case("PX4 hangs for 0.6 s", tick=1138, height_m=4.2, wind_m_s=3.0, mission="columns")
    flown = fly_case(case)
    assert not flown.wrong
    assert flown.min_separation_m > 0.80
