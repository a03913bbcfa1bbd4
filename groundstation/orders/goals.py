"""The goal of each vehicle, for each order that sends vehicles to goals. Pure.

Some orders leave values open that only the fleet's present state decides: the position of a
formation that is ordered without one, the centre of a rotation, the slot of each vehicle under
`assign="nearest"`. These values are filled into the intent, so that a preview shows them and a
second planning of the same order keeps them.

Without a fleet state, the goals follow from the fleet file alone. A mission is checked in this way
before it flies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from groundstation.fleet.slot_owners import by_vehicle, slot_owner_of, spot_of
from groundstation.fleet.state import FleetState
from groundstation.formations.assignment import nearest_slots, spots_without_crossing
from groundstation.orders.held_formation import (
    HeldFormation,
    formation_position,
    held_after,
    held_slots,
)
from groundstation.orders.intents import (
    DEFAULT_HEIGHT_M,
    INTENTS,
    BringHome,
    Formation,
    Goto,
    Home,
    Intent,
    Move,
    Rotate,
    Yaw,
)
from groundstation.orders.reachable_goals import height_of_goal_m, shortest_leg_s
from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.ground import least_height_m, touchable_ground_at_m
from onboard.tuples import Xyz

_MIN_FLIGHT_S = 3.0  # shortest duration of a flight home


class ExpectedFleet(NamedTuple):
    """Vehicles as they are expected to be before an order of a mission that is only checked."""

    positions_enu_m: Mapping[str, Xyz] = {}  # [m], ENU; a vehicle without one is on its spot
    on_ground: frozenset[str] = frozenset()  # vehicles that certainly stand on the ground


class GoalFacts(NamedTuple):
    """Everything besides the order that its goals depend on."""

    fleet: FleetConfig
    state: FleetState | None  # None: only the fleet file is used
    held: HeldFormation  # formation before the order
    names: list[str]  # vehicles of the order that may be ordered
    expected: ExpectedFleet = ExpectedFleet()  # where no state is used

    def spot_enu_m(self, name: str) -> Xyz:
        """Return a vehicle's take-off spot [m]; a spare has the spot of the vehicle it replaces."""
        return spot_of(name, self.fleet, self.state)

    def slots(self, held: HeldFormation) -> dict[str, Xyz]:
        """Return the offset of each vehicle in a formation [m], with spares that replace others."""
        return by_vehicle(held_slots(self.fleet, held), self.state)

    def by_slot_owner(self, takes: Mapping[str, str]) -> dict[str, str]:
        """Return an assignment of slots with slot owners instead of vehicles.

        Args:
            takes: vehicle -> the vehicle whose slot it takes.
        """
        return {
            slot_owner_of(name, self.state): slot_owner_of(other, self.state)
            for name, other in takes.items()
        }


class Goals(NamedTuple):
    """The goals of one order."""

    intent: Intent  # with the values filled in that the order leaves open
    goals: Mapping[str, Xyz] = {}  # empty if they are known only when the order is flown
    refusals: Mapping[str, str] = {}  # vehicle -> sentence


def goals_of(intent: Intent, facts: GoalFacts) -> Goals:
    """Return the goals of an order, or the reasons why it has none.

    Args:
        intent: intent of a verb that has goals.
        facts: the fleet, and the vehicles that may be ordered.

    Raises:
        ConfigError: a formation cannot be made.
    """
    goals_of_kind = _GOALS_BY_KIND[INTENTS[intent.verb]]
    return goals_of_kind(intent, facts)


# -- each vehicle has a goal of its own ------------------------------------------------------------


def _goto(intent: Goto, facts: GoalFacts) -> Goals:
    goals = {}
    refusals = {}
    for name in facts.names:
        if name in intent.goals:
            goals[name] = intent.goals[name]
        else:
            refusals[name] = f"{name}: this order has no goal for it."
    return Goals(intent, goals, refusals)


def _yaw(intent: Yaw, facts: GoalFacts) -> Goals:
    """Return the positions where the vehicles are or go to, because they turn there."""
    if facts.state is None:
        return Goals(intent)

    destinations = known_destinations(facts.names, facts.state)
    if len(destinations) < len(facts.names):
        return Goals(intent, {}, _no_position(facts.names, destinations))
    return Goals(intent, destinations)


