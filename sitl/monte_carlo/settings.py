"""Everything that is chosen for a campaign: vehicles, law, errors, perturbation; and ``--set
key=value``.
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
    *(
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
    ),
    *("px4_version", "px4_params", "sitl", "mocap_required"),
)


def _from_to(default: float, low: float, high: float) -> float:
    value: float = field(default=default, metadata={"low": low, "high": high})
    return value


@dataclass(frozen=True, slots=True)
class Perturbation:
    """Errors that the control does not know, beside those of the estimate; each with its default
    and bounds.
    """

    # age of a message when it arrives, in whole ticks of 20 ms, at least one
    delay_s: float = _from_to(0.04, 0.0, 2.0)
    loss_share: float = _from_to(0.10, 0.0, 1.0)  # of each link's messages
    burst_s: float = _from_to(0.0, 0.0, 60.0)  # length of a sender's silences; 0 for none
    burst_every_s: float = _from_to(10.0, 0.1, 1e4)  # mean interval of a sender's silences
    gust_m_s2: float = _from_to(0.1, 0.0, 5.0)  # std per horizontal axis, correlated over 1 s
    # lag_mismatch, gain, drag_mismatch, hover_mismatch: half widths of uniform relative errors of
    # the lag and gain of the attitude, of drag and of hover throttle, constant per vehicle
    lag_mismatch: float = _from_to(0.10, 0.0, 0.9)
    lag_error_s: float = _from_to(0.0, 0.0, 1.0)  # added to the dead time
    gain: float = _from_to(0.05, 0.0, 0.9)
    drag_mismatch: float = _from_to(0.0, 0.0, 0.9)
    hover_mismatch: float = _from_to(0.0, 0.0, 0.5)


@dataclass(frozen=True, slots=True)
class ErrorClass:
    """Accuracy of the own estimate, per axis; correlated over a time unless that is 0.

    arrival_m, slow_m_s: a vehicle has arrived when it is truly this near its goal and this slow;
    three standard deviations wider than with a mocap, since it holds its estimate on the goal and
    not itself. law: values that a fleet of that accuracy flies with, where the fleet file does not
    say.
    """

    name: str
    position_std_m: float
    velocity_std_m_s: float
    position_time_s: float
    velocity_time_s: float
    arrival_m: float = 0.15
    slow_m_s: float = 0.15
    law: Mapping[str, float] = field(default_factory=dict)


ERRORS = {
    "none": ErrorClass("none", 0.0, 0.0, 0.0, 0.0),
    "mocap": ErrorClass("mocap", 0.003, 0.0, 0.0, 0.0),
    "vision": ErrorClass(
        *("vision", 0.05, 0.12, 0.5, 0.5),
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
        *("gps", 0.2, 0.2, 5.0, 0.7),
        arrival_m=0.75,
        slow_m_s=0.75,
    ),
}


@dataclass(frozen=True, slots=True)
class Setup:
    """One choice of everything but the scenario; ``types`` are given to the vehicles in turn."""

    law: str
    types: tuple[str, ...]
    type_tables: Mapping[str, Mapping[str, Any]]
    law_table: Mapping[str, Any]
    fleet_table: Mapping[str, Any]
    errors: ErrorClass
    perturbation: Perturbation
    scale: float = 1.0

    def fleet(self, count: int) -> FleetConfig:
        """A fleet of ``count`` vehicles, validated like any fleet file; ConfigError when the values
        do not go.
        """
        spacing = 2.0 + 10.0 * float(self.fleet_table.get("safety_distance_m", 0.8))
        vehicles = {
            f"v{i}": {
                "type": self.types[i % len(self.types)],
                "system_id": i + 1,
                "start_enu_m": [spacing * i, 0.0, 0.0],
                "agent": f"tcp/127.0.0.1:{20000 + i}",
                "autopilot": f"udpin://127.0.0.1:{30000 + i}",
            }
            for i in range(count)
        }
        wide = 1e6
        fleet = {
            **{key: self.fleet_table[key] for key in _FLEET_KEYS if key in self.fleet_table},
            "name": "campaign",
            "geofence_m": {"x": [-wide, wide], "y": [-wide, wide], "z": [-wide, wide]},
        }
        return fleet_from_mapping(
            {
                "schema": 1,
                "fleet": fleet,
                "law": {**self.law_table, "name": self.law},
                "radio": {
                    "expected_delay_s": self.perturbation.delay_s,
                    "expected_loss_frac": min(self.perturbation.loss_share, 0.9),
                },
                "types": {name: dict(table) for name, table in self.type_tables.items()},
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
        types: names separated by commas, given to the vehicles in turn (default: sih, or the fleet
            file's first).
        changes: ``key=value`` each; see :func:`keys`.
    Raises:
        ConfigError: unknown law, type, errors or key, a value out of bounds, or a fleet file that
            is wrong.
    """
    data = tomllib.loads(load_fleet(fleet_path).text) if fleet_path is not None else _examples()
    common = {
        key: value
        for key, value in data.get("defaults", {}).items()
        if key not in ("type", "enabled")
    }
    tables = {name: {**common, **table} for name, table in data.get("types", {}).items()}
    default = "sih" if "sih" in tables else next(iter(tables), "")
    names = tuple((default if types is None else types).split(","))
    for name in names:
        if name not in tables:
            raise ConfigError(
                f"--type: there is no vehicle type '{name}'. Known here: {', '.join(tables) or 'none'}."
            )
    if errors not in ERRORS:
        raise ConfigError(
            f"--errors is '{errors}', but there are only {', '.join(ERRORS)}. Name one of these."
        )
    given_law = dict(data.get("law", {}))
    law = str(given_law.get("name", "covey")) if law is None else law
    if fleet_path is not None:  # a law of one's own is looked for beside the file that names it
        given_law["folder"] = os.path.join(
            os.path.dirname(os.path.abspath(fleet_path)), given_law.get("folder", ".")
        )
    if not (math.isfinite(scale) and 0.1 <= scale <= 100.0):
        raise ConfigError(f"--scale is {scale}; it must lie between 0.1 and 100.")
    law_table: dict[str, Any] = {**ERRORS[errors].law, **given_law}
    fleet_table: dict[str, Any] = dict(data.get("fleet", {}))
    perturbation = Perturbation()
    for change in changes:
        key, equals, text = change.partition("=")
        key = _ALIASES.get(key, key)
        group, _, rest = key.rpartition(".")
        if not equals or key not in keys():
            raise ConfigError(
                f"--set {change}: {'there is no such key' if equals else 'write it as key=value'}. "
                f"Keys: {', '.join(keys(with_aliases=True))}."
            )
        value = _value(change, text)
        if group == "fleet":
            fleet_table[rest] = value
        elif group == "law":
            law_table[rest] = value
        elif group == "sitl":
            for name in names:
                tables[name]["sitl"] = {**tables[name].get("sitl", {}), rest: value}
        elif group == "vehicle":
            for name in names:
                tables[name][rest] = value
        else:
            low, high = next(
                entry.metadata.values() for entry in fields(Perturbation) if entry.name == key
            )
            if isinstance(value, (bool, str)) or not low <= value <= high:
                raise ConfigError(
                    f"--set {change}: the value must be a number from {low:g} to {high:g}."
                )
            perturbation = replace(perturbation, **{key: float(value)})
    return Setup(law, names, tables, law_table, fleet_table, ERRORS[errors], perturbation, scale)


def keys(*, with_aliases: bool = False) -> list[str]:
    """All keys of ``--set``; the short names too when asked for."""
    law = [f"law.{name}" for name in LawConfig.__struct_fields__ if name != "name"]
    vehicle = [
        f"vehicle.{name}" for name in Vehicle.__struct_fields__ if name not in _NOT_A_VEHICLE_VALUE
    ]
    sitl = [f"sitl.{name}" for name in SitlProfile.__struct_fields__]
    fleet = [f"fleet.{name}" for name in _FLEET_KEYS]
    short = [*_ALIASES] if with_aliases else []
    return [entry.name for entry in fields(Perturbation)] + short + fleet + law + vehicle + sitl


def _value(change: str, text: str) -> float | int | bool | str:
    """A number (also ``.7``, which TOML refuses), true or false, else the words, whose quotes may
    stand.
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
    return value if isinstance(value, float | int | str) else text


def _examples() -> dict[str, Any]:
    """The vehicle types of the example fleets; nothing else of them."""
    types: dict[str, Any] = {}
    for name in _EXAMPLES:
        types |= read_toml(name, "fleet file")[0].get("types", {})
    return {"types": types}
