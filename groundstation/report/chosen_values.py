"""Lists a fleet file's values beside their defaults, to show what was chosen. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from onboard.config.fleet import FleetConfig

_MAX_LETTERS = 200  # most letters of a value
# Keys that tell vehicles apart or say how to reach them are not shown; they need no default.
_IDENTITY = frozenset(("name", "index", "system_id", "agent", "autopilot", "direct", "mocap_body"))
# Keys with folders and addresses on one computer are not shown.
_PLACES = frozenset(("folder", "keys", "routers", "simulator"))


class ShownSetting(NamedTuple):
    """One value of a fleet file."""

    table: str  # fleet, law, mocap, radio or vehicles
    key: str
    value: str
    default: str  # empty if there is none
    is_chosen: bool  # whether the value differs from its default
    vehicles: str  # names of the vehicles with this value; empty for all


def settings(fleet: FleetConfig) -> list[ShownSetting]:
    """List the values that a fleet flies with.

    Args:
        fleet: the fleet file.

    Returns:
        Values of the fleet, the law, the mocap, the radio and the vehicles. A value that several
        vehicles share is listed once.
    """
    found = [
        *_table_settings("fleet", fleet.fleet),
        *_table_settings("law", fleet.law),
        *_table_settings("mocap", fleet.mocap),
    ]
    if fleet.radio is not None:
        found += _table_settings("radio", fleet.radio)
    return found + _vehicle_settings(fleet)


def _vehicle_settings(fleet: FleetConfig) -> list[ShownSetting]:
    """Return the vehicles' values, each once with the names of the vehicles that share it."""
    names_by_setting: dict[ShownSetting, list[str]] = {}
    for name, vehicle in fleet.vehicles.items():
        for setting in _table_settings("vehicles", vehicle):
            if setting.key not in _IDENTITY:
                names_by_setting.setdefault(setting, []).append(name)

    found = []
    for setting, names in names_by_setting.items():
        vehicles = ", ".join(names)
        if len(names) == len(fleet.vehicles):
            vehicles = ""
        found.append(setting._replace(vehicles=vehicles))
    found.sort(key=lambda setting: setting.key)
    return found


def _table_settings(table: str, values: msgspec.Struct, prefix: str = "") -> Iterator[ShownSetting]:
    """Yield the values of one table; a table within it is yielded with dotted keys."""
    for field in msgspec.structs.fields(values):
        if field.name in _PLACES:
            continue
        value = getattr(values, field.name)
        key = prefix + field.name
        if isinstance(value, msgspec.Struct):
            yield from _table_settings(table, value, f"{key}.")
            continue

        default = field.default
        if default is msgspec.NODEFAULT and field.default_factory is not msgspec.NODEFAULT:
            default = field.default_factory()
        has_default = default is not msgspec.NODEFAULT
        default_words = ""
        if has_default:
            default_words = _words(default)
        yield ShownSetting(
            table=table,
            key=key,
            value=_words(value),
            default=default_words,
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
        return f"[{', '.join(_words(part) for part in value)}]"[:_MAX_LETTERS]
    if isinstance(value, dict):
        pairs = [f"{key} = {_words(part)}" for key, part in value.items()]
        return (", ".join(pairs) or "none")[:_MAX_LETTERS]
    return str(value)[:_MAX_LETTERS]
