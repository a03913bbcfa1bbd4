"""Fleets among walls: ways around them and through a passage for one, with what goes wrong there.

By ground truth nobody touches a wall, and nobody comes nearer to another one than it may.
"""

from __future__ import annotations

import asyncio
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from groundstation.orders.result import Results
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from sitl.emulator.emulator import Environment
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep
from sitl.physics.wind import WindSettings

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

BODY_M = 0.25  # radius
SAFETY_M = 0.8
HALF_LANE_M = 0.6  # the law needs 0.45 m on both sides


def box(name: str, west_m: float, south_m: float, east_m: float, north_m: float) -> dict[str, Any]:
    corners = [[west_m, south_m], [east_m, south_m], [east_m, north_m], [west_m, north_m]]
    return {"name": name, "polygon_enu_m": corners}


WALL = [box("wall", -0.05, -2.5, 0.05, 2.5)]
# two rooms, and between them a passage of 4 m that is wide enough for one
LANE = [
    box("north", -2.0, HALF_LANE_M, 2.0, 5.95),
    box("south", -2.0, -5.95, 2.0, -HALF_LANE_M),
]
BESIDE_WALL = [(-3.0, 0.2), (-3.0, -1.2), (-3.0, 1.6)]
FACING = [(-4.0, 0.0), (4.0, 0.0)]
MEET = ("move mav0 4 1.5 1.0", "move mav1 -4 1.5 1.0")


def fleet_among(obstacles: list[dict[str, Any]], starts: list[tuple[float, float]]) -> FleetConfig:
    data = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-6.0, 6.0], "y": [-6.0, 6.0], "z": [0.0, 3.0]}
    data["fleet"]["max_wind_m_s"] = 6.0
    data["obstacles"] = obstacles

    names = list(data["vehicles"])[: len(starts)]
    data["vehicles"] = {name: data["vehicles"][name] for name in names}
    for name, start in zip(names, starts, strict=True):
        data["vehicles"][name]["start_enu_m"] = [*start, 0.0]
    slots = data["formations"]["triangle"]
    data["formations"]["triangle"] = {name: slots[name] for name in names}
    return fleet_from_mapping(data)


def wind(east_m_s: float, north_m_s: float) -> Environment:
    return Environment(WindSettings((east_m_s, north_m_s, 0.0), 0.6))


class Flown:
    """A flight, the least distance of a vehicle's centre from a wall, and orders side by side."""

    def __init__(self, flight: Lockstep) -> None:
        self.flight = flight
        self.wall_m = math.inf
        flight.client.add_listener(self._look)
        flight.takeoff(1.0)

    def _look(self, state: object) -> None:
        for view in self.flight.state.vehicles.values():
            if view.truth is None or view.truth.is_on_ground:
                continue
            for obstacle in self.flight.config.obstacles:
                away_m = obstacle.distance_m(view.truth.position_enu_m)
                self.wall_m = min(self.wall_m, away_m)

    def order(self, *texts: str, timeout_s: float = 120.0) -> Results:
        """Give orders at once, and return the results of all of their vehicles."""

        async def all_of_them() -> list[Results]:
            orders = (self.flight.client.order(text, timeout_s) for text in texts)
            return await asyncio.gather(*orders)

        results: Results = {}
        for own in self.flight.wait_for(all_of_them()):
            results.update(own)
        return results

    def place(self, name: str) -> tuple[float, float]:
        truth = self.flight.state.vehicles[name].truth
        assert truth is not None
        return truth.position_enu_m[0], truth.position_enu_m[1]

    def after(self, seconds: float, function: Callable[[], object]) -> None:
        self.flight.at(self.flight.time_s + seconds, function)

    def keeps_its_distances(self) -> bool:
        return self.wall_m > BODY_M and self.flight.min_separation_m > SAFETY_M


def are_done(results: Results) -> bool:
    return all(result.is_done for result in results.values())


@pytest.mark.parametrize("east_north_m_s", [(0.0, 0.0), (0.0, 4.0), (4.0, 0.0)])
def test_moves_a_formation_and_the_way_home_lead_around_a_wall(
    lockstep, east_north_m_s: tuple[float, float]
) -> None:
    flown = Flown(lockstep(fleet_among(WALL, BESIDE_WALL), environment=wind(*east_north_m_s)))
    assert are_done(flown.order("move mav0 3 0.2 1.0"))
    assert are_done(flown.order("formation triangle 3 0 1.0"))
    assert are_done(flown.order("home"))
    assert flown.keeps_its_distances()


def test_a_vehicle_that_is_held_on_its_way_around_goes_on_with_the_next_order(lockstep) -> None:
    flown = Flown(lockstep(fleet_among(WALL, BESIDE_WALL)))
    flown.after(5.0, lambda: flown.flight.start_soon(flown.flight.client.order("hold mav0", 9.0)))
    assert flown.order("move mav0 3 0.2 1.0")["mav0"].phase == "superseded"
    assert flown.place("mav0")[1] > 1.0
    assert are_done(flown.order("move mav0 3 -0.5 1.0"))
    assert flown.keeps_its_distances()


