"""Observations of a flight: the results of its steps, arrivals, and the fleet at its end. Pure.

The mission's runner, or the host of a script, writes these values while the vehicles fly. The
verdict is made of them and of the record.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.fleet.touchdown import Touchdown
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz


class Arrival(msgspec.Struct, frozen=True):
    """Distance of a vehicle from its goal when its order ended."""

    step: str
    vehicle: str
    distance_m: float
    is_truth: bool  # whether it comes from ground truth, not from telemetry
    is_done: bool = True  # False: the order failed or was replaced on the way


# Phases of orders that do not make a flight fail. The mission itself has cancelled the wait for the
# end of an order, and the order stays in force.
RIGHT_PHASES = ("done", "cancelled")


class StepResult(msgspec.Struct, frozen=True):
    """One step of the mission, with each vehicle's phase and sentence."""

    step: str
    duration_s: float
    vehicles: dict[str, str]  # vehicle -> phase
    sentences: dict[str, str]  # vehicle -> sentence

    @property
    def is_done(self) -> bool:
        """Whether every vehicle has done the step."""
        return all(phase == "done" for phase in self.vehicles.values())


@dataclass(slots=True)
class FlightObservations:
    """Observations of one flight, the input of :func:`groundstation.verdict.verdict.judge`."""

    mission: str
    fleet: FleetConfig
    state: FleetState  # the fleet at the end
    steps: list[StepResult]
    arrivals: list[Arrival]
    begin_ns: int  # start of the first step, on the ground's monotonic clock
    end_ns: int
    earlier_touchdowns: Collection[Touchdown] = ()  # contacts with the ground before the start
    earlier_collided: Collection[str] = ()  # vehicles that had touched another one before the start
    left_out: Collection[str] = ()  # vehicles that the mission went on without
    left_out_orders: Sequence[str] = ()  # orders that the operator has left out, in words
    # vehicles that do not fly although their last order left them flying, each with a sentence
    other_ends: Mapping[str, str] = field(default_factory=dict)
    failure: str = ""  # reason for the mission's early end, as a sentence
    is_nobody_heard: bool = False  # whether no vehicle answered
    is_wrong_input: bool = False
    is_interrupted: bool = False
    is_taken: bool = False  # whether somebody else has taken the fleet, which ended the mission
    # whether vehicles may fly at the end: the fleet was taken, or the mission was not begun
    is_left_flying: bool = False
    pilots: Collection[str] = ()  # vehicles that were flown by hand at the end

    @property
    def touchdowns(self) -> list[Touchdown]:
        """Contacts with the ground in this flight, oldest first; simulation only."""
        return [
            touchdown
            for touchdown in self.state.touchdowns
            if touchdown not in self.earlier_touchdowns
        ]


def collided_vehicles(state: FleetState) -> frozenset[str]:
    """Return the vehicles that have touched another one since the emulator's start.

    Args:
        state: the fleet as known now.
    """
    return frozenset(
        name
        for name, view in state.vehicles.items()
        if view.truth is not None and view.truth.is_collided
    )


def arrival_of(step: str, view: VehicleView, goal: Xyz, now_ns: int, *, is_done: bool) -> Arrival:
    """Return the distance of a vehicle from its goal now, by ground truth if there is one.

    Args:
        step: name of the order.
        view: the vehicle as known now.
        goal: goal of the order [m], ENU.
        now_ns: the ground's monotonic clock [ns].
        is_done: whether the order is done.
    """
    if view.truth is not None and view.has_truth(now_ns):
        true_distance_m = round(math.dist(view.truth.position_enu_m, goal), 4)
        return Arrival(step, view.name, true_distance_m, is_truth=True, is_done=is_done)

    distance_m = math.inf
    position_enu_m = view.position_enu_m(now_ns)
    if position_enu_m is not None:
        distance_m = round(math.dist(position_enu_m, goal), 4)
    return Arrival(step, view.name, distance_m, is_truth=False, is_done=is_done)


def flown_law(state: FleetState, fleet: FleetConfig) -> str:
    """Return the law that the agents report, or the fleet file's law if none has reported one."""
    vehicles_by_law: dict[str, list[str]] = {}
    for name, view in state.vehicles.items():
        if view.telemetry is not None:
            vehicles_by_law.setdefault(view.telemetry.law, []).append(name)

    if len(vehicles_by_law) > 1:
        return ", ".join(f"{law} ({', '.join(names)})" for law, names in vehicles_by_law.items())
    return next(iter(vehicles_by_law), fleet.law.name)
