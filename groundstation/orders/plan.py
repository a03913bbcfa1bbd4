"""Turns an intent into one checked message per vehicle, or into a refusal in words. Pure.

An order is planned once. Before it is sent, :func:`check_again` checks the planned goals against
the fleet at that time. The goals themselves do not change after they were shown.

The checks come in this order: whether the values are valid, which vehicles may be ordered, then the
goals, then the conditions of the verb itself. Once a check has refused a vehicle, the later checks
are not made.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np

from groundstation.fleet.slot_owners import out_of_service, slot_owner_of, spot_of
from groundstation.fleet.state import FleetState
from groundstation.fleet.stoppable import stoppable
from groundstation.orders.goals import ExpectedFleet, GoalFacts, Goals, goals_of
from groundstation.orders.held_formation import HeldFormation, held_after, held_slots
from groundstation.orders.intents import (
    LONGEST_EVERY_S,
    LONGEST_MOVE_S,
    BringHome,
    Formation,
    Goto,
    Home,
    Intent,
    Move,
    Rotate,
    Swap,
    Takeoff,
    for_fewer,
)
from groundstation.orders.reachable_goals import reach_refusal
from groundstation.orders.swap import names_that_hear, swap_refusals, with_slot_owner
from onboard.bus.schema import BY_MISSION, ON_PATHS, Order, Telemetry
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    above_words,
    parking_distance_m,
    parking_height_share,
)
from onboard.config.flight_space import flight_space_of, goal_refusal
from onboard.config.ground import ground_at_m, least_height_m
from onboard.config.pair_separation import separation_m
from onboard.config.toml_reading import convert
from onboard.control.raised_ground import CLEARANCE_IN_ORDER
from onboard.feasibility.finding import rounded_up
from onboard.tuples import Xyz

ORDER_LIFE_S = 2.0  # time from an order to its deadline
_MAX_SPACING_M = 1000.0
# A vehicle may report that it stands this much higher than the fleet file says.
_STANDS_HIGHER_M = 0.05
_OTHER_HEIGHT_M = 0.3  # difference from which a refusal says that heights do not count
_NO_FORMATION = HeldFormation(name=None)


@dataclass(frozen=True, slots=True)
class PlannedOrder:
    """A checked order of an operator: messages to send, and refusals."""

    intent: Intent  # with the values filled in that the order leaves open
    orders: Mapping[str, Order] = field(default_factory=dict)  # vehicle -> message
    refusals: Mapping[str, str] = field(default_factory=dict)  # vehicle -> sentence
    # vehicles that are refused for a reason of their own; the others are only because these are
    causes: frozenset[str] = frozenset()
    held: HeldFormation = _NO_FORMATION  # formation after the order is sent


def random_id() -> str:
    """Return an order id that no other order has."""
    return uuid.uuid4().hex[:12]


def plan_order(
    intent: Intent,
    fleet: FleetConfig,
    state: FleetState | None,
    *,
    held: HeldFormation,
    author: str,
    now_ns: int,
    node: str = "",
    new_id: Callable[[], str] = random_id,
    expected: ExpectedFleet | None = None,
) -> PlannedOrder:
    """Check an intent against the fleet and make its orders.

    If one vehicle of a joint order is refused, no vehicle gets the order, so that no formation
    flies with only some of its vehicles.

    Args:
        intent: the order, from the grammar or from a program.
        fleet: the fleet file.
        state: the fleet as known now; None checks against the fleet file alone.
        held: present formation.
        author: person or program that orders.
        now_ns: the ground's monotonic clock [ns].
        node: the ground's name on the bus.
        new_id: function that returns a new order id.
        expected: where vehicles are expected, if nothing is known of them now; None: all are on
            their take-off spots.

    Returns:
        Orders for the vehicles that may be ordered, refusals for the others.
    """
    expected = expected or ExpectedFleet()
    try:
        intent = with_checked_values(intent)
    except ConfigError as error:
        wrong_values = dict.fromkeys(intent.names, str(error))
        return PlannedOrder(intent=intent, refusals=wrong_values, held=held)

    intent = _for_those_taking_part(intent, fleet, state, held)
    if isinstance(intent, Swap) and state is not None:
        intent = with_slot_owner(intent, state)

    names = [name for name in intent.names if _may_be_ordered(name, intent, fleet)]
    refusals: Mapping[str, str] = {
        name: _unknown(name, fleet) for name in intent.names if name not in names
    }

    goals_enu_m: Mapping[str, Xyz] = {}
    if not refusals and intent.has_goals:
        facts = GoalFacts(fleet=fleet, state=state, held=held, names=names, expected=expected)
        intent, goals_enu_m, refusals = _checked_goals(intent, facts, now_ns)

    if not refusals and isinstance(intent, Swap) and state is not None:
        refusals = swap_refusals(intent, fleet, state, now_ns)
        names = names_that_hear(intent, state, now_ns)
    if not refusals and isinstance(intent, Takeoff):
        grounds_m = {name: _ground_m(name, fleet, state, expected) for name in names}
        refusals = _height_refusals(grounds_m, intent.height_m, fleet)
    causes = frozenset(refusals)
    if intent.is_joint:
        refusals = refuse_jointly(refusals, names)

    values = intent.message_values()
    orders = {
        name: Order(
            order_id=new_id(),
            author=author,
            kind=intent.kind_for(name),
            stamp_ns=now_ns,
            deadline_ns=_deadline_ns(now_ns),
            position_enu_m=goals_enu_m.get(name),
            height_m=values.height_m,
            duration_s=values.duration_s,
            node=node,
            yaw_deg=values.yaw_deg,
            then_land=values.then_land,
            reason=values.reason,
            stands_in_for=_slot_owner_for(name, intent),
            follows=values.follows,
        )
        for name in names
        if name not in refusals
    }
    if orders:
        held = held_after(intent, held)
    return PlannedOrder(
        intent=intent,
        orders=with_heard_stamps(orders, state),
        refusals=refusals,
        causes=causes,
        held=held,
    )


def with_checked_values(intent: Intent) -> Intent:
    """Return the same order with values of the right types, all of which an order may have.

    Numbers and arrays of numpy become those of Python, and lists become tuples.

    Args:
        intent: the order, from the grammar or from a program.

    Raises:
        ConfigError: a value has a wrong type or length, is not finite, or is out of bounds.
    """
    values = msgspec.to_builtins(intent, enc_hook=_as_built_in)
    checked: Intent = convert(values, type(intent), "order", intent.verb)

    bad_number = _bad_number(checked)
    if bad_number is not None:
        raise ConfigError(bad_number)
    return checked


def _as_built_in(value: Any) -> Any:
    """Return a value of a type that msgspec does not know as one that it knows."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, Iterable):
        return list(value)
    return repr(value)


