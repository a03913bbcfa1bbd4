"""What an operator asks for -> one checked order per vehicle, or a reason in words. Pure.

Grammar (``WHO`` is ``all``, names or places: ``mav0,mav2``, ``0-1``; left out it means all)::

    arm [WHO]   disarm [WHO]   hold [WHO]   land [WHO]   kill WHO   locate WHO
    takeoff [WHO] [HEIGHT]                 takeoff all 1.0
    move WHO X Y Z [in SECONDS]            move all 2 0 1.2
    formation NAME [WHO] [SPACING] [X Y Z] [in SECONDS]

``move`` for one vehicle names its own goal. For several it names the formation's position: each one's slot is added,
so that they never get one goal together. The formation is the last one ordered, at first the first of the fleet file.
SPACING stretches the formation until its two nearest slots are so far apart; ``move`` keeps it.
"""

from __future__ import annotations

import itertools
import math
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from groundstation.fleet.state import FleetState
from onboard.bus.schema import Order, OrderKind, Vec3
from onboard.config.fleet import ConfigError, FleetConfig, parking_distance_m

Verb = Literal["arm", "disarm", "takeoff", "move", "formation", "land", "hold", "kill", "locate"]
VERBS: tuple[Verb, ...] = get_args(Verb)
DEFAULT_HEIGHT_M = 1.0
ORDER_LIFE_S = 2.0
USAGE: dict[Verb, str] = {
    "arm": "arm [WHO]",
    "disarm": "disarm [WHO]",
    "takeoff": "takeoff [WHO] [HEIGHT], for instance: takeoff all 1.0",
    "move": "move WHO X Y Z [in SECONDS], for instance: move all 2 0 1.2",
    "formation": "formation NAME [WHO] [SPACING] [X Y Z] [in SECONDS], for instance: formation triangle 1.6 0 1.2 1.0",
    "land": "land [WHO]",
    "hold": "hold [WHO]",
    "kill": "kill WHO, for instance: kill mav1",
    "locate": "locate WHO, for instance: locate mav1",
}


class OrderError(ValueError):
    """An order that makes no sense as it stands: a sentence; nothing is sent."""


@dataclass(frozen=True, slots=True)
class Intent:
    """What the operator wants: a verb, for whom, and its numbers (metres in fleet ENU, seconds)."""

    verb: Verb
    vehicles: tuple[str, ...]
    height_m: float | None = None
    position_enu_m: Vec3 | None = None
    formation: str | None = None
    duration_s: float = 0.0
    spacing_m: float | None = None

    def __str__(self) -> str:
        numbers = () if self.position_enu_m is None else tuple(f"{value:g}" for value in self.position_enu_m)
        height = tuple(f"{value:g}" for value in (self.height_m, self.spacing_m) if value is not None)
        name = (self.formation,) if self.formation else ()
        ending = (f"in {self.duration_s:g} s",) if self.duration_s else ()
        return " ".join((self.verb, *name, ",".join(self.vehicles), *height, *numbers, *ending))


@dataclass(frozen=True, slots=True)
class Plan:
    """The checked result: orders to send, refusals with their reason, and formation and spacing that hold from now."""

    intent: Intent
    orders: Mapping[str, Order] = field(default_factory=dict)
    refusals: Mapping[str, str] = field(default_factory=dict)
    formation: str | None = None
    spacing_m: float | None = None


def parse(text: str, fleet: FleetConfig) -> Intent:
    """The intent of one line.

    Raises:
        OrderError: anything that is not exactly one well-formed order; nothing is guessed.
    """
    if any(ord(char) < 32 and char != "\t" for char in text.strip()):
        raise OrderError("One line is one order: remove the line break or control character.")
    words = text.split()
    if not words:
        raise OrderError(f"Nothing was ordered. Orders are: {', '.join(VERBS)}.")
    if words[0].lower() == "identify":
        raise OrderError(f"The order 'identify' is now called 'locate': say: {' '.join(['locate', *words[1:]])}")
    verb = next((known for known in VERBS if known == words[0].lower()), None)
    if verb is None:
        raise OrderError(f"'{words[0][:40]}' is no order. Orders are: {', '.join(VERBS)}.")
    rest, duration_s = _take_duration(words[1:], verb)
    formation = None
    if verb == "formation":
        if not rest:
            raise OrderError(f"Which formation? Write: {USAGE[verb]}")
        formation, rest = rest[0], rest[1:]
        if formation not in fleet.formations:
            raise OrderError(f"'{formation[:40]}' is no formation of this fleet: it has {_listed(fleet.formations)}.")
    counts = {"takeoff": (0, 1), "move": (3,), "formation": (0, 1, 3, 4)}.get(verb, (0,))
    names, numbers = _take_vehicles(rest, verb, counts, fleet)
    if verb == "kill" and not names:
        raise OrderError("Kill stops the motors in the air, so it names its vehicles: write kill mav1, or kill all.")
    if verb in ("move", "locate") and not names:
        raise OrderError(f"{verb.capitalize()} whom? Write: {USAGE[verb]}")
    if not names:
        names = fleet.enabled_names
    if not names:
        raise OrderError(f"Fleet '{fleet.fleet.name}' has nobody to order: no vehicle is enabled in its file.")
    if verb == "formation" and len(names) == len(fleet.enabled_names):
        names = tuple(name for name in names if name in fleet.formations[formation or ""])
    if verb == "takeoff":
        return Intent(verb, names, height_m=numbers[0] if numbers else DEFAULT_HEIGHT_M)
    spacing_m = numbers.pop(0) if len(numbers) in (1, 4) else None
    position = (numbers[0], numbers[1], numbers[2]) if len(numbers) == 3 else None
    return Intent(verb, names, position_enu_m=position, formation=formation, duration_s=duration_s, spacing_m=spacing_m)


