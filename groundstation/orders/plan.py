"""An intent -> one checked order per vehicle, or a reason in words for each refusal. Pure.

An order is planned once. Before it is sent, :func:`check_again` checks the planned goals against
the fleet as it is then; the goals themselves stay as they were shown.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.formations.assignment import nearest_slots
from groundstation.formations.slots import formation_slots, stretched
from groundstation.orders.grammar import DEFAULT_HEIGHT_M, USAGE, Intent
from onboard.bus.schema import Order, OrderKind, Vec3
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    above_words,
    parking_distance_m,
    parking_height_share,
)
from onboard.config.pair_separation import separation_m

ORDER_LIFE_S = 2.0
_MIN_HEIGHT_M = 0.2
_OTHER_HEIGHT_M = 0.3  # from which on a refusal says that heights do not count
_BRINGS_DOWN = ("land", "hold", "disarm", "kill", "locate")
_TO_GOALS = ("move", "goto", "formation", "rotate", "yaw", "home")
_JOINT = (*_TO_GOALS, "takeoff")  # one refusal refuses the whole order


@dataclass(frozen=True, slots=True)
class HeldFormation:
    """The formation that moves of several vehicles keep."""

    name: str | None  # in the fleet file; None when it has none
    spacing_m: float | None = None  # distance of its two nearest slots; None: as in the fleet file
    rotation_deg: float = 0.0  # against the fleet file, counterclockwise
    # for each vehicle the one whose slot it has; None: its own
    takes: Mapping[str, str] | None = None


@dataclass(frozen=True, slots=True)
class PlannedOrder:
    """A checked order of an operator: messages to send, and refusals."""

    intent: Intent  # with the position filled in that a formation without one takes
    orders: Mapping[str, Order] = field(default_factory=dict)  # vehicle -> message
    refusals: Mapping[str, str] = field(default_factory=dict)  # vehicle -> sentence
    held: HeldFormation = HeldFormation(None)  # holds as soon as the order is sent


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
) -> PlannedOrder:
    """Check an intent against the fleet and make its orders.

    If one goal of a joint move is refused, none of that move is sent: nobody wants half a
    formation.

    Args:
        intent: the order, by the grammar or by a program.
        fleet: the fleet file.
        state: the fleet as known now; None checks against the fleet file alone.
        held: formation that holds now.
        author: person or program that orders.
        now_ns: the ground's monotonic clock [ns].
        node: the ground's name on the bus.
        new_id: makes the orders' ids.

    Returns:
        Orders for the vehicles that may be ordered, refusals for the others.
    """
    goals: dict[str, Vec3] = {}
    barred = [name for name in intent.vehicles if not _may_be_ordered(name, intent.verb, fleet)]
    refusals = {name: _unknown(name, fleet) for name in barred}
    names = [name for name in intent.vehicles if name not in refusals]
    refusals.update({name: reason for name in names if (reason := _bad_number(intent))})
    if not refusals and intent.verb in _TO_GOALS:
        try:
            intent, goals, refusals = _goals(intent, fleet, state, held, names)
        except ConfigError as error:  # a formation that cannot be made
            refusals = dict.fromkeys(names, str(error))
        if not refusals:
            refusals = _goal_refusals(goals, fleet, state, now_ns)
    if not refusals and intent.verb == "takeoff":
        refusals = _height_refusals(names, intent.height_m or 0.0, fleet)
    if intent.verb in _JOINT:
        refusals = _refuse_jointly(refusals, names)
    kind: OrderKind = "move" if intent.verb in _TO_GOALS else intent.verb  # type: ignore[assignment]
    orders = {
        name: Order(
            order_id=new_id(),
            author=author,
            kind=kind,
            stamp_ns=now_ns,
            deadline_ns=_deadline_ns(now_ns),
            position_enu_m=goals.get(name),
            height_m=intent.height_m if kind == "takeoff" else None,
            duration_s=intent.duration_s,
            node=node,
            yaw_deg=intent.yaw_deg,
            then_land=intent.verb == "home",
        )
        for name in names
        if name not in refusals
    }
    return PlannedOrder(
        intent, addressed(orders, state), refusals, _kept(intent, held) if orders else held
    )


def check_again(
    planned: PlannedOrder, fleet: FleetConfig, state: FleetState, now_ns: int
) -> PlannedOrder:
    """Check a planned order against the fleet as it is now, and stamp it anew.

    Args:
        planned: by :func:`plan_order`.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].

    Returns:
        The same orders with the same goals, or refusals instead of all of them.
    """
    goals = {
        name: goal
        for name, order in planned.orders.items()
        if (goal := order.position_enu_m) is not None
    }
    refusals = _refuse_jointly(_goal_refusals(goals, fleet, state, now_ns), planned.orders)
    orders = {
        name: msgspec.structs.replace(order, stamp_ns=now_ns, deadline_ns=_deadline_ns(now_ns))
        for name, order in planned.orders.items()
        if name not in refusals
    }
    return replace(
        planned, orders=addressed(orders, state), refusals={**planned.refusals, **refusals}
    )


def addressed(orders: Mapping[str, Order], state: FleetState | None) -> dict[str, Order]:
    """Return orders that show their vehicles how new they are, by what was heard of each last.

    Args:
        orders: vehicle -> order.
        state: the fleet as known now; None when nothing is known.

    Returns:
        The orders, with the stamp of each vehicle's newest telemetry where there is one.
    """
    heard = {} if state is None else {name: state.vehicles[name].telemetry for name in orders}
    return {
        name: order
        if (last := heard.get(name)) is None
        else msgspec.structs.replace(order, heard_boot_id=last.boot_id, heard_ns=last.stamp_ns)
        for name, order in orders.items()
    }


def slots_of(
    fleet: FleetConfig, formation: str, spacing_m: float | None = None, rotation_deg: float = 0.0
) -> dict[str, Vec3]:
    """Return the offsets of a formation, stretched and turned in the plane.

    Args:
        fleet: the fleet file.
        formation: its name.
        spacing_m: distance [m] of its two nearest slots; None leaves the formation as it is.
        rotation_deg: counterclockwise.

    Returns:
        Offset of each vehicle from the formation's position, metres ENU.
    """
    return stretched(formation_slots(fleet, formation), spacing_m, rotation_deg)


def formation_position(
    slots: Mapping[str, Vec3], state: FleetState, names: Sequence[str]
) -> Vec3 | None:
    """Return the position of a formation: the mean of its vehicles' positions minus their slots.

    Args:
        slots: offset of each vehicle, metres ENU.
        state: the fleet as known now.
        names: vehicles to average over.

    Returns:
        Position in metres ENU; None when no vehicle reports one.
    """
    positions = []
    for name in names:
        view = state.vehicles.get(name)
        if (
            view is None
            or view.telemetry is None
            or name not in slots
            or not view.telemetry.is_position_valid
        ):
            continue
        own = view.telemetry.position_enu_m
        positions.append(
            tuple(value - offset for value, offset in zip(own, slots[name], strict=True))
        )
    if not positions:
        return None
    x, y, z = (sum(axis) / len(positions) for axis in zip(*positions, strict=True))
    return (x, y, z)


def _deadline_ns(now_ns: int) -> int:
    return now_ns + int(ORDER_LIFE_S * 1e9)


def _refuse_jointly(refusals: Mapping[str, str], names: Iterable[str]) -> dict[str, str]:
    if not refusals:
        return {}
    cause = ", ".join(refusals)
    others = {
        name: f"{name}: not sent, because {cause} was refused."
        for name in names
        if name not in refusals
    }
    return {**refusals, **others}


def _may_be_ordered(name: str, verb: str, fleet: FleetConfig) -> bool:
    """Whether it takes part, or is to be brought down although it does not."""
    return name in fleet.enabled_names or (name in fleet.vehicles and verb in _BRINGS_DOWN)


def _unknown(name: str, fleet: FleetConfig) -> str:
    if name in fleet.vehicles:
        return f"{name} is not enabled in the fleet file: it may be brought down only. Set enabled = true to fly it."
    return f"{name[:40]} is not a vehicle of fleet '{fleet.fleet.name}': it has {', '.join(fleet.enabled_names)}."


def _bad_number(intent: Intent) -> str | None:
    numbers = (intent.height_m, intent.spacing_m, intent.yaw_deg, intent.rotation_deg)
    values = [
        *(intent.position_enu_m or ()),
        intent.duration_s,
        *(value or 0.0 for value in numbers),
    ]
    if not all(math.isfinite(value) for value in values):
        return "A number of this order is not finite. Give metres in the fleet's frame, seconds and degrees."
    if not 0.0 <= intent.duration_s <= 600.0:
        return f"A duration of {intent.duration_s:g} s is outside 0 to 600 s."
    if intent.spacing_m is not None and not 0.0 < intent.spacing_m <= 1000.0:
        return f"A spacing of {intent.spacing_m:g} m is no distance between slots. Give metres, for instance 1.6."
    return None


def _kept(intent: Intent, held: HeldFormation) -> HeldFormation:
    """Return the formation that holds once this order is sent."""
    if intent.verb == "rotate":
        return replace(
            held,
            rotation_deg=math.remainder(held.rotation_deg + (intent.rotation_deg or 0.0), 360.0),
        )
    if intent.formation is None:
        return held
    return HeldFormation(
        intent.formation, intent.spacing_m, intent.rotation_deg or 0.0, intent.takes
    )


def held_slots(fleet: FleetConfig, held: HeldFormation) -> dict[str, Vec3]:
    """Return the offsets of the vehicles in the formation that holds.

    Args:
        fleet: the fleet file.
        held: its name, spacing, rotation, and who has whose slot.

    Returns:
        Offset of each vehicle from the formation's position, metres ENU.
    """
    if held.name is None:
        return {}
    slots = slots_of(fleet, held.name, held.spacing_m, held.rotation_deg)
    return (
        slots if held.takes is None else {name: slots[taken] for name, taken in held.takes.items()}
    )


def _goals(
    intent: Intent,
    fleet: FleetConfig,
    state: FleetState | None,
    held: HeldFormation,
    names: list[str],
) -> tuple[Intent, dict[str, Vec3], dict[str, str]]:
    """The intent with its position, the goal of each vehicle, and refusals."""
    if intent.verb in ("goto", "home", "yaw"):
        return intent, *_own_goals(intent, fleet, state, names)
    keeps = _kept(intent, held)
    position, slots = intent.position_enu_m, held_slots(fleet, keeps)
    if position is None and intent.verb in ("formation", "rotate"):
        if intent.verb == "rotate" and state is None:
            return intent, {}, {}  # judged when it is flown
        before = slots if intent.verb == "formation" else held_slots(fleet, held)
        position = formation_position(before, state, names) if state is not None else None
        if position is None:
            reason = "the formation's position is not known, because no vehicle reports one. Write it: {}"
            return intent, {}, dict.fromkeys(names, reason.format(USAGE["formation"]))
        intent = replace(intent, position_enu_m=position)
    if position is None:
        return intent, {}, dict.fromkeys(names, "a move needs a position: X Y Z in metres.")
    if intent.verb == "move" and len(names) == 1:
        return intent, {names[0]: position}, {}
    if keeps.name is None:
        reason = (
            f"this fleet file has no formation, so give each vehicle its own goal: {USAGE['goto']}"
        )
        return intent, {}, dict.fromkeys(names, reason)
    if intent.is_nearest and intent.takes is None:
        spots = {
            name: _spot(state.vehicles.get(name)) if state else fleet.vehicles[name].start_enu_m
            for name in names
        }
        wanted = {name: slots[name] for name in names if name in slots}
        known = {name: spot for name, spot in spots.items() if spot is not None}
        takes = nearest_slots(wanted, known, position)
        intent, slots = (
            replace(intent, takes=takes),
            {name: slots[taken] for name, taken in takes.items()},
        )
    goals, refusals = {}, {}
    for name in names:
        if name in slots:
            offset = slots[name]
            goals[name] = (
                position[0] + offset[0],
                position[1] + offset[1],
                position[2] + offset[2],
            )
        else:
            refusals[name] = (
                f"{name} has no slot in formation '{keeps.name}' (slots: {', '.join(slots) or 'none'})."
            )
    return intent, goals, refusals


def _own_goals(
    intent: Intent, fleet: FleetConfig, state: FleetState | None, names: list[str]
) -> tuple[dict[str, Vec3], dict[str, str]]:
    """The goals of an order in which each vehicle has its own, and refusals."""
    if intent.verb == "goto":
        given = intent.goals or {}
        goals = {name: given[name] for name in names if name in given}
        return goals, {
            name: f"{name}: this order has no goal for it." for name in names if name not in given
        }
    if state is None:
        if intent.verb == "yaw":
            return {}, {}  # judged when it is flown
        spots = dict.fromkeys(names, (0.0, 0.0, DEFAULT_HEIGHT_M))
    else:
        known = {name: _spot(state.vehicles.get(name)) for name in names}
        unknown = [name for name, spot in known.items() if spot is None]
        if unknown:
            return {}, {name: f"{name} does not report where it is." for name in unknown}
        spots = {name: spot for name, spot in known.items() if spot is not None}
    if intent.verb == "yaw":
        return spots, {}
    pads = {name: fleet.vehicles[name].start_enu_m for name in names}
    height_m = intent.height_m
    return {
        name: (x, y, spots[name][2] if height_m is None else height_m)
        for name, (x, y, _) in pads.items()
    }, {}


def _spot(view: VehicleView | None) -> Vec3 | None:
    """Return where a vehicle is going to, or else where it is."""
    telemetry = None if view is None else view.telemetry
    if telemetry is None or not telemetry.is_position_valid:
        return None
    has_goal = telemetry.state in ("flying", "holding") and all(
        map(math.isfinite, telemetry.goal_position_enu_m)
    )
    return telemetry.goal_position_enu_m if has_goal else telemetry.position_enu_m


def _goal_refusals(
    goals: Mapping[str, Vec3], fleet: FleetConfig, state: FleetState | None, now_ns: int
) -> dict[str, str]:
    refusals: dict[str, str] = {}
    fence, parking_m = fleet.fleet.geofence_m, parking_distance_m(fleet)
    for name, goal in goals.items():
        if not fence.contains(goal) or goal[2] <= 0.0:
            refusals[name] = (
                f"{name}: the goal ({goal[0]:.2f}, {goal[1]:.2f}, {goal[2]:.2f}) lies outside the fence "
                f"x {list(fence.x)}, y {list(fence.y)}, z {list(fence.z)} m. Choose one inside, above the ground."
            )
    for name, goal in goals.items():
        for other, position, noun in _others(name, goals, state, now_ns):
            distance_m = separation_m(goal, position, parking_height_share(fleet))
            if distance_m < parking_m:
                distance_m = math.dist(goal[:2], position[:2])
                above_m = abs(goal[2] - position[2])
                high = (
                    f" and {above_m:.1f} m above or below it" if above_m > _OTHER_HEIGHT_M else ""
                )
                anyhow = above_words(fleet)
                if high and not anyhow:
                    anyhow = ", horizontally at any height: it has no vertical separation"
                refusals.setdefault(
                    name,
                    f"{name}: its goal is {distance_m:.2f} m from {other}'s {noun}{high}; the law '{fleet.law.name}' "
                    f"keeps {parking_m:.2f} m between parked vehicles{anyhow}. Choose a goal further away.",
                )
    return refusals


def _others(
    name: str, goals: Mapping[str, Vec3], state: FleetState | None, now_ns: int
) -> Iterator[tuple[str, Vec3, str]]:
    """Goals of this order, and those of vehicles that fly but are not part of it."""
    for other, goal in goals.items():
        if other != name:
            yield other, goal, "goal"
    for other, view in state.vehicles.items() if state is not None else ():
        telemetry = view.telemetry
        if (
            other in goals
            or telemetry is None
            or not telemetry.is_airborne
            or not view.is_fresh(now_ns)
        ):
            continue
        if telemetry.state in ("flying", "taking off") and all(
            map(math.isfinite, telemetry.goal_position_enu_m)
        ):
            yield other, telemetry.goal_position_enu_m, "goal"
        elif telemetry.is_position_valid:
            yield other, telemetry.position_enu_m, "position"


def _height_refusals(names: list[str], height_m: float, fleet: FleetConfig) -> dict[str, str]:
    _, top = fleet.fleet.geofence_m.z
    if _MIN_HEIGHT_M <= height_m <= top:
        return {}
    reason = f"a take-off height of {height_m:g} m is outside {_MIN_HEIGHT_M:g} to {top:g} m, the top of the fence."
    return {name: f"{name}: {reason}" for name in names}
