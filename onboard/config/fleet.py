"""Fleet files: frozen values, validated when loaded; unknown keys are errors that name file, key and remedy.

Precedence: a vehicle's own key, then its type's, then ``[defaults]``. Nothing here does I/O but :func:`load_fleet`.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import os
import re
import tomllib
from collections.abc import Mapping
from typing import Any, Literal, get_args

import msgspec

from onboard.config import mocap as mocap_config
from onboard.config import obstacles
from onboard.config import sitl as sitl_profile
from onboard.config.law import LawConfig as LawConfig
from onboard.config.law import LawName as LawName
from onboard.config.mocap import MocapConfig as MocapConfig
from onboard.config.sitl import SitlProfile as SitlProfile

SCHEMA = 1
Vec3 = tuple[float, float, float]


class ConfigError(ValueError):
    """Wrong input from a person: a sentence with file, key, bound and what to do. Exit status 2."""


class Origin(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Global origin of the fleet frame outdoors."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float


class Geofence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Box in fleet ENU; each axis (low, high) in metres."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]

    def contains(self, position_enu_m: Vec3, margin_m: float = 0.0) -> bool:
        """Whether the point lies in the box shrunk by ``margin_m`` (horizontally and at the top)."""
        x, y, z = position_enu_m
        return (
            self.x[0] + margin_m <= x <= self.x[1] - margin_m
            and self.y[0] + margin_m <= y <= self.y[1] - margin_m
            and self.z[0] - 0.5 <= z <= self.z[1] - margin_m
        )


class FleetSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[fleet]``: what holds for all vehicles."""

    name: str
    geofence_m: Geofence
    origin: Literal["mocap"] | Origin = "mocap"
    safety_distance_m: float = 0.80
    body_diameter_m: float = 0.50
    battery_warning_pct: float = 30.0
    battery_land_pct: float = 20.0
    direct_command_timeout_s: float = 0.3
    bus_lost_land_s: float = 5.0
    simulator: str | None = None

    @property
    def global_origin(self) -> Origin | None:
        """Where on Earth the fleet frame lies, if the file says so."""
        return self.origin if isinstance(self.origin, Origin) else None


class Vehicle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One vehicle with its type's and the defaults' values merged in."""

    name: str
    index: int
    system_id: int
    start_enu_m: Vec3
    agent: str
    autopilot: str
    direct: str | None = None
    mocap_body: str | None = None
    type: str = ""
    enabled: bool | Literal["scan"] = True
    mass_kg: float = 1.0
    hover_thrust_frac: float = 0.5
    attitude_delay_s: float = 0.04
    attitude_wn_rad_s: float = 11.0
    attitude_zeta: float = 0.6
    drag_1_s: float = 0.0
    max_tilt_deg: float = 25.0
    max_speed_m_s: float = 1.0
    max_acceleration_m_s2: float = 1.5
    mocap_required: bool = True
    px4_params: dict[str, float | int] = {}
    sitl: SitlProfile = SitlProfile()

    @property
    def body(self) -> str | None:
        """Name of this vehicle's mocap body; None when it flies without a mocap."""
        return self.mocap_body or (self.name if self.mocap_required else None)

    @property
    def lag_s(self) -> float:
        """Time over which the law predicts: dead time plus 2 zeta / wn of the attitude response."""
        return self.attitude_delay_s + 2.0 * self.attitude_zeta / self.attitude_wn_rad_s