def _slot_owner_for(name: str, intent: Intent) -> str:
    """Return the slot owner of the spare of a swap; empty for other vehicles and orders."""
    if isinstance(intent, Swap) and name == intent.spare:
        if intent.slot_owner:
            return intent.slot_owner
        return intent.swapped
    return ""


def _for_those_taking_part(
    intent: Intent, fleet: FleetConfig, state: FleetState | None, held: HeldFormation
) -> Intent:
    """Return an order to all without the vehicles that it cannot mean.

    Args:
        intent: the order; one that names its vehicles is not changed.
        fleet: the fleet file.
        state: the fleet as known now.
        held: present formation.
    """
    intent = _without_disabled(intent, state)
    intent = _without_bystanders(intent, state)
    intent = _without_lost_on_ground(intent, state)
    return _without_slotless(intent, fleet, state, held)


def _checked_goals(intent: Intent, facts: GoalFacts, now_ns: int) -> Goals:
    """Return the goals of an order, with refusals where there is none or no vehicle may go to it.

    Args:
        intent: intent of a verb that has goals.
        facts: the fleet, and the vehicles that may be ordered.
        now_ns: the ground's monotonic clock [ns].
    """
    try:
        planned = goals_of(intent, facts)
    except ConfigError as error:  # a formation that cannot be made
        return Goals(intent, refusals=dict.fromkeys(facts.names, str(error)))

    if planned.refusals:
        return planned
    refusals = _goal_refusals(planned.goals, facts.fleet, facts.state, now_ns)
    return planned._replace(refusals=refusals)


def _without_disabled(intent: Intent, state: FleetState | None) -> Intent:
    """Return an order to all without the vehicles that are out of service, or swapped.

    An order that names its vehicles is not changed, and neither is one that brings vehicles down.
    """
    if state is None or not intent.is_everybody or intent.brings_down:
        return intent

    excluded = out_of_service(state)
    names = tuple(name for name in intent.names if name not in excluded)
    if not names or len(names) == len(intent.names):
        return intent
    return for_fewer(intent, names)


