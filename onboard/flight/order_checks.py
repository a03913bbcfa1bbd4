"""Refusals of orders, each with its reason. Pure: the answer depends only on the arguments.

:func:`refusal` returns the first reason that it finds. It checks in this order: the deadline and
the id of the order; whether the flight table has a row for the order in this step; and what the
order requests, which is a start, a path or a goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from onboard.bus.codec import is_finite
from onboard.bus.schema import BESIDE, ON_PATHS, Order, Telemetry
from onboard.config.fleet import FleetConfig, FleetSection
from onboard.config.flight_space import flight_space_of, goal_refusal
from onboard.config.ground import least_height_m
from onboard.config.pair_separation import separation_m
from onboard.config.stand_in import stand_in_refusal
from onboard.control.control_mode import ControlMode
from onboard.control.raised_ground import CLEARANCE_ON_VEHICLE, ground_refusal
from onboard.control.reachability import is_below_fence, route_refusal
from onboard.control.router import Surroundings
from onboard.flight import follow_flight, path_flight, sentences, takeover
from onboard.flight.context import FlightContext
from onboard.flight.effects import takeoff_height_m
from onboard.flight.state_machine import accepts
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Situation
from onboard.tuples import Xyz

_LONGEST_MOVE_S = 3600.0

_IN_AIR = "The vehicle is in the air: order land, or kill if it must fall."
_NOT_ON_GROUND = (
    "PX4 does not say that the vehicle is on the ground: order land, or kill if it must fall."
)
_FLYING_ORDERS = ("arm", "takeoff", "move", "follow_path")
_AT_REST = (FlightStep.WAITING, FlightStep.READY, FlightStep.LANDED)
_AT_HOME_M = 0.5  # largest horizontal distance from the take-off spot
# steps in which the vehicle may still be in the air
_MAY_BE_UP = {
    FlightStep.CONTACT,
    FlightStep.PX4_LANDING,
    FlightStep.FAILED,
    FlightStep.FAILED_DISARMING,
    FlightStep.KILLING,
}


class OrderFacts(NamedTuple):
    """Facts that decide on an order, besides the flight."""

    view: FlightView
    fleet: FleetConfig
    surroundings: Surroundings  # static things around the vehicle
    others: Mapping[str, Telemetry]  # newest telemetry of each other vehicle
    last_positions_enu_m: Mapping[str, Xyz]  # where each of them was by its newest valid state
    distances_m: Mapping[str, float]  # separation from each other vehicle
    not_ready: tuple[str, ...]  # reasons of the preflight check against a take-off
    # computes the reasons against a takeover in the air; a function, because computing them is
    # expensive
    not_ready_in_air: Callable[[], tuple[str, ...]]


def refusal(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason why ``order`` cannot start, or None.

    Kill is never refused, even when it is late.
    """
    if order.kind == "kill":
        return None

    late = late_sentence(order, facts.view.now_ns)
    if late is not None:
        return late
    if not order.order_id:
        return "An order needs an id of its own, by which its end is reported: set order_id."

    if order.kind in BESIDE:  # changes no step of the flight
        return _refusal_beside_flight(order, flight, facts)
    if order.kind == "hold" and flight.state == "failed":
        return _refusal_to_take_over(order, flight, facts)

    if facts.view.is_flown_by_hand:
        reason = _refusal_of_pilot(order, flight)
        if reason is not None:
            return reason

    if not accepts(flight.step, order.kind):
        return _refusal_of_step(order, flight)
    if flight.step in _AT_REST and order.kind in ("land", "move"):
        return _refusal_at_rest(order, flight, facts)

    if order.kind == "disarm" and flight.step in _MAY_BE_UP and not facts.view.is_on_ground:
        return _NOT_ON_GROUND
    match order.kind:
        case "arm" | "takeoff":
            return _refusal_to_start(order, flight, facts)
        case "reboot":
            return _refusal_to_reboot(facts.view)
        case "follow_path":
            return _refusal_to_follow_path(order, flight, facts)
        case "move":
            return _refusal_to_move(order, flight, facts)
    return None


