"""Which orders are refused, and why. Pure: the answer depends on what is passed in."""

from __future__ import annotations

import math
from collections.abc import Mapping

from onboard.autopilot import Snapshot, Vec3
from onboard.bus.codec import is_finite
from onboard.bus.schema import LOCATE, Order, Telemetry
from onboard.config.fleet import FleetConfig
from onboard.flight.context import FlightContext
from onboard.flight.types import Step

_LOWEST_GOAL_M = 0.2
_LONGEST_MOVE_S = 3600.0
DEFAULT_HEIGHT_M = 1.0


def refusal(
    order: Order,
    now_ns: int,
    *,
    flight: FlightContext,
    snapshot: Snapshot,
    position_enu_m: Vec3,
    not_ready: tuple[str, ...],
    others: Mapping[str, Telemetry],
    fleet: FleetConfig,
) -> str | None:
    """A sentence why ``order`` cannot be begun, or None. Kill is never refused, not even when it is late."""
    if order.kind == "kill":
        return None
    late = late_sentence(order, now_ns)
    if late is not None:
        return late
    if not order.order_id:
        return "An order needs an id of its own, by which its end is told: give it one."
    if order.kind in LOCATE:
        return None
    if order.kind in ("arm", "takeoff"):
        return _start(order, flight, position_enu_m, not_ready, others, fleet)
    if order.kind == "disarm":
        in_air = flight.state in ("taking off", "flying", "holding") or flight.step is Step.DESCENT
        if in_air or (flight.state == "failed" and snapshot.landed.name != "ON_GROUND"):
            return "The vehicle is in the air: order land, or kill if it must fall."
        return None
    if order.kind == "land":
        if flight.state in ("flying", "holding", "landing") or flight.state == "failed" or _is_climbing(flight):
            return None
        return f"The vehicle is not in the air (it is {flight.state})."
    if flight.state not in ("flying", "holding") and not _is_climbing(flight):
        return f"The vehicle does not fly (it is {flight.state}): order take-off first."
    if order.kind == "move":
        return _move(order, others, fleet)
    return None


def late_sentence(order: Order, now_ns: int) -> str | None:
    """What to say of an order that came after its deadline; None of one in time."""
    if not order.deadline_ns or order.deadline_ns >= now_ns:
        return None
    return f"The order came {1e-9 * (now_ns - order.deadline_ns):.1f} s after its deadline: send it again."


def _start(
    order: Order,
    flight: FlightContext,
    position_enu_m: Vec3,
    not_ready: tuple[str, ...],
    others: Mapping[str, Telemetry],
    fleet: FleetConfig,
) -> str | None:
    if flight.state == "armed" and order.kind == "arm":
        return "The vehicle is armed already."
    if flight.state not in ("waiting", "ready", "landed", "armed") or flight.step is not Step.IDLE:
        return f"The vehicle cannot start now: it is {flight.state}."
    if not_ready:
        return not_ready[0]
    if order.kind == "takeoff":
        height = DEFAULT_HEIGHT_M if order.height_m is None else order.height_m
        x, y, z = position_enu_m
        if not math.isfinite(height) or height < z + _LOWEST_GOAL_M:
            return f"A take-off to {height:g} m does not leave the ground: order at least {z + _LOWEST_GOAL_M:.1f} m."
        if not fleet.fleet.geofence_m.contains((x, y, height)):
            return f"Height {height:g} m at ({x:.2f}, {y:.2f}) m lies outside the geofence."
        for name, other in others.items():
            distance = math.hypot(other.position_enu_m[0] - x, other.position_enu_m[1] - y)
            if other.is_position_valid and distance < fleet.fleet.safety_distance_m:
                return (
                    f"{name} stands {distance:.2f} m away, nearer than the safety distance "
                    f"{fleet.fleet.safety_distance_m:.2f} m: carry them apart."
                )
    return None


def _move(order: Order, others: Mapping[str, Telemetry], fleet: FleetConfig) -> str | None:
    goal = order.position_enu_m
    if goal is None or not is_finite(goal):
        return "A move needs a finite position [x, y, z] in metres."
    if not order.duration_s <= _LONGEST_MOVE_S:
        return f"A move cannot take {order.duration_s:g} s: give up to {_LONGEST_MOVE_S:.0f} s, or 0 for the shortest."
    text = "(" + ", ".join(f"{value:.2f}" for value in goal) + ") m"
    if not fleet.fleet.geofence_m.contains(goal) or goal[2] < fleet.fleet.geofence_m.z[0] + _LOWEST_GOAL_M:
        return f"Goal {text} lies outside the geofence, or less than {_LOWEST_GOAL_M} m above its floor."
    for name, other in others.items():
        # A flying neighbour may just have been ordered elsewhere; one on the ground, or landing, stays where it is.
        if other.is_airborne and other.state != "landing":
            continue
        distance = math.hypot(other.position_enu_m[0] - goal[0], other.position_enu_m[1] - goal[1])
        if other.is_position_valid and distance < fleet.fleet.safety_distance_m:
            return f"Goal {text} is {distance:.2f} m from {name}, which is {other.state}: choose another goal."
    return None


def goal_conflict(goal: Vec3, others: Mapping[str, Telemetry], distance_m: float) -> str | None:
    """Another flying vehicle's announced goal that is too near to ours, in words."""
    for name, other in others.items():
        if not other.is_airborne:
            continue
        distance = math.hypot(other.goal_position_enu_m[0] - goal[0], other.goal_position_enu_m[1] - goal[1])
        if distance < distance_m:
            return f"Our goal is {distance:.2f} m from the goal of {name}: the two cannot both be reached."
    return None


def _is_climbing(flight: FlightContext) -> bool:
    return flight.state == "taking off" and flight.step is Step.CLIMB
