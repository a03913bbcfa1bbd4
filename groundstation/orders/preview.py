"""Preview of an order: where all vehicles go, and reasons not to send the order. Pure.

A preview describes the fleet at one moment. The fleet moves while the preview is shown, so
:func:`changed` says whether anything that matters has changed since.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from msgspec.structs import replace

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.orders.forecast import Leg
from groundstation.orders.intents import Intent, Takeoff
from groundstation.orders.plan import PlannedOrder
from onboard.bus.schema import Order, Telemetry
from onboard.tuples import Xyz

_CAN_START = ("waiting", "ready", "landed", "armed")
_CAN_MOVE = ("flying", "holding", "taking off")
_HAS_GOAL = _CAN_MOVE
# While the preview is shown, a vehicle may drift by _DRIFT_M plus its speed times _DRIFT_S.
_DRIFT_M = 0.3
_DRIFT_S = 1.0
_MOVING_M_S = 0.4  # speed from which a note says that the vehicle moves


@dataclass(frozen=True, slots=True)
class OrderPreview:
    """One planned order, as it is shown before it is sent."""

    planned: PlannedOrder
    legs: Mapping[str, Leg]  # way of each vehicle with a known position
    reasons: tuple[str, ...] = ()  # reasons not to send it, in sentences
    notes: tuple[str, ...] = ()  # notes for the operator, in sentences
    unfit: frozenset[str] = frozenset()  # ordered vehicles that would refuse it
    silent: frozenset[str] = frozenset()  # flying vehicles that are not heard

    @property
    def intent(self) -> Intent:
        """The order, with every number filled in."""
        return self.planned.intent

    @property
    def goals(self) -> dict[str, Xyz]:
        """Goals of the ordered vehicles, metres ENU."""
        return {name: leg.goal_enu_m for name, leg in self.legs.items() if leg.is_by_this_order}


def preview_order(planned: PlannedOrder, state: FleetState, now_ns: int) -> OrderPreview:
    """Return what a planned order would do to the fleet in its present state.

    Args:
        planned: the order.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        Legs, reasons against sending it, and notes.
    """
    intent = planned.intent
    legs: dict[str, Leg] = {}
    notes = []
    silent: set[str] = set()
    unfit: dict[str, str] = {}

    for name, view in state.vehicles.items():
        order = planned.orders.get(name)
        if order is not None:
            reason = _expected_refusal(intent, view, now_ns)
            if reason is not None:
                unfit[name] = reason

        telemetry = view.telemetry
        position = view.position_enu_m(now_ns)
        if position is None and view.is_airborne and telemetry is not None:
            silent.add(name)
            notes.append(
                f"{name} flies and its position is not known now: computed from its last one."
            )
            if telemetry.is_position_valid:
                position = telemetry.position_enu_m
        if position is None or telemetry is None:
            continue

        legs[name] = _leg(intent, telemetry, position, order)
        if telemetry.is_airborne and math.hypot(*telemetry.velocity_enu_m_s) > _MOVING_M_S:
            notes.append(f"{name} moves: computed as if it began from a standstill.")

    reasons = [*dict.fromkeys(planned.refusals.values()), *unfit.values()]
    fit = tuple(name for name in planned.orders if name not in unfit)
    if unfit and fit and not planned.refusals:
        pronoun = "it" if len(unfit) == 1 else "them"
        reasons.append(f"Without {pronoun}: {replace(intent, vehicles=fit)}")

    return OrderPreview(
        planned=planned,
        legs=legs,
        reasons=tuple(reasons),
        notes=tuple(notes),
        unfit=frozenset(unfit),
        silent=frozenset(silent),
    )


def changed(
    preview: OrderPreview, checked: PlannedOrder, state: FleetState, now_ns: int
) -> str | None:
    """Compare the present fleet with the fleet that a preview was made of.

    Args:
        preview: preview as it is shown.
        checked: planned order of the preview, checked again now.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        The first difference that matters, in words; None if the preview is still right.
    """
    if checked.orders.keys() != preview.planned.orders.keys():
        return "the vehicles that can be ordered have changed"

    for view in state.vehicles.values():
        words = _difference(preview, view, now_ns)
        if words is not None:
            return words
    return None


def _difference(preview: OrderPreview, view: VehicleView, now_ns: int) -> str | None:
    """Return what has changed about one vehicle, in words; None if nothing that matters has."""
    name = view.name
    telemetry = view.telemetry
    position = view.position_enu_m(now_ns)
    leg = preview.legs.get(name)
    was_silent = name in preview.silent

    if leg is None:
        if position is None:
            return None
        return f"{name} has appeared"

    if telemetry is None or position is None:
        matters = leg.is_by_this_order or not leg.is_parked
        if was_silent or not matters:
            return None
        return f"{name} is silent"
    if was_silent:
        return f"{name} is heard again"

    if not leg.is_by_this_order:
        was_airborne = not leg.is_parked
        if telemetry.is_airborne and not was_airborne:
            return f"{name} has taken off"
        if was_airborne and not telemetry.is_airborne:
            return f"{name} has landed"

    # A vehicle that is only to arm gets an order as well, although its leg is by an earlier order.
    gets_order = name in preview.planned.orders
    is_unfit = gets_order and _expected_refusal(preview.intent, view, now_ns) is not None
    was_unfit = name in preview.unfit
    if is_unfit != was_unfit:
        return f"{name}'s readiness has changed"

    speed_m_s = math.hypot(*telemetry.velocity_enu_m_s)
    if math.dist(position, leg.start_enu_m) > _DRIFT_M + _DRIFT_S * speed_m_s:
        return f"{name} has moved"

    if not leg.is_by_this_order and telemetry.is_airborne:
        goal_change_m = math.dist(_goal(telemetry, position), leg.goal_enu_m)
        if goal_change_m > _DRIFT_M:
            return f"{name} goes elsewhere"
    return None


def _expected_refusal(intent: Intent, view: VehicleView, now_ns: int) -> str | None:
    """Return why a vehicle would refuse the order now, by its telemetry; None if it would not."""
    telemetry = view.telemetry
    if telemetry is None:
        return f"{view.name} is not heard: is its agent running?"
    if not view.is_fresh(now_ns):
        return f"{view.name} is not heard any more: is its agent running?"

    if intent.is_start:
        is_armed_already = intent.verb == "arm" and telemetry.state == "armed"
        if telemetry.state not in _CAN_START or is_armed_already:
            return f"{view.name} cannot start: it is {telemetry.state}."
        if telemetry.not_ready:
            return f"{view.name} is not ready: {telemetry.not_ready[0]}"
    elif intent.verb == "skip" and not (telemetry.show_id or telemetry.follows):
        return f"{view.name} follows no path: there is no end of one to fly to."
    elif telemetry.state == "landing":
        why = f" ({telemetry.reason.rstrip('.')})" if telemetry.reason else ""
        return f"{view.name} is landing{why}: wait until it is down, then order take-off."
    elif telemetry.state not in _CAN_MOVE:
        return f"{view.name} does not fly (it is {telemetry.state}): order take-off first."

    if not telemetry.is_position_valid:
        return f"{view.name} does not know its position."
    return None


def _leg(intent: Intent, telemetry: Telemetry, position: Xyz, order: Order | None) -> Leg:
    """Return a vehicle's straight way by this order, or by an earlier one.

    An order to arm moves no vehicle. A vehicle on the ground that is not ordered stays where it is.
    """
    if order is None or intent.verb == "arm":
        is_parked = not telemetry.is_airborne
        goal = position if is_parked else _goal(telemetry, position)
        return Leg(position, goal, is_by_this_order=False, is_parked=is_parked)

    if intent.verb == "skip":
        # The goal that a vehicle on a path reports is the end of the path. A vehicle that follows
        # another one holds where it is.
        goal = position if telemetry.follows else _goal(telemetry, position)
        return Leg(position, goal)
    if order.position_enu_m is not None:
        return Leg(position, order.position_enu_m, order.duration_s)

    x, y, height_m = position
    if isinstance(intent, Takeoff) and intent.height_m:
        height_m = intent.height_m
    return Leg(position, (x, y, height_m), order.duration_s)


def _goal(telemetry: Telemetry, position: Xyz) -> Xyz:
    """Return the goal that a vehicle reports, or its position if it reports none."""
    goal_enu_m = telemetry.goal_position_enu_m
    if telemetry.state in _HAS_GOAL and all(map(math.isfinite, goal_enu_m)):
        return goal_enu_m
    return position
