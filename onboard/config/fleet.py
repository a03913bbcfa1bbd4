"""Loads fleet files as frozen, validated values; other packages import this module.

An unknown key is an error that names file, key and remedy. A vehicle's key overrides the same key
of its type, which overrides ``[defaults]``. Only :func:`load_fleet` and the search for a user's own
law do I/O. Loading a fleet file never runs code that the file names.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from onboard.config import fences, formation_shape, obstacles
from onboard.config.corrections import CorrectionsConfig as CorrectionsConfig
from onboard.config.fleet_config import HEADING_NOISE_RAD as HEADING_NOISE_RAD
from onboard.config.fleet_config import FleetConfig as FleetConfig
from onboard.config.fleet_config import FleetSection as FleetSection
from onboard.config.fleet_config import Geofence as Geofence
from onboard.config.fleet_config import Origin as Origin
from onboard.config.fleet_config import Vehicle as Vehicle
from onboard.config.fleet_config import above_words as above_words
from onboard.config.fleet_config import parking_distance_m as parking_distance_m
from onboard.config.fleet_config import parking_height_share as parking_height_share
from onboard.config.law import LawConfig as LawConfig
from onboard.config.law_import import OwnLaw as OwnLaw
from onboard.config.mocap import MocapConfig as MocapConfig
from onboard.config.people import Person as Person
from onboard.config.radio import RadioConfig as RadioConfig
from onboard.config.sitl import SitlProfile as SitlProfile
from onboard.config.toml_reading import ConfigError as ConfigError
from onboard.config.toml_reading import check_schema as check_schema
from onboard.config.toml_reading import convert as convert
from onboard.config.toml_reading import read_toml as read_toml
from onboard.config.toml_reading import table, tables, unknown_key
from onboard.config.validation import check_fleet
from onboard.config.vehicle_tables import (
    check_shared_tables,
    vehicle_from_tables,
    with_written_keys,
)
from onboard.tuples import Xyz

KNOWN_KEYS = (
    "corrections",
    "defaults",
    "fences",
    "fleet",
    "formations",
    "law",
    "mocap",
    "obstacles",
    "people",
    "radio",
    "schema",
    "types",
    "vehicles",
)


def load_fleet(path: str | os.PathLike[str], *, needs_folders: bool = True) -> FleetConfig:
    """Read and validate a fleet file.

    Args:
        path: path of the file, or the name of an example: ``paper``.
        needs_folders: whether the user's own law and the folder of keys that the file names must be
            on this computer; False if nothing will fly, for instance for the file of a recorded
            flight. The law is not imported, see :meth:`FleetConfig.import_law`.
    Returns:
        The values of the file.
    Raises:
        ConfigError: The file is missing or is not TOML, or has an unknown key, a wrong type, a
            value out of bounds or a duplicated id.
    """
    data, text, name = read_toml(path, "fleet file")
    return fleet_from_mapping(data, path=name, text=text, needs_folders=needs_folders)


def fleet_from_mapping(
    data: Mapping[str, Any], *, path: str = "<fleet>", text: str = "", needs_folders: bool = True
) -> FleetConfig:
    """Resolve and validate the content of a fleet file.

    Args:
        data: tables of the file.
        path: path of the file, for messages.
        text: text of the file, kept with the values.
        needs_folders: see :func:`load_fleet`.
    Returns:
        The values of the file.
    Raises:
        ConfigError: see :func:`load_fleet`.
    """
    try:
        return _resolved(data, path=path, text=text, needs_folders=needs_folders)
    except ConfigError as error:
        raise ConfigError(with_written_keys(str(error), data)) from error


def _resolved(data: Mapping[str, Any], *, path: str, text: str, needs_folders: bool) -> FleetConfig:
    check_schema(data, path)
    if "step" in data or isinstance(data.get("fleet"), str):
        raise ConfigError(
            f"{path} is a mission file, not a fleet file. Name its fleet, or fly it: "
            f"covey fly {path}"
        )
    for key in data:
        if key not in KNOWN_KEYS:
            raise unknown_key(path, key, key, KNOWN_KEYS)
    for key in ("fleet", "vehicles"):
        if key not in data:
            raise ConfigError(f"{path}: the table '{key}' is missing. Add [{key}].")

    fleet = convert(data["fleet"], FleetSection, path, "fleet")
    law = convert(data.get("law", {}), LawConfig, path, "law")

    written_formations = table(data.get("formations", {}), path, "formations")
    slots, shapes = formation_shape.split(written_formations, path)
    formations = convert(slots, dict[str, dict[str, Xyz]], path, "formations")

    written_obstacles = convert(
        data.get("obstacles", []), tuple[obstacles.Obstacle, ...], path, "obstacles"
    )
    written_fences = convert(data.get("fences", []), tuple[fences.Fence, ...], path, "fences")
    mocap = convert(data.get("mocap", {}), MocapConfig, path, "mocap")
    people: dict[str, Person] = {}
    for name, own_table in tables(data.get("people", {}), path, "people").items():
        people[name] = convert(own_table, Person, path, f"people.{name}")
    radio: RadioConfig | None = None
    if "radio" in data:
        radio = convert(data["radio"], RadioConfig, path, "radio")
    corrections: CorrectionsConfig | None = None
    if "corrections" in data:
        corrections = convert(data["corrections"], CorrectionsConfig, path, "corrections")

    types = tables(data.get("types", {}), path, "types")
    defaults = table(data.get("defaults", {}), path, "defaults")
    check_shared_tables(types, defaults, path)
    vehicles: dict[str, Vehicle] = {}
    own_tables = tables(data["vehicles"], path, "vehicles")
    for index, (name, own_table) in enumerate(own_tables.items()):
        vehicles[name] = vehicle_from_tables(name, index, own_table, types, defaults, path)

    config = FleetConfig(
        path=path,
        fleet=fleet,
        law=law,
        formations=formations,
        vehicles=vehicles,
        text=text,
        obstacles=written_obstacles,
        fences=written_fences,
        mocap=mocap,
        people=people,
        shapes=shapes,
        radio=radio,
        corrections=corrections,
    )
    check_fleet(config, needs_folders=needs_folders)

    if needs_folders:
        return config.with_own_law()
    return config
