"""Reads one line of text as an order, or says in words why it is not an order. Pure.

The console, the live page and ``covey order`` call :func:`parse`. The grammar is as follows.
``WHO`` is ``all``, names or indices: ``mav0,mav2``, ``0-1``. Without ``WHO``, all are meant::

    arm [WHO]   disarm [WHO]   hold [WHO]   land [WHO]   kill WHO   locate WHO
    takeoff [WHO] [HEIGHT]                 takeoff all 1.0
    move WHO X Y Z [yaw DEG] [in SECONDS]  move all 2 0 1.2
    goto NAME X Y Z [NAME X Y Z ...] [yaw DEG] [in SECONDS]
    formation NAME [WHO] [SPACING] [X Y Z] [nearest] [turned DEG] [yaw DEG] [in SECONDS]
    rotate [WHO] DEG [in SECONDS]          rotate all 90
    yaw [WHO] DEG                          yaw mav1 -90
    home [WHO] [HEIGHT] [in SECONDS]       home all
    swap WHO SPARE                         swap mav2 mav7

* ``move`` gives one vehicle its goal. For several vehicles it gives the formation's position; each
  vehicle's slot is added. The formation is the one that was ordered last. Before the first such
  order it is the first of the fleet file.
* ``formation``: SPACING is the distance of the two nearest slots, to which the formation is
  stretched. ``turned`` turns it about its position, counterclockwise. ``nearest`` assigns the slots
  so that the longest flight is as short as possible; otherwise each vehicle has its own slot. A
  later ``move`` keeps all this.
* ``rotate`` turns the present formation further.
* ``goto`` gives each vehicle a goal. All goals are checked together, so vehicles may change places.
* ``home`` sends vehicles to the take-off spots of the fleet file, at their present heights or at
  HEIGHT, and lands them there.
* ``yaw`` is the heading, counterclockwise from east.

The class of a verb in `groundstation/orders/intents.py` says how many numbers and which options it
takes.
"""

from __future__ import annotations

import math

from msgspec import structs

from groundstation.formations.slots import formation_names, formation_slots
from groundstation.orders.intents import (
    INTENTS,
    LONGEST_EVERY_S,
    LONGEST_MOVE_S,
    Intent,
    LineWords,
)
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.plain_text import meant_words
from onboard.tuples import Xyz

_OPTION_MEANINGS = {
    "in": f"duration between 0 and {LONGEST_MOVE_S:g} s",
    "yaw": "heading in degrees",
    "turned": "angle in degrees",
    "by": "number of vehicles in a wave, 1 or more",
    "every": f"time between two waves, 0 to {LONGEST_EVERY_S:g} s",
}
_MAX_QUOTED = 40  # characters of a wrong word that a sentence repeats


class OrderError(ConfigError):
    """A line or a call is not a valid order, so nothing is sent; the text is a sentence."""


def parse(text: str, fleet: FleetConfig) -> Intent:
    """Return the intent of one line.

    Args:
        text: the line, in the grammar of this module.
        fleet: the fleet file, for the names of vehicles and formations.

    Returns:
        The intent, with the names of its vehicles.

    Raises:
        OrderError: the line is not exactly one well-formed order. Nothing is guessed.
    """
    if any(ord(char) < 32 and char != "\t" for char in text.strip()):
        raise OrderError("One line is one order: remove the line break or control character.")

    words = text.split()
    if [word.lower() for word in words[:2]] == ["bring", "home"]:
        words = ["bring_home", *words[2:]]
    kind = _verb_of(words)
    words = words[1:]

    # The name of the formation is taken first, because it may be a word such as `nearest`.
    formation = ""
    is_nearest = False
    if kind.verb == "formation":
        formation = _formation_of(words, kind, fleet)
        words = words[1:]
        is_nearest = any(word.lower() == "nearest" for word in words)
        words = [word for word in words if word.lower() != "nearest"]
    options, words = _take_options(words, kind)

    if kind.verb == "goto":
        goals = _take_goals(words, fleet)
        return kind.from_line(LineWords(vehicles=tuple(goals), options=options, goals=goals))

    if kind.verb == "swap":
        return kind(vehicles=_take_swapped(words, fleet))

    names, numbers = _take_vehicles(words, kind, fleet)
    is_everybody = not names or words[0].lower() == "all"
    names = _names_meant(names, kind, fleet)
    if kind.verb == "formation":
        _check_formation(formation, fleet)

    intent = kind.from_line(
        LineWords(
            vehicles=names,
            numbers=numbers,
            options=options,
            formation=formation,
            is_nearest=is_nearest,
        )
    )
    return structs.replace(intent, is_everybody=is_everybody)


