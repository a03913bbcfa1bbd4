"""The routes of a fleet file's vehicles to their goals: whether there are any, how long they are,
and how long they take.

The map of what surrounds a vehicle is computed once, and kept for later questions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache

from groundstation.fleet.state import FleetState
from onboard.avoidance.params import Capsule, LawParams, law_params, still
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.control import router
from onboard.control.raised_ground import ground_refusal, height_over_ground_m
from onboard.control.reachability import route_refusal
from onboard.control.trajectory import TrajectoryParams, shortest_duration_s
from onboard.control.vertical_limits import planned_m_s2
from onboard.tuples import Xyz


def reach_refusal(
    fleet: FleetConfig,
    name: str,
    begin_enu_m: Xyz,
    goal_enu_m: Xyz,
    clearance_share: float | None = None,
) -> str:
    """Return why a vehicle cannot reach a goal, and what to do first; empty if it can.

    Args:
        fleet: the fleet file.
        name: one of its vehicles.
        begin_enu_m, goal_enu_m: position of the vehicle, and the goal [m], ENU.
        clearance_share: clearance above raised ground, one of the shares in
            onboard/control/raised_ground.py; None: raised ground may be in the way.
    """
    around = _around(fleet, name)
    words = route_refusal(around, name, begin_enu_m, goal_enu_m)
    if words or clearance_share is None:
        return words
    return ground_refusal(
        fleet=fleet,
        vehicle=fleet.vehicles[name],
        around=around,
        begin_enu_m=begin_enu_m,
        goal_enu_m=goal_enu_m,
        clearance_share=clearance_share,
    )


def height_of_goal_m(
    fleet: FleetConfig, name: str, begins_enu_m: Iterable[Xyz], goal_enu_m: Xyz
) -> float:
    """Return a height of a goal to which a vehicle passes over raised ground [m].

    Args:
        fleet: the fleet file.
        name: one of its vehicles.
        begins_enu_m: positions from which it may begin [m], ENU.
        goal_enu_m: the goal [m], ENU.
    """
    return height_over_ground_m(
        fleet=fleet,
        vehicle=fleet.vehicles[name],
        around=_around(fleet, name),
        begins_enu_m=begins_enu_m,
        goal_enu_m=goal_enu_m,
    )


def route_length_m(fleet: FleetConfig, name: str, begin_enu_m: Xyz, goal_enu_m: Xyz) -> float:
    """Return the length [m] of a vehicle's route to a goal, around what stands still.

    Args:
        fleet: the fleet file.
        name: one of its vehicles.
        begin_enu_m, goal_enu_m: position of the vehicle, and the goal [m], ENU.
    """
    return router.route_length_m(_around(fleet, name), begin_enu_m, goal_enu_m)


def shortest_move_s(fleet: FleetConfig, name: str, begin_enu_m: Xyz, goal_enu_m: Xyz) -> float:
    """Return the shortest time [s] that a vehicle needs to a goal if it flies alone.

    Args:
        fleet: the fleet file.
        name: one of its vehicles.
        begin_enu_m, goal_enu_m: position of the vehicle, and the goal [m], ENU.
    """
    distance_m = route_length_m(fleet, name, begin_enu_m, goal_enu_m)
    climb_m = goal_enu_m[2] - begin_enu_m[2]
    return shortest_leg_s(fleet.vehicles[name], distance_m, climb_m)


def shortest_leg_s(vehicle: Vehicle, distance_m: float, climb_m: float) -> float:
    """Return the shortest time [s] of a flight from rest to rest within a vehicle's limits.

    Args:
        vehicle: its entry in the fleet file.
        distance_m: length of its route.
        climb_m: height of the end above the first point; negative for a descent.
    """
    bounds = TrajectoryParams(
        max_speed_m_s=vehicle.max_speed_m_s,
        max_acceleration_m_s2=vehicle.max_acceleration_m_s2,
        max_vertical_m_s2=planned_m_s2(vehicle.hover_thrust_frac),
    )
    return shortest_duration_s(distance_m, climb_m, bounds)


def longest_move_s(fleet: FleetConfig, state: FleetState, goals: Mapping[str, Xyz]) -> float:
    """Return the time after which the last vehicle is at its goal if each flies alone.

    It is in whole seconds [s]. Vehicles that do not report a position are left out; without any the
    time is 0.

    Args:
        fleet: the fleet file.
        state: state of the fleet now.
        goals: goal of each vehicle [m], ENU.
    """
    times_s = [0.0]
    for name, goal in goals.items():
        telemetry = state.vehicles[name].telemetry
        if telemetry is not None and telemetry.is_position_valid:
            times_s.append(shortest_move_s(fleet, name, telemetry.position_enu_m, goal))
    return float(math.ceil(max(times_s)))


def _around(fleet: FleetConfig, name: str) -> router.Surroundings:
    """Return what surrounds a vehicle of a fleet file."""
    return _surroundings(still(fleet), law_params(fleet, name))


@lru_cache(maxsize=16)
def _surroundings(things: tuple[Capsule, ...], law: LawParams) -> router.Surroundings:
    return router.surroundings(things, law)
