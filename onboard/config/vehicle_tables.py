"""Merges the tables of one vehicle: its own keys, its type's keys and the defaults."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, get_type_hints

from onboard.config.fleet_config import PX4_VERSIONS, Vehicle
from onboard.config.sitl import SitlProfile
from onboard.config.toml_reading import ConfigError, convert, unknown_key

# keys that are allowed only in a vehicle's own table, not in its type's table or the defaults
_VEHICLE_ONLY = {
    "system_id",
    "start_enu_m",
    "agent",
    "autopilot",
    "direct",
    "mocap_body",
    "emulated",
}
_REQUIRED = ("system_id", "start_enu_m", "agent", "autopilot")
_DERIVED = {"name", "index"}  # fields of a vehicle that are not keys of the file
_MERGED = ("px4_params", "sitl")  # tables that are merged key by key
_VEHICLE_KEY = re.compile(r"'vehicles\.(?P<vehicle>[A-Za-z0-9_-]+)\.(?P<key>\w+(\.\w+)?)")


def check_shared_tables(
    types: dict[str, dict[str, Any]], defaults: dict[str, Any], path: str
) -> None:
    """Check keys and values of the types and the defaults, also of those that no vehicle uses.

    Args:
        types: all vehicle types of the file.
        defaults: the file's ``[defaults]``.
        path: path of the file, for messages.
    Raises:
        ConfigError: A key is unknown, or a value has a wrong type.
    """
    shared = set(Vehicle.__struct_fields__) - _DERIVED - _VEHICLE_ONLY
    _check_shared_table(defaults, "defaults", shared, path)
    for type_name, type_table in types.items():
        _check_shared_table(type_table, f"types.{type_name}", shared - {"type"}, path)


def vehicle_from_tables(
    name: str,
    index: int,
    own: dict[str, Any],
    types: dict[str, dict[str, Any]],
    defaults: dict[str, Any],
    path: str,
) -> Vehicle:
    """Merge the tables of one vehicle.

    Args:
        name: name of the vehicle.
        index: its position in the fleet file.
        own: its own table.
        types: all vehicle types of the file, checked.
        defaults: the file's ``[defaults]``, checked.
        path: path of the file, for messages.
    Raises:
        ConfigError: A key is unknown or missing, the type is unknown, or a value has a wrong type.
    """
    key = f"vehicles.{name}"
    # in a command, a word that begins with - is an option
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,39}", name):
        raise ConfigError(
            f"{path}: '{key}': a name has 1 to 40 of the characters A-Z a-z 0-9 _ -, and does "
            "not begin with -. Rename the vehicle."
        )

    type_name = own.get("type", defaults.get("type", ""))
    if not isinstance(type_name, str):
        raise ConfigError(f"{path}: '{key}.type' must be the name of a [types.NAME].")
    if type_name and type_name not in types:
        type_names = "none"
        if types:
            type_names = ", ".join(types)
        raise ConfigError(
            f"{path}: '{key}.type' is {type_name!r}, but there is no [types.{type_name}]. "
            f"Types of this file: {type_names}."
        )
    type_table = types.get(type_name, {})

    _check_keys(own, key, set(Vehicle.__struct_fields__) - _DERIVED, path)

    for entry in _REQUIRED:
        if entry not in own:
            raise ConfigError(
                f"{path}: '{key}.{entry}' is missing. Every vehicle needs one of its own."
            )

    merged: dict[str, Any] = {"type": type_name}
    for table in (defaults, type_table, own):
        for entry, value in table.items():
            former = merged.get(entry, {})
            if entry in _MERGED and isinstance(value, dict) and isinstance(former, dict):
                merged[entry] = {**former, **value}
            else:
                merged[entry] = value

    _check_px4_version(merged.get("px4_version", PX4_VERSIONS[0]), f"{path}: '{key}.px4_version'")
    # converted separately first, because the message then lists the known keys of this table
    convert(merged.get("sitl", {}), SitlProfile, path, f"{key}.sitl")
    return convert({**merged, "name": name, "index": index}, Vehicle, path, key)  # type: ignore[no-any-return]


def with_written_keys(message: str, data: Mapping[str, Any]) -> str:
    """Return a message in which each key of a vehicle has the name of the table that sets it.

    A vehicle has keys from its own table, from its type's and from the defaults. The checks only
    know the vehicle.

    Args:
        message: a message about a fleet file, with keys such as ``'vehicles.mav0.mass_kg'``.
        data: tables of the file.
    """

    def as_written(found: re.Match[str]) -> str:
        own = ["vehicles", found["vehicle"]]
        type_name = _at(data, [*own, "type"]) or _at(data, ["defaults", "type"])
        keys = found["key"].split(".")
        for place in (own, ["types", str(type_name)], ["defaults"]):
            if _at(data, [*place, *keys]) is not None:
                return "'" + ".".join([*place, *keys])
        return found[0]

    return _VEHICLE_KEY.sub(as_written, message)


def _at(table: Any, keys: Sequence[str]) -> Any:
    """Return the value of a key in tables in a table; None if there is none."""
    for key in keys:
        if not isinstance(table, Mapping):
            return None
        table = table.get(key)
    return table


def _check_shared_table(
    shared_table: dict[str, Any], prefix: str, allowed: set[str], path: str
) -> None:
    """Refuse a table with a key that is not allowed in it, or with a value of a wrong type."""
    _check_keys(shared_table, prefix, allowed, path)
    kinds = get_type_hints(Vehicle)
    for entry, value in shared_table.items():
        key = f"{prefix}.{entry}"
        if entry == "px4_version":
            _check_px4_version(value, f"{path}: '{key}'")
        convert(value, kinds[entry], path, key)


def _check_keys(table: dict[str, Any], prefix: str, allowed: set[str], path: str) -> None:
    """Refuse a table with a key that is not allowed in it."""
    for entry in table:
        if entry not in allowed:
            raise unknown_key(path, f"{prefix}.{entry}", entry, sorted(allowed))


def _check_px4_version(version: object, where: str) -> None:
    if version not in PX4_VERSIONS:
        known = ", ".join(f'"{each}"' for each in PX4_VERSIONS)
        raise ConfigError(
            f"{where} is {version!r}. Write one of {known}, in quotes; for another PX4 the nearest "
            "one."
        )
