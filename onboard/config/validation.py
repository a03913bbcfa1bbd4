"""Checks a whole fleet file: bounds, names, endpoints, duplicate values and spacing.

The first mistake raises a ConfigError. Each check yields sentences without the name of the file. A
check may rely on earlier checks, so only the first sentence counts.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from onboard.config import corrections, fences, folders, formation_shape, obstacles, people
from onboard.config import mocap as mocap_config
from onboard.config import radio as radio_config
from onboard.config import sitl as sitl_profile
from onboard.config.areas import START_BELOW_FLOOR_M
from onboard.config.earth import ALTITUDES_M, Origin, is_on_earth
from onboard.config.endpoints import (
    LAST_PORT,
    THIS_COMPUTER,
    canonical_host,
    do_overlap,
    host_of,
    is_host,
    split_serial,
)
from onboard.config.fleet_config import (
    FleetConfig,
    FleetSection,
    Vehicle,
    above_words,
    parking_distance_m,
    parking_height_share,
)
from onboard.config.law import LawConfig
from onboard.config.pair_separation import separation_m
from onboard.config.toml_reading import ConfigError, bound_problems

# bounds of numbers; a string names another key of [fleet], whose value is the bound
FLEET_BOUNDS: dict[str, tuple[float | str, float | str]] = {
    "safety_distance_m": (0.1, 50.0),
    "vertical_separation_m": (0.04, 50.0),
    "placing_m": (0.001, 5.0),
    "body_diameter_m": (0.02, "safety_distance_m"),
    "battery_land_pct": (8.0, 100.0),
    "battery_warning_pct": ("battery_land_pct", 100.0),
    "direct_command_timeout_s": (0.05, 5.0),
    "bus_lost_land_s": (0.5, 120.0),
    "ground_lost_land_s": (1.0, 3600.0),
    "max_wind_m_s": (0.1, 30.0),
}
GEOFENCE_BOUNDS: dict[str, tuple[float, float]] = {
    "x": (-fences.FARTHEST_M, fences.FARTHEST_M),
    "y": (-fences.FARTHEST_M, fences.FARTHEST_M),
    "z": (-fences.FARTHEST_M, fences.FARTHEST_M),
}
VEHICLE_BOUNDS: dict[str, tuple[float, float]] = {
    "hover_time_s": (10.0, 86400.0),
    "mass_kg": (0.02, 50.0),
    "hover_thrust_frac": (0.1, 0.9),
    "attitude_delay_s": (0.0, 0.5),
    "attitude_wn_rad_s": (1.0, 60.0),
    "attitude_zeta": (0.2, 2.0),
    "drag_1_s": (0.0, 5.0),
    "max_tilt_deg": (5.0, 45.0),
    "max_speed_m_s": (0.1, 10.0),
    "max_acceleration_m_s2": (0.1, 10.0),
    "max_wind_m_s": (0.1, 30.0),
    "system_id": (1, 255),
}
_LEAST_DRAG_1_S = 1e-6  # winds are pushes divided by the drag, and must stay numbers
_ROUNDING_M = 1e-9  # a distance between two written positions may be smaller by this than written
# Least vertical separation in body diameters. The downwash of a vehicle one body above pushes with
# 8 % of the weight, and that of a vehicle two bodies above with 3 %.
_MIN_HEIGHT_BODIES = 2.0
# One silent vehicle drives everybody in its range away by the margin, and finally to the walls.
_LARGEST_UNCOOPERATIVE_MARGIN_M = 1.0

_PX4_PARAM = re.compile(r"[A-Z][A-Z0-9_]{0,15}")  # MAVLink has room for 16 characters
# PX4 stores a parameter in 32 bits
_PX4_WHOLE_NUMBERS = (-(2.0**31), 2.0**31 - 1.0)
_PX4_NUMBERS = (-(2.0**128 - 2.0**104), 2.0**128 - 2.0**104)
_AGENT_ENDPOINT = re.compile(r"(tcp|quic|tls|udp)/[A-Za-z0-9_.:\[\]-]+:\d{1,5}")
_AUTOPILOT_ENDPOINT = re.compile(r"(udpin|udpout|serial)://.+")
_DIRECT_ENDPOINT = re.compile(r"(udpin|udpout|tcp)://.+:\d+")
_ALL_NETWORKS = re.compile(r"[a-z]+/(0\.0\.0\.0|\[::\]):")
_KEYED = ("quic/", "tls/")  # schemes of endpoints whose links use keys

# names that the keys of other nodes and of the certificate authority have; a fleet without keys may
# get them later
_KEY_NAMES = ("viewer", "mocap", "corrections", "router", "ca")

# first words of node names; agents recognise the kind of a node by them
_NODE_WORDS = ("ground", "watcher", "recorder", "sitl")

# Words that mean something else than a vehicle where an order names its vehicles, in small letters.
# `kill all` stops the whole fleet, and `kill 0-1` several vehicles.
_ORDER_WORD = re.compile(r"all|by|every|in|nearest|turned|yaw|\d+-\d+")

PX4_WITHOUT_SIGNING = ("1.16", "1.17")  # versions of PX4 that do not sign MAVLink


def check_fleet(config: FleetConfig, *, needs_folders: bool) -> None:
    """Check everything in a fleet file that the types of the values do not ensure.

    Args:
        config: a whole fleet file.
        needs_folders: see :func:`onboard.config.fleet.load_fleet`.
    Raises:
        ConfigError: the first mistake.
    """
    first = next(_problems(config, needs_folders=needs_folders), None)
    if first is not None:
        raise ConfigError(f"{config.path}: {first}")


def _problems(config: FleetConfig, *, needs_folders: bool) -> Iterator[str]:
    """Yield a sentence for each mistake, in the order of the checks."""
    yield from folders.keys_problems(config.fleet.keys, must_exist=needs_folders)
    yield from folders.law_problems(config.law.folder, must_exist=needs_folders)
    yield from _fleet_section_problems(config)
    yield from _law_problems(config)
    for vehicle in config.vehicles.values():
        yield from _vehicle_problems(config, vehicle)
    yield from _name_problems(config)
    yield from _double_problems(config)

    bodies = {name: vehicle.body for name, vehicle in config.vehicles.items()}
    yield from people.problems(config.people, bodies)
    bodies_by_key = {f"vehicles.{name}": body for name, body in bodies.items()}
    for name, body in config.people_bodies.items():
        bodies_by_key[f"people.{name}"] = body
    yield from mocap_config.problems(config.mocap, bodies_by_key)
    yield from radio_config.problems(config.radio)
    yield from _corrections_problems(config)

    clearance_m = 0.5 * config.fleet.body_diameter_m + config.law.obstacle_margin_m
    starts_enu_m = {name: vehicle.start_enu_m for name, vehicle in config.vehicles.items()}
    yield from obstacles.problems(config.obstacles, starts_enu_m, clearance_m)
    yield from fences.problems(
        config.fences, config.fleet.global_origin, starts_enu_m, config.law.fence_margin_m
    )

    yield from _start_problems(config)
    yield from _formation_problems(config)
    yield from _bus_problems(config)


def _fleet_section_problems(config: FleetConfig) -> Iterator[str]:
    fleet = config.fleet
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", fleet.name):
        yield (
            f"'fleet.name' is {fleet.name!r}; it is part of the bus keys. "
            "Use 1 to 40 of A-Z a-z 0-9 _ -."
        )
    if not config.vehicles:
        yield "'vehicles' is empty. Add at least one [vehicles.NAME]."

    for key, (lowest, highest) in FLEET_BOUNDS.items():
        value = getattr(fleet, key)
        if value is not None:
            low = _bound(fleet, lowest)
            high = _bound(fleet, highest)
            for sentence in bound_problems(f"fleet.{key}", value, low, high):
                yield sentence + _other_key(lowest, highest)

    yield from _vertical_problems(fleet, config.law)
    yield from _origin_problems(fleet.global_origin)

    for axis, bounds in GEOFENCE_BOUNDS.items():
        low, high = getattr(fleet.geofence_m, axis)
        for value in (low, high):
            yield from bound_problems(f"fleet.geofence_m.{axis}", value, *bounds)
        if low >= high:
            yield f"'fleet.geofence_m.{axis}' is [{low}, {high}]; give [low, high] with low < high."


def _origin_problems(origin: Origin | None) -> Iterator[str]:
    if origin is None:
        return
    if not is_on_earth(origin.latitude_deg, origin.longitude_deg):
        yield (
            f"'fleet.origin' is {origin.latitude_deg}, {origin.longitude_deg}, which is no place "
            "on Earth. Give latitude_deg within -90 to 90 and longitude_deg within -180 to 180."
        )
    yield from bound_problems("fleet.origin.altitude_m", origin.altitude_m, *ALTITUDES_M)


def _corrections_problems(config: FleetConfig) -> Iterator[str]:
    yield from corrections.problems(config.corrections, config.fleet.global_origin)
    if config.corrections is None:
        return
    if not any(map(config.takes_corrections, config.vehicles.values())):
        yield (
            "'corrections' are for vehicles that fly by satellites, and this fleet has none. "
            "Remove the table, or give a vehicle mocap_required = false and "
            'px4_position = "gps".'
        )


def _other_key(*bounds: float | str) -> str:
    """Return a sentence that names the key which is the bound of another; empty if none is."""
    for bound in bounds:
        if isinstance(bound, str):
            return f" One bound is 'fleet.{bound}'."
    return ""


def _bound(fleet: FleetSection, bound: float | str) -> float:
    """Return a bound, which may be the value of another key."""
    if isinstance(bound, str):
        return float(getattr(fleet, bound))
    return bound


def _vertical_problems(fleet: FleetSection, law: LawConfig) -> Iterator[str]:
    if fleet.vertical_separation_m is None:
        if law.passing_heights > 1:
            yield (
                "'law.passing_heights' is 2, and 'fleet.vertical_separation_m' is not given: "
                "without it nobody passes above anybody. Write vertical_separation_m, or remove "
                "passing_heights."
            )
        return

    least_m = _MIN_HEIGHT_BODIES * fleet.body_diameter_m
    if fleet.vertical_separation_m < least_m:
        yield (
            f"'fleet.vertical_separation_m' is {fleet.vertical_separation_m:g} m; a vehicle of "
            f"fleet.body_diameter_m = {fleet.body_diameter_m:g} m blows down on whoever flies less "
            f"than {least_m:g} m below it: a body's height, and the reach of its downwash. Write "
            "that or more, or remove the key."
        )
    if law.built_in == "paper":
        yield (
            "'fleet.vertical_separation_m' is given, and 'law.name' is 'paper', which knows no "
            "heights. Remove vertical_separation_m, or fly law.name = 'covey'."
        )


def _bus_problems(config: FleetConfig) -> Iterator[str]:
    endpoints = {
        f"vehicles.{name}.agent": vehicle.agent for name, vehicle in config.vehicles.items()
    }
    endpoints["fleet.simulator"] = config.simulator_endpoint
    for number, endpoint in enumerate(config.fleet.routers):
        endpoints[f"fleet.routers[{number}]"] = endpoint

    owners: dict[tuple[str, int], str] = {}  # host and port -> key
    for key, endpoint in endpoints.items():
        if not _AGENT_ENDPOINT.fullmatch(endpoint):
            yield f"'{key}' is {endpoint!r}; write it as quic/10.0.0.5:7447."
        yield from _address_problems(key, endpoint)

        _, _, address = endpoint.partition("/")
        owner = owners.setdefault((canonical_host(host_of(endpoint)), _port_of(endpoint)), key)
        if owner != key:
            yield (
                f"'{key}' and '{owner}' are both at {address}. Only one can listen there: change "
                "one of them."
            )
        if _ALL_NETWORKS.match(endpoint):
            yield (
                f"'{key}' is {endpoint!r}. The others connect to this address: name the one at "
                "which they reach this computer. With all networks at once nodes find each other "
                "one by one, in minutes."
            )

    without_keys = [key for key, endpoint in endpoints.items() if not endpoint.startswith(_KEYED)]
    if len(without_keys) == len(endpoints):
        return
    if without_keys:
        names = ", ".join(f"'{key}'" for key in without_keys)
        yield (
            f"{names} is without keys (tcp/ or udp/) among endpoints with keys. Use quic/ for all, "
            "or for none."
        )


def _port_of(endpoint: str) -> int:
    """Return the port of a checked endpoint."""
    _, _, port = endpoint.rpartition(":")
    return int(port)


def _address_problems(key: str, endpoint: str) -> Iterator[str]:
    """Yield a sentence if an endpoint has a device, a host or a port that cannot be opened."""
    if endpoint.startswith("serial://"):
        try:
            split_serial(endpoint)
        except ValueError:
            yield (
                f"'{key}' is {endpoint!r}, which has no device and baud rate. Write it as "
                "serial:///dev/ttyAMA0:921600, with a baud rate that serial devices have."
            )
        return

    _, _, port = endpoint.rpartition(":")
    if not is_host(host_of(endpoint)) or not port.isdecimal():
        yield (
            f"'{key}' is {endpoint!r}, which does not end in a host and a port. Write HOST:PORT, "
            "where HOST is a name, an IPv4 address or an IPv6 address in brackets."
        )
    is_port = len(port) <= len(str(LAST_PORT)) and 1 <= int(port) <= LAST_PORT
    if not is_port:
        yield f"'{key}' is {endpoint!r}; a port is a number from 1 to {LAST_PORT}."


def law_bounds(key: str) -> tuple[float, float]:
    """Return the bounds of a number of ``[law]``.

    Args:
        key: key of the number.
    Returns:
        least and largest value.
    """
    if key == "uncooperative_margin_m":
        return 0.0, _LARGEST_UNCOOPERATIVE_MARGIN_M

    least = 1e-3
    if "margin" in key or "gain" in key:  # margins and the shortfall gain may be 0
        least = 0.0
    return least, 100.0


def _law_problems(config: FleetConfig) -> Iterator[str]:
    law = config.law
    for key in LawConfig.__struct_fields__:
        value = getattr(law, key)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            yield from bound_problems(f"law.{key}", value, *law_bounds(key))

    is_large = len(config.enabled_names) > 3
    if law.built_in == "paper" and is_large and not law.paper_force_ring:
        yield (
            f"'law.name' is 'paper' for {len(config.enabled_names)} vehicles. In the paper's ring "
            "each vehicle avoids only the next one, so with more than 3 some pairs do not avoid "
            "each other. Use law.name = 'covey', or set law.paper_force_ring = true to fly it all "
            "the same, in simulation."
        )


def _serial_device(written: str) -> str:
    """Return the device that somebody has written without its scheme, or an example of one."""
    if written.startswith("/dev/"):
        return written
    return "/dev/ttyAMA0"


def _vehicle_problems(config: FleetConfig, vehicle: Vehicle) -> Iterator[str]:
    name = vehicle.name
    for key, (low, high) in VEHICLE_BOUNDS.items():
        value = getattr(vehicle, key)
        if value is not None:
            yield from bound_problems(f"vehicles.{name}.{key}", value, low, high)
    if 0.0 < vehicle.drag_1_s < _LEAST_DRAG_1_S:
        yield (
            f"'vehicles.{name}.drag_1_s' is {vehicle.drag_1_s}; it must be 0, where it is not "
            f"known, or at least {_LEAST_DRAG_1_S:g}."
        )

    for key, (low, high) in sitl_profile.BOUNDS.items():
        numbers = getattr(vehicle.sitl, key)
        if not isinstance(numbers, tuple):
            numbers = (numbers,)
        for number in numbers:
            yield from bound_problems(f"vehicles.{name}.sitl.{key}", number, low, high)

    yield from _endpoint_problems(vehicle)
    yield from _px4_param_problems(vehicle)
    if vehicle.mavlink_signing and vehicle.px4_version in PX4_WITHOUT_SIGNING:
        yield (
            f"'vehicles.{name}.mavlink_signing' is true, but PX4 v{vehicle.px4_version} "
            "('px4_version') can neither sign nor check. Fly v1.18 and write "
            'px4_version = "1.18", or remove mavlink_signing.'
        )

    if not all(math.isfinite(value) for value in vehicle.start_enu_m):
        yield f"'vehicles.{name}.start_enu_m' must be three finite numbers in metres."
    if not config.fleet.geofence_m.contains(vehicle.start_enu_m):
        yield (
            f"'vehicles.{name}.start_enu_m' {list(vehicle.start_enu_m)} lies outside "
            "fleet.geofence_m. Move the start or widen the fence."
        )
        return

    floor_m, _ = config.fleet.geofence_m.z
    _, _, start_m = vehicle.start_enu_m
    if start_m < floor_m - START_BELOW_FLOOR_M:
        yield (
            f"'vehicles.{name}.start_enu_m' {list(vehicle.start_enu_m)} lies "
            f"{floor_m - start_m:g} m below the floor of fleet.geofence_m, so the vehicle would "
            "cross the fence on the ground. Lower the floor to the ground."
        )


def _endpoint_problems(vehicle: Vehicle) -> Iterator[str]:
    """Yield a sentence for each endpoint of a vehicle that cannot be opened."""
    name = vehicle.name
    if not _AGENT_ENDPOINT.fullmatch(vehicle.agent):
        yield f"'vehicles.{name}.agent' is {vehicle.agent!r}; write it as tcp/127.0.0.1:7460."
    if not _AUTOPILOT_ENDPOINT.fullmatch(vehicle.autopilot):
        yield (
            f"'vehicles.{name}.autopilot' is {vehicle.autopilot!r}; write it as "
            "udpin://127.0.0.1:14540, with a port of its own, or as "
            f"serial://{_serial_device(vehicle.autopilot)}:921600."
        )
    if vehicle.direct is not None and not _DIRECT_ENDPOINT.fullmatch(vehicle.direct):
        yield (
            f"'vehicles.{name}.direct' is {vehicle.direct!r}; write it as "
            "udpout://127.0.0.1:18570, with a port of its own."
        )
    for key in ("agent", "autopilot", "direct"):
        endpoint = getattr(vehicle, key)
        if endpoint is not None:
            yield from _address_problems(f"vehicles.{name}.{key}", endpoint)
    if vehicle.direct is not None and host_of(vehicle.direct).startswith("["):
        yield (
            f"'vehicles.{name}.direct' is {vehicle.direct!r}; the ground cannot open links to IPv6 "
            "addresses. Write PX4's IPv4 address or its name."
        )


def _px4_param_problems(vehicle: Vehicle) -> Iterator[str]:
    """Yield a sentence for each name and each value that no parameter of PX4 can have."""
    for param, value in vehicle.px4_params.items():
        if not _PX4_PARAM.fullmatch(param):
            yield (
                f"'vehicles.{vehicle.name}.px4_params' has {param[:40]!r}; a parameter of PX4 has "
                "up to 16 of the characters A-Z 0-9 _, for instance MPC_Z_P."
            )
        bounds = _PX4_NUMBERS
        if isinstance(value, int):
            bounds = _PX4_WHOLE_NUMBERS
        yield from bound_problems(f"vehicles.{vehicle.name}.px4_params.{param}", value, *bounds)


def _name_problems(config: FleetConfig) -> Iterator[str]:
    """Yield a sentence for each vehicle whose name means something else to agents or in orders."""
    for name in config.vehicles:
        first_word, _, _ = name.partition("-")
        if first_word in _NODE_WORDS:
            yield (
                f"A vehicle is named '{name}', as nodes of the kind '{first_word}' are. Give it "
                "another name."
            )
        if name in _KEY_NAMES:
            yield (
                f"A vehicle is named '{name}', which is the name of another node's key. Give it "
                "another name."
            )
        if _ORDER_WORD.fullmatch(name.lower()):
            yield (
                f"A vehicle is named '{name}', which means something else in an order such as "
                f"'kill {name}'. Give it another name."
            )


def _double_problems(config: FleetConfig) -> Iterator[str]:
    """Yield a sentence for each value that two vehicles share although it must be unique."""
    owners: dict[tuple[str, Any], str] = {}  # key and value -> vehicle
    for name, vehicle in config.vehicles.items():
        for key in ("system_id", "mocap_body"):
            value = getattr(vehicle, key)
            if value is None:
                continue
            owner = owners.setdefault((key, value), name)
            if owner != name:
                yield (
                    f"'vehicles.{name}.{key}' is {value!r}, which 'vehicles.{owner}.{key}' has "
                    "too. Give each vehicle its own."
                )
    yield from _link_problems(config)


class _Link(NamedTuple):
    """A vehicle's link to its PX4."""

    vehicle: str
    key: str
    endpoint: str
    computer: str  # whose port or serial device it is; empty for a port of PX4
    place: str  # scheme and port, or the serial device
    host: str  # in one spelling; empty for a serial device