def _home(intent: Home, facts: GoalFacts) -> Goals:
    """Return points above the take-off spots, at the ordered height or at each vehicle's own."""
    if facts.state is None:
        # Only the heights are used: a vehicle that is not expected anywhere has the default height.
        destinations = dict.fromkeys(facts.names, (0.0, 0.0, DEFAULT_HEIGHT_M))
        destinations.update(facts.expected.positions_enu_m)
    else:
        destinations = known_destinations(facts.names, facts.state)
    if len(destinations) < len(facts.names):
        return Goals(intent, {}, _no_position(facts.names, destinations))

    goals = {}
    for name in facts.names:
        spot_enu_m = facts.spot_enu_m(name)
        goals[name] = _goal_above_spot(facts, name, spot_enu_m, destinations[name], intent.height_m)
    return Goals(intent, goals)


def _bring_home(intent: BringHome, facts: GoalFacts) -> Goals:
    """Return points above the take-off spots, which are assigned by the present positions.

    Each flies at its own height, or at the ordered one.
    """
    positions = {}
    for name in facts.names:
        if facts.state is None:
            spot_enu_m = facts.spot_enu_m(name)
            positions[name] = facts.expected.positions_enu_m.get(name, spot_enu_m)
            continue
        telemetry = facts.state.telemetry_of(name)
        if telemetry is not None and telemetry.is_position_valid:
            positions[name] = telemetry.position_enu_m
    if len(positions) < len(facts.names):
        return Goals(intent, {}, _no_position(facts.names, positions))

    takes = intent.takes
    if takes is None:
        takes = _spots_taken(facts, positions)
        intent = replace(intent, takes=takes)

    goals = {}
    for name in facts.names:
        spot_enu_m = facts.spot_enu_m(takes.get(name, name))
        goals[name] = _goal_above_spot(facts, name, spot_enu_m, positions[name], intent.height_m)

    if not intent.duration_s:
        # The assignment avoids conflicts only if all vehicles need the same time.
        longest_s = max(
            _flight_s(positions[name], goal, facts.fleet.vehicles[name])
            for name, goal in goals.items()
        )
        intent = replace(intent, duration_s=math.ceil(10.0 * max(_MIN_FLIGHT_S, longest_s)) / 10.0)
    return Goals(intent, goals)


def _spots_taken(facts: GoalFacts, positions: Mapping[str, Xyz]) -> dict[str, str]:
    """Return for each vehicle of the order the owner of the take-off spot that it takes.

    Vehicles in the air share the spots that are free for them, by their ways. A vehicle that stands
    or lands, whose agent refuses the order, keeps its own spot or the one on which it stands.

    Args:
        facts: the fleet.
        positions: position of each vehicle of the order [m], ENU.
    """
    flying = [name for name in facts.names if _resting_enu_m(facts, name) is None]
    standing = _vehicles_on_spots(facts)
    owners = _free_spot_owners(flying, standing)
    spots = {name: facts.spot_enu_m(owner) for name, owner in owners.items()}
    assigned = spots_without_crossing(spots, positions)
    stands_on = {vehicle: owner for owner, vehicle in standing.items()}

    takes = {}
    for name in facts.names:
        if name in assigned:
            takes[name] = owners[assigned[name]]
        else:
            takes[name] = stands_on.get(name, name)
    return takes


def _free_spot_owners(flying: Sequence[str], standing: Mapping[str, str]) -> dict[str, str]:
    """Return for each vehicle in the air the owner of a take-off spot that is free for it.

    It is the vehicle itself, unless another one stands on its spot. Then it is that other one,
    whose own spot is free unless a third one stands there, and so on.

    Args:
        flying: vehicles of the order that are in the air.
        standing: owner of a spot -> the vehicle that stands on it.
    """
    owners: dict[str, str] = {}
    for name in flying:
        owner = name
        visited = [owner]
        while owner in standing and standing[owner] not in visited:
            owner = standing[owner]
            visited.append(owner)

        is_free = owner not in standing and owner not in owners.values()
        owners[name] = owner if is_free else name
    return owners


def _vehicles_on_spots(facts: GoalFacts) -> dict[str, str]:
    """Return the owner of each take-off spot that is not free -> who stands or lands on it."""
    names: Iterable[str] = sorted(facts.expected.on_ground)
    if facts.state is not None:
        names = facts.state.vehicles  # with those that are heard although the file disables them

    resting = {}
    for name in names:
        position_enu_m = _resting_enu_m(facts, name)
        if position_enu_m is not None:
            resting[name] = position_enu_m

    standing: dict[str, str] = {}
    for owner in dict.fromkeys([*facts.fleet.enabled_names, *resting]):
        spot_enu_m = facts.spot_enu_m(owner)
        for name, position_enu_m in resting.items():
            apart_m = math.dist(position_enu_m[:2], spot_enu_m[:2])
            if apart_m < facts.fleet.fleet.safety_distance_m:
                standing[owner] = name
                break
    return standing


