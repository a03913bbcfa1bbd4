"""The settings of a campaign: vehicles, law, errors and perturbation.

They start from a fleet file, or from the vehicle types of the example fleets. ``--set key=value``
then changes single values.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import msgspec

from onboard.config.example_files import EXAMPLES
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    Geofence,
    LawConfig,
    OwnLaw,
    SitlProfile,
    Vehicle,
    fleet_from_mapping,
    load_fleet,
    read_toml,
)
from onboard.config.law_import import find_own_law
from onboard.config.validation import GEOFENCE_BOUNDS
from onboard.plain_text import meant_words

DEFAULT_TYPE = "sih"  # vehicle type, where there is one of that name
_EXAMPLES = ("sih", "paper")  # example fleets whose types can be named without --fleet
# keys of the table [fleet] that count in a campaign
_FLEET_KEYS = ("safety_distance_m", "vertical_separation_m", "body_diameter_m")
# short names of keys of the law and the vehicle
_ALIASES = {
    "tilt_deg": "vehicle.max_tilt_deg",
    "range_m": "law.range_m",
    "neighbours": "law.max_neighbours",
}
# vehicle keys that --set does not change
_NOT_A_VEHICLE_VALUE = (
    "name",
    "index",
    "system_id",
    "start_enu_m",
    "agent",
    "autopilot",
    "direct",
    "mocap_body",
    "type",
    "enabled",
    "emulated",
    "px4_version",
    "px4_params",
    "sitl",
    "mocap_required",
)
_UNCHECKED_SPACING_M = 10.0  # between starts, where the safety distance is no number
_IN_A_ROW = 16  # number of starts in a row
_UNBOUNDED_M = 1e6  # half width of a geofence too large for any flight to reach


def _from_to(default: float, low: float, high: float) -> float:
    """Return a dataclass field with its default, and the bounds that ``--set`` checks."""
    value: float = field(default=default, metadata={"low": low, "high": high})
    return value


@dataclass(frozen=True, slots=True)
class SimulatedErrors:
    """Disturbances of a flight, in addition to the errors of the estimate.

    The mismatches and the gain are half widths of uniform relative errors: the simulated vehicle
    differs from its fleet file by a constant share of that size.
    """

    # age of a message when it arrives, in whole ticks of 20 ms, at least one
    delay_s: float = _from_to(0.04, 0.0, 2.0)
    loss_share: float = _from_to(0.10, 0.0, 1.0)  # share of each link's messages that is lost
    burst_s: float = _from_to(0.0, 0.0, 60.0)  # length of a sender's silences; 0 for none
    burst_every_s: float = _from_to(10.0, 0.1, 1e4)  # mean interval between a sender's silences
    # std of a force per mass on each horizontal axis, correlated over 1 s
    gust_m_s2: float = _from_to(0.1, 0.0, 5.0)
    # velocity of a steady wind, which acts through the drag; the seed decides its direction
    wind_m_s: float = _from_to(0.0, 0.0, 30.0)
    # std of the gusts of that wind per horizontal axis; vertically half of it
    gust_m_s: float = _from_to(0.0, 0.0, 30.0)
    gust_s: float = _from_to(1.0, 0.0, 60.0)  # correlation time of gust_m_s
    lag_mismatch: float = _from_to(0.10, 0.0, 0.9)  # relative error of the attitude lag
    lag_error_s: float = _from_to(0.0, 0.0, 1.0)  # added to the dead time of the attitude
    gain: float = _from_to(0.05, 0.0, 0.9)  # relative error of the gain of the attitude
    drag_mismatch: float = _from_to(0.0, 0.0, 0.9)  # relative error of the drag
    hover_mismatch: float = _from_to(0.0, 0.0, 0.5)  # relative error of the hover thrust

    def gusts_m_s2(self, drag_1_s: float) -> float:
        """Return the standard deviation, per axis, of the acceleration that gusts cause.

        Args:
            drag_1_s: drag of the vehicle, through which gusts of the wind act.
        """
        return math.hypot(self.gust_m_s2, drag_1_s * self.gust_m_s)


@dataclass(frozen=True, slots=True)
class ErrorClass:
    """Accuracy of a vehicle's own estimate, per axis."""

    name: str
    position_std_m: float
    velocity_std_m_s: float
    # correlation times of the errors; 0: white noise
    position_time_s: float
    velocity_time_s: float
    # error of the acceleration, constant in each flight, as of a tilted accelerometer
    acceleration_std_m_s2: float = 0.0
    # A vehicle has arrived when its true position is nearer to its goal than the first limit, and
    # its true speed is below the second. Gusts widen both. A vehicle holds its estimated position
    # on the goal, not its true one, so both are three standard deviations wider than with a mocap.
    arrival_m: float = 0.15
    slow_m_s: float = 0.15
    # values of the law for this accuracy, unless the fleet file sets them
    law: Mapping[str, float] = field(default_factory=dict)