def _without_bystanders(intent: Intent, state: FleetState | None) -> Intent:
    """Return an order about paths to all without the vehicles that do not follow anything.

    If no vehicle follows a path or another vehicle, the order is not changed.
    """
    if state is None or intent.kind not in ON_PATHS or not intent.is_everybody:
        return intent

    names = stoppable(state, [name for name in intent.names if name in state.vehicles])
    if not names:
        return intent
    return for_fewer(intent, names)


def _without_lost_on_ground(intent: Intent, state: FleetState | None) -> Intent:
    """Return an order that sends all home without the vehicles that stand without a position.

    Such a vehicle cannot fly, and would refuse the order for all others as well.
    """
    if state is None or not isinstance(intent, (Home, BringHome)) or not intent.is_everybody:
        return intent

    names = tuple(name for name in intent.names if not _stands_lost(state.telemetry_of(name)))
    if not names:
        return intent
    return for_fewer(intent, names)


def _stands_lost(telemetry: Telemetry | None) -> bool:
    if telemetry is None:
        return False
    return not telemetry.is_airborne and not telemetry.is_position_valid


def _without_slotless(
    intent: Intent, fleet: FleetConfig, state: FleetState | None, held: HeldFormation
) -> Intent:
    """Return an order to all about a formation without the vehicles that have no slot in it.

    A spare, for instance, has a slot only when it stands in for a vehicle that has one.
    """
    if not isinstance(intent, (Formation, Move, Rotate)) or not intent.is_everybody:
        return intent
    next_held = held_after(intent, held)
    if next_held.name is None:
        return intent

    try:
        slots = held_slots(fleet, next_held)
    except ConfigError:  # a formation that cannot be made; goals_of says why
        return intent
    names = tuple(name for name in intent.names if slot_owner_of(name, state) in slots)
    if not names:
        return intent
    return for_fewer(intent, names)


def occupied_goals(
    planned: PlannedOrder, fleet: FleetConfig, state: FleetState, now_ns: int
) -> dict[str, str]:
    """Return the goals at which another vehicle is on the ground, or was when it fell silent.

    The vehicles would refuse such a goal themselves, or not reach it.

    Args:
        planned: result of :func:`plan_order`.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        Vehicle -> sentence.
    """
    resting_enu_m = state.resting_enu_m(now_ns, without=planned.orders)
    sentences = {}
    limits = fleet.fleet
    for name, order in planned.orders.items():
        goal = order.position_enu_m
        if goal is None:
            continue
        for other, position in resting_enu_m.items():
            distance_m = separation_m(goal, position, limits.height_share)
            if distance_m < limits.safety_distance_m:
                sentences[name] = (
                    f"{name}: its goal is {distance_m:.2f} m from {other}, which is on the ground "
                    "or silent."
                )
    return sentences


def check_again(
    planned: PlannedOrder, fleet: FleetConfig, state: FleetState, now_ns: int
) -> PlannedOrder:
    """Check a planned order against the present fleet, and give its messages new stamps.

    Args:
        planned: result of :func:`plan_order`.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        The same orders with the same goals, or refusals instead of all of them.
    """
    goals_enu_m = {}
    for name, order in planned.orders.items():
        if order.position_enu_m is not None:
            goals_enu_m[name] = order.position_enu_m

    refusals = _goal_refusals(goals_enu_m, fleet, state, now_ns)
    refusals = refuse_jointly(refusals, planned.orders)

    orders = {
        name: stamped_anew(order, now_ns)
        for name, order in planned.orders.items()
        if name not in refusals
    }
    return replace(
        planned,
        orders=with_heard_stamps(orders, state),
        refusals={**planned.refusals, **refusals},
    )


def with_heard_stamps(orders: Mapping[str, Order], state: FleetState | None) -> dict[str, Order]:
    """Return orders with the stamp of the newest telemetry that was heard of each vehicle.

    The vehicle can tell from this stamp, which its own clock has made, how old the order is.

    Args:
        orders: vehicle -> order.
        state: the fleet as known now; None if nothing is known.

    Returns:
        The orders; those to vehicles without telemetry are unchanged.
    """
    if state is None:
        return dict(orders)

    stamped = {}
    for name, order in orders.items():
        view = state.vehicles.get(name)  # None: disabled by the fleet file, and not heard
        if view is not None and view.telemetry is not None:
            order = msgspec.structs.replace(
                order, heard_boot_id=view.telemetry.boot_id, heard_ns=view.telemetry.stamp_ns
            )
        stamped[name] = order
    return stamped


def of_mission(planned: PlannedOrder) -> PlannedOrder:
    """Return a planned order whose messages say that a mission has given it.

    Args:
        planned: order as a person would give it.
    """
    orders = {
        name: msgspec.structs.replace(order, reason=BY_MISSION)
        for name, order in planned.orders.items()
    }
    return replace(planned, orders=orders)