def _resting_enu_m(facts: GoalFacts, name: str) -> Xyz | None:
    """Return where a vehicle stands or lands [m], ENU; None if it may fly elsewhere.

    A silent one stands where it was heard last, once its PX4 has reported that it is disarmed. One
    that does not know where it is, as after a blind landing, stands where it was last seen.
    """
    if facts.state is None:
        if name not in facts.expected.on_ground:
            return None
        return facts.expected.positions_enu_m.get(name)

    view = facts.state.vehicles[name]
    telemetry = view.telemetry
    if telemetry is not None and telemetry.state == "landing" and telemetry.is_position_valid:
        return telemetry.position_enu_m

    sighting = view.sighting
    if view.resting_enu_m is not None or telemetry is None or sighting is None:
        return view.resting_enu_m
    if sighting.is_flying:
        return None
    return sighting.position_enu_m


def _goal_above_spot(
    facts: GoalFacts, name: str, spot_enu_m: Xyz, from_enu_m: Xyz, ordered_height_m: float | None
) -> Xyz:
    """Return a vehicle's goal above a take-off spot [m], ENU.

    Args:
        facts: the fleet.
        name: the vehicle.
        spot_enu_m: the spot, its own or another one [m].
        from_enu_m: its position, or the goal of its present flight [m].
        ordered_height_m: height of the goal [m]; None: the vehicle's own, or more where the ground
            requires it. A vehicle on the ground gets a goal as well; its agent refuses the order
            with a better reason.
    """
    x, y, _ = spot_enu_m
    if ordered_height_m is not None:
        return (x, y, ordered_height_m)

    least_m = least_height_m(facts.fleet.vehicles[name])
    lowest_m = float(touchable_ground_at_m(facts.fleet, x, y)) + least_m
    _, _, own_height_m = from_enu_m
    height_m = max(own_height_m, lowest_m)
    return (x, y, _height_at_home_m(facts, name, (x, y, height_m)))


def _height_at_home_m(facts: GoalFacts, name: str, goal_enu_m: Xyz) -> float:
    """Return the height of a goal at home to which a flight passes over raised ground [m].

    It is the goal's own height if there is no such height below the fence's top.
    """
    _, _, height_m = goal_enu_m
    telemetry = None if facts.state is None else facts.state.telemetry_of(name)
    if telemetry is None:  # it is not known where the flight begins
        return height_m

    # the order may begin anywhere from here to where the vehicle can stop
    here_enu_m = telemetry.position_enu_m
    velocity_enu_m_s = telemetry.velocity_enu_m_s
    braking_m_s2 = facts.fleet.vehicles[name].max_acceleration_m_s2
    braking_s = math.hypot(*velocity_enu_m_s) / (2.0 * braking_m_s2)
    x, y, z = (
        position_m + braking_s * velocity_m_s
        for position_m, velocity_m_s in zip(here_enu_m, velocity_enu_m_s, strict=True)
    )
    over_m = height_of_goal_m(facts.fleet, name, (here_enu_m, (x, y, z)), goal_enu_m)
    _, top_m = facts.fleet.fleet.geofence_m.z
    if over_m > top_m:
        return height_m
    return over_m


def _flight_s(begin_enu_m: Xyz, end_enu_m: Xyz, vehicle: Vehicle) -> float:
    """Return the shortest duration of a straight flight from rest to rest [s]."""
    climb_m = end_enu_m[2] - begin_enu_m[2]
    return shortest_leg_s(vehicle, math.dist(begin_enu_m, end_enu_m), climb_m)


# -- the formation's position, and a slot for each vehicle -----------------------------------------


def _move(intent: Move, facts: GoalFacts) -> Goals:
    """Return the position itself for one vehicle, or slots of the present formation for several."""
    names = facts.names
    if len(names) == 1 and not intent.is_of_formation:
        return Goals(intent, {names[0]: intent.position_enu_m})

    held = facts.held
    slots = facts.slots(held)
    return _slot_goals(intent, facts, held, intent.position_enu_m, slots)