def _link_problems(config: FleetConfig) -> Iterator[str]:
    """Yield a sentence for each port and each serial device that two links to PX4 have."""
    links: dict[tuple[str, str], list[_Link]] = {}  # computer and place -> links
    for link in _links(config):
        others = links.setdefault((link.computer, link.place), [])
        for other in others:
            # the ground may send to the same port of PX4 as the vehicle's own agent
            is_own_px4 = not link.computer and link.vehicle == other.vehicle
            if not is_own_px4 and do_overlap(link.host, other.host):
                where = ""
                if link.computer:
                    where = f", on the same computer, {link.computer}"
                yield (
                    f"'{link.key}' is {link.endpoint!r}, and '{other.key}' is {other.endpoint!r}: "
                    f"the same port or device{where}. Give each its own."
                )
        others.append(link)


def _links(config: FleetConfig) -> Iterator[_Link]:
    """Yield the links of all vehicles to their PX4."""
    for name, vehicle in config.vehicles.items():
        # each companion has ports and serial devices of its own; the ground opens `direct`
        for key, opener in (("autopilot", vehicle.host), ("direct", THIS_COMPUTER)):
            endpoint = getattr(vehicle, key)
            if endpoint is None:
                continue

            scheme, _, _ = endpoint.partition(":")
            computer = ""
            if scheme in ("serial", "udpin"):
                computer = canonical_host(opener)

            if scheme == "serial":
                place, _ = split_serial(endpoint)
                host = ""
            else:
                place = f"{scheme} {_port_of(endpoint)}"
                host = canonical_host(host_of(endpoint))

            yield _Link(
                vehicle=name,
                key=f"vehicles.{name}.{key}",
                endpoint=endpoint,
                computer=computer,
                place=place,
                host=host,
            )