def stamped_anew(order: Order, now_ns: int) -> Order:
    """Return the same order with a new stamp and a new deadline.

    Args:
        order: order as it was sent before.
        now_ns: the ground's monotonic clock [ns].
    """
    return msgspec.structs.replace(order, stamp_ns=now_ns, deadline_ns=_deadline_ns(now_ns))


def _deadline_ns(now_ns: int) -> int:
    return now_ns + int(ORDER_LIFE_S * 1e9)


# -- refusals --------------------------------------------------------------------------------------


def refuse_jointly(refusals: Mapping[str, str], names: Iterable[str]) -> dict[str, str]:
    """Return refusals for all vehicles if there is at least one; otherwise none."""
    if not refusals:
        return {}

    cause = ", ".join(refusals)
    jointly = dict(refusals)
    for name in names:
        if name not in refusals:
            jointly[name] = f"{name}: not sent, because {cause} was refused."
    return jointly


def _may_be_ordered(name: str, intent: Intent, fleet: FleetConfig) -> bool:
    """Whether a vehicle takes part, or the order brings down a vehicle that does not take part."""
    if name in fleet.enabled_names:
        return True
    return name in fleet.vehicles and intent.brings_down


def _unknown(name: str, fleet: FleetConfig) -> str:
    if name in fleet.vehicles:
        return (
            f"{name}: it is not enabled in the fleet file, and may be brought down only. "
            "Set enabled = true to fly it."
        )
    return (
        f"{name[:40]}: it is not a vehicle of fleet '{fleet.fleet.name}', which has "
        f"{', '.join(fleet.enabled_names)}."
    )


def _bad_number(intent: Intent) -> str | None:
    """Return a sentence about a number that no order may have; None if all numbers are valid."""
    if not all(math.isfinite(number) for number in _numbers(intent)):
        return (
            "A number of this order is not finite. "
            "Give metres in the fleet's frame, seconds and degrees."
        )

    duration_s = intent.message_values().duration_s
    if not 0.0 <= duration_s <= LONGEST_MOVE_S:
        return f"A duration of {duration_s:g} s is outside 0 to {LONGEST_MOVE_S:g} s."

    if isinstance(intent, Takeoff):
        is_period_valid = 0.0 <= intent.every_s <= LONGEST_EVERY_S
        if intent.by < 0 or not is_period_valid:
            return (
                f"Waves of {intent.by} vehicles every {intent.every_s:g} s: "
                f"give 1 or more, and 0 to {LONGEST_EVERY_S:g} s."
            )

    spacing_m = intent.spacing_m if isinstance(intent, Formation) else None
    if spacing_m is not None and not 0.0 < spacing_m <= _MAX_SPACING_M:
        return (
            f"A spacing of {spacing_m:g} m is no distance between slots. "
            "Give metres, for instance 1.6."
        )
    return None


def _numbers(intent: Intent) -> Iterator[float]:
    """Yield the numbers of an intent, also those of its goals."""
    for name in intent.__struct_fields__:
        value = getattr(intent, name)
        if isinstance(value, int | float):
            yield value
        elif isinstance(value, tuple) and name != "vehicles":
            yield from value
    if isinstance(intent, Goto):
        for goal in intent.goals.values():
            yield from goal


def _goal_refusals(
    goals_enu_m: Mapping[str, Xyz], fleet: FleetConfig, state: FleetState | None, now_ns: int
) -> dict[str, str]:
    """Return a refusal for each goal that is outside the fence, unreachable, or near another's."""
    refusals: dict[str, str] = {}
    for name, goal in goals_enu_m.items():
        refusal = _space_refusal(name, goal, fleet)
        if refusal is None:
            refusal = _route_refusal(name, goal, fleet, state)
        if refusal is not None:
            refusals[name] = refusal

    parking_m = parking_distance_m(fleet)
    for name, goal in goals_enu_m.items():
        for other, position, noun in _others(name, goals_enu_m, state, now_ns):
            if separation_m(goal, position, parking_height_share(fleet)) < parking_m:
                sentence = _too_near(name, goal, f"{other}'s {noun}", position, fleet)
                refusals.setdefault(name, sentence)
    return refusals


def _space_refusal(name: str, goal: Xyz, fleet: FleetConfig) -> str | None:
    """Return why a goal is outside the permitted space; None if it is inside."""
    words = goal_refusal(fleet, fleet.vehicles[name], goal)
    if not words:
        return None
    return f"{name}: the goal {_goal_text(goal)} {words}."