def default_formation(fleet: FleetConfig) -> str | None:
    """The formation that holds before one was ordered."""
    return next(iter(fleet.formations), None)


def random_id() -> str:
    """A name for an order that no other order has."""
    return uuid.uuid4().hex[:12]


def plan(
    intent: Intent,
    fleet: FleetConfig,
    state: FleetState | None,
    *,
    formation: str | None,
    author: str,
    now_ns: int,
    spacing_m: float | None = None,
    node: str = "",
    new_id: Callable[[], str] = random_id,
) -> Plan:
    """Check an intent against the fleet and make its orders; ``formation`` and ``spacing_m`` are what holds now.

    If one goal of a joint move is refused, none of that move is sent: half a formation is nobody's wish.
    """
    held = intent.formation or formation
    held_spacing_m = intent.spacing_m if intent.formation else spacing_m
    goals: dict[str, Vec3] = {}
    refusals = {name: _unknown(name, fleet) for name in intent.vehicles if name not in fleet.enabled_names}
    names = [name for name in intent.vehicles if name not in refusals]
    refusals.update({name: reason for name in names if (reason := _bad_number(intent))})
    if not refusals and intent.verb in ("move", "formation"):
        goals, refusals = _goals(intent, fleet, state, held, names, held_spacing_m)
        if not refusals:
            refusals = _goal_refusals(goals, fleet, state, now_ns)
    if not refusals and intent.verb == "takeoff":
        refusals = _height_refusals(names, intent.height_m or 0.0, fleet)
    if refusals and intent.verb in ("move", "formation", "takeoff"):
        cause = ", ".join(refusals)
        refusals.update(
            {name: f"{name}: not sent, because {cause} was refused." for name in names if name not in refusals}
        )
    kind: OrderKind = "move" if intent.verb == "formation" else intent.verb
    orders = {
        name: Order(
            order_id=new_id(),
            author=author,
            kind=kind,
            stamp_ns=now_ns,
            deadline_ns=now_ns + int(ORDER_LIFE_S * 1e9),
            position_enu_m=goals.get(name),
            height_m=intent.height_m if kind == "takeoff" else None,
            duration_s=intent.duration_s,
            node=node,
        )
        for name in names
        if name not in refusals
    }
    if orders and intent.verb == "formation":
        formation, spacing_m = held, held_spacing_m
    return Plan(intent, orders, refusals, formation, spacing_m)


def slots_of(fleet: FleetConfig, formation: str, spacing_m: float | None = None) -> dict[str, Vec3]:
    """The offsets of a formation, stretched until its two nearest slots are ``spacing_m`` apart in the plane."""
    slots = fleet.formations[formation]
    nearest_m = min((math.dist(p[:2], q[:2]) for p, q in itertools.combinations(slots.values(), 2)), default=0.0)
    scale = 1.0 if spacing_m is None or nearest_m <= 0.0 else spacing_m / nearest_m
    return {name: (scale * x, scale * y, z) for name, (x, y, z) in slots.items()}


def formation_position(slots: Mapping[str, Vec3], state: FleetState, names: Sequence[str]) -> Vec3 | None:
    """Where a formation is, as the mean over its vehicles of position minus slot; None if nobody is known."""
    spots = []
    for name in names:
        view = state.vehicles.get(name)
        if view is None or view.telemetry is None or name not in slots or not view.telemetry.is_position_valid:
            continue
        here = view.telemetry.position_enu_m
        spots.append(tuple(value - offset for value, offset in zip(here, slots[name], strict=True)))
    if not spots:
        return None
    x, y, z = (sum(axis) / len(spots) for axis in zip(*spots, strict=True))
    return (x, y, z)


def _take_duration(words: list[str], verb: Verb) -> tuple[list[str], float]:
    if "in" not in words:
        return words, 0.0
    at = words.index("in")
    tail = words[at + 1 :]
    if verb not in ("move", "formation") or not tail or len(tail) > 2 or tail[1:] not in ([], ["s"]):
        raise OrderError(f"'in' is followed by a number of seconds, at the end. Write: {USAGE[verb]}")
    seconds = _number(tail[0])
    if seconds is None or not 0.0 < seconds <= 600.0:
        raise OrderError(f"'{tail[0][:40]}' is no duration between 0 and 600 s.")
    return words[:at], seconds


