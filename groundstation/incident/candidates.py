"""The changes of a flight that might have kept its promise, the safety distance of the fleet file.

The flight is flown again with one candidate at a time. There are two kinds of candidates. A cause
is something unusual in this flight: a fault, an order of another ground, an unusual value in the
fleet file, weather, a bad bus, another law. The change removes it. A defence is something that was
not wrong, but could be safer: the change adds margin or lowers the speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from groundstation.flights.changes import Change, FlightOrigin
from onboard.config.example_files import example_names, existing_file
from onboard.config.file_reading import FLEET_FILE, read_text, toml_values
from onboard.config.fleet import LawConfig, RadioConfig
from onboard.config.fleet_config import FleetSection, Vehicle
from onboard.config.sitl import SitlProfile
from onboard.config.validation import VEHICLE_BOUNDS

CandidateKind = Literal["cause", "defence"]

_CALM = "0,0"  # wind to the east and to the north [m/s], as in --what-if wind=3,0
_MORE_MARGIN_M = 0.2
_SLOWER_FRAC = 0.7
_USUAL_BUS = {
    "delay_s": 0.001,
    "jitter_s": 0.0,
    "loss": 0.0,
    "burst": 1.0,
    "reorder": 0.0,
    "duplicate": 0.0,
}
# keys of names and folders, which have no effect in flight
_NAMES = ("name", "folder", "keys", "simulator", "origin")


class Candidate(NamedTuple):
    """One candidate, which consists of one or more changes."""

    kind: CandidateKind
    what: str  # in words that fit after "The flight would have passed"
    changes: tuple[Change, ...]


def candidates_of(origin: FlightOrigin) -> list[Candidate]:
    """Return the candidates of a flight, the likeliest first.

    Args:
        origin: files and settings of the flight.
    """
    fleet = toml_values(origin.fleet_text, "fleet.toml")
    return [
        *_faults(origin),
        *_orders(origin),
        *_numbers(fleet),
        *_law(fleet),
        *_weather(origin),
        *_bus(origin),
        *_defences(fleet),
    ]


def _faults(origin: FlightOrigin) -> Iterator[Candidate]:
    """Yield candidates that remove one fault, from the options or from the mission's steps."""
    for number, line in enumerate(origin.settings.faults, start=1):
        yield _cause(f"without the fault '{line}'", "without_fault", number)

    if origin.settings.mission_path.endswith(".py"):
        return
    steps = toml_values(origin.mission_text, "mission.toml").get("step", [])
    for number, step in enumerate(steps, start=1):
        if step.get("do") == "fault":
            what = f"without the fault '{step.get('name')}' of step {number}"
            yield _cause(what, "without_step", number)


def _orders(origin: FlightOrigin) -> Iterator[Candidate]:
    for number, line in enumerate(origin.settings.orders, start=1):
        yield _cause(f"without the order '{line}'", "without_order", number)


def _numbers(fleet: Mapping[str, Any]) -> Iterator[Candidate]:
    """Yield candidates that replace one unusual value of the fleet file by the usual one.

    Usual values are the defaults of the tables, for a vehicle type the values of the shipped type
    of that name, and for a vehicle the values of its type and of ``[defaults]``.
    """
    for table, kind in (("law", LawConfig), ("fleet", FleetSection), ("radio", RadioConfig)):
        usual = _defaults(kind)
        for key, value in fleet.get(table, {}).items():
            has_usual = key in usual and key not in _NAMES
            if has_usual and _is_scalar(usual[key]) and usual[key] != value:
                yield _other_value(f"{table}.{key}", value, usual[key])

    defaults = fleet.get("defaults", {})
    yield from _differences("defaults", defaults, _usual_vehicle())

    shipped = _shipped_types()
    for name, values in fleet.get("types", {}).items():
        yield from _differences(f"types.{name}", values, shipped.get(name, {}))

    types = fleet.get("types", {})
    for name, values in fleet.get("vehicles", {}).items():
        type_values = types.get(values.get("type", defaults.get("type", "")), {})
        yield from _differences(f"vehicles.{name}", values, {**defaults, **type_values})


def _differences(
    path: str, values: Mapping[str, Any], usual: Mapping[str, Any]
) -> Iterator[Candidate]:
    """Yield candidates for the values of a table, and of tables within it, that are unusual."""
    for key, value in values.items():
        if key not in usual:
            continue
        if isinstance(value, Mapping) and isinstance(usual[key], Mapping):
            yield from _differences(f"{path}.{key}", value, usual[key])
        elif _is_scalar(value) and value != usual[key]:
            yield _other_value(f"{path}.{key}", value, usual[key])


