"""The values of a fleet file beside their defaults: which were chosen for this fleet. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from onboard.config.fleet import FleetConfig

_MOST_LETTERS = 200  # of a value
# what says where and who a vehicle is, and has no default that it could differ from
_IDENTITY = frozenset(("name", "index", "system_id", "agent", "autopilot", "direct", "mocap_body"))
# where things lie on one computer
_PLACES = frozenset(("folder", "keys", "routers", "simulator"))


class ShownSetting(NamedTuple):
    """One value of a fleet file."""

    table: str  # as the fleet file names it: law, types or vehicles
    key: str
    value: str
    default: str  # empty: there is none
    is_chosen: bool  # differs from the default
    vehicles: str  # that have it; empty for all


def settings(fleet: FleetConfig) -> list[ShownSetting]:
    """List the values that a fleet flies with.

    Args:
        fleet: the fleet file.

    Returns:
        Values of the fleet, the law, the mocap, the radio, and of the vehicles, each once where
        several vehicles share it.
    """
    found = [*_of("fleet", fleet.fleet), *_of("law", fleet.law), *_of("mocap", fleet.mocap)]
    if fleet.radio is not None:
        found += _of("radio", fleet.radio)
    return found + _of_vehicles(fleet)


def _of_vehicles(fleet: FleetConfig) -> list[ShownSetting]:
    """Return the vehicles' values; a value that several have names them together."""
    having: dict[ShownSetting, list[str]] = {}
    for name, vehicle in fleet.vehicles.items():
        for setting in _of("vehicles", vehicle):
            if setting.key not in _IDENTITY:
                having.setdefault(setting, []).append(name)

    found = []
    for setting, names in having.items():
        is_of_all = len(names) == len(fleet.vehicles)
        found.append(setting._replace(vehicles="" if is_of_all else ", ".join(names)))
    found.sort(key=lambda setting: setting.key)
    return found


def _of(table: str, values: msgspec.Struct, prefix: str = "") -> Iterator[ShownSetting]:
    for field in msgspec.structs.fields(values):
        if field.name in _PLACES:
            continue
        value = getattr(values, field.name)
        key = prefix + field.name
        if isinstance(value, msgspec.Struct):
            yield from _of(table, value, f"{key}.")
            continue

        default = field.default
        if default is msgspec.NODEFAULT and field.default_factory is not msgspec.NODEFAULT:
            default = field.default_factory()
        has_default = default is not msgspec.NODEFAULT
        yield ShownSetting(
            table=table,
            key=key,
            value=_words(value),
            default=_words(default) if has_default else "",
            is_chosen=has_default and value != default,
            vehicles="",
        )


def _words(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return f"[{', '.join(_words(part) for part in value)}]"[:_MOST_LETTERS]
    if isinstance(value, dict):
        pairs = [f"{key} = {_words(part)}" for key, part in value.items()]
        return (", ".join(pairs) or "none")[:_MOST_LETTERS]
    return str(value)[:_MOST_LETTERS]