@pytest.mark.parametrize("after_s", [3.0, 5.0, 7.0])
def test_poses_that_stop_for_a_while_on_the_way_around_change_nothing(
    lockstep, after_s: float
) -> None:
    flown = Flown(lockstep(fleet_among(WALL, BESIDE_WALL)))
    flown.flight.inject(Fault("mocap_lost", "mav0", flown.flight.time_s + after_s, 0.6))
    assert are_done(flown.order("move mav0 3 0.2 1.0"))
    assert flown.keeps_its_distances()


def test_an_ordered_duration_is_flown_around_a_wall(lockstep) -> None:
    flown = Flown(lockstep(fleet_among(WALL, BESIDE_WALL)))
    begin_s = flown.flight.time_s
    assert are_done(flown.order("move mav0 3 0.2 1.0 in 40"))
    assert 28.0 < flown.flight.time_s - begin_s < 44.0


@pytest.mark.parametrize("east_north_m_s", [(0.0, 0.0), (0.0, 4.0), (4.0, 0.0)])
def test_two_that_meet_in_a_passage_for_one_both_arrive(
    lockstep, east_north_m_s: tuple[float, float]
) -> None:
    flown = Flown(lockstep(fleet_among(LANE, FACING), environment=wind(*east_north_m_s)))
    assert are_done(flown.order(*MEET))
    assert flown.keeps_its_distances()


def test_a_vehicle_that_flies_away_from_its_goal_says_to_whom_it_gives_way(lockstep) -> None:
    flown = Flown(lockstep(fleet_among(LANE, FACING)))
    given_way_to: list[str] = []

    def look(state: object) -> None:
        telemetry = flown.flight.state.vehicles["mav0"].telemetry
        if telemetry is not None and telemetry.velocity_enu_m_s[0] < -0.3:
            given_way_to.append(telemetry.avoids)

    flown.flight.client.add_listener(look)
    assert are_done(flown.order(*MEET))
    assert set(given_way_to) == {"mav1"}


@pytest.mark.parametrize("held", ["mav0", "mav1"])
def test_one_that_is_held_where_they_meet_flies_on_later(lockstep, held: str) -> None:
    flown = Flown(lockstep(fleet_among(LANE, FACING)))
    hold = f"hold {held}"
    flown.after(11.0, lambda: flown.flight.start_soon(flown.flight.client.order(hold, 9.0)))
    results = flown.order(*MEET)
    assert results[held].phase == "superseded"
    assert are_done(flown.order(*MEET))
    assert flown.keeps_its_distances()


def test_one_whose_agent_dies_where_they_meet_blocks_the_other_which_says_so(lockstep) -> None:
    flown = Flown(lockstep(fleet_among(LANE, FACING)))
    flown.after(8.0, flown.flight.agents["mav1"].kill)
    result = flown.order(*MEET)["mav0"]
    assert result.phase == "timed out"
    assert "kept off by mav1" in result.sentence
    assert flown.keeps_its_distances()


def test_one_that_has_landed_in_the_passage_blocks_it_and_is_named(lockstep) -> None:
    flown = Flown(lockstep(fleet_among(LANE, FACING)))
    assert are_done(flown.order("move mav1 0 0 1.0"))
    assert are_done(flown.order("land mav1"))

    result = flown.order("move mav0 4 1.5 1.0")["mav0"]
    assert result.phase == "timed out"
    assert "mav1 on the ground" in result.sentence
    assert math.dist(flown.place("mav0"), flown.place("mav1")) > SAFETY_M
    assert flown.keeps_its_distances()


def test_one_that_hovers_in_the_passage_is_pushed_through_it(lockstep) -> None:
    flown = Flown(lockstep(fleet_among(LANE, FACING)))
    assert are_done(flown.order("move mav1 0 0 1.0"))
    assert are_done(flown.order("move mav0 4 1.5 1.0"))
    assert flown.keeps_its_distances()


def test_six_change_rooms_through_a_passage_for_one(lockstep) -> None:
    starts = [(-3.0, -1.3), (-3.0, 1.3), (-4.3, 0.0), (3.0, -1.3), (3.0, 1.3), (4.3, 0.0)]
    goals = [(4.5, -2.5), (4.5, 2.5), (3.2, 0.0), (-4.5, -2.5), (-4.5, 2.5), (-3.2, 0.0)]
    data = tomllib.loads(Path("configs/fleets/eight.toml").read_text())
    data["fleet"]["geofence_m"] = {"x": [-6.0, 6.0], "y": [-6.0, 6.0], "z": [0.0, 3.0]}
    data["obstacles"] = LANE
    data["formations"] = {}
    names = list(data["vehicles"])[:6]
    data["vehicles"] = {name: data["vehicles"][name] for name in names}
    for name, start in zip(names, starts, strict=True):
        data["vehicles"][name]["start_enu_m"] = [*start, 0.0]

    flown = Flown(lockstep(fleet_from_mapping(data)))
    texts = [f"move {name} {x} {y} 1.0" for name, (x, y) in zip(names, goals, strict=True)]
    assert are_done(flown.order(*texts, timeout_s=200.0))
    assert flown.keeps_its_distances()
