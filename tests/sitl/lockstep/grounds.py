"""What can happen to a ground in flight, and fleets that cross each other's ways meanwhile.

Every vehicle has a direct endpoint, so a ground that blames an agent without reason has a way to
land it past the law.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.bus.schema import Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from sitl.lockstep.campaign.breaking import (
    Inject,
    cut_ground,
    hang_ground,
    kill_ground,
    slow_ground,
    starve_ground,
)
from sitl.lockstep.flight import Lockstep
from tests.sitl.square_fleets import square_fleet

MIN_SEPARATION_M = 0.80
GROUND_LOST_LAND_S = 8.0
_DOWN_S = 60.0


def direct_fleet(count: int) -> FleetConfig:
    """Return a square of vehicles whose PX4s can be reached past the agents."""
    fleet = square_fleet(count)
    vehicles = {
        name: replace(vehicle, direct=f"udpout://127.0.0.1:{18_570 + vehicle.index}")
        for name, vehicle in fleet.vehicles.items()
    }
    section = replace(fleet.fleet, ground_lost_land_s=GROUND_LOST_LAND_S)
    return replace(fleet, vehicles=vehicles, fleet=section)


def exchange(fleet: FleetConfig, height_m: float = 1.0) -> Mission:
    """Return a mission in which the first changes places with the last, and so on."""
    names = fleet.enabled_names
    goals = {}
    for name, other in zip(names, reversed(names), strict=True):
        east_m, north_m, _ = fleet.vehicles[other].start_enu_m
        goals[name] = [east_m, north_m, height_m]
    steps = [
        {"do": "takeoff", "height_m": height_m},
        {"do": "goto", "goals": goals},
        {"do": "land"},
    ]
    return mission_from_mapping({"schema": 1, "step": steps}, path="exchange.toml", fleet=fleet)


# besides these a ground may be killed
GROUND_FAULTS: dict[str, Inject] = {
    "cut for 1.8 s": cut_ground(1.8),
    "cut for 4 s": cut_ground(4.0),
    "cut for good": cut_ground(60.0),
    "slow": slow_ground,
    "starved": starve_ground,
    "hung for 0.8 s": hang_ground(0.8),
    "hung for 3 s": hang_ground(3.0),
    "hung for 12 s": hang_ground(12.0),
    "killed": kill_ground,
}


class GroundCase(NamedTuple):
    """One flight: what happens to the ground, and when, with how many vehicles."""

    fault: str
    vehicles: int
    at_s: float  # since the start
    seed: int = 0


class GroundFlown(NamedTuple):
    """What became of it, by ground truth and by what the ground said."""

    case: GroundCase
    nearest_m: float
    direct: list[str]  # landings past the agents
    is_down: bool  # everybody, at the end

    @property
    def wrong(self) -> list[str]:
        """Return what must not be, as sentences."""
        wrong = [*self.direct]
        if not self.nearest_m > MIN_SEPARATION_M:
            wrong.append(f"{MIN_SEPARATION_M:g} m is promised: {self.nearest_m:.2f} m")
        if not self.is_down:
            wrong.append("not everybody is down at the end")
        return wrong


def fly(case: GroundCase) -> GroundFlown:
    """Fly one case: vehicles change places, and something happens to their ground."""
    fleet = direct_fleet(case.vehicles)
    with Lockstep(fleet, seed=case.seed) as flight:
        nearest = Nearest(flight)
        flight.at(case.at_s, lambda: GROUND_FAULTS[case.fault](flight, ""))
        flight.fly(exchange(fleet))
        flight.bus.heal()
        for _ in range(round(_DOWN_S)):
            if all_down(flight):
                break
            flight.run(1.0)
        return GroundFlown(case, nearest.distance_m, directly_landed(flight), all_down(flight))


def directly_landed(flight: Lockstep) -> list[str]:
    """Return what the ground said about landings past the agents."""
    return [event.sentence for event in flight.events if event.code == "direct_command"]


class Nearest:
    """The smallest distance between two vehicles of which one flies, by ground truth."""

    def __init__(self, flight: Lockstep) -> None:
        self.distance_m = math.inf
        self._truths: dict[str, Truth] = {}
        self._last_name = flight.config.enabled_names[-1]
        node = flight.bus.node("judge")
        node.start()
        node.subscribe(Topic.TRUTH, "*", self._take)

    def _take(self, _topic: Topic, name: str, message: object) -> None:
        assert isinstance(message, Truth)
        self._truths[name] = message
        if name != self._last_name:
            return

        for one, other in itertools.combinations(self._truths.values(), 2):
            if one.is_on_ground and other.is_on_ground:
                continue
            apart_m = math.dist(one.position_enu_m[:2], other.position_enu_m[:2])
            self.distance_m = min(self.distance_m, apart_m)


def all_down(flight: Lockstep) -> bool:
    """Whether every PX4 is disarmed."""
    return not any(px4.is_armed for px4 in flight.simulation.emulator.autopilots)
