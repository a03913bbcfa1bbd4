"""Everything that is chosen for a campaign: vehicles, law, errors and perturbation.

A choice starts from the types of a fleet file, or from those of the example fleets. Single values
are then changed by ``--set key=value``.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    LawConfig,
    SitlProfile,
    Vehicle,
    fleet_from_mapping,
    load_fleet,
    read_toml,
)

_EXAMPLES = ("sih", "paper")  # whose types can be named without --fleet
# of a fleet file, for a campaign
_FLEET_KEYS = ("safety_distance_m", "vertical_separation_m", "body_diameter_m")
# short names for what is otherwise a value of the law or of the vehicle
_ALIASES = {
    "tilt_deg": "vehicle.max_tilt_deg",
    "range_m": "law.range_m",
    "neighbours": "law.max_neighbours",
}
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
    "px4_version",
    "px4_params",
    "sitl",
    "mocap_required",
)
_UNBOUNDED_M = 1e6  # half width of a geofence that no flight reaches


def _from_to(default: float, low: float, high: float) -> float:
    """Return a field with its default and the bounds of ``--set``."""
    value: float = field(default=default, metadata={"low": low, "high": high})
    return value


@dataclass(frozen=True, slots=True)
class SimulatedErrors:
    """Errors that the control does not know, beside those of the estimate.

    The four mismatches and the gain are half widths of uniform relative errors, each constant per
    vehicle.
    """

    # age of a message when it arrives, in whole ticks of 20 ms, at least one
    delay_s: float = _from_to(0.04, 0.0, 2.0)
    loss_share: float = _from_to(0.10, 0.0, 1.0)  # of each link's messages
    burst_s: float = _from_to(0.0, 0.0, 60.0)  # length of a sender's silences; 0 for none
    burst_every_s: float = _from_to(10.0, 0.1, 1e4)  # mean interval of a sender's silences
    gust_m_s2: float = _from_to(0.1, 0.0, 5.0)  # std per horizontal axis, correlated over 1 s
    # velocity of the air, which pushes by the drag: steady, from a direction of the flight's seed
    wind_m_s: float = _from_to(0.0, 0.0, 30.0)
    gust_m_s: float = _from_to(0.0, 0.0, 30.0)  # std per horizontal axis, half of it vertically
    gust_s: float = _from_to(1.0, 0.0, 60.0)  # correlation time of these gusts
    lag_mismatch: float = _from_to(0.10, 0.0, 0.9)  # of the lag of the attitude
    lag_error_s: float = _from_to(0.0, 0.0, 1.0)  # added to the dead time
    gain: float = _from_to(0.05, 0.0, 0.9)  # error of the gain of the attitude
    drag_mismatch: float = _from_to(0.0, 0.0, 0.9)
    hover_mismatch: float = _from_to(0.0, 0.0, 0.5)  # of the hover throttle

    def gusts_m_s2(self, drag_1_s: float) -> float:
        """Return the standard deviation per axis of what gusts push a vehicle with.

        Args:
            drag_1_s: of the vehicle, through which moving air pushes.
        """
        return math.hypot(self.gust_m_s2, drag_1_s * self.gust_m_s)


@dataclass(frozen=True, slots=True)
class ErrorClass:
    """Accuracy of the own estimate, per axis."""

    name: str
    position_std_m: float
    velocity_std_m_s: float
    # over which the errors are correlated; 0: white noise
    position_time_s: float
    velocity_time_s: float
    # A vehicle has arrived when it is truly this near its goal and this slow, in calm air; gusts
    # widen both. Both are three standard deviations wider than with a mocap: a vehicle holds its
    # estimate on the goal, not itself.
    arrival_m: float = 0.15
    slow_m_s: float = 0.15
    # values that a fleet of that accuracy flies with, where the fleet file does not say
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
        arrival_m=0.30,
        slow_m_s=0.50,
        law={
            "kappa_1_1_s": 5.0,
            "kappa_2_1_s": 10.0,
            "shortfall_gain": 0.6,
            "v_perp_m_s": 0.5,
            "v_perp_crowd_m_s": 0.7,
            "crowd_count": 5,
            "accuracy_time_s": 0.5,
        },
    ),
    "gps": ErrorClass(
        name="gps",
        position_std_m=0.2,
        velocity_std_m_s=0.2,
        position_time_s=5.0,
        velocity_time_s=0.7,
        arrival_m=0.75,
        slow_m_s=0.75,
    ),
}


@dataclass(frozen=True, slots=True)
class Setup:
    """One choice of everything but the scenario."""

    law: str
    types: tuple[str, ...]  # given to the vehicles in turn
    # tables as in a fleet file
    type_tables: Mapping[str, Mapping[str, Any]]
    law_table: Mapping[str, Any]
    fleet_table: Mapping[str, Any]
    errors: ErrorClass
    perturbation: SimulatedErrors
    scale: float = 1.0  # of positions in the plane

    def fleet(self, count: int) -> FleetConfig:
        """Return a fleet of ``count`` vehicles, validated like any fleet file.

        Raises:
            ConfigError: the values do not go together.
        """
        spacing_m = 2.0 + 10.0 * float(self.fleet_table.get("safety_distance_m", 0.8))
        vehicles = {}
        for i in range(count):
            vehicles[f"v{i}"] = {
                "type": self.types[i % len(self.types)],
                "system_id": i + 1,
                "start_enu_m": [spacing_m * i, 0.0, 0.0],
                "agent": f"tcp/127.0.0.1:{20000 + i}",
                "autopilot": f"udpin://127.0.0.1:{30000 + i}",
            }

        everywhere = [-_UNBOUNDED_M, _UNBOUNDED_M]
        chosen = {key: self.fleet_table[key] for key in _FLEET_KEYS if key in self.fleet_table}
        fleet = {
            **chosen,
            "name": "campaign",
            "geofence_m": {"x": everywhere, "y": everywhere, "z": everywhere},
        }

        radio = {
            "expected_delay_s": self.perturbation.delay_s,
            "expected_loss_frac": min(self.perturbation.loss_share, 0.9),
        }
        types = {name: dict(table) for name, table in self.type_tables.items()}

        return fleet_from_mapping(
            {
                "schema": 1,
                "fleet": fleet,
                "law": {**self.law_table, "name": self.law},
                "radio": radio,
                "types": types,
                "vehicles": vehicles,
            },
            path="covey simulate",
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
        law: its name; by default the fleet file's, or Covey's.
        types: names separated by commas, given to the vehicles in turn (default: sih, or the fleet
            file's first).
        fleet_path: gives types, law and distances; by default the example fleets do.
        errors: name of an error class.
        scale: of positions in the plane.
        changes: ``key=value`` each; see :func:`keys`.
    Raises:
        ConfigError: unknown law, type, errors or key, a value out of bounds, or a fleet file that
            is wrong.
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
    if law is None:
        law = str(file_law.get("name", "covey"))
    if fleet_path is not None:
        # a law of one's own is looked for beside the file that names it
        beside = os.path.dirname(os.path.abspath(fleet_path))
        file_law["folder"] = os.path.join(beside, file_law.get("folder", "."))

    if not (math.isfinite(scale) and 0.1 <= scale <= 100.0):
        raise ConfigError(f"--scale is {scale}; it must lie between 0.1 and 100.")

    law_table: dict[str, Any] = {**ERRORS[errors].law, **file_law}
    fleet_table: dict[str, Any] = dict(data.get("fleet", {}))
    perturbation = SimulatedErrors()

    for change in changes:
        group, key, value = _parsed_change(change)
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
            perturbation = _perturbed(perturbation, change, key, value)

    return Setup(
        law=law,
        types=names,
        type_tables=type_tables,
        law_table=law_table,
        fleet_table=fleet_table,
        errors=ERRORS[errors],
        perturbation=perturbation,
        scale=scale,
    )


def _type_tables(data: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the types of a fleet file by name, each with the defaults of the file."""
    defaults = {}
    for key, value in data.get("defaults", {}).items():
        if key not in ("type", "enabled"):
            defaults[key] = value
    return {name: {**defaults, **table} for name, table in data.get("types", {}).items()}


