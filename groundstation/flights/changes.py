"""Changes of a recorded lockstep flight, with which it is flown again to see what differs.

A change is written KEY=VALUE. It takes effect at the start of the flight, or at a second of it. In
the second case the flight is the recorded one until then, and only some changes are possible.

* ``law.kappa_1_1_s=5``: changes a value of the fleet file; in flight only a number of ``[law]``
* ``law=off``: changes the law; not in flight
* ``seed=4``: changes the seed of all random numbers; not in flight
* ``wind=3,0`` and ``gust=0.5``: change the mean wind towards east and north, and its gusts
* ``bus.delay_s=0.1``: changes a quality of the simulated bus
* ``fault=mav1 motor_dead motor=2``: adds a fault, which begins at that second
* ``order=hold all``: adds an order of another ground at that second
* ``without_fault=1``, ``without_order=1``: remove a fault or an order, counted from 1
* ``without_step=3``: removes a step of a mission file, counted from 1; not in flight
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from msgspec.structs import replace

from groundstation.flights.simulation_settings import (
    SimulationSettings,
    refuse_wrong_settings,
    timed_order,
    wind_of,
)
from groundstation.processes.free_ports import toml_text
from groundstation.starter.fleet_edit import edited
from onboard.config.file_reading import toml_values
from onboard.config.fleet import KNOWN_KEYS, ConfigError
from onboard.plain_text import meant_words

_BUS = "bus."
_LAW = "law."
_WITHOUT_FAULT = "without_fault"
_WITHOUT_ORDER = "without_order"
_WITHOUT_STEP = "without_step"
# keys that may change in flight, in addition to all keys of the bus and the law
_MAY_CHANGE_IN_FLIGHT = ("wind", "gust", "fault", "order", _WITHOUT_FAULT, _WITHOUT_ORDER)
# keys that are not in the fleet file, in addition to all keys of the bus
_NOT_OF_FLEET_FILE = (*_MAY_CHANGE_IN_FLIGHT, "seed", _WITHOUT_STEP)


class Change(NamedTuple):
    """One change of a flight."""

    key: str
    value: str

    @property
    def text(self) -> str:
        """The change in its written form, KEY=VALUE."""
        return f"{self.key}={self.value}"

    @property
    def is_of_fleet_file(self) -> bool:
        """Whether it changes a value of the fleet file."""
        return self.key not in _NOT_OF_FLEET_FILE and not self.key.startswith(_BUS)


class FlightOrigin(NamedTuple):
    """The files and settings from which a flight is flown."""

    fleet_text: str  # TOML
    mission_text: str  # TOML or Python
    settings: SimulationSettings


def parse_change(text: str) -> Change:
    """Return the change of a text KEY=VALUE.

    Raises:
        ConfigError: the text has another form, or there is no such change.
    """
    key, sign, value = text.partition("=")
    key = key.strip()
    if not sign or not key or not value.strip():
        raise ConfigError(
            f"--what-if is '{text}'; write KEY=VALUE, for instance law.kappa_1_1_s=5, wind=3,0,"
            " bus.delay_s=0.1, 'fault=mav1 motor_dead motor=2' or 'order=hold all'."
        )
    change = Change(key=key, value=value.strip())
    if change.is_of_fleet_file and key.partition(".")[0] not in KNOWN_KEYS:
        meant = meant_words(key, (*_NOT_OF_FLEET_FILE, *KNOWN_KEYS))
        raise ConfigError(
            f"--what-if {change.text}: there is no such change.{meant} Give"
            f" {', '.join(_NOT_OF_FLEET_FILE)}, {_BUS}KEY, law, or a key of the fleet file."
        )
    return change


def changed(origin: FlightOrigin, changes: Sequence[Change], at_s: float | None) -> FlightOrigin:
    """Return the files and settings of a changed flight.

    Args:
        origin: files and settings of the recorded flight.
        changes: the changes.
        at_s: second at which they take effect; None: at the start.

    Raises:
        ConfigError: a change is impossible, or not possible in flight.
    """
    for change in changes:
        if at_s is None:
            origin = _changed_from_start(origin, change)
        else:
            settings = _changed_in_flight(origin.settings, change, at_s)
            origin = origin._replace(settings=settings)
    refuse_wrong_settings(origin.settings)
    return origin


def _changed_from_start(origin: FlightOrigin, change: Change) -> FlightOrigin:
    if change.is_of_fleet_file:
        return origin._replace(fleet_text=edited_fleet(origin.fleet_text, change))
    if change.key == _WITHOUT_STEP:
        return origin._replace(mission_text=_without_step(origin, change))
    return origin._replace(settings=_changed_settings(origin.settings, change))


def _changed_settings(settings: SimulationSettings, change: Change) -> SimulationSettings:
    """Return settings with a change that takes effect at the start."""
    if change.key == "wind":
        return replace(settings, wind_enu_m_s=_wind(change))
    if change.key == "gust":
        return replace(settings, gust_m_s=_number(change))
    if change.key == "seed":
        return replace(settings, seed=_whole_number(change))
    if change.key.startswith(_BUS):
        name = change.key.removeprefix(_BUS)
        return replace(settings, bus={**settings.bus, name: _number(change)})
    return _with_changed_plan(settings, change, 0.0)


def _changed_in_flight(
    settings: SimulationSettings, change: Change, at_s: float
) -> SimulationSettings:
    """Return settings with a change that takes effect at a second of the flight."""
    is_of_law = change.key.startswith(_LAW) and change.key != "law.name"
    is_of_bus = change.key.startswith(_BUS)
    may_change = change.key in _MAY_CHANGE_IN_FLIGHT or is_of_bus or is_of_law
    if not may_change:
        raise ConfigError(
            f"--what-if {change.text}: this cannot change in flight. Leave --resume-at out, and it"
            " counts from the start."
        )
    if change.key in ("fault", "order", _WITHOUT_FAULT, _WITHOUT_ORDER):
        return _with_changed_plan(settings, change, at_s)

    # The value is only checked here; a wrong one raises ConfigError.
    if change.key == "wind":
        _wind(change)
    elif change.key == "gust":
        refuse_wrong_settings(replace(settings, gust_m_s=_number(change)))
    else:
        _number(change)
    return replace(settings, changes=(*settings.changes, f"{at_s:g} {change.text}"))


def _with_changed_plan(
    settings: SimulationSettings, change: Change, at_s: float
) -> SimulationSettings:
    """Return settings in which a fault or an order is added or removed."""
    if change.key == "fault":
        line = change.value
        if " at=" not in line:
            line = f"{line} at={at_s:g}"
        return replace(settings, faults=(*settings.faults, line))

    if change.key == "order":
        return replace(settings, orders=(*settings.orders, f"{at_s:g} {change.value}"))

    if change.key == _WITHOUT_FAULT:
        faults = _without(settings.faults, change, "faults")
        return replace(settings, faults=faults)

    orders = _without(settings.orders, change, "orders")
    return replace(settings, orders=orders)


def _without(lines: tuple[str, ...], change: Change, noun: str) -> tuple[str, ...]:
    """Return lines without the one whose number, counted from 1, is the value of the change."""
    number = _whole_number(change)
    if not 1 <= number <= len(lines):
        raise ConfigError(
            f"--what-if {change.text}: this flight has {len(lines)} {noun}, counted from 1."
        )
    remaining = list(lines)
    del remaining[number - 1]
    return tuple(remaining)


def _without_step(origin: FlightOrigin, change: Change) -> str:
    """Return the text of a mission file without the step whose number is the change's value."""
    if origin.settings.mission_path.endswith(".py"):
        raise ConfigError(f"--what-if {change.text}: a Python mission has no steps of a file.")

    values = toml_values(origin.mission_text, origin.settings.mission_path)
    steps = values.get("step", [])
    number = _whole_number(change)
    if not 1 <= number <= len(steps):
        raise ConfigError(
            f"--what-if {change.text}: this mission has {len(steps)} steps, counted from 1."
        )
    del steps[number - 1]
    return toml_text(values)


def timed_change(line: str) -> tuple[float, Change]:
    """Return the second and the change of a line ``SECONDS KEY=VALUE``.

    Raises:
        ConfigError: the line has another form.
    """
    timed = timed_order(line)
    return timed.at_s, parse_change(timed.text)


def edited_fleet(text: str, change: Change) -> str:
    """Return the text of a fleet file with one value changed."""
    key = change.key
    if key == "law":
        key = "law.name"

    # each part of the dotted key, from the last to the first, becomes a table around the value
    values: Any = _value(change.value)
    for part in reversed(key.split(".")):
        values = {part: values}
    return edited(text, values)


def _value(text: str) -> Any:
    """Return the TOML value of a text, or the text itself if it is not TOML."""
    try:
        return toml_values(f"value = {text}", "--what-if")["value"]
    except ConfigError:
        return text


def _wind(change: Change) -> tuple[float, float]:
    return wind_of(change.value, option="--what-if wind")


def _number(change: Change) -> float:
    try:
        number = float(change.value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"--what-if {change.text}: this must be a number.")
    return number


def _whole_number(change: Change) -> int:
    number = _number(change)
    if not number.is_integer():
        raise ConfigError(f"--what-if {change.text}: this must be a whole number.")
    return int(number)