def _refusal_beside_flight(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against an order that does not change the flight's step, or None."""
    if order.kind == "load_path":
        return path_flight.part_refusal(flight.path, order.path, flight.vehicle, facts.fleet)
    if order.kind in ON_PATHS and flight.followed:
        return None
    if order.kind in ON_PATHS:
        return path_flight.change_refusal(flight.path, order.kind)
    if order.kind == "disable":
        return _refusal_off_the_ground(flight, facts.view)
    if order.kind == "enable":
        return _refusal_to_enable(flight, facts.others)
    if order.kind == "stand_in":
        return _refusal_to_stand_in(order, flight, facts)
    return None


def _refusal_to_stand_in(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against standing in for another vehicle, or None."""
    off_the_ground = _refusal_off_the_ground(flight, facts.view)
    if off_the_ground is not None:
        return off_the_ground

    name = flight.vehicle.name
    position_enu_m = None
    if facts.view.has_position:
        position_enu_m = facts.view.position_enu_m
    reason = stand_in_refusal(facts.fleet, name, order.stands_in_for, position_enu_m)
    if not reason:
        return None
    return reason


def _refusal_to_enable(flight: FlightContext, others: Mapping[str, Telemetry]) -> str | None:
    """Return a sentence if another vehicle stands in for this one, or None."""
    for other, telemetry in others.items():
        if telemetry.stands_in_for == flight.slot_owner and not telemetry.disabled_by:
            return sentences.has_stand_in(flight.vehicle.name, other)
    return None


def _refusal_off_the_ground(flight: FlightContext, view: FlightView) -> str | None:
    """Return a sentence if a vehicle is not disarmed on the ground, or None."""
    if flight.step not in _AT_REST:
        doing: str = flight.state
    elif view.snapshot.is_armed:
        doing = "armed"
    else:
        return None
    return f"A vehicle is disabled or swapped on the ground only, disarmed: it is {doing}."


def acceptance(order: Order, flight: FlightContext, view: FlightView) -> str:
    """Return what an accepted order does, if that differs from its name; otherwise empty."""
    if order.kind == "land" and flight.was_killed:
        return sentences.lands_unless_killed(flight)
    if order.kind != "disarm":
        return ""
    lifts_off = flight.step is FlightStep.LIFTOFF and not view.is_on_ground
    if lifts_off or flight.step is FlightStep.CLIMB:
        return sentences.LANDS_TO_DISARM
    return ""


def late_sentence(order: Order, now_ns: int) -> str | None:
    """Return the sentence about an order that came after its deadline; None if it was in time."""
    if not order.deadline_ns or order.deadline_ns >= now_ns:
        return None
    late_s = 1e-9 * (now_ns - order.deadline_ns)
    return f"The order came {late_s:.1f} s after its deadline: send it again."


def goal_conflict(goal: Xyz, others: Mapping[str, Telemetry], limits: FleetSection) -> str | None:
    """Return a sentence about the conflict with the goal of another flying vehicle, or None."""
    for name, other in others.items():
        if not other.is_airborne:
            continue
        distance_m = separation_m(other.goal_position_enu_m, goal, limits.height_share)
        if distance_m < limits.safety_distance_m:
            return (
                f"The goal is {distance_m:.2f} m from the goal of {name}: "
                "the two vehicles cannot both be there. Choose another goal."
            )
    return None


def _refusal_to_take_over(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against a hold that takes over after a failed flight, or None."""
    not_ready = facts.not_ready_in_air()
    refused = takeover.refusal(
        view=facts.view,
        not_ready=not_ready,
        distances_m=facts.distances_m,
        fleet=facts.fleet,
        vehicle=flight.vehicle,
    )
    if refused is not None and flight.was_killed:
        return _refusal_of_step(order, flight)
    return refused


def _refusal_of_pilot(order: Order, flight: FlightContext) -> str | None:
    """Return the reason against an order to a vehicle that a pilot flies by hand, or None.

    While a pilot flies, only a person's order that names this vehicle can land it.
    """
    name = flight.vehicle.name
    if order.kind == "land" and order.reason:  # by a mission, or to all vehicles
        return f"{name} is flown by hand: `land {name}` takes it."
    if order.kind in _FLYING_ORDERS and flight.step.situation is Situation.SILENT:
        return (
            f"{name} is flown by hand: once its pilot has switched to hold, "
            f"`hold {name}` takes it over."
        )
    return None


def _refusal_of_step(order: Order, flight: FlightContext) -> str:
    """Return the reason why the flight table has no row for the order in this step."""
    doing: str = flight.state
    if flight.step.text:
        doing = f"{flight.state} ({flight.step.text})"

    is_start = order.kind in ("arm", "takeoff")
    if flight.was_killed and is_start:
        return f"{flight.reason} It is {doing} and cannot start now: look at it first."
    if flight.was_killed:
        return f"{flight.reason} It is {doing}: look at it before you order take-off."
    if flight.step is FlightStep.PX4_LANDING and not is_start:
        why = f" ({flight.reason.rstrip('.')})" if flight.reason else ""
        return (
            f"PX4 is landing the vehicle by itself{why}, and this agent cannot fly it meanwhile: "
            "wait until it is down, let a pilot take over, or order kill if it must fall."
        )

    match order.kind:
        case "arm" if flight.state == "armed":
            return "The vehicle is armed already."
        case "arm" | "takeoff":
            return f"The vehicle cannot start now: it is {doing}."
        case "reboot":
            return f"PX4 starts anew on the ground only, disarmed: it is {doing}."
        case "disarm":
            return _IN_AIR
        case _ if flight.step is FlightStep.TAKEOVER:
            return "It is being taken over from PX4's hold: wait until it holds, or order land."
        case "follow_path" if flight.step.situation is Situation.FLYING:
            return f"No path begins while it is {doing}: order hold first."
        case "land":
            return f"The vehicle is not in the air (it is {doing})."
        case _ if flight.state == "landing":
            return f"The vehicle is {doing}: wait until it is down, then order take-off."
        case _ if flight.step.control_mode is ControlMode.DEAD_RECKONING:
            return "The vehicle has lost its position: wait until it is back, or order land."
        case _:
            return f"The vehicle does not fly (it is {doing}): order take-off first."


def _refusal_at_rest(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against `land` or `home` for a vehicle on the ground, or None.

    None means that the order is already done. A vehicle at its take-off spot is at home. A vehicle
    that was killed or that fell refuses the order, because a person must inspect it.
    """
    name = flight.vehicle.name
    if flight.was_killed:
        return _refusal_of_step(order, flight)
    if flight.has_fallen:
        return f"{name} fell: {flight.reason} Look at it before you order take-off."
    if facts.view.snapshot.is_armed:
        return _refusal_of_step(order, flight)
    if order.kind == "land":
        return None

    home_enu_m = order.position_enu_m
    if not order.then_land or home_enu_m is None or not facts.view.has_position:
        return _refusal_of_step(order, flight)

    away_m = math.dist(home_enu_m[:2], facts.view.position_enu_m[:2])
    if away_m > _AT_HOME_M:
        return (
            f"{name} stands {away_m:.1f} m from its take-off spot: order take-off first, "
            "or carry it there."
        )
    return None


def _refusal_to_start(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against arming or taking off, or None."""
    if flight.disabled_by:
        return sentences.disabled(flight)
    if facts.not_ready:
        return facts.not_ready[0]
    if order.kind == "arm":
        return None

    limits = facts.fleet.fleet
    height_m = takeoff_height_m(order)
    x, y, z = facts.view.position_enu_m

    lowest_m = z + least_height_m(flight.vehicle)
    if not math.isfinite(height_m) or height_m < lowest_m:
        return (
            f"A take-off to {height_m:g} m does not leave the ground: "
            f"order at least {lowest_m:.1f} m."
        )
    if not limits.geofence_m.contains((x, y, height_m)):
        return f"Height {height_m:g} m at ({x:.2f}, {y:.2f}) m lies outside the geofence."
    wrong_place = flight_space_of(facts.fleet).refusal((x, y, height_m))
    if wrong_place:
        return f"Height {height_m:g} m at ({x:.2f}, {y:.2f}) m lies {wrong_place}."
    if is_below_fence(facts.surroundings, (x, y, z), height_m):
        return (
            f"A fence is above ({x:.2f}, {y:.2f}) m, on the way up to {height_m:g} m: carry "
            "the vehicle out from below it, or order a lower take-off."
        )

    for name, other in facts.others.items():
        # the point of the climb that is nearest to the other vehicle
        _, _, other_z_m = other.position_enu_m
        nearest_z_m = min(max(other_z_m, z), height_m)
        nearest_enu_m = (x, y, nearest_z_m)
        distance_m = separation_m(other.position_enu_m, nearest_enu_m, limits.height_share)
        if not other.is_position_valid or distance_m >= limits.safety_distance_m:
            continue

        if limits.height_share > 0.0 and other.is_airborne:
            beside_m = math.dist(other.position_enu_m[:2], (x, y))
            return (
                f"{name} flies {beside_m:.2f} m beside the way up, at a height of "
                f"{other_z_m:.2f} m: move {name} away, or order a lower take-off."
            )
        return (
            f"{name} stands {distance_m:.2f} m away, nearer than the safety distance "
            f"{limits.safety_distance_m:.2f} m: carry them apart."
        )
    return None


def _refusal_to_reboot(view: FlightView) -> str | None:
    """Return the reason against rebooting PX4, or None. PX4 must be disarmed and on the ground."""
    if view.snapshot.is_armed:
        return "PX4 is armed: order disarm first. It starts anew on the ground only, disarmed."
    if not view.is_on_ground:
        return (
            "PX4 does not say that the vehicle is on the ground: it starts anew there only. "
            "Where PX4 is not heard at all, take its power off."
        )
    return None


def _refusal_to_follow_path(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against following the loaded path, or None."""
    view = facts.view
    least_pct = facts.fleet.fleet.battery_warning_pct
    battery_pct = 100.0 * view.snapshot.battery_frac
    if battery_pct < least_pct:
        return (
            f"The battery is at {battery_pct:.0f} %, below {least_pct:g} %: "
            "no path is begun with it."
        )
    return path_flight.start_refusal(flight.path, order.path, view.now_ns, view.position_enu_m)


def _refusal_to_move(order: Order, flight: FlightContext, facts: OrderFacts) -> str | None:
    """Return the reason against a move to the ordered goal, or None."""
    not_followed = follow_flight.goal_refusal(flight.follow, order)
    if not_followed is not None:
        return not_followed

    vehicle = flight.vehicle
    goal = order.position_enu_m
    if goal is None or not is_finite(goal):
        return "A move needs a finite position [x, y, z] in metres."
    if not order.duration_s <= _LONGEST_MOVE_S:
        return (
            f"A move cannot take {order.duration_s:g} s: "
            f"give up to {_LONGEST_MOVE_S:.0f} s, or 0 for the shortest."
        )
    if order.yaw_deg is not None and not math.isfinite(order.yaw_deg):
        return "A heading needs a finite number of degrees, counterclockwise from east."

    goal_text = _goal_text(goal)
    words = goal_refusal(facts.fleet, vehicle, goal)
    if words:
        return f"Goal {goal_text} {words}."

    if facts.view.has_position:
        here_enu_m = facts.view.position_enu_m
        words = route_refusal(facts.surroundings, vehicle.name, here_enu_m, goal)
        if not words:
            words = ground_refusal(
                fleet=facts.fleet,
                vehicle=vehicle,
                around=facts.surroundings,
                begin_enu_m=here_enu_m,
                goal_enu_m=goal,
                clearance_share=CLEARANCE_ON_VEHICLE,
            )
        if words:
            return f"Goal {goal_text} {words}."

    return _refusal_by_neighbours(goal, facts)


def _goal_text(goal: Xyz) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in goal) + ") m"


def _refusal_by_neighbours(goal: Xyz, facts: OrderFacts) -> str | None:
    """Return the reason against a goal too near to a neighbour on the ground or that lands."""
    _, _, goal_z_m = goal
    limits = facts.fleet.fleet
    for name, other in facts.others.items():
        # A flying neighbour may just have been ordered elsewhere. A neighbour that lands or is on
        # the ground stays where it is.
        if other.is_airborne and other.state != "landing":
            continue

        # one that has lost its position stays where it was last
        position_enu_m = facts.last_positions_enu_m.get(name)
        seen = ""
        if other.is_position_valid:
            position_enu_m = other.position_enu_m
        elif position_enu_m is not None:
            seen = " and was last seen there"
        if position_enu_m is None:
            continue

        x, y, z = position_enu_m
        if other.is_airborne:
            z = min(z, goal_z_m)  # a landing neighbour occupies the whole column below it
        distance_m = separation_m((x, y, z), goal, limits.height_share)
        if distance_m < limits.safety_distance_m:
            return (
                f"Goal {_goal_text(goal)} is {distance_m:.2f} m from {name}, "
                f"which is {other.state}{seen}: choose another goal."
            )
    return None