def _type_names(types: str | None, tables: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the types that are flown in turn.

    Raises:
        ConfigError: an unknown one.
    """
    if types is None:
        types = "sih" if "sih" in tables else next(iter(tables), "")

    names = tuple(types.split(","))
    for name in names:
        if name not in tables:
            known = ", ".join(tables) or "none"
            raise ConfigError(f"--type: there is no vehicle type '{name}'. Known here: {known}.")
    return names


def _parsed_change(change: str) -> tuple[str, str, float | int | bool | str]:
    """Return group, key and value of ``[group.]key=value``; the perturbation has no group.

    Raises:
        ConfigError: it is not written so, there is no such key, or the value is not finite.
    """
    name, equals, text = change.partition("=")
    name = _ALIASES.get(name, name)

    problem = None
    if not equals:
        problem = "write it as key=value"
    elif name not in keys():
        problem = "there is no such key"
    if problem:
        raise ConfigError(f"--set {change}: {problem}. Keys: {', '.join(keys(with_aliases=True))}.")

    group, _, key = name.rpartition(".")
    return group, key, _value(change, text)


def _perturbed(
    perturbation: SimulatedErrors, change: str, key: str, value: float | int | bool | str
) -> SimulatedErrors:
    """Return a perturbation with one value changed.

    Raises:
        ConfigError: the value is no number, or out of bounds.
    """
    bounds = {entry.name: entry.metadata for entry in fields(SimulatedErrors)}
    low = bounds[key]["low"]
    high = bounds[key]["high"]
    if isinstance(value, (bool, str)) or not low <= value <= high:
        raise ConfigError(f"--set {change}: the value must be a number from {low:g} to {high:g}.")
    return replace(perturbation, **{key: float(value)})


def keys(*, with_aliases: bool = False) -> list[str]:
    """Return all keys of ``--set``.

    Args:
        with_aliases: the short names too.
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
    """Return the value of a change: a number, true or false, else the words.

    TOML refuses numbers such as ``.7``, which are taken here. Words may stand in quotes.
    """
    try:
        value: object = tomllib.loads(f"x = {text}")["x"]
    except tomllib.TOMLDecodeError:
        try:
            value = float(text)
        except ValueError:
            value = text

    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"--set {change}: the value must be finite.")
    if isinstance(value, float | int | str):
        return value
    return text  # a date, a list or a table, which no key takes


def _examples() -> dict[str, Any]:
    """Return the vehicle types of the example fleets, and nothing else of them."""
    types: dict[str, Any] = {}
    for name in _EXAMPLES:
        example, _, _ = read_toml(name, "fleet file")
        types |= example.get("types", {})
    return {"types": types}
