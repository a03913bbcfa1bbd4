"""Writes a commented fleet file and a first mission from a few answers.

Both are checked as if they were flown now, before they are returned.
"""

from __future__ import annotations

import contextlib
import ipaddress
import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from json import dumps
from typing import Literal, get_args

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import refuse_unflyable
from groundstation.processes.free_ports import port_of_index
from groundstation.starter.layout import Plan, grid, half_width_m, ring
from onboard.config.example_files import EXAMPLES
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, read_toml
from onboard.config.mocap import SystemType

Position = Literal["optitrack", "vicon", "qualisys", "vrpn", "motionanalysis", "bus", "gps"]
_CAMERAS = (
    "Take --position bus. Where a program of yours knows each vehicle's pose in one common frame, "
    "publish the poses: docs/mocap.md. Where each vehicle's camera sends its own PX4 odometry, "
    'write mocap_required = false and px4_position = "vision" into the type of the fleet file: '
    "docs/px4-sitl.md."
)
# sources of positions that are not asked for, each with what to do instead
NOT_POSITIONS = {
    "vision": _CAMERAS,
    "uwb": (
        "No radio beacons are read by Covey. Where a program of yours knows each vehicle's pose, "
        "take --position bus, and publish the poses: docs/mocap.md."
    ),
    "mocap": "Take the name of your motion capture, or --position bus for poses of your own.",
    "rtk": "RTK is satellites for PX4: take --position gps.",
    "gnss": "Take --position gps.",
    "vio": _CAMERAS,
}
HERE = "here"  # answer for the companions if agents and PX4s run on this machine
MOST = 200  # vehicles; MAVLink has 255 system ids, and other programs use some of them
_LAST_HOST = 254  # last number of the last address of a network; 255 means all of its computers
_MAX_AT_50_HZ = 8  # vehicles that can send all their states over one radio channel
_FIRST_PORT = 7460  # port of the first agent
_FIRST_DIRECT_PORT = 18570  # port of the first PX4 past its companion

# First ports of PX4: to its companion, and direct. From the eleventh instance on PX4's own ports
# collide, so others are used.
_PX4_INSTANCES = 10
_PORTS = (14540, 18570)
_PORTS_FROM_TEN = (15550, 19580)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """The answers from which a new fleet file is written."""

    name: str = "fleet"
    vehicles: int = 3
    position: Position = "bus"
    mocap_host: str = "192.168.1.2"
    origin: str = "47.397742,8.545594,489.4"  # latitude, longitude [deg], altitude [m]
    companions: str = HERE  # first address of the companion computers, or all of them
    autopilot: str = "serial:///dev/ttyAMA0:921600"  # as each companion sees its PX4
    spacing_m: float | None = None
    type: str = "quad"
    mass_kg: float = 1.0

    @property
    def is_outdoors(self) -> bool:
        """Whether the vehicles fly by satellites."""
        return self.position == "gps"


@dataclass(frozen=True, slots=True)
class Starter:
    """The texts of the new files, and their contents as values."""

    fleet_text: str
    mission_text: str
    fleet: FleetConfig
    mission: Mission


def refuse_wrong_answer(key: str, answers: Answers) -> None:
    """Refuse one answer by itself; whether the law can fly such a fleet is not checked here.

    Args:
        key: name of the answer, a field of Answers.
        answers: the answers so far. The number of vehicles counts for their companions.

    Raises:
        ConfigError: the answer is wrong.
    """
    value = getattr(answers, key)
    if isinstance(value, str) and not value.isprintable():
        raise ConfigError(
            f"--{key.replace('_', '-')} is {value!r}; it has characters that cannot be printed."
            " Write it without them."
        )
    if key == "vehicles" and not 1 <= answers.vehicles <= MOST:
        raise ConfigError(f"--vehicles is {answers.vehicles}; it must lie between 1 and {MOST}.")

    spacing_m = answers.spacing_m
    if key == "spacing_m" and spacing_m is not None and not 0.1 <= spacing_m <= 100.0:
        raise ConfigError(f"--spacing is {spacing_m:g}; it must lie between 0.1 and 100 m.")

    if key == "type" and not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", answers.type):
        raise ConfigError(
            f"--type is {answers.type!r}; a type has 1 to 40 of A-Z a-z 0-9 _ - as its name."
        )
    if key == "companions":
        companion_addresses(answers.companions, answers.vehicles)
    if key == "origin":
        _origin_of(answers.origin)