def _route_refusal(
    name: str, goal: Xyz, fleet: FleetConfig, state: FleetState | None
) -> str | None:
    """Return why a vehicle finds no route to a goal from where it is; None if it finds one."""
    telemetry = None if state is None else state.telemetry_of(name)
    if telemetry is None or not telemetry.is_position_valid:
        return None

    words = reach_refusal(fleet, name, telemetry.position_enu_m, goal, CLEARANCE_IN_ORDER)
    if not words:
        return None
    return f"{name}: the goal {_goal_text(goal)} {words}."


def _goal_text(goal: Xyz) -> str:
    x, y, z = goal
    return f"({x:.2f}, {y:.2f}, {z:.2f})"


def _too_near(name: str, goal: Xyz, other: str, position: Xyz, fleet: FleetConfig) -> str:
    """Return the sentence about a goal that is too near to another one."""
    goal_x, goal_y, goal_z = goal
    x, y, z = position
    distance_m = math.dist((goal_x, goal_y), (x, y))
    height_difference_m = abs(goal_z - z)

    height_words = ""
    if height_difference_m > _OTHER_HEIGHT_M:
        height_words = f" and {height_difference_m:.1f} m above or below it"

    rule_words = above_words(parking_distance_m(fleet), parking_height_share(fleet))
    if height_words and not rule_words:
        rule_words = ", horizontally at any height: it has no vertical separation"

    return (
        f"{name}: its goal is {distance_m:.2f} m from {other}{height_words}; "
        f"the law '{fleet.law.name}' keeps {parking_distance_m(fleet):.2f} m between parked "
        f"vehicles{rule_words}. Choose a goal further away."
    )


def _others(
    name: str, goals_enu_m: Mapping[str, Xyz], state: FleetState | None, now_ns: int
) -> Iterator[tuple[str, Xyz, str]]:
    """Yield the goals of this order, and goals or positions of other vehicles that fly.

    Each item is the other vehicle, its goal or position, and the word "goal" or "position".
    """
    for other, goal in goals_enu_m.items():
        if other != name:
            yield other, goal, "goal"

    if state is None:
        return
    for other, view in state.vehicles.items():
        telemetry = view.telemetry
        if other in goals_enu_m or telemetry is None:
            continue
        if not telemetry.is_airborne or not view.is_fresh(now_ns):
            continue

        goal = telemetry.goal_position_enu_m
        if telemetry.state in ("flying", "taking off") and all(map(math.isfinite, goal)):
            yield other, goal, "goal"
        elif telemetry.is_position_valid:
            yield other, telemetry.position_enu_m, "position"


def _ground_m(
    name: str, fleet: FleetConfig, state: FleetState | None, expected: ExpectedFleet
) -> float:
    """Return the height [m] at which a vehicle stands before its take-off, or may report it.

    A vehicle that flies or is not ready refuses the take-off itself, at whatever height it is.
    """
    telemetry = None if state is None else state.telemetry_of(name)
    if telemetry is not None and telemetry.is_position_valid:
        _, _, z = telemetry.position_enu_m
        if not telemetry.is_airborne and not telemetry.not_ready:
            return z

    x, y, _ = expected.positions_enu_m.get(name, spot_of(name, fleet, state))
    return float(ground_at_m(fleet, x, y)) + _STANDS_HIGHER_M


def _height_refusals(
    grounds_m: Mapping[str, float], height_m: float, fleet: FleetConfig
) -> dict[str, str]:
    """Return refusals of a take-off to a height outside the fence, or too near to the ground.

    Args:
        grounds_m: height of the ground under each vehicle [m].
        height_m: ordered height, above the fleet's origin [m].
        fleet: the fleet file.
    """
    floor_m, top_m = fleet.fleet.geofence_m.z
    for area in flight_space_of(fleet).areas:
        if area.keeps_in:
            top_m = min(top_m, area.high_m)

    refusals = {}
    for name, ground_m in grounds_m.items():
        lowest_m = max(floor_m, ground_m + least_height_m(fleet.vehicles[name]))
        lowest_m = rounded_up(lowest_m, 2)
        if height_m > top_m:
            refusals[name] = (
                f"{name}: a take-off height of {height_m:g} m is above {top_m:g} m, the top of the "
                "fence."
            )
        elif height_m < lowest_m:
            refusals[name] = (
                f"{name}: a take-off to {height_m:g} m does not leave the ground: order at least "
                f"{lowest_m:g} m."
            )
    return refusals