def default_formation(fleet: FleetConfig) -> str | None:
    """Return the first formation of the fleet file, which counts before one is ordered."""
    return next(iter(formation_names(fleet)), None)


def _verb_of(words: list[str]) -> type[Intent]:
    """Return the class of the verb that a line begins with."""
    names = [name.replace("_", " ") for name in INTENTS]
    verbs = ", ".join(names)
    if not words:
        raise OrderError(f"Nothing was ordered. Orders are: {verbs}.")

    verb = words[0].lower()
    if verb == "identify":
        line = " ".join(["locate", *words[1:]])
        raise OrderError(f"The order 'identify' is now called 'locate': say: {line}")
    if verb in ("take", "give", "keep") and words[1:2] == ["control"]:
        raise OrderError(
            f"'{verb} control' is no order to vehicles: write it in covey tui or on a page of "
            "covey web."
        )
    if verb not in INTENTS:
        meant = meant_words(verb[:_MAX_QUOTED].replace("_", " "), names)
        first_word = words[0]
        raise OrderError(f"'{first_word[:_MAX_QUOTED]}' is no order.{meant} Orders are: {verbs}.")
    return INTENTS[verb]


def _formation_of(words: list[str], kind: type[Intent], fleet: FleetConfig) -> str:
    """Return the formation that the first of these words names."""
    if not words:
        raise OrderError(f"Which formation? Write: {kind.usage}")

    formation = words[0]
    if formation not in formation_names(fleet):
        known = ", ".join(formation_names(fleet)) or "none"
        raise OrderError(
            f"'{formation[:_MAX_QUOTED]}' is no formation of this fleet: it has {known}."
        )
    return formation


def _names_meant(names: tuple[str, ...], kind: type[Intent], fleet: FleetConfig) -> tuple[str, ...]:
    """Return the vehicles that a line means: those that it names, or all if it names none."""
    if names:
        return names

    if kind.verb == "kill":
        raise OrderError(
            "Kill stops the motors in the air, so it names its vehicles: write kill mav1, or kill "
            "all."
        )
    if kind.must_name_vehicles:
        raise OrderError(f"{kind.verb.capitalize()} whom? Write: {kind.usage}")
    if not fleet.enabled_names:
        raise OrderError(
            f"Fleet '{fleet.fleet.name}' has nobody to order: no vehicle is enabled in its file."
        )
    return fleet.enabled_names


def _take_options(words: list[str], kind: type[Intent]) -> tuple[dict[str, float], list[str]]:
    """Return the numbers after options at the end of a line, and the words before them."""
    begin = len(words)
    for index, word in enumerate(words):
        if word.lower() in _OPTION_MEANINGS:
            begin = index
            break

    options: dict[str, float] = {}
    tail = words[begin:]
    while tail:
        option_word, *behind_option = tail
        option = option_word.lower()
        if option not in kind.options or option in options or not behind_option:
            raise OrderError(
                f"'{option_word[:_MAX_QUOTED]}' is not understood there. Write: {kind.usage}"
            )

        number_word, *tail = behind_option
        value = _number(number_word)
        if value is None or not _may_follow(option, value):
            raise OrderError(f"'{number_word[:_MAX_QUOTED]}' is no {_OPTION_MEANINGS[option]}.")
        options[option] = value

        if option == "in" and tail[:1] == ["s"]:  # the unit, as in `in 5 s`
            tail = tail[1:]

    return options, words[:begin]