def starter(answers: Answers) -> Starter:
    """Write fleet file and mission, and check both as if they were flown now.

    Args:
        answers: answers of the user.

    Returns:
        The files.

    Raises:
        ConfigError: an answer is wrong, or the law cannot fly such a fleet.
    """
    for field in fields(answers):
        refuse_wrong_answer(field.name, answers)

    # positions by satellites are wrong by metres, those of a motion capture by millimetres
    default_spacing_m = 1.6
    wider_in_ring = 1.1
    if answers.is_outdoors:
        default_spacing_m = 4.0
        wider_in_ring = 1.3
    spacing_m = default_spacing_m
    if answers.spacing_m is not None:
        spacing_m = answers.spacing_m

    names = [f"mav{index}" for index in range(answers.vehicles)]
    spots = grid(answers.vehicles, spacing_m)
    slots = ring(answers.vehicles, wider_in_ring * spacing_m, spots)
    fleet_text = _fleet_text(answers, names, spots, slots, spacing_m)
    fleet = fleet_from_mapping(tomllib.loads(fleet_text), path="fleet.toml", text=fleet_text)
    mission_text = _mission_text(answers, fleet, _timeout_s(spots, slots, answers))
    mission = mission_from_mapping(
        tomllib.loads(mission_text), path="mission.toml", text=mission_text, fleet=fleet
    )
    refuse_unflyable(mission, is_simulated=False)
    return Starter(fleet_text=fleet_text, mission_text=mission_text, fleet=fleet, mission=mission)


def type_names() -> list[str]:
    """Return the names of the example vehicle types; any other name is a new, cautious type."""
    return sorted(_example_types())


def _example_types() -> dict[str, dict[str, object]]:
    types: dict[str, dict[str, object]] = {}
    for name in ("sih", "paper"):
        data, *_ = read_toml(f"{EXAMPLES}/fleets/{name}.toml", "fleet file")
        types |= data["types"]
    return types


def _fleet_text(
    answers: Answers, names: Sequence[str], spots: list[Plan], slots: list[Plan], spacing_m: float
) -> str:
    """Return the text of the fleet file."""
    if answers.is_outdoors:
        room_m = 2.0 * spacing_m
        heights_m = [-1.0, 10.0]
        promise_m = 1.2
    else:
        room_m = 1.5
        heights_m = [0.0, 3.0]
        promise_m = 0.8
    half_m = half_width_m([*spots, *slots], room_m)
    side = [-half_m, half_m]

    lines = [
        "# Written by covey init. docs/fleet-file.md explains every key; covey check says whether "
        "it can be flown.",
        "schema = 1",
        "",
        "[fleet]",
        f"name = {_toml_text(answers.name)}  # a part of the names on the bus: one for each fleet "
        "of your network",
        *_origin(answers),
        f"safety_distance_m = {promise_m:.2f}  # centres are never nearer",
        "body_diameter_m = 0.50  # from propeller tip to propeller tip: measure yours",
        "# the box that nobody leaves, fleet frame: x east, y north, z up. Measure your net",
        f"geofence_m = {{ x = {side}, y = {side}, z = {heights_m} }}",
        "battery_warning_pct = 30",
        "battery_land_pct = 20  # a vehicle below it lands by itself",
        "",
        "[law]",
        'name = "covey"',
        *law_lines(answers),
        *_mocap(answers, names),
        *_radio(answers),
        *_corrections(answers),
        "",
        "[formations.ring]  # offsets from the formation's position: east, north, up",
    ]
    for name, (x, y) in zip(names, slots, strict=True):
        lines.append(f"{name} = [{x}, {y}, 0.0]")

    lines += ["", *type_lines(answers), "", "[defaults]", f'type = "{answers.type}"']
    for table in _vehicles(answers, names, spots):
        lines += table
    return "\n".join(lines) + "\n"


def _toml_text(text: str) -> str:
    """Return a printable text as a string of TOML: one of JSON, without pairs of surrogates."""
    return dumps(text, ensure_ascii=False)


def _radio(answers: Answers) -> list[str]:
    if answers.companions == HERE or answers.vehicles <= _MAX_AT_50_HZ:
        return []
    return [
        "",
        "[radio]  # the Wi-Fi that all share; covey check computes what they take of it",
        "states_hz = 25",
    ]


def _corrections(answers: Answers) -> list[str]:
    if not answers.is_outdoors:
        return []
    return [
        "",
        "# RTK: with corrections from a base positions are wrong by centimetres. Take the # away",
        "# once you have a source: a receiver of yours on a cable, a caster (ntrip), or tcp.",
        "# docs/corrections.md; then: covey corrections --fleet fleet.toml --check",
        "# [corrections]",
        '# source = "serial"',
        '# address = "/dev/ttyUSB0"',
        '# fix = "rtk_fixed"  # nobody takes off without',
    ]


