"""One line of text -> the intent of an order, or a reason in words why it is none. Pure.

Grammar (``WHO`` is ``all``, names or indices: ``mav0,mav2``, ``0-1``; left out it means all)::

    arm [WHO]   disarm [WHO]   hold [WHO]   land [WHO]   kill WHO   locate WHO
    takeoff [WHO] [HEIGHT]                 takeoff all 1.0
    move WHO X Y Z [yaw DEG] [in SECONDS]  move all 2 0 1.2
    goto NAME X Y Z [NAME X Y Z ...] [yaw DEG] [in SECONDS]
    formation NAME [WHO] [SPACING] [X Y Z] [nearest] [turned DEG] [yaw DEG] [in SECONDS]
    rotate [WHO] DEG [in SECONDS]          rotate all 90
    yaw [WHO] DEG                          yaw mav1 -90
    home [WHO] [HEIGHT] [in SECONDS]       home all

``move`` for one vehicle names its own goal. For several it names the formation's position: each
one's slot is added, so that they never get one goal together. The formation is the last one
ordered, at first the first of the fleet file. SPACING stretches the formation until its two nearest
slots are so far apart; ``turned`` turns it about its position, counterclockwise; ``rotate`` turns
it further. ``nearest`` deals its slots out anew, such that the longest flight is as short as it can
be; else each vehicle has its own slot. ``move`` keeps all that. ``goto`` names a goal for each
vehicle, and all of them are judged together: vehicles may change places. ``home`` leads over the
take-off spots of the fleet file, at the present heights or at HEIGHT, and lands there. ``yaw`` is
the heading, counterclockwise from east.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from groundstation.formations.slots import formation_names, formation_slots
from onboard.bus.schema import Vec3
from onboard.config.fleet import ConfigError, FleetConfig

Verb = Literal[
    "arm",
    "disarm",
    "takeoff",
    "move",
    "goto",
    "formation",
    "rotate",
    "yaw",
    "home",
    "land",
    "hold",
    "kill",
    "locate",
]
PathVerb = Literal["load_path", "follow_path"]  # of programs and missions; nobody types a path
VERBS: tuple[Verb, ...] = get_args(Verb)
DEFAULT_HEIGHT_M = 1.0
USAGE: dict[Verb, str] = {
    "arm": "arm [WHO]",
    "disarm": "disarm [WHO]",
    "takeoff": "takeoff [WHO] [HEIGHT], for instance: takeoff all 1.0",
    "move": "move WHO X Y Z [yaw DEG] [in SECONDS], for instance: move all 2 0 1.2",
    "goto": "goto NAME X Y Z [NAME X Y Z ...] [yaw DEG] [in SECONDS], for instance: goto mav0 2 0 1 mav1 0 2 1",
    "formation": "formation NAME [WHO] [SPACING] [X Y Z] [nearest] [turned DEG] [yaw DEG] [in SECONDS], for instance: "
    "formation triangle 1.6 0 1.2 1.0",
    "rotate": "rotate [WHO] DEG [in SECONDS], for instance: rotate all 90",
    "yaw": "yaw [WHO] DEG, for instance: yaw mav1 -90",
    "home": "home [WHO] [HEIGHT] [in SECONDS], for instance: home all",
    "land": "land [WHO]",
    "hold": "hold [WHO]",
    "kill": "kill WHO, for instance: kill mav1",
    "locate": "locate WHO, for instance: locate mav1",
}


_COUNTS: dict[Verb, tuple[int, ...]] = {  # of numbers
    "takeoff": (0, 1), "move": (3,), "formation": (0, 1, 3, 4), "rotate": (1,), "yaw": (1,), "home": (0, 1)
}  # fmt: skip
_KEYWORDS = {
    "in": "duration between 0 and 600 s",
    "yaw": "heading in degrees",
    "turned": "angle in degrees",
}


class OrderError(ConfigError):
    """An order that makes no sense as it stands: a sentence; nothing is sent."""


@dataclass(frozen=True, slots=True)
class Intent:
    """One order of an operator, before it is checked. Positions are in fleet ENU."""

    verb: Verb | PathVerb
    vehicles: tuple[str, ...]
    height_m: float | None = None  # of a take-off, or of the way home
    position_enu_m: Vec3 | None = None  # goal of one vehicle, or the formation's position
    formation: str | None = None  # name in the fleet file
    duration_s: float = 0.0  # of the move; 0 leaves it to the vehicle's limits
    # distance of the formation's two nearest slots; None: as in the fleet file
    spacing_m: float | None = None
    goals: Mapping[str, Vec3] | None = None  # of goto: a goal for each vehicle
    yaw_deg: float | None = None  # heading to turn to, counterclockwise from east; None: as it is
    # of the formation against the fleet file; of rotate: further than it is
    rotation_deg: float | None = None
    is_nearest: bool = False  # the formation's slots are dealt out anew, by the vehicles' positions
    # for each vehicle the one whose slot it takes; None: its own
    takes: Mapping[str, str] | None = None

    def __str__(self) -> str:
        values = (self.height_m, self.spacing_m, *(self.position_enu_m or ()))
        numbers = [f"{value:g}" for value in values if value is not None]
        words = [self.verb, *([self.formation] if self.formation else [])]
        if self.goals is not None:
            words += [
                f"{name} {' '.join(f'{value:g}' for value in goal)}"
                for name, goal in self.goals.items()
            ]
        else:
            words += [",".join(self.vehicles), *numbers]
        words += ["nearest"] if self.is_nearest else []
        turn, yaw = self.rotation_deg, self.yaw_deg
        words += (
            [] if turn is None else [f"{turn:g}"] if self.verb == "rotate" else [f"turned {turn:g}"]
        )
        words += [] if yaw is None else [f"{yaw:g}"] if self.verb == "yaw" else [f"yaw {yaw:g}"]
        return " ".join((*words, *([f"in {self.duration_s:g} s"] if self.duration_s else [])))


def parse(text: str, fleet: FleetConfig) -> Intent:
    """Parse one line.

    Args:
        text: the line, as the module's grammar says.
        fleet: the fleet file, for the names of vehicles and formations.

    Returns:
        The intent of the line.

    Raises:
        OrderError: the line is not exactly one well-formed order. Nothing is guessed.
    """
    if any(ord(char) < 32 and char != "\t" for char in text.strip()):
        raise OrderError("One line is one order: remove the line break or control character.")
    words = text.split()
    if not words:
        raise OrderError(f"Nothing was ordered. Orders are: {', '.join(VERBS)}.")
    if words[0].lower() == "identify":
        raise OrderError(
            f"The order 'identify' is now called 'locate': say: {' '.join(['locate', *words[1:]])}"
        )
    verb = next((known for known in VERBS if known == words[0].lower()), None)
    if verb is None:
        raise OrderError(f"'{words[0][:40]}' is no order. Orders are: {', '.join(VERBS)}.")
    is_nearest = verb == "formation" and "nearest" in words[2:]
    options, rest = _take_options(
        [word for word in words[1:] if not (is_nearest and word == "nearest")], verb
    )
    if verb == "goto":
        goals = _take_goals(rest, fleet)
        return Intent(
            verb,
            tuple(goals),
            goals=goals,
            yaw_deg=options.get("yaw"),
            duration_s=options.get("in", 0.0),
        )
    formation = None
    if verb == "formation":
        if not rest:
            raise OrderError(f"Which formation? Write: {USAGE[verb]}")
        formation, rest = rest[0], rest[1:]
        if formation not in formation_names(fleet):
            known = ", ".join(formation_names(fleet)) or "none"
            raise OrderError(f"'{formation[:40]}' is no formation of this fleet: it has {known}.")
    names, numbers = _take_vehicles(rest, verb, _COUNTS.get(verb, (0,)), fleet)
    if verb == "kill" and not names:
        raise OrderError(
            "Kill stops the motors in the air, so it names its vehicles: write kill mav1, or kill all."
        )
    if verb in ("move", "locate") and not names:
        raise OrderError(f"{verb.capitalize()} whom? Write: {USAGE[verb]}")
    if not names:
        names = fleet.enabled_names
    if not names:
        raise OrderError(
            f"Fleet '{fleet.fleet.name}' has nobody to order: no vehicle is enabled in its file."
        )
    if verb == "formation" and len(names) == len(fleet.enabled_names):
        names = _with_slots(names, fleet, formation or "")
    return _with_numbers(
        Intent(verb, names, formation=formation, is_nearest=is_nearest), numbers, options
    )


def _with_numbers(intent: Intent, numbers: list[float], options: Mapping[str, float]) -> Intent:
    """Return an order with its numbers, whose meaning depends on the verb, and with what followed
    keywords.
    """
    first = numbers[0] if numbers else None
    if intent.verb == "takeoff":
        return replace(intent, height_m=DEFAULT_HEIGHT_M if first is None else first)
    duration_s = options.get("in", 0.0)
    if intent.verb == "home":
        return replace(intent, height_m=first, duration_s=duration_s)
    if intent.verb == "rotate":
        return replace(intent, rotation_deg=first, duration_s=duration_s)
    if intent.verb == "yaw":
        return replace(intent, yaw_deg=first)
    return replace(
        intent,
        spacing_m=numbers.pop(0) if len(numbers) in (1, 4) else None,
        position_enu_m=(numbers[0], numbers[1], numbers[2]) if len(numbers) == 3 else None,
        duration_s=duration_s,
        yaw_deg=options.get("yaw"),
        rotation_deg=options.get("turned"),
    )


def default_formation(fleet: FleetConfig) -> str | None:
    """Return the formation that holds before one was ordered: the first of the fleet file."""
    return next(iter(formation_names(fleet)), None)


def _take_options(words: list[str], verb: Verb) -> tuple[dict[str, float], list[str]]:
    """Return the numbers that follow keywords at the end of a line, and the words before them."""
    options: dict[str, float] = {}
    known = [keyword for keyword in _KEYWORDS if f"[{keyword} " in USAGE[verb]]
    at = min(
        (words.index(keyword) for keyword in _KEYWORDS if keyword in words), default=len(words)
    )
    rest, tail = words[:at], words[at:]
    while tail:
        keyword, meaning = tail[0], _KEYWORDS.get(tail[0])
        if keyword not in known or keyword in options or meaning is None or len(tail) < 2:
            raise OrderError(f"'{keyword[:40]}' is not understood there. Write: {USAGE[verb]}")
        value = _number(tail[1])
        if (
            value is None
            or not math.isfinite(value)
            or (keyword == "in" and not 0.0 < value <= 600.0)
        ):
            raise OrderError(f"'{tail[1][:40]}' is no {meaning}.")
        options[keyword] = value
        tail = tail[3:] if keyword == "in" and tail[2:3] == ["s"] else tail[2:]
    return options, rest


def _take_goals(words: list[str], fleet: FleetConfig) -> dict[str, Vec3]:
    """Return the goal of each vehicle of ``NAME X Y Z NAME X Y Z ...``."""
    goals: dict[str, Vec3] = {}
    for k in range(0, len(words), 4):
        numbers = [_number(word) for word in words[k + 1 : k + 4]]
        values = [value for value in numbers if value is not None and math.isfinite(value)]
        if len(values) != 3:
            raise OrderError(
                f"A goal has a name and three numbers, in metres. Write: {USAGE['goto']}"
            )
        try:
            names = fleet.select(words[k])
        except ConfigError as error:
            raise OrderError(str(error)) from None
        if len(names) != 1 or names[0] in goals:
            raise OrderError(
                f"'{words[k][:40]}' must be one vehicle, and only once: each has a goal of its own."
            )
        goals[names[0]] = (values[0], values[1], values[2])
    if not goals:
        raise OrderError(f"Whose goals? Write: {USAGE['goto']}")
    return goals


def _take_vehicles(
    words: list[str], verb: Verb, counts: tuple[int, ...], fleet: FleetConfig
) -> tuple[tuple[str, ...], list[float]]:
    """Split ``[WHO] numbers``: at most one word more than there are numbers, and that word selects
    the vehicles.
    """
    for count in sorted(counts, reverse=True):
        selection, numbers = (
            words[: len(words) - count],
            words[len(words) - count :] if count else [],
        )
        if len(words) < count or len(selection) > 1:
            continue
        values = [_number(word) for word in numbers]
        may_select = (
            count in (1, 4)
            and not selection
            and verb not in ("rotate", "yaw")
            and "." not in numbers[0]
        )
        if may_select and _is_selection(numbers[0], fleet):
            # `takeoff 1` selects the vehicle with index 1; a height or a spacing is written 1.0
            continue
        if any(value is None for value in values):
            continue
        if any(not math.isfinite(value) for value in values if value is not None):
            raise OrderError(
                "A coordinate is not a finite number. Give metres in the fleet's frame."
            )
        try:
            names = fleet.select(selection[0]) if selection else ()
        except ConfigError as error:
            raise OrderError(str(error)) from None
        return names, [value for value in values if value is not None]
    raise OrderError(f"That is not understood. Write: {USAGE[verb]}")


def _is_selection(word: str, fleet: FleetConfig) -> bool:
    try:
        return bool(fleet.select(word))
    except ConfigError:
        return False


def _with_slots(names: tuple[str, ...], fleet: FleetConfig, formation: str) -> tuple[str, ...]:
    try:
        slots = formation_slots(fleet, formation)
    except ConfigError as error:
        raise OrderError(str(error)) from None
    return tuple(name for name in names if name in slots)


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