def _may_follow(option: str, value: float) -> bool:
    """Return whether a number may follow an option."""
    if option == "in":
        return 0.0 < value <= LONGEST_MOVE_S
    if option == "by":
        return value >= 1.0 and value.is_integer()
    if option == "every":
        return 0.0 <= value <= LONGEST_EVERY_S
    return math.isfinite(value)


def _take_goals(words: list[str], fleet: FleetConfig) -> dict[str, Xyz]:
    """Return the goal of each vehicle of ``NAME X Y Z NAME X Y Z ...``."""
    usage = INTENTS["goto"].usage
    goals: dict[str, Xyz] = {}

    for begin in range(0, len(words), 4):
        name_word = words[begin]
        numbers = [_number(word) for word in words[begin + 1 : begin + 4]]
        values = [value for value in numbers if value is not None and math.isfinite(value)]
        if len(values) != 3:
            raise OrderError(f"A goal has a name and three numbers, in metres. Write: {usage}")

        names = _select(name_word, fleet)
        if len(names) != 1 or names[0] in goals:
            raise OrderError(
                f"'{name_word[:_MAX_QUOTED]}' must be one vehicle, and only once: each has a goal "
                "of its own."
            )
        x, y, z = values
        goals[names[0]] = (x, y, z)

    if not goals:
        raise OrderError(f"Whose goals? Write: {usage}")
    return goals


def _take_vehicles(
    words: list[str], kind: type[Intent], fleet: FleetConfig
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Return the vehicles and the numbers of ``[WHO] numbers``.

    A verb may allow several counts of numbers. The largest count is chosen that fits the line: at
    most one word for the vehicles, and only numbers after it.
    """
    for count in sorted(kind.number_counts, reverse=True):
        if len(words) not in (count, count + 1):
            continue
        selection = words[: len(words) - count]
        number_words = words[len(words) - count :]

        # `takeoff 1` selects the vehicle with index 1; a height or a spacing is written 1.0. With
        # 1 or 4 numbers, the first of them is a height or a spacing.
        may_be_index = kind.first_number_is_vehicle and count in (1, 4) and not selection
        if may_be_index and number_words[0].isdecimal():
            _check_index(number_words[0], fleet)
            continue

        values = [_number(word) for word in number_words]
        numbers = tuple(value for value in values if value is not None)
        if len(numbers) < count:
            continue
        if not all(math.isfinite(number) for number in numbers):
            raise OrderError(
                "A coordinate is not a finite number. Give metres in the fleet's frame."
            )

        names: tuple[str, ...] = ()
        if selection:
            names = _select(selection[0], fleet)
        return names, numbers

    raise OrderError(f"That is not understood. Write: {kind.usage}")


def _take_swapped(words: list[str], fleet: FleetConfig) -> tuple[str, ...]:
    """Return the vehicle that is swapped, and its spare."""
    names: tuple[str, ...] = ()
    if words:
        names = _select(",".join(words), fleet)
    if len(words) != 2 or len(names) != 2:
        raise OrderError(f"A swap is of two vehicles. Write: {INTENTS['swap'].usage}")
    return names


def _select(word: str, fleet: FleetConfig) -> tuple[str, ...]:
    """Return the vehicles that a word selects."""
    if word.lower() == "all":
        word = "all"
    try:
        return fleet.select(word)
    except ConfigError as error:
        raise OrderError(str(error)) from None


def _check_index(word: str, fleet: FleetConfig) -> None:
    """Refuse a number without a point that is not the index of any vehicle."""
    try:
        fleet.select(word)
    except ConfigError:
        raise OrderError(
            f"'{word[:_MAX_QUOTED]}' is no vehicle: they are counted from 0 to "
            f"{len(fleet.vehicles) - 1}. Metres are written with a point, for instance 1.5."
        ) from None


def _check_formation(formation: str, fleet: FleetConfig) -> None:
    """Refuse a formation that cannot be made, for instance from a missing picture."""
    try:
        formation_slots(fleet, formation)
    except ConfigError as error:
        raise OrderError(str(error)) from None


def _number(word: str) -> float | None:
    """Return the number that a word represents; None for any other word.

    Python would read 1_0 as 10, which may have been meant as 1.0.
    """
    if "_" in word:
        return None
    try:
        return float(word)
    except ValueError:
        return None