def _origin(answers: Answers) -> list[str]:
    if not answers.is_outdoors:
        return ['origin = "mocap"  # the fleet frame is the motion capture\'s']
    latitude, longitude, altitude = _origin_of(answers.origin)
    return [
        "# the point of the Earth that is 0, 0, 0 of the fleet frame: the same in every vehicle's "
        "file",
        f"origin = {{ latitude_deg = {latitude}, longitude_deg = {longitude}, "
        f"altitude_m = {altitude} }}",
    ]


def _origin_of(words: str) -> tuple[float, float, float]:
    """Return latitude, longitude [deg] and altitude [m].

    Raises:
        ConfigError: these are not three numbers.
    """
    try:
        latitude, longitude, altitude = (float(part) for part in words.split(","))
    except ValueError:
        raise ConfigError(
            f"--origin is '{words}'; write LATITUDE,LONGITUDE,ALTITUDE in degrees and "
            "metres, such as 47.397742,8.545594,489.4."
        ) from None
    return latitude, longitude, altitude


def law_lines(answers: Answers) -> list[str]:
    """Return the lines of ``[law]`` after its name."""
    if not answers.is_outdoors:
        return []
    return [
        "# positions of satellites are wrong by 0.2 m and 0.2 m/s for seconds: what that costs",
        'margin = "fixed"',
        "design_margin_m = 1.5",
        "shortfall_gain = 0.6",
        "v_perp_m_s = 0.5",
        "v_perp_crowd_m_s = 0.7",
        "range_m = 15.0",
    ]


def _mocap(answers: Answers, names: Sequence[str]) -> list[str]:
    """Return the lines of the table [mocap], or a comment in its place."""
    if answers.position == "bus":
        return [
            "",
            "# No [mocap]: somebody publishes each vehicle's pose on the bus. In simulation covey "
            "sitl does",
        ]
    if answers.position not in get_args(SystemType):
        return []

    up = "z"
    if answers.position in ("optitrack", "motionanalysis"):
        up = "y"
    listed = ", ".join(names[:3])
    if len(names) > 3:
        listed += ", ..."
    return [
        "",
        "[mocap]  # docs/mocap.md",
        'source = "motioncapture"',
        f'type = "{answers.position}"',
        f"hostname = {_toml_text(answers.mocap_host)}  # the computer on which its program runs",
        f'up = "{up}"  # the axis that points up, as that program streams it: look there',
        "yaw_deg = 0.0  # then turn about up until its x axis is the fleet's east",
        "latency_s = 0.010  # covey mocap --check measures it",
        f"# name the bodies there {listed}, nose along x, z up",
    ]


def type_lines(answers: Answers) -> list[str]:
    """Return the lines of the table of the vehicle type, with its table for the emulator."""
    if answers.is_outdoors:
        position = [
            "mocap_required = false",
            'px4_position = "gps"',
            "# satellites for place and speed, not for height, which wanders by a metre with them",
            "px4_params = { EKF2_GPS_CTRL = 5 }",
        ]
    else:
        position = ["mocap_required = true"]

    head = f"[types.{answers.type}]"
    known = _example_types().get(answers.type)
    if known is not None:
        values = [f"{key} = {value}" for key, value in known.items() if isinstance(value, float)]
        emulated = known.get("sitl")
        emulated_values = []
        if isinstance(emulated, dict):
            emulated_values = [f"{key} = {value}" for key, value in emulated.items()]
        return [
            head,
            *values,
            *position,
            "",
            f"[types.{answers.type}.sitl]  # of the emulator only",
            *emulated_values,
        ]

    top_speed_m_s = 1.0
    if answers.is_outdoors:
        top_speed_m_s = 1.3
    return [
        head,
        f"mass_kg = {answers.mass_kg}  # with battery",
        "# The next five are cautious values of a quadrotor of 0.3 to 3 kg. Fly one vehicle alone "
        "with them,",
        "# then put in what covey identify measures.",
        "hover_thrust_frac = 0.5  # the throttle that hovers: MPC_THR_HOVER of a tuned PX4",
        "attitude_delay_s = 0.04",
        "attitude_wn_rad_s = 9.0  # how quickly it tilts; a lower value keeps more distance",
        "attitude_zeta = 0.7",
        "drag_1_s = 0.3",
        "max_tilt_deg = 25.0",
        f"max_speed_m_s = {top_speed_m_s}",
        *position,
    ]


