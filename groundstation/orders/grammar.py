"""One line of text -> the intent of an order, or a reason in words why it is none. Pure.

Grammar (``WHO`` is ``all``, names or indices: ``mav0,mav2``, ``0-1``; left out it means all)::

    arm [WHO]   disarm [WHO]   hold [WHO]   land [WHO]   kill WHO   locate WHO
    takeoff [WHO] [HEIGHT]                 takeoff all 1.0
    move WHO X Y Z [in SECONDS]            move all 2 0 1.2
    formation NAME [WHO] [SPACING] [X Y Z] [in SECONDS]

``move`` for one vehicle names its own goal. For several it names the formation's position: each one's slot is added,
so that they never get one goal together. The formation is the last one ordered, at first the first of the fleet file.
SPACING stretches the formation until its two nearest slots are so far apart; ``move`` keeps it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from onboard.bus.schema import Vec3
from onboard.config.fleet import ConfigError, FleetConfig

Verb = Literal["arm", "disarm", "takeoff", "move", "formation", "land", "hold", "kill", "locate"]
PathVerb = Literal["load_path", "follow_path"]  # of programs and missions; nobody types a path
VERBS: tuple[Verb, ...] = get_args(Verb)
DEFAULT_HEIGHT_M = 1.0
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


class OrderError(ConfigError):
    """An order that makes no sense as it stands: a sentence; nothing is sent."""


@dataclass(frozen=True, slots=True)
class Intent:
    """One order of an operator, before it is checked. Positions are in fleet ENU."""

    verb: Verb | PathVerb
    vehicles: tuple[str, ...]
    height_m: float | None = None  # of a take-off
    position_enu_m: Vec3 | None = None  # goal of one vehicle, or the formation's position
    formation: str | None = None  # name in the fleet file
    duration_s: float = 0.0  # of the move; 0 leaves it to the vehicle's limits
    spacing_m: float | None = None  # distance of the formation's two nearest slots; None: as in the fleet file
    goals: Mapping[str, Vec3] | None = None  # of a move with a goal for each vehicle, instead of a position

    def __str__(self) -> str:
        numbers = () if self.position_enu_m is None else tuple(f"{value:g}" for value in self.position_enu_m)
        height = tuple(f"{value:g}" for value in (self.height_m, self.spacing_m) if value is not None)
        name = (self.formation,) if self.formation else ()
        ending = (f"in {self.duration_s:g} s",) if self.duration_s else ()
        return " ".join((self.verb, *name, ",".join(self.vehicles), *height, *numbers, *ending))


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
    """Return the formation that holds before one was ordered: the first of the fleet file."""
    return next(iter(fleet.formations), None)


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
    """Split ``[WHO] numbers``: at most one word more than there are numbers, and that word selects the vehicles."""
    for count in sorted(counts, reverse=True):
        selection, numbers = words[: len(words) - count], words[len(words) - count :] if count else []
        if len(words) < count or len(selection) > 1:
            continue
        values = [_number(word) for word in numbers]
        if count in (1, 4) and not selection and "." not in numbers[0] and _is_selection(numbers[0], fleet):
            continue  # `takeoff 1` selects the vehicle with index 1; a height or a spacing is written 1.0
        if any(value is None for value in values):
            continue
        if any(not math.isfinite(value) for value in values if value is not None):
            raise OrderError("A coordinate is not a finite number. Give metres in the fleet's frame.")
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


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _listed(names: Mapping[str, object]) -> str:
    return ", ".join(names) or "none"