ERRORS = {
    "none": ErrorClass(
        name="none",
        position_std_m=0.0,
        velocity_std_m_s=0.0,
        position_time_s=0.0,
        velocity_time_s=0.0,
    ),
    "mocap": ErrorClass(
        name="mocap",
        position_std_m=0.003,
        velocity_std_m_s=0.0,
        position_time_s=0.0,
        velocity_time_s=0.0,
    ),
    "vision": ErrorClass(
        name="vision",
        position_std_m=0.05,
        velocity_std_m_s=0.12,
        position_time_s=0.5,
        velocity_time_s=0.5,
        acceleration_std_m_s2=0.1,
        arrival_m=0.30,
        slow_m_s=0.50,
        law={
            "kappa_1_1_s": 8.0,
            "kappa_2_1_s": 7.0,
            "shortfall_gain": 0.6,
            "v_perp_m_s": 0.7,
            "v_perp_crowd_m_s": 1.0,
            "crowd_count": 5,
            # longer than the errors' 0.5 s, so that a pair keeps 5.3 sigma_d
            "accuracy_time_s": 0.77,
        },
    ),
    "gps": ErrorClass(
        name="gps",
        position_std_m=0.2,
        velocity_std_m_s=0.2,
        position_time_s=5.0,
        velocity_time_s=0.7,
        acceleration_std_m_s2=0.1,
        arrival_m=0.75,
        slow_m_s=0.75,
    ),
}