def _vehicles(answers: Answers, names: Sequence[str], spots: list[Plan]) -> list[list[str]]:
    hosts = companion_addresses(answers.companions, len(names))
    tables = []
    for index, (name, host, (x, y)) in enumerate(zip(names, hosts, spots, strict=True)):
        lines = [
            "",
            f"[vehicles.{name}]",
            f"system_id = {index + 1}  # MAV_SYS_ID of its PX4",
            f"start_enu_m = [{x}, {y}, 0.0]",
        ]
        if answers.companions == HERE:
            lines += endpoint_lines(index)
        else:
            lines.append(
                f"agent = {_toml_text(f'tcp/{host}:{_FIRST_PORT}')}  # its companion computer"
            )
            lines.append(
                f"autopilot = {_toml_text(answers.autopilot)}  # PX4 as that computer sees it"
            )
            lines.append(
                f'# direct = "udpout://ADDRESS:{_FIRST_DIRECT_PORT}"  # PX4 past the companion'
            )
        if not answers.is_outdoors:
            lines.append(f'mocap_body = "{name}"')
        tables.append(lines)
    return tables


def endpoint_lines(index: int) -> list[str]:
    """Return agent, autopilot and direct endpoint of a vehicle whose PX4 runs on this machine.

    Args:
        index: index of PX4's instance, from 0.
    """
    first_onboard, first_direct = _PORTS
    number = index
    if index >= _PX4_INSTANCES:
        first_onboard, first_direct = _PORTS_FROM_TEN
        number = index - _PX4_INSTANCES
    return [
        f'agent = "tcp/127.0.0.1:{_FIRST_PORT + index}"',
        f'autopilot = "udpin://127.0.0.1:{port_of_index(first_onboard, number)}"',
        f'direct = "udpout://127.0.0.1:{first_direct + number}"',
    ]


def companion_addresses(words: str, count: int) -> list[str]:
    """Return the address of each vehicle's companion computer.

    Args:
        words: ``here``, or the first IPv4 address, which is counted up, or all addresses separated
            by commas.
        count: number of vehicles.

    Returns:
        One address for each vehicle.

    Raises:
        ConfigError: the number of addresses is wrong, or the first one cannot be counted up within
            its network.
    """
    if words == HERE:
        return ["127.0.0.1"] * count

    given = [word.strip() for word in words.split(",")]
    if len(given) == count:
        return given
    first: ipaddress.IPv4Address | None = None
    with contextlib.suppress(ValueError):
        first = ipaddress.IPv4Address(given[0])
    if first is not None and len(given) == 1:
        last_of_first = _LAST_HOST - count + 1
        if not 1 <= first.packed[-1] <= last_of_first:
            raise ConfigError(
                f"--companions is '{words}'; counted up for {count} vehicles, addresses would not "
                f"end in 1 to {_LAST_HOST}. Give a first address that ends in 1 to "
                f"{last_of_first}, or all {count} with commas between."
            )
        return [str(first + index) for index in range(count)]
    raise ConfigError(
        f"--companions is '{words}'; give '{HERE}', the first address (192.168.1.11), from which "
        f"is counted up, or all {count} with commas between."
    )


def _timeout_s(spots: list[Plan], slots: list[Plan], answers: Answers) -> int:
    """Return the timeout [s] of a change of formation, with time for detours."""
    longest_m = max(math.dist(spot, slot) for spot, slot in zip(spots, slots, strict=True))
    return 30 + 10 * math.ceil(0.5 * longest_m + 0.1 * answers.vehicles)


def _mission_text(answers: Answers, fleet: FleetConfig, ring_timeout_s: int) -> str:
    """Return the text of the first mission: take-off, ring, move, landing."""
    height_m = 1.0
    arrived_within_m = 0.15
    if answers.is_outdoors:
        height_m = 2.5
        arrived_within_m = 1.5
    return f"""\
# A first mission, written by covey init: take off, form a ring, move it, land.
# docs/mission-file.md explains every key.
# Simulated: covey fly mission.toml --lockstep, or with console and real processes:
# covey fly mission.toml --sitl
schema = 1
fleet = "fleet.toml"

[[step]]
do = "takeoff"
height_m = {height_m}
timeout_s = 60

[[step]]
do = "formation"
name = "ring"
position_enu_m = [0.0, 0.0, {height_m}]
timeout_s = {ring_timeout_s}

[[step]]
do = "move"  # of all vehicles: the formation's position
position_enu_m = [0.3, 0.0, {height_m + 0.2}]
timeout_s = 40

[[step]]
do = "land"
timeout_s = 90

[expect]  # the verdict after the flight, and the exit status
min_separation_m = {fleet.fleet.safety_distance_m:.2f}
arrived_within_m = {arrived_within_m}
all_landed = true

[on_failure]  # of any step
do = "land"
"""