def _start_problems(config: FleetConfig) -> Iterator[str]:
    safety_m = config.fleet.safety_distance_m
    for first, second in itertools.combinations(config.enabled_names, 2):
        first_enu_m = config.vehicles[first].start_enu_m
        second_enu_m = config.vehicles[second].start_enu_m
        spacing_m = math.dist(first_enu_m[:2], second_enu_m[:2])
        if spacing_m < safety_m - _ROUNDING_M:
            yield (
                f"'vehicles.{first}.start_enu_m' and 'vehicles.{second}.start_enu_m' are "
                f"{spacing_m:.2f} m apart; at least fleet.safety_distance_m = {safety_m:.2f} m is "
                "needed. Move them apart."
            )


def _formation_problems(config: FleetConfig) -> Iterator[str]:
    yield from formation_shape.problems(config.shapes)

    parking_m = parking_distance_m(config)
    height_share = parking_height_share(config)
    above = above_words(parking_m, height_share)
    for formation, slots in config.formations.items():
        for name in slots:
            if name not in config.vehicles:
                yield (
                    f"'formations.{formation}.{name}' names no vehicle of this fleet "
                    f"({', '.join(config.vehicles)}). Correct the name."
                )

        for first, second in itertools.combinations(slots, 2):
            spacing_m = separation_m(slots[first], slots[second], height_share)
            if spacing_m < parking_m - _ROUNDING_M:
                yield (
                    f"slots 'formations.{formation}.{first}' and '.{second}' are {spacing_m:.2f} m "
                    f"apart; the law '{config.law.name}' can park vehicles at {parking_m:.2f} m or "
                    f"more{above}. Spread the slots."
                )