@dataclass(frozen=True, slots=True)
class Setup:
    """All settings of a campaign except its scenarios."""

    law: str
    types: tuple[str, ...]  # names of vehicle types, assigned to the vehicles in turn
    # tables as in a fleet file
    type_tables: Mapping[str, Mapping[str, Any]]
    law_table: Mapping[str, Any]
    fleet_table: Mapping[str, Any]
    errors: ErrorClass
    perturbation: SimulatedErrors
    scale: float = 1.0  # factor of all horizontal positions
    # Keys of the values that --set, or "set" of a scene, has changed. They are no part of the repr,
    # because that stands for the settings themselves.
    changed_keys: tuple[str, ...] = field(default=(), repr=False)
    # User's own law -> hash of the source that flies. The repr leaves these out, too, because the
    # flights of Covey's laws do not depend on them.
    law_hashes: Mapping[str, str] = field(default_factory=dict, repr=False)

    def with_law_source(self, law: str) -> Setup:
        """Return these settings, bound to the present source of a law of the user's own.

        Settings of a built-in law stay the same.

        Args:
            law: name of the law.

        Raises:
            ConfigError: there is no such law, or the values are inconsistent.
        """
        own_law = None
        if LawConfig(name=law).is_own:
            own_law = replace(self, law=law).fleet(1).own_law
        if own_law is None:
            return self
        return replace(self, law_hashes={**self.law_hashes, law: own_law.source_hash})

    def fleet(self, count: int) -> FleetConfig:
        """Return a fleet of ``count`` vehicles, validated like any fleet file.

        Raises:
            ConfigError: the values are inconsistent, or the source of a user's own law has changed.
        """
        # The scenarios replace these starts. They only have to be valid, so they are far apart, in
        # rows that fit into the box of a fleet file.
        spacing_m = _UNCHECKED_SPACING_M
        safety_distance_m = self.fleet_table.get("safety_distance_m", 0.8)
        if isinstance(safety_distance_m, int | float):  # anything else is refused below
            spacing_m = 2.0 + 10.0 * safety_distance_m
        vehicles = {}
        for i in range(count):
            vehicles[f"v{i}"] = {
                "type": self.types[i % len(self.types)],
                "system_id": i + 1,
                "start_enu_m": [spacing_m * (i % _IN_A_ROW), spacing_m * (i // _IN_A_ROW), 0.0],
                "agent": f"tcp/127.0.0.1:{20000 + i}",
                "autopilot": f"udpin://127.0.0.1:{30000 + i}",
            }

        chosen = {key: self.fleet_table[key] for key in _FLEET_KEYS if key in self.fleet_table}
        fleet = {
            **chosen,
            "name": "campaign",
            "geofence_m": GEOFENCE_BOUNDS,
        }

        radio = {
            "expected_delay_s": self.perturbation.delay_s,
            # 0.9 is the most that a fleet file may expect
            "expected_loss_frac": min(self.perturbation.loss_share, 0.9),
        }
        types = {name: dict(table) for name, table in self.type_tables.items()}

        config = fleet_from_mapping(
            {
                "schema": 1,
                "fleet": fleet,
                "law": {**self.law_table, "name": self.law},
                "radio": radio,
                "types": types,
                "vehicles": vehicles,
            },
            path="the simulated fleet",
        )
        if config.own_law is not None:
            self._check_law_source(config.own_law)

        everywhere = (-_UNBOUNDED_M, _UNBOUNDED_M)
        geofence_m = Geofence(x=everywhere, y=everywhere, z=everywhere)
        section = msgspec.structs.replace(config.fleet, geofence_m=geofence_m)
        return msgspec.structs.replace(config, fleet=section)

    def _check_law_source(self, law: OwnLaw) -> None:
        """Refuse a law that was edited while its flights are under way.

        Raises:
            ConfigError: its source has another hash than at first.
        """
        first_hash = self.law_hashes.get(law.name, law.source_hash)
        if law.source_hash != first_hash:
            raise ConfigError(
                f"The source of {law.name} was edited while it was flying: its hash was "
                f"{first_hash}, and is {law.source_hash} now. Flights of the two are not added up. "
                "Start the same command again to fly the law as it is now."
            )


def setup_for(
    *,
    law: str | None = None,
    types: str | None = None,
    fleet_path: str | None = None,
    errors: str = "mocap",
    scale: float = 1.0,
    changes: Sequence[str] = (),
) -> Setup:
    """Return the setup of a command line.

    Args:
        law: name of the law; by default the fleet file's, or else Covey's.
        types: names of vehicle types separated by commas, assigned to the vehicles in turn; by
            default sih, or else the first type of the fleet file.
        fleet_path: a fleet file with types, law and distances; by default the example fleets.
        errors: name of an error class.
        scale: factor of all horizontal positions.
        changes: changes of single values, each as ``key=value``; see :func:`keys`.

    Raises:
        ConfigError: law, type, error class or key is unknown, a value is out of bounds, or the
            fleet file is wrong.
    """
    if fleet_path is not None:
        data = tomllib.loads(load_fleet(fleet_path).text)
    else:
        data = _examples()

    type_tables = _type_tables(data)
    names = _type_names(types, type_tables)
    if errors not in ERRORS:
        raise ConfigError(
            f"--errors is '{errors}', but there are only {', '.join(ERRORS)}. Name one of these."
        )

    file_law = dict(data.get("law", {}))
    if fleet_path is not None:
        # the folder of a user's own law is relative to the fleet file that names it
        fleet_folder = os.path.dirname(os.path.abspath(fleet_path))
        file_law["folder"] = os.path.join(fleet_folder, file_law.get("folder", "."))
    if law is None:
        law = str(file_law.get("name", "covey"))
    elif LawConfig(name=law).is_own:
        find_own_law(law, (file_law.get("folder", "."), os.getcwd()), "--law")

    if not (math.isfinite(scale) and 0.1 <= scale <= 100.0):
        raise ConfigError(f"--scale is {scale}; it must lie between 0.1 and 100.")

    law_table: dict[str, Any] = {**ERRORS[errors].law, **file_law}
    fleet_table: dict[str, Any] = dict(data.get("fleet", {}))
    perturbation = SimulatedErrors()
    changed_keys = []

    for change in changes:
        try:
            group, key, value = parsed_change(change)
        except ConfigError as error:
            raise ConfigError(f"--set {error}") from None
        changed_keys.append(f"{group}.{key}".lstrip("."))
        if group == "fleet":
            fleet_table[key] = value
        elif group == "law":
            law_table[key] = value
        elif group == "sitl":
            for name in names:
                profile = type_tables[name].get("sitl", {})
                type_tables[name]["sitl"] = {**profile, key: value}
        elif group == "vehicle":
            for name in names:
                type_tables[name][key] = value
        else:
            perturbation = replace(perturbation, **{key: float(value)})

    unbound = Setup(
        law=law,
        types=names,
        type_tables=type_tables,
        law_table=law_table,
        fleet_table=fleet_table,
        errors=ERRORS[errors],
        perturbation=perturbation,
        scale=scale,
        changed_keys=tuple(changed_keys),
    )
    return unbound.with_law_source(law)


def _type_tables(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the types of a fleet file by name, each with the defaults of the file."""
    defaults = {}
    for key, value in data.get("defaults", {}).items():
        if key not in ("type", "enabled"):
            defaults[key] = value
    return {name: {**defaults, **table} for name, table in data.get("types", {}).items()}


def _type_names(types: str | None, tables: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the vehicle types, to be assigned to the vehicles in turn.

    Raises:
        ConfigError: a type is unknown.
    """
    if types is None and DEFAULT_TYPE in tables:
        types = DEFAULT_TYPE
    elif types is None:
        types = next(iter(tables), "")

    names = tuple(types.split(","))
    for name in names:
        if name not in tables:
            known = ", ".join(tables) or "none"
            raise ConfigError(
                f"There is no vehicle type '{name}' (--type, or 'type' of a scene). "
                f"Known here: {known}."
            )
    return names


def parsed_change(change: str) -> tuple[str, str, float | int | bool | str]:
    """Return group, key and value of ``[group.]key=value``.

    The group is empty for keys of the perturbation, whose values are numbers within their bounds.

    Raises:
        ConfigError: the change has another form, the key is unknown, the value is not finite, or
            it is no value of the perturbation.
    """
    name, equals, text = change.partition("=")
    name = _ALIASES.get(name, name)

    known = keys(with_aliases=True)
    if not equals:
        raise ConfigError(f"{change}: write it as key=value. Keys: {', '.join(known)}.")
    if name not in keys():
        remedy = f"{meant_words(name, known)} covey simulate --help lists all keys."
        raise ConfigError(f"{change}: there is no such key.{remedy}")

    group, _, key = name.rpartition(".")
    value = _value(change, text)
    if not group:
        _check_bounds(change, key, value)
    return group, key, value


def _check_bounds(change: str, key: str, value: float | int | bool | str) -> None:
    """Check a value of the perturbation.

    Raises:
        ConfigError: the value is not a number, or is out of bounds.
    """
    bounds = {entry.name: entry.metadata for entry in fields(SimulatedErrors)}
    low = bounds[key]["low"]
    high = bounds[key]["high"]
    if isinstance(value, (bool, str)) or not low <= value <= high:
        raise ConfigError(f"{change}: the value must be a number from {low:g} to {high:g}.")


def keys(*, with_aliases: bool = False) -> list[str]:
    """Return all keys of ``--set``.

    Args:
        with_aliases: whether the short names are among them.
    """
    names = [entry.name for entry in fields(SimulatedErrors)]
    if with_aliases:
        names += _ALIASES

    names += [f"fleet.{name}" for name in _FLEET_KEYS]
    names += [f"law.{name}" for name in LawConfig.__struct_fields__ if name != "name"]
    for name in Vehicle.__struct_fields__:
        if name not in _NOT_A_VEHICLE_VALUE:
            names.append(f"vehicle.{name}")
    names += [f"sitl.{name}" for name in SitlProfile.__struct_fields__]
    return names


def _value(change: str, text: str) -> float | int | bool | str:
    """Return the value of a change: a number, true or false, or else a text.

    Numbers such as ``.7``, which are not valid TOML, are accepted. A text may stand in quotes.
    """
    try:
        value: object = tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        try:
            value = float(text)
        except ValueError:
            value = text

    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{change}: the value must be finite.")
    if isinstance(value, float | int | str):
        return value
    return text  # a date, a list or a table; no key accepts it


def _examples() -> dict[str, Any]:
    """Return the content of a fleet file that has only the vehicle types of the examples."""
    types: dict[str, Any] = {}
    for name in _EXAMPLES:
        # by its path, because a name alone may be that of a user's file
        path = os.path.join(EXAMPLES, "fleets", f"{name}.toml")
        example, _, _ = read_toml(path, "fleet file")
        types |= example.get("types", {})
    return {"types": types}
