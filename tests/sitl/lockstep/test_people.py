"""A person with markers walks among the vehicles: they keep the safety distance to his circle, they
hold while the motion capture does not see him, and they do not take off beside him.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from onboard.bus.pose_publisher import PosePublisher
from onboard.bus.schema import MocapPose
from onboard.config.fleet import FleetConfig, Person
from onboard.safety.failsafe_table import Condition
from sitl.lockstep.flight import Lockstep

_FRAME_S = 0.02
_HEAD_M = 1.7

Point = tuple[float, float]


class Visitor:
    """A person whom the motion capture sees, at the place that a function of time says."""

    def __init__(self, flight: Lockstep, place: Callable[[float], Point], radius_m: float) -> None:
        self.flight = flight
        self.place = place
        self.radius_m = radius_m
        self.is_seen = True
        self.nearest_m = math.inf  # of a vehicle in the air to his circle
        node = flight.bus.node("markers")
        node.start()
        self._publisher = PosePublisher(node)
        self._rng = np.random.default_rng(5)
        self._frames = 0
        self._frame()

    def _frame(self) -> None:
        """Publish one frame, note the distances, and plan the next frame."""
        flight = self.flight
        x, y = self.place(flight.time_s)
        noise_m = self._rng.normal(0.0, 0.003, 3)
        self._frames += 1
        pose = MocapPose(
            body="anna",
            boot_id=1,
            sequence=self._frames,
            stamp_ns=flight.simulation.now_ns,
            is_tracked=self.is_seen,
            position_enu_m=(x + noise_m[0], y + noise_m[1], _HEAD_M + noise_m[2]),
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        )
        self._publisher.publish(pose)

        emulator = flight.simulation.emulator
        position, _, _ = emulator.world.truth_enu()
        is_on_ground = emulator.world.vehicles.states.on_ground
        for east_m, north_m in position[~is_on_ground, :2]:
            distance_m = math.hypot(east_m - x, north_m - y) - self.radius_m
            self.nearest_m = min(self.nearest_m, distance_m)

        flight.at(flight.time_s + _FRAME_S, self._frame)


def with_anna(fleet: FleetConfig, radius_m: float = 0.4) -> FleetConfig:
    return msgspec.structs.replace(fleet, people={"anna": Person(radius_m=radius_m)})


def position_of(flight: Lockstep, name: str) -> tuple[float, float, float]:
    telemetry = flight.state.vehicles[name].telemetry
    assert telemetry is not None
    return telemetry.position_enu_m


def along(begin: Point, end: Point, from_s: float, speed_m_s: float) -> Callable[[float], Point]:
    """Return a straight walk that begins at a time and ends by standing."""
    length_m = math.dist(begin, end)

    def place(time_s: float) -> Point:
        share = min(max(time_s - from_s, 0.0) * speed_m_s / length_m, 1.0)
        return begin[0] + share * (end[0] - begin[0]), begin[1] + share * (end[1] - begin[1])

    return place


@pytest.mark.long
@pytest.mark.parametrize(("speed_m_s", "radius_m"), [(0.6, 0.7), (1.0, 0.4), (1.5, 0.4)])
@pytest.mark.parametrize("seed", [1, 2])
def test_vehicles_keep_the_safety_distance_to_the_circle_of_who_walks_through_them(
    lockstep, paper, speed_m_s, radius_m, seed
):
    flight = lockstep(with_anna(paper, radius_m=radius_m), seed=seed)
    visitor = Visitor(flight, lambda time_s: (-3.8, 3.0), radius_m)
    flight.takeoff(1.0)
    begin = (-3.8, -1.2)
    visitor.place = along(begin, (3.8, -1.7), flight.time_s + 2.0, speed_m_s)
    flight.run(2.0 + 8.0 / speed_m_s)
    assert visitor.nearest_m > 0.8
    flight.run(10.0)
    for name, agent in flight.agents.items():
        assert agent.core.flight.state == "flying", name
        assert not agent.core.failsafes.conditions, name


@pytest.mark.long
def test_nobody_flies_over_a_person_where_vehicles_fly_above_each_other(lockstep, paper):
    section = msgspec.structs.replace(paper.fleet, vertical_separation_m=1.0)
    tall = msgspec.structs.replace(paper, fleet=section)
    flight = lockstep(with_anna(tall), seed=3)
    visitor = Visitor(flight, lambda time_s: (0.0, 0.3), 0.4)
    flight.takeoff(2.8)
    flight.wait_for(flight.client.order("move mav1 0 2 2.8", 12.0))
    assert visitor.nearest_m > 0.8


def test_vehicles_hold_while_a_person_is_not_seen_and_forget_who_has_gone(lockstep, paper):
    flight = lockstep(with_anna(paper), seed=4)
    visitor = Visitor(flight, lambda time_s: (0.0, 2.5), 0.4)
    flight.takeoff(1.0)
    flight.start_soon(flight.client.order("move mav0 -1.5 1.5 1.0", 20.0))
    flight.run(1.0)
    visitor.is_seen = False
    flight.run(0.5)
    for agent in flight.agents.values():
        assert agent.core.failsafes.conditions == {Condition.NEIGHBOUR_UNSEEN}
    core = flight.agents["mav0"].core
    held_at_m = position_of(flight, "mav0")
    assert core.flight.state == "holding"

    flight.run(5.0)
    assert math.dist(position_of(flight, "mav0"), held_at_m) < 0.6
    flight.run(5.0)
    assert not core.failsafes.conditions, "after ten seconds she has left the room"
    results = flight.order("move mav0 -1.5 1.5 1.0", 20.0)
    assert all(result.is_done for result in results.values())


def test_nobody_takes_off_beside_a_person(lockstep, paper):
    flight = lockstep(with_anna(paper), seed=5)
    visitor = Visitor(flight, lambda time_s: (0.0, -0.5), 0.4)
    flight.run(8.0)
    [refusal] = flight.agents["mav1"].core.preflight.not_ready
    assert "Let anna step back." in refusal
    assert not flight.agents["mav0"].core.preflight.not_ready
    [result] = flight.order("takeoff mav1 1.0").values()
    assert result.phase == "refused"
    assert "anna is 0.6" in result.sentence
    assert visitor.nearest_m == math.inf


@pytest.mark.failsafe("separation breached", step="armed on the ground")
def test_the_propellers_stop_when_a_person_walks_up_to_an_armed_vehicle(lockstep, paper):
    flight = lockstep(with_anna(paper), seed=6)
    visitor = Visitor(flight, lambda time_s: (-3.0, -1.2), 0.4)
    flight.run(8.0)
    flight.order("arm mav1", 5.0)
    x, y, _ = position_of(flight, "mav1")
    visitor.place = along((-3.0, -1.2), (x, y), flight.time_s, 1.0)
    flight.run(5.0)

    assert not flight.simulation.emulator.autopilots[1].is_armed
    [said] = [event.sentence for event in flight.events if event.code == "separation-breached"]
    assert said == "Separation breached (anna): disarming."
    assert visitor.nearest_m == math.inf


@pytest.mark.failsafe("separation breached", step="lifting off")
@pytest.mark.parametrize("after_s", [0.0, 0.5, 1.0, 1.5, 2.0])
def test_a_vehicle_does_not_rise_from_a_spot_to_which_a_person_walks(lockstep, paper, after_s):
    """She is at the safety distance that long after the order was accepted."""
    flight = lockstep(with_anna(paper), seed=7)
    visitor = Visitor(flight, lambda time_s: (-3.0, -1.2), 0.4)
    flight.run(8.0)
    x, y, _ = position_of(flight, "mav1")
    flight.start_soon(flight.client.order("takeoff mav1 1.0", 10.0))
    begin = (x - 1.25 - 1.0 * after_s, y)
    visitor.place = along(begin, (x, y), flight.time_s, 1.0)

    highest_m = 0.0
    for _ in range(80):
        flight.run(0.1)
        highest_m = max(highest_m, float(flight.simulation.emulator.world.truth_enu()[0][1, 2]))
    assert highest_m < 0.2
    assert not flight.simulation.emulator.autopilots[1].is_armed