def _take_vehicles(
    words: list[str], verb: Verb, counts: tuple[int, ...], fleet: FleetConfig
) -> tuple[tuple[str, ...], list[float]]:
    """Split ``[WHO] numbers``: at most one word more than there are numbers, and that word is WHO."""
    for count in sorted(counts, reverse=True):
        who, numbers = words[: len(words) - count], words[len(words) - count :] if count else []
        if len(words) < count or len(who) > 1:
            continue
        values = [_number(word) for word in numbers]
        if count in (1, 4) and not who and "." not in numbers[0] and _is_selection(numbers[0], fleet):
            continue  # `takeoff 1` selects the vehicle at place 1; a height or a spacing is written 1.0
        if any(value is None for value in values):
            continue
        if any(not math.isfinite(value) for value in values if value is not None):
            raise OrderError("A coordinate is not a finite number. Give metres in the fleet's frame.")
        try:
            names = fleet.select(who[0]) if who else ()
        except ConfigError as error:
            raise OrderError(str(error)) from None
        return names, [value for value in values if value is not None]
    raise OrderError(f"That is not understood. Write: {USAGE[verb]}")


def _is_selection(word: str, fleet: FleetConfig) -> bool:
    try:
        return bool(fleet.select(word))
    except ConfigError:
        return False


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _listed(names: Mapping[str, object]) -> str:
    return ", ".join(names) or "none"


def _unknown(name: str, fleet: FleetConfig) -> str:
    if name in fleet.vehicles:
        return f"{name} is not enabled in the fleet file. Set enabled = true to fly it."
    return f"{name[:40]} is not a vehicle of fleet '{fleet.fleet.name}': it has {', '.join(fleet.enabled_names)}."


def _bad_number(intent: Intent) -> str | None:
    values = [*(intent.position_enu_m or ()), intent.duration_s, intent.height_m or 0.0, intent.spacing_m or 0.0]
    if not all(math.isfinite(value) for value in values):
        return "A number of this order is not finite. Give metres in the fleet's frame, and seconds."
    if not 0.0 <= intent.duration_s <= 600.0:
        return f"A duration of {intent.duration_s:g} s is outside 0 to 600 s."
    if intent.spacing_m is not None and not 0.0 < intent.spacing_m <= 1000.0:
        return f"A spacing of {intent.spacing_m:g} m is no distance between slots. Give metres, for instance 1.6."
    return None


def _goals(
    intent: Intent,
    fleet: FleetConfig,
    state: FleetState | None,
    held: str | None,
    names: list[str],
    spacing_m: float | None,
) -> tuple[dict[str, Vec3], dict[str, str]]:
    position = intent.position_enu_m
    slots = slots_of(fleet, held, spacing_m) if held is not None else {}
    if intent.verb == "formation" and held is not None and position is None:
        position = formation_position(slots, state, names) if state is not None else None
        if position is None:
            reason = "the formation's position is not known, because no vehicle reports one. Write it: {}"
            return {}, {name: reason.format(USAGE["formation"]) for name in names}
    if position is None:
        return {}, dict.fromkeys(names, "a move needs a position: X Y Z in metres.")
    if intent.verb == "move" and len(names) == 1:
        return {names[0]: position}, {}
    if held is None:
        reason = "this fleet file has no formation, so several vehicles cannot share one order. Move them one by one."
        return {}, dict.fromkeys(names, reason)
    goals, refusals = {}, {}
    for name in names:
        if name in slots:
            offset = slots[name]
            goals[name] = (position[0] + offset[0], position[1] + offset[1], position[2] + offset[2])
        else:
            refusals[name] = f"{name} has no slot in formation '{held}' (slots: {_listed(slots)})."
    return goals, refusals


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
        for other, spot, what in _others(name, goals, state, now_ns):
            distance_m = math.dist(goal[:2], spot[:2])
            if distance_m < parking_m:
                refusals.setdefault(
                    name,
                    f"{name}: its goal is {distance_m:.2f} m from {other}'s {what}; the law '{fleet.law.name}' keeps "
                    f"{parking_m:.2f} m between parked vehicles. Choose a goal further away.",
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
        if other in goals or telemetry is None or not telemetry.is_airborne or not view.is_fresh(now_ns):
            continue
        if telemetry.state in ("flying", "taking off") and all(map(math.isfinite, telemetry.goal_position_enu_m)):
            yield other, telemetry.goal_position_enu_m, "goal"
        elif telemetry.is_position_valid:
            yield other, telemetry.position_enu_m, "position"


def _height_refusals(names: list[str], height_m: float, fleet: FleetConfig) -> dict[str, str]:
    _, top = fleet.fleet.geofence_m.z
    if 0.2 <= height_m <= top:
        return {}
    reason = f"a take-off height of {height_m:g} m is outside 0.2 to {top:g} m, the top of the fence."
    return {name: f"{name}: {reason}" for name in names}