class FleetConfig(msgspec.Struct, frozen=True):
    """A whole fleet file, resolved."""

    path: str
    fleet: FleetSection
    law: LawConfig
    formations: dict[str, dict[str, Vec3]]
    vehicles: dict[str, Vehicle]
    text: str
    obstacles: tuple[obstacles.Obstacle, ...] = ()
    mocap: MocapConfig = MocapConfig()

    @property
    def namespace(self) -> str:
        """Key prefix on the bus."""
        return f"covey/{self.fleet.name}"

    @property
    def config_hash(self) -> str:
        """Equal on all vehicles that read the same values; differing hashes refuse take-off."""
        parts = [self.fleet, self.law, self.formations, self.vehicles, self.obstacles, self.mocap]
        values = msgspec.json.encode(parts, order="deterministic")
        return hashlib.sha256(values).hexdigest()[:12]

    @property
    def enabled_names(self) -> tuple[str, ...]:
        """Vehicles that take part, in the order of the file."""
        return tuple(name for name, vehicle in self.vehicles.items() if vehicle.enabled is not False)

    @property
    def simulator_endpoint(self) -> str:
        """Where an emulator listens on the bus; by default the port below the lowest agent's."""
        if self.fleet.simulator:
            return self.fleet.simulator
        ports = [int(vehicle.agent.rsplit(":", 1)[1]) for vehicle in self.vehicles.values()]
        return f"tcp/127.0.0.1:{min(ports) - 1}"

    def select(self, vehicles: str | None, exclude: str | None = None) -> tuple[str, ...]:
        """Names for ``a,b`` or places ``0-2`` or ``all``, minus ``exclude``; ConfigError on an unknown one."""
        chosen = self.enabled_names if vehicles in (None, "", "all") else self._names(str(vehicles))
        excluded = self._names(exclude) if exclude else ()
        return tuple(name for name in chosen if name not in excluded)

    def _names(self, text: str) -> tuple[str, ...]:
        order = list(self.vehicles)
        names: list[str] = []
        for part in (piece.strip() for piece in text.split(",")):
            span = re.fullmatch(r"(\d+)(?:-(\d+))?", part)
            if part in self.vehicles:
                names.append(part)
            elif part == "all":
                names.extend(self.enabled_names)
            elif span:
                first, last = int(span[1]), int(span[2] or span[1])
                if first > last or last >= len(order):
                    raise ConfigError(
                        f"'{part}' selects no vehicle: places count from 0 to {len(order) - 1}, lower one first."
                    )
                names.extend(order[first : last + 1])
            else:
                raise ConfigError(f"'{part}' is not a vehicle of fleet '{self.fleet.name}': it has {', '.join(order)}.")
        return tuple(dict.fromkeys(names))


def load_fleet(path: str | os.PathLike[str]) -> FleetConfig:
    """Read and validate a fleet file.

    Raises:
        ConfigError: file missing, not TOML, unknown key, wrong type, value out of bounds, duplicated id.
    """
    data, text = read_toml(path, "fleet file")
    return fleet_from_mapping(data, path=os.fspath(path), text=text)


def read_toml(path: str | os.PathLike[str], what: str) -> tuple[dict[str, Any], str]:
    """The TOML data and text of a file, or a ConfigError that says what is wrong with it."""
    name = os.fspath(path)
    try:
        with open(name, encoding="utf-8") as file:
            text = file.read()
        return tomllib.loads(text), text
    except FileNotFoundError:
        kind = "missions" if what.startswith("mission") else "fleets"
        raise ConfigError(
            f"{name}: there is no such {what}. Give the path of an existing one, such as configs/{kind}/paper.toml."
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{name}: this {what} cannot be read ({error}). Check the path and its permissions."
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name}: not valid TOML: {error}. Correct that line.") from None


def fleet_from_mapping(data: Mapping[str, Any], *, path: str = "<fleet>", text: str = "") -> FleetConfig:
    """Resolve and validate the content of a fleet file; see :func:`load_fleet`."""
    check_schema(data, path)
    known = {"schema", "fleet", "law", "formations", "mocap", "obstacles", "types", "defaults", "vehicles"}
    for key in data:
        if key not in known:
            raise ConfigError(f"{path}: unknown key '{key}'. Known keys here: {', '.join(sorted(known))}.")
    for key in ("fleet", "vehicles"):
        if key not in data:
            raise ConfigError(f"{path}: the table '{key}' is missing. Add [{key}].")
    fleet = convert(data["fleet"], FleetSection, path, "fleet")
    law = convert(data.get("law", {}), LawConfig, path, "law")
    formations = convert(data.get("formations", {}), dict[str, dict[str, Vec3]], path, "formations")
    standing = convert(data.get("obstacles", []), tuple[obstacles.Obstacle, ...], path, "obstacles")
    mocap = convert(data.get("mocap", {}), MocapConfig, path, "mocap")
    types = _tables(data.get("types", {}), path, "types")
    defaults = _table(data.get("defaults", {}), path, "defaults")
    vehicles = {
        name: _vehicle(name, index, table, types, defaults, path)
        for index, (name, table) in enumerate(_tables(data["vehicles"], path, "vehicles").items())
    }
    config = FleetConfig(path, fleet, law, formations, vehicles, text, standing, mocap)
    _check(config)
    return config