def _formation(intent: Formation, facts: GoalFacts) -> Goals:
    held = held_after(intent, facts.held)
    slots = facts.slots(held)

    position_enu_m = intent.position_enu_m
    if position_enu_m is None and facts.state is not None:
        position_enu_m = formation_position(slots, facts.state, facts.names)
    if position_enu_m is None:
        return _no_formation_position(intent, facts)
    intent = replace(intent, position_enu_m=position_enu_m)

    if intent.assign == "nearest" and intent.takes is None:
        destinations = _destinations_or_starts(facts)
        own_slots = {name: slots[name] for name in facts.names if name in slots}
        takes = nearest_slots(own_slots, destinations, position_enu_m)
        intent = replace(intent, takes=facts.by_slot_owner(takes))
        held = held_after(intent, facts.held)
        slots = facts.slots(held)

    return _slot_goals(intent, facts, held, position_enu_m, slots)


def _rotate(intent: Rotate, facts: GoalFacts) -> Goals:
    """Return the slots of the present formation, turned further about its present position."""
    if facts.held.name is None:
        return _no_formation(intent, facts)
    center_enu_m = intent.center_enu_m
    if center_enu_m is None:
        if facts.state is None:
            return Goals(intent)
        slots_before = facts.slots(facts.held)
        center_enu_m = formation_position(slots_before, facts.state, facts.names)
    if center_enu_m is None:
        return _no_formation_position(intent, facts)
    intent = replace(intent, center_enu_m=center_enu_m)

    held = held_after(intent, facts.held)
    slots = facts.slots(held)
    return _slot_goals(intent, facts, held, center_enu_m, slots)


def _slot_goals(
    intent: Intent,
    facts: GoalFacts,
    held: HeldFormation,
    position_enu_m: Xyz,
    slots: Mapping[str, Xyz],
) -> Goals:
    """Return the slot of each vehicle about the formation's position."""
    if held.name is None:
        return _no_formation(intent, facts)

    x, y, z = position_enu_m
    goals = {}
    refusals = {}
    for name in facts.names:
        if name not in slots:
            known = ", ".join(slots) or "none"
            refusals[name] = f"{name}: it has no slot in formation '{held.name}' (slots: {known})."
            continue

        east_m, north_m, up_m = slots[name]
        goals[name] = (x + east_m, y + north_m, z + up_m)
    return Goals(intent, goals, refusals)


def _no_formation(intent: Intent, facts: GoalFacts) -> Goals:
    reason = (
        "this fleet file has no formation, so give each vehicle its own goal: "
        f"{INTENTS['goto'].usage}"
    )
    return Goals(intent, {}, dict.fromkeys(facts.names, reason))


def _no_formation_position(intent: Intent, facts: GoalFacts) -> Goals:
    reason = (
        "the formation's position is not known, because no vehicle reports one. "
        f"Write it: {INTENTS['formation'].usage}"
    )
    return Goals(intent, {}, dict.fromkeys(facts.names, reason))


# -- where vehicles are or go to -------------------------------------------------------------------


def known_destinations(names: list[str], state: FleetState) -> dict[str, Xyz]:
    """Return the goal of each vehicle that moves, and the position of each other one [m], ENU.

    Vehicles that do not report a position are left out.
    """
    destinations = {}
    for name in names:
        destination = _destination(state.telemetry_of(name))
        if destination is not None:
            destinations[name] = destination
    return destinations


def _destinations_or_starts(facts: GoalFacts) -> dict[str, Xyz]:
    """Return the known destinations; without a state, the take-off spots of the fleet file."""
    if facts.state is not None:
        return known_destinations(facts.names, facts.state)
    return {name: facts.spot_enu_m(name) for name in facts.names}


def _destination(telemetry: Telemetry | None) -> Xyz | None:
    """Return a vehicle's goal, or its position if it has no goal; None if it reports neither."""
    if telemetry is None or not telemetry.is_position_valid:
        return None

    goal_enu_m = telemetry.goal_position_enu_m
    if telemetry.state in ("flying", "holding") and all(map(math.isfinite, goal_enu_m)):
        return goal_enu_m
    return telemetry.position_enu_m


def _no_position(names: list[str], known: Mapping[str, Xyz]) -> dict[str, str]:
    return {name: f"{name}: it does not report where it is." for name in names if name not in known}


_GOALS_BY_KIND: dict[type[Intent], Callable[[Any, GoalFacts], Goals]] = {
    Goto: _goto,
    Yaw: _yaw,
    Home: _home,
    BringHome: _bring_home,
    Move: _move,
    Formation: _formation,
    Rotate: _rotate,
}