def _law(fleet: Mapping[str, Any]) -> Iterator[Candidate]:
    name = fleet.get("law", {}).get("name", "covey")
    if name != "covey":
        yield _cause(f"with Covey's law in place of '{name}'", "law", "covey")


def _weather(origin: FlightOrigin) -> Iterator[Candidate]:
    settings = origin.settings
    has_wind = any(settings.wind_enu_m_s)
    if has_wind or settings.gust_m_s:
        changes = (Change("wind", _CALM), Change("gust", "0"))
        yield Candidate(kind="cause", what="in calm air", changes=changes)
    if has_wind and settings.gust_m_s:
        yield _cause("without the gusts", "gust", 0)


def _bus(origin: FlightOrigin) -> Iterator[Candidate]:
    """Yield candidates that give the simulated bus its usual quality, in one value or in all."""
    bad = {}
    for name, value in origin.settings.bus.items():
        if name in _USUAL_BUS and value != _USUAL_BUS[name]:
            bad[name] = value
    for name, value in bad.items():
        what = f"with the usual {name} of the bus ({_USUAL_BUS[name]:g} in place of {value:g})"
        yield _cause(what, f"bus.{name}", _USUAL_BUS[name])
    if len(bad) > 1:
        changes = tuple(Change(f"bus.{name}", f"{_USUAL_BUS[name]:g}") for name in bad)
        yield Candidate(kind="cause", what="with a perfect bus", changes=changes)


def _defences(fleet: Mapping[str, Any]) -> Iterator[Candidate]:
    """Yield the candidates of more margin, and of less speed of all vehicles."""
    margin_m = fleet.get("law", {}).get("design_margin_m", LawConfig().design_margin_m)
    wider = Change("law.design_margin_m", f"{margin_m + _MORE_MARGIN_M:g}")
    what = f"{_MORE_MARGIN_M:g} m more margin (law.design_margin_m)"
    yield Candidate(kind="defence", what=what, changes=(wider,))

    tables = {"defaults": fleet.get("defaults", {})}
    for group in ("types", "vehicles"):
        for name, values in fleet.get(group, {}).items():
            tables[f"{group}.{name}"] = values

    slower = []
    for path, values in tables.items():
        speed_m_s = values.get("max_speed_m_s")
        if _is_scalar(speed_m_s):
            slower.append(Change(f"{path}.max_speed_m_s", f"{_SLOWER_FRAC * speed_m_s:g}"))
    if slower:
        what = f"{1.0 - _SLOWER_FRAC:.0%} less speed (max_speed_m_s of all vehicles)"
        yield Candidate(kind="defence", what=what, changes=tuple(slower))


def _cause(what: str, key: str, value: object) -> Candidate:
    """Return the candidate that removes a cause by one change."""
    return Candidate(kind="cause", what=what, changes=(Change(key, f"{value}"),))


def _other_value(key: str, value: object, usual: object) -> Candidate:
    """Return the candidate that replaces an unusual value of the fleet file."""
    return _cause(f"with {key} = {usual} in place of {value}", key, _toml(usual))


def _toml(value: object) -> str:
    """Return a number, a truth value or a word as a change writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value}"


def _defaults(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the defaults of the fields of a table that have one."""
    fields = msgspec.structs.fields(kind)
    return {field.name: field.default for field in fields if not field.required}


def _usual_vehicle() -> dict[str, Any]:
    """Return the numbers of a vehicle whose tables set none."""
    usual: dict[str, Any] = {"sitl": _defaults(SitlProfile)}
    for key, value in _defaults(Vehicle).items():
        if key in VEHICLE_BOUNDS and value is not None:
            usual[key] = value
    return usual


def _is_scalar(value: object) -> bool:
    return isinstance(value, (bool, int, float, str))


def _shipped_types() -> dict[str, dict[str, Any]]:
    """Return the vehicle types of the example fleets; of two with the same name, the first."""
    types: dict[str, dict[str, Any]] = {}
    for name in example_names("fleet file"):
        path = Path(existing_file(name, "fleet file"))
        values = toml_values(read_text(path, FLEET_FILE), str(path))
        for type_name, table in values.get("types", {}).items():
            types.setdefault(type_name, table)
    return types
