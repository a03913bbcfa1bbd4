"""Finds vehicles that do not fly although their last order leaves them flying. Pure.

A vehicle that was ordered to fly to a goal is expected to fly there until its next order. If it
stands on the ground instead, a failsafe, a pilot or somebody else's order has landed it, or it has
fallen. If it is still in the air, it may land without an order, or its agent may have failed and
send no more setpoints.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from groundstation.fleet.state import FleetState, VehicleView
from onboard.bus.schema import Order

_LEAVES_FLYING = frozenset(("takeoff", "move", "hold", "follow_path"))
_LEAVES_DOWN = frozenset(("land", "kill", "disarm"))


class LastOrder(Struct, frozen=True):
    """The last order that a vehicle has done, or that brings it down."""

    words: str
    leaves_flying: bool  # whether the vehicle flies after the order
    done_ns: int  # time at which it was done or noted, on the ground's clock


def last_order(words: str, message: Order, done_ns: int) -> LastOrder | None:
    """Return the order as the last one of a vehicle; None if it says nothing about the flight.

    Args:
        words: the order in words.
        message: message to one vehicle.
        done_ns: time at which it was done, on the ground's clock [ns].
    """
    if message.kind in _LEAVES_FLYING:
        return LastOrder(words, leaves_flying=not message.then_land, done_ns=done_ns)
    if message.kind in _LEAVES_DOWN:
        return LastOrder(words, leaves_flying=False, done_ns=done_ns)
    return None


def other_ends(orders: Mapping[str, LastOrder], state: FleetState) -> dict[str, str]:
    """Return the vehicles that do not fly although their last order leaves them flying.

    Args:
        orders: the last order of each vehicle.
        state: state of the fleet now.

    Returns:
        vehicle -> sentence with the cause, if the vehicle has reported one.
    """
    sentences = {}
    for name, order in orders.items():
        end = _end(state.vehicles[name])
        if not order.leaves_flying or not end:
            continue
        cause = _cause(name, order, state)
        if not cause:
            cause = "it has not said why."
        sentences[name] = (
            f"{name} {end}, though its last finished order was '{order.words}': {cause}"
        )
    return sentences


def _end(view: VehicleView) -> str:
    """Return how a vehicle has ended its flight, in words; empty if it flies or is not heard."""
    telemetry = view.telemetry
    if telemetry is None:
        return ""
    if not view.is_airborne:
        return "is down"
    if telemetry.state == "failed" and telemetry.order_kind not in _LEAVES_DOWN:
        return "has failed"
    if telemetry.state == "landing" and not telemetry.order_id:
        return "is landing"
    return ""


def _cause(name: str, order: LastOrder, state: FleetState) -> str:
    """Return why a vehicle came down after its order; empty if it has not said why.

    An event is critical if the vehicle landed, levelled or stopped because of it. The last critical
    event is the cause. Without one, it is the last warning, or else the reason in the telemetry.
    """
    warning = ""
    for logged in reversed(state.events):
        event = logged.event
        if logged.received_ns < order.done_ns:
            break
        if event.vehicle != name:
            continue
        if event.severity == "critical":
            return event.sentence
        if event.severity == "warning" and not warning:
            warning = event.sentence

    telemetry = state.vehicles[name].telemetry
    if not warning and telemetry is not None:
        return telemetry.reason
    return warning