def check_schema(data: Mapping[str, Any], path: str) -> None:
    """Refuse files of another schema version."""
    if data.get("schema") != SCHEMA:
        raise ConfigError(
            f"{path}: schema is {data.get('schema', 'missing')!r}, this version reads schema = {SCHEMA}. "
            f"Put 'schema = {SCHEMA}' on the first line."
        )


def convert(value: Any, kind: Any, path: str, key: str) -> Any:
    """``value`` as ``kind``, or a ConfigError that names file and key path."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at `")
        unknown = re.search(r"unknown field `(.+?)`", message)
        tail = where.rstrip("`").lstrip("$")
        if unknown:
            full = f"{key}{tail}.{unknown[1]}"
            inner = kind if not tail else next(iter(get_args(kind)), None) if re.fullmatch(r"\[\d+\]", tail) else None
            names = ", ".join(getattr(inner, "__struct_fields__", ()))
            known = f" Known keys here: {names}." if names else ""
            raise ConfigError(f"{path}: unknown key '{full}'.{known} Remove or correct it.") from None
        raise ConfigError(f"{path}: '{key}{tail}': {message}. Correct the value.") from None


def _table(value: Any, path: str, key: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(f"{path}: '{key}' must be a table, not {type(value).__name__}.")
    return value


def _tables(value: Any, path: str, key: str) -> dict[str, dict[str, Any]]:
    return {name: _table(table, path, f"{key}.{name}") for name, table in _table(value, path, key).items()}


_VEHICLE_ONLY = {"system_id", "start_enu_m", "agent", "autopilot", "direct", "mocap_body"}
_DERIVED = {"name", "index"}


def _vehicle(
    name: str,
    index: int,
    own: dict[str, Any],
    types: dict[str, dict[str, Any]],
    defaults: dict[str, Any],
    path: str,
) -> Vehicle:
    key = f"vehicles.{name}"
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", name):
        raise ConfigError(f"{path}: '{key}': a name has 1 to 40 of the characters A-Z a-z 0-9 _ -. Rename the vehicle.")
    type_name = own.get("type", defaults.get("type", ""))
    if type_name and type_name not in types:
        raise ConfigError(
            f"{path}: '{key}.type' is {type_name!r}, but there is no [types.{type_name}]. "
            f"Types of this file: {', '.join(types) or 'none'}."
        )
    type_table = types.get(type_name, {})
    known = set(Vehicle.__struct_fields__) - _DERIVED
    for where, table, allowed in (
        ("defaults", defaults, known - _VEHICLE_ONLY),
        (f"types.{type_name}", type_table, known - _VEHICLE_ONLY - {"type"}),
        (key, own, known),
    ):
        for entry in table:
            if entry not in allowed:
                raise ConfigError(
                    f"{path}: unknown key '{where}.{entry}'. Known keys here: {', '.join(sorted(allowed))}."
                )
    for entry in ("system_id", "start_enu_m", "agent", "autopilot"):
        if entry not in own:
            raise ConfigError(f"{path}: '{key}.{entry}' is missing. Every vehicle needs one of its own.")
    merged: dict[str, Any] = {"type": type_name}
    for table in (defaults, type_table, own):
        for entry, value in table.items():
            nested = entry in ("px4_params", "sitl") and isinstance(value, dict)
            merged[entry] = {**merged.get(entry, {}), **value} if nested else value
    convert(merged.get("sitl", {}), SitlProfile, path, f"{key}.sitl")  # names the keys that are known there
    return convert({**merged, "name": name, "index": index}, Vehicle, path, key)  # type: ignore[no-any-return]


_BOUNDS: dict[str, tuple[float, float]] = {
    "mass_kg": (0.02, 50.0),
    "hover_thrust_frac": (0.1, 0.9),
    "attitude_delay_s": (0.0, 0.5),
    "attitude_wn_rad_s": (1.0, 60.0),
    "attitude_zeta": (0.2, 2.0),
    "drag_1_s": (0.0, 5.0),
    "max_tilt_deg": (5.0, 45.0),
    "max_speed_m_s": (0.1, 10.0),
    "max_acceleration_m_s2": (0.1, 10.0),
    "system_id": (1, 255),
}
_AGENT_ENDPOINT = re.compile(r"tcp/(127\.\d+\.\d+\.\d+|localhost|\[::1\]|[A-Za-z0-9_.:\[\]-]+):(\d{1,5})")
_AUTOPILOT_ENDPOINT = re.compile(r"(udpin|udpout|serial)://.+")


def _check(config: FleetConfig) -> None:
    path, fleet = config.path, config.fleet
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", fleet.name):
        raise ConfigError(
            f"{path}: 'fleet.name' is {fleet.name!r}; use 1 to 40 of A-Z a-z 0-9 _ - (it names the bus keys)."
        )
    if not config.vehicles:
        raise ConfigError(f"{path}: 'vehicles' is empty. Add at least one [vehicles.NAME].")
    _bound(path, "fleet.safety_distance_m", fleet.safety_distance_m, 0.1, 50.0)
    _bound(path, "fleet.body_diameter_m", fleet.body_diameter_m, 0.02, fleet.safety_distance_m)
    _bound(path, "fleet.battery_warning_pct", fleet.battery_warning_pct, fleet.battery_land_pct, 100.0)
    _bound(path, "fleet.battery_land_pct", fleet.battery_land_pct, 8.0, 100.0)
    _bound(path, "fleet.direct_command_timeout_s", fleet.direct_command_timeout_s, 0.05, 5.0)
    _bound(path, "fleet.bus_lost_land_s", fleet.bus_lost_land_s, 0.5, 120.0)
    for axis in ("x", "y", "z"):
        low, high = getattr(fleet.geofence_m, axis)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ConfigError(
                f"{path}: 'fleet.geofence_m.{axis}' is [{low}, {high}]; give [low, high] with low < high."
            )
    for key in LawConfig.__struct_fields__:
        value = getattr(config.law, key)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            _bound(path, f"law.{key}", value, 0.0 if "margin" in key or "gain" in key else 1e-3, 100.0)
    if config.law.name == "paper" and len(config.enabled_names) > 3 and not config.law.paper_force_ring:
        raise ConfigError(
            f"{path}: 'law.name' is 'paper' for {len(config.enabled_names)} vehicles; its ring (each avoids the next) "
            "covers every pair only up to 3. Use law.name = 'covey', or set law.paper_force_ring = true to see it fail."
        )
    seen: dict[tuple[str, Any], str] = {}
    for name, vehicle in config.vehicles.items():
        for key, (low, high) in _BOUNDS.items():
            _bound(path, f"vehicles.{name}.{key}", getattr(vehicle, key), low, high)
        for key, (low, high) in sitl_profile.BOUNDS.items():
            value = getattr(vehicle.sitl, key)
            for number in value if isinstance(value, tuple) else (value,):
                _bound(path, f"vehicles.{name}.sitl.{key}", number, low, high)
        if not _AGENT_ENDPOINT.fullmatch(vehicle.agent):
            raise ConfigError(f"{path}: 'vehicles.{name}.agent' is {vehicle.agent!r}; write it as tcp/127.0.0.1:7460.")
        if not _AUTOPILOT_ENDPOINT.fullmatch(vehicle.autopilot):
            raise ConfigError(
                f"{path}: 'vehicles.{name}.autopilot' is {vehicle.autopilot!r}; write it as udpin://127.0.0.1:14540."
            )
        if not all(math.isfinite(value) for value in vehicle.start_enu_m):
            raise ConfigError(f"{path}: 'vehicles.{name}.start_enu_m' must be three finite numbers in metres.")
        if not fleet.geofence_m.contains(vehicle.start_enu_m):
            raise ConfigError(
                f"{path}: 'vehicles.{name}.start_enu_m' {list(vehicle.start_enu_m)} lies outside fleet.geofence_m. "
                "Move the start or widen the fence."
            )
        for key in ("system_id", "agent", "autopilot", "direct", "mocap_body"):
            value = getattr(vehicle, key)
            if value is None:
                continue
            other = seen.setdefault((key, value), name)
            if other != name:
                raise ConfigError(
                    f"{path}: 'vehicles.{name}.{key}' is {value!r}, which 'vehicles.{other}.{key}' has too. "
                    "Give each vehicle its own."
                )
    for sentence in mocap_config.problems(config.mocap, {name: v.body for name, v in config.vehicles.items()}):
        raise ConfigError(f"{path}: {sentence}")
    _check_obstacles(config)
    _check_spacing(config)


def _check_obstacles(config: FleetConfig) -> None:
    clearance_m = 0.5 * config.fleet.body_diameter_m + config.law.obstacle_margin_m
    starts = {name: vehicle.start_enu_m for name, vehicle in config.vehicles.items()}
    for sentence in obstacles.problems(config.obstacles, starts, clearance_m):
        raise ConfigError(f"{config.path}: {sentence}")


def _check_spacing(config: FleetConfig) -> None:
    path, fleet = config.path, config.fleet
    parking = parking_distance_m(config)
    names = config.enabled_names
    for first, second in itertools.combinations(names, 2):
        spacing = math.dist(config.vehicles[first].start_enu_m[:2], config.vehicles[second].start_enu_m[:2])
        if spacing < fleet.safety_distance_m:
            raise ConfigError(
                f"{path}: 'vehicles.{first}.start_enu_m' and 'vehicles.{second}.start_enu_m' are {spacing:.2f} m "
                f"apart; at least fleet.safety_distance_m = {fleet.safety_distance_m:.2f} m is needed. Move them apart."
            )
    for formation, slots in config.formations.items():
        for name in slots:
            if name not in config.vehicles:
                raise ConfigError(
                    f"{path}: 'formations.{formation}.{name}' names no vehicle of this fleet "
                    f"({', '.join(config.vehicles)}). Correct the name."
                )
        for first, second in itertools.combinations(slots, 2):
            spacing = math.dist(slots[first][:2], slots[second][:2])
            if spacing < parking:
                raise ConfigError(
                    f"{path}: slots 'formations.{formation}.{first}' and '.{second}' are {spacing:.2f} m apart; the "
                    f"law '{config.law.name}' can park vehicles at {parking:.2f} m or more. Spread the slots."
                )


def parking_distance_m(config: FleetConfig) -> float:
    """Smallest spacing at which two vehicles can hover next to each other under the configured law.

    Paper-exact law: sqrt(d_inf^2 + d_inf v_perp / kappa_3), since (8) forbids to hover closer. Covey's law: the design
    distance plus 0.10 m (measured: slots nearer than that are reached late or never).
    """
    law, d_inf = config.law, config.fleet.safety_distance_m
    if law.name == "paper":
        return math.sqrt(d_inf**2 + d_inf * law.paper_v_perp_m_s / law.paper_kappa_3_1_s)
    if law.name == "off":
        return config.fleet.body_diameter_m
    slowest_s = max((vehicle.lag_s for vehicle in config.vehicles.values()), default=0.0)
    return d_inf + law.margin_m(slowest_s) + 0.10


def _bound(path: str, key: str, value: float, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        raise ConfigError(f"{path}: '{key}' is {value}; it must lie between {low:g} and {high:g}.")
