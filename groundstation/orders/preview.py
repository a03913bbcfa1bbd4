"""An order as it lies before the operator: who goes where, what speaks against it, whether it is still true. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.orders.forecast import Leg
from groundstation.orders.grammar import Intent, Plan, slots_of
from onboard.bus.schema import Telemetry, Vec3
from onboard.config.fleet import FleetConfig

PREVIEWED = ("arm", "takeoff", "move", "formation")
_STARTS = ("arm", "takeoff")
_CAN_START = ("waiting", "ready", "landed", "armed")
_CAN_MOVE = ("flying", "holding", "taking off")
_DRIFT_M, _DRIFT_S = 0.3, 1.0  # what may change between looking and sending, at rest and of the way of who moves
_MOVING_M_S = 0.4


@dataclass(frozen=True, slots=True)
class Proposal:
    """One order, looked at.

    intent: with every number that was left open filled in. legs: of everybody whose place is known. against: reasons
    not to send it, in sentences. notes: what the operator should know all the same. unfit: who would not do it. silent:
    who flies without being heard.
    """

    intent: Intent
    plan: Plan
    legs: Mapping[str, Leg]
    against: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unfit: frozenset[str] = frozenset()
    silent: frozenset[str] = frozenset()

    @property
    def goals(self) -> dict[str, Vec3]:
        """Where the ordered vehicles go."""
        return {name: leg.goal_enu_m for name, leg in self.legs.items() if leg.is_ordered}


def propose(plan: Plan, fleet: FleetConfig, state: FleetState, now_ns: int) -> Proposal:
    """Look at what a plan would do to the fleet as it is now."""
    intent = plan.intent
    against = list(dict.fromkeys(plan.refusals.values()))
    legs: dict[str, Leg] = {}
    notes = []
    silent: set[str] = set()
    unfit: dict[str, str] = {}
    for name, view in state.vehicles.items():
        order = plan.orders.get(name)
        told = view.telemetry
        if order is not None:
            reason = _unfit(intent, view, now_ns)
            if reason is not None:
                unfit[name] = reason
        spot = view.position_enu_m(now_ns)
        if spot is None or told is None:
            if view.is_airborne and told is not None:
                silent.add(name)
                notes.append(f"{name} flies and its place is not known now: computed where it was last.")
                spot = told.position_enu_m if told.is_position_valid else None
            if spot is None or told is None:
                continue
        legs[name] = _leg(intent, told, spot, None if order is None else (order.position_enu_m, order.duration_s))
        if told.is_airborne and math.hypot(*told.velocity_enu_m_s) > _MOVING_M_S:
            notes.append(f"{name} moves: computed as if it began from a standstill.")
    against += unfit.values()
    rest = tuple(name for name in plan.orders if name not in unfit)
    if unfit and rest and not plan.refusals:
        others = replace(intent, vehicles=rest)
        against.append(f"Without {'it' if len(unfit) == 1 else 'them'}: {others}")
    return Proposal(
        _filled_in(intent, plan, fleet),
        plan,
        legs,
        tuple(against),
        tuple(notes),
        unfit=frozenset(unfit),
        silent=frozenset(silent),
    )


def changed(proposal: Proposal, plan: Plan, state: FleetState, now_ns: int) -> str | None:
    """What is not any more as it was when ``proposal`` was made, in words; None when nothing is."""
    if plan.refusals.keys() != proposal.plan.refusals.keys() or plan.orders.keys() != proposal.plan.orders.keys():
        return "who can be ordered has changed"
    for name, order in plan.orders.items():
        before = proposal.plan.orders[name].position_enu_m
        if (before is None) != (order.position_enu_m is None):
            return f"{name}'s goal has changed"
        if before is not None and order.position_enu_m is not None and math.dist(before, order.position_enu_m) > 0.01:
            return f"{name}'s goal has changed"
    for name, view in state.vehicles.items():
        leg, told, spot = proposal.legs.get(name), view.telemetry, view.position_enu_m(now_ns)
        if leg is None:
            if spot is not None:
                return f"{name} has appeared"
            continue
        if told is None or spot is None:
            if name not in proposal.silent and (not leg.is_parked or leg.is_ordered):
                return f"{name} is silent"
            continue
        if name in proposal.silent:
            return f"{name} is heard again"
        if told.is_airborne == leg.is_parked and not leg.is_ordered:
            return f"{name} has {'taken off' if told.is_airborne else 'landed'}"
        if name in plan.orders and (_unfit(plan.intent, view, now_ns) is not None) != (name in proposal.unfit):
            return f"{name}'s readiness has changed"
        speed_m_s = math.hypot(*told.velocity_enu_m_s)
        if math.dist(spot, leg.start_enu_m) > _DRIFT_M + _DRIFT_S * speed_m_s:
            return f"{name} has moved"
        if not leg.is_ordered and told.is_airborne and math.dist(_goal(told, spot), leg.goal_enu_m) > _DRIFT_M:
            return f"{name} goes elsewhere"
    return None


def _unfit(intent: Intent, view: VehicleView, now_ns: int) -> str | None:
    """Why this vehicle would not do it now; what its agent would say, as far as telemetry tells."""
    told = view.telemetry
    if told is None or not view.is_fresh(now_ns):
        return f"{view.name} is not heard{'' if told is None else ' any more'}: is its agent running?"
    if intent.verb in _STARTS:
        if told.state not in _CAN_START or (intent.verb == "arm" and told.state == "armed"):
            return f"{view.name} cannot start: it is {told.state}."
        if told.not_ready:
            return f"{view.name} is not ready: {told.not_ready[0]}"
    elif told.state not in _CAN_MOVE:
        return f"{view.name} does not fly (it is {told.state}): order take-off first."
    if not told.is_position_valid:
        return f"{view.name} does not know where it is."
    return None


def _leg(intent: Intent, told: Telemetry, spot: Vec3, order: tuple[Vec3 | None, float] | None) -> Leg:
    if order is None or intent.verb == "arm":
        is_parked = not told.is_airborne
        return Leg(spot, spot if is_parked else _goal(told, spot), is_ordered=False, is_parked=is_parked)
    goal, duration_s = order
    return Leg(spot, goal or (spot[0], spot[1], intent.height_m or spot[2]), duration_s)


def _goal(told: Telemetry, spot: Vec3) -> Vec3:
    if told.state in ("flying", "taking off", "holding") and all(map(math.isfinite, told.goal_position_enu_m)):
        return told.goal_position_enu_m
    return spot


def _filled_in(intent: Intent, plan: Plan, fleet: FleetConfig) -> Intent:
    """The position that a formation without one takes: what is sent is then what was seen."""
    if intent.verb != "formation" or intent.position_enu_m is not None or intent.formation is None:
        return intent
    slots = slots_of(fleet, intent.formation, intent.spacing_m)
    for name, order in plan.orders.items():
        if order.position_enu_m is not None:
            x, y, z = (goal - offset for goal, offset in zip(order.position_enu_m, slots[name], strict=True))
            return replace(intent, position_enu_m=(x, y, z))
    return intent
