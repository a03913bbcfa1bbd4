"""Reads Skybrush's compiled shows, ``.skyc``.

They are zips with ``show.json`` and the members to which its ``$ref`` refer.

Lengths are metres with z up, times are seconds, and yaw is in degrees clockwise from the x axis.
The control points of a point belong to the Bezier curve that ends at it.

The show's frame is right-handed. ``environment.location`` has its place on Earth: the orientation
is the compass direction of the x axis, in degrees clockwise from north. So a show whose orientation
is 90 has x to the east and y to the north, as the fleet's frame; an outdoor show with another one
is turned. Sources: Skybrush Studio for Blender, "Key concepts" and "Show panel"; ShowLocation in
its sbstudio/model/location.py.
"""

from __future__ import annotations

import base64
import binascii
import itertools
import math
import os
import posixpath
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from groundstation.paths.lights import TimedColour
from groundstation.paths.pieces import divided, turned
from groundstation.shows.light_program import colours
from groundstation.shows.show import (
    MAX_DRONES,
    Drone,
    Show,
    begin_of_path_s,
    bezier_piece,
    check_light_count,
    path_from_pieces,
)
from groundstation.shows.zip_members import DAMAGES, PACKINGS, refuse_many_members
from onboard.config.file_reading import (
    MAX_JSON_VALUES,
    SHOW_FILE,
    json_size,
    json_values,
    opened,
)
from onboard.config.fleet import ConfigError, Origin
from onboard.control.path import DURATION, MAX_PIECES, YAW, Path, coefficients_of, path_of
from onboard.plain_text import listed
from onboard.tuples import Xyz

_MAX_BYTES = 67_108_864  # unpacked size of all members that are read
_DEEPEST = 20  # levels of references and tables within each other

_LONGEST_NAME = 200  # letters of a show's and a drone's name
_HIGHEST_M = 10_000.0  # altitude of a show's origin
_EAST_DEG = 90.0  # compass direction of the fleet's x axis
_MAX_YAW_DEG = 360_000.0  # a thousand turns


def read_skyc(file: str | os.PathLike[str]) -> Show:
    """Read a show.

    Args:
        file: path of the .skyc file.

    Returns:
        The show.

    Raises:
        ConfigError: the file does not exist, is not a zip, is truncated or too large, is of another
            version, or has no paths.
    """
    name = os.fspath(file)
    try:
        with opened(name, SHOW_FILE) as stream:
            refuse_many_members(name, stream)
            with zipfile.ZipFile(stream) as archive:
                return _show(name, _Members(name, archive).read("show.json"))
    except ConfigError:
        raise
    except DAMAGES as error:
        raise ConfigError(
            f"{name}: this is no .skyc, or it is truncated ({error}). Export it again."
        ) from None


class _Keypoint(NamedTuple):
    """A point of a trajectory, with the control points of the curve that leads to it."""

    time_s: float
    position: Xyz
    control_points: list[Xyz]


class _Members:
    """Reads JSON members of a zip and resolves their references, with limits of size and depth."""

    def __init__(self, name: str, archive: zipfile.ZipFile) -> None:
        self._name = name
        self._archive = archive
        self._bytes_left = _MAX_BYTES
        self._values_left = MAX_JSON_VALUES
        self._read: dict[str, Any] = {}

    def read(self, member: str, depth: int = 0) -> Any:
        """Return the content of a member."""
        if member in self._read:
            return self._read[member]

        data = self._bytes_of(member)
        self._values_left -= json_size(data)
        if self._values_left < 0:
            raise ConfigError(
                f"{self._name}: it unpacks to more than {MAX_JSON_VALUES} values: that is no show."
            )
        value = json_values(data, f"{self._name}: '{member}'")
        self._read[member] = self._resolved(value, posixpath.dirname(member), depth)
        return self._read[member]

    def _bytes_of(self, member: str) -> bytes:
        try:
            packing = self._archive.getinfo(member).compress_type
            if packing not in PACKINGS:
                raise ConfigError(
                    f"{self._name}: '{member}' is packed by method {packing}; Skybrush uses "
                    f"{zipfile.ZIP_DEFLATED}, deflate. Export the show again."
                )
            with self._archive.open(member) as stream:
                data = stream.read(self._bytes_left + 1)
        except KeyError:
            raise ConfigError(
                f"{self._name}: the show has no member '{member}'. Export it again."
            ) from None

        self._bytes_left -= len(data)
        if self._bytes_left < 0:
            raise ConfigError(
                f"{self._name}: it unpacks to more than {_MAX_BYTES >> 20} MB: that is no show."
            )
        return data

    def _resolved(self, value: Any, folder: str, depth: int) -> Any:
        """Return a value in which references are replaced by the values to which they refer."""
        if depth > _DEEPEST:
            raise ConfigError(
                f"{self._name}: references within references without end. Export the show again."
            )

        if isinstance(value, dict):
            reference = value.get("$ref")
            if isinstance(reference, str):
                return self._referenced(reference, folder, depth)
            return {key: self._resolved(part, folder, depth + 1) for key, part in value.items()}

        # lists of numbers contain no references, and a show has millions of them
        if isinstance(value, list) and any(isinstance(part, dict) for part in value):
            return [self._resolved(part, folder, depth + 1) for part in value]
        return value

    def _referenced(self, reference: str, folder: str, depth: int) -> Any:
        """Return the value to which ``member#/key/key`` refers.

        Returns None if there is no such key, or if the member is not JSON.
        """
        member, _, pointer = reference.partition("#")
        path = posixpath.normpath(posixpath.join(folder, member))
        if not path.lower().endswith(".json"):
            return None  # music, pictures and films, which an import does not need

        target = self.read(path, depth + 1)
        for key in filter(None, pointer.split("/")):
            if isinstance(target, dict) and key in target:
                target = target[key]
            else:
                target = None
        return target


def _show(name: str, data: Any) -> Show:
    """Return the show in the data of ``show.json``.

    Raises:
        ConfigError: its version cannot be read, or its drones are not valid.
    """
    if not isinstance(data, dict):
        data = {}
    if data.get("version") != 1:
        raise ConfigError(
            f"{name}: show.json has version {data.get('version')!r}; version 1 can be read."
        )
    drones = _table(data, "swarm").get("drones")
    if not isinstance(drones, list) or not 1 <= len(drones) <= MAX_DRONES:
        raise ConfigError(f"{name}: 'swarm.drones' must list 1 to {MAX_DRONES} drones.")

    environment = _table(data, "environment")
    location = _table(environment, "location")
    is_outdoors = environment.get("type") == "outdoor"
    title = _table(data, "meta").get("title")
    if not isinstance(title, str) or not title:
        title, _ = os.path.splitext(os.path.basename(name))

    read_drones: list[Drone] = []
    auto_yaw_names: list[str] = []
    for index, drone in enumerate(drones):
        settings = _table(drone, "settings")
        read_drones.append(_drone(name, index, settings))
        check_light_count(name, read_drones)  # after each drone, before more memory is filled
        if _table(settings, "yawControl").get("autoYaw") is True:
            auto_yaw_names.append(read_drones[-1].name)
    show = Show(
        title=title[:_LONGEST_NAME],
        drones=tuple(read_drones),
        is_outdoors=is_outdoors,
        origin=_origin(location),
        notes=_auto_yaw_notes(auto_yaw_names),
    )
    if is_outdoors and location.get("orientation") is not None:
        orientation_deg = _number(f"{name}, 'environment.location'", location["orientation"])
        show = _turned(show, orientation_deg)
    return show


def _auto_yaw_notes(names: Sequence[str]) -> tuple[str, ...]:
    """Return a note if drones are to turn with their flight, which Covey does not fly."""
    if not names:
        return ()
    return (
        f"'autoYaw' is not read ({listed(names)}): a vehicle does not turn into the direction of"
        " its flight, and its heading follows the setpoints of yaw, if there are any",
    )


def _table(value: Any, key: str) -> dict[str, Any]:
    """Return a table within a table; an empty one if there is none."""
    if not isinstance(value, dict):
        return {}
    part = value.get(key)
    if not isinstance(part, dict):
        return {}
    return part


def _origin(location: dict[str, Any]) -> Origin | None:
    """Return the show's origin on Earth; None if the file has none, or a wrong one."""
    try:
        # through text, so that True and lists are refused as numbers
        latitude_deg, longitude_deg, *altitude = (
            float(str(number)) for number in location["origin"]
        )
    except (KeyError, TypeError, ValueError):
        return None
    altitude_m = altitude[0] if altitude else 0.0  # a file may leave it out

    # Skybrush writes 1e-7 degrees and millimetres. Numbers within a circle are degrees and metres.
    if max(abs(latitude_deg), abs(longitude_deg)) > 360.0:
        latitude_deg /= 1e7
        longitude_deg /= 1e7
        altitude_m /= 1e3

    # these comparisons are false for NaN, too
    is_on_earth = (
        -90.0 <= latitude_deg <= 90.0
        and -180.0 <= longitude_deg <= 180.0
        and -_HIGHEST_M <= altitude_m <= _HIGHEST_M
    )
    if not is_on_earth:
        return None
    return Origin(latitude_deg, longitude_deg, altitude_m)


def _turned(show: Show, orientation_deg: float) -> Show:
    """Return a show in the fleet's frame, with x to the east and y to the north.

    Args:
        show: the show in its own frame.
        orientation_deg: compass direction of its x axis, clockwise from north.
    """
    compass_deg = orientation_deg % 360.0
    turn_deg = _EAST_DEG - compass_deg  # counterclockwise
    if turn_deg == 0.0:
        return show

    turn_rad = math.radians(turn_deg)
    cosine = math.cos(turn_rad)
    sine = math.sin(turn_rad)
    drones = []
    for drone in show.drones:
        x, y, z = drone.home_enu_m
        home_enu_m = (cosine * x - sine * y, sine * x + cosine * y, z)
        drones.append(replace(drone, home_enu_m=home_enu_m, path=turned(drone.path, turn_rad)))

    note = (
        f"the x axis of the show points to {compass_deg:g} degrees of the compass: homes and paths "
        f"are turned by {turn_deg:g} degrees counterclockwise, such that x is east and y north"
    )
    return replace(show, drones=tuple(drones), notes=(*show.notes, note))


def _drone(file: str, index: int, settings: dict[str, Any]) -> Drone:
    """Return a drone of a show.

    Args:
        file: name of the show's file.
        index: the drone's index in the show, which names it if it has no name.
        settings: the drone's settings in ``show.json``.
    """
    name = settings.get("name")
    if not isinstance(name, str) or not name:
        name = f"drone {index + 1}"
    name = name[:_LONGEST_NAME]
    subject = f"{file}, '{name}'"
    trajectory = _table(settings, "trajectory")
    if trajectory.get("version") != 1:
        raise ConfigError(
            f"{subject}: its trajectory has version {trajectory.get('version')!r}; version 1 can be"
            " read."
        )

    first_s, pieces, first_enu_m = _pieces(subject, trajectory.get("points"))
    path = path_from_pieces(subject, pieces)
    first_s += _number(subject, trajectory.get("takeoffTime", 0.0))
    last_s = first_s + sum(duration_s for duration_s, *_ in pieces)
    begin_s = begin_of_path_s(path, first_s, last_s)
    path = _with_yaw(subject, path, begin_s, _table(settings, "yawControl"))

    home_enu_m = first_enu_m
    if settings.get("home") is not None:
        home_enu_m = _point(subject, settings["home"])
    return Drone(
        name=name,
        home_enu_m=home_enu_m,
        path=path,
        begin_s=begin_s,
        lights=_lights(subject, _table(settings, "lights"), last_s),
    )


def _pieces(subject: str, points: Any) -> tuple[float, list[list[float]], Xyz]:
    """Return the time of the first point, the pieces of the path, and the first position."""
    if not isinstance(points, list) or len(points) < 2:
        raise ConfigError(f"{subject}: its trajectory has fewer than two points: it is no path.")
    if len(points) > MAX_PIECES + 1:
        raise ConfigError(
            f"{subject}: its trajectory has {len(points)} points; {MAX_PIECES + 1} are the most "
            "that a vehicle can hold. Export the show with fewer."
        )

    pieces: list[list[float]] = []
    keypoints = [_keypoint(subject, k, point) for k, point in enumerate(points)]
    for k, (before, after) in enumerate(itertools.pairwise(keypoints), start=1):
        if not after.time_s > before.time_s:
            raise ConfigError(
                f"{subject}: points[{k}]: its time does not rise above the one before. Export "
                "the show again."
            )
        corners = (before.position, *after.control_points, after.position)
        curve = [list(corner) for corner in corners]
        pieces.append(bezier_piece(after.time_s - before.time_s, curve))

    first = keypoints[0]
    return first.time_s, pieces, first.position


def _keypoint(subject: str, index: int, keypoint: Any) -> _Keypoint:
    """Return a point of a trajectory, checked."""
    if not isinstance(keypoint, list) or len(keypoint) < 2:
        raise ConfigError(f"{subject}: points[{index}] is no [time, [x, y, z], [control points]].")

    time, position, *further = keypoint
    listed = []
    if further and further[0]:
        listed = further[0]
    if not isinstance(listed, list) or len(listed) > 2:
        raise ConfigError(
            f"{subject}: points[{index}] has {str(listed)[:40]} where a list of at most"
            " two control points is needed. Export the show again."
        )
    return _Keypoint(
        time_s=_number(subject, time),
        position=_point(subject, position),
        control_points=[_point(subject, control) for control in listed],
    )


def _yaw_setpoints(subject: str, setpoints: list[Any]) -> tuple[list[float], list[float]]:
    """Return the rising times [s] of the setpoints, and the yaws [deg], clockwise."""
    times_s: list[float] = []
    yaws_deg: list[float] = []
    for k, setpoint in enumerate(setpoints):
        if not isinstance(setpoint, list) or len(setpoint) != 2:
            raise ConfigError(
                f"{subject}: yaw setpoint {k} is {str(setpoint)[:40]!r} where [time, yaw in"
                " degrees] is needed. Export the show again."
            )
        time, yaw = setpoint
        times_s.append(_number(subject, time))
        yaws_deg.append(_number(subject, yaw))
        if k > 0 and times_s[k] < times_s[k - 1]:
            raise ConfigError(
                f"{subject}: yaw setpoint {k}: its time is earlier than the one before. Export the "
                "show again."
            )
        if abs(yaws_deg[k]) > _MAX_YAW_DEG:
            raise ConfigError(
                f"{subject}: yaw setpoint {k} is {yaws_deg[k]:g} degrees; at most"
                f" {_MAX_YAW_DEG:g} are read. Export the show again."
            )
    return times_s, yaws_deg


def _with_yaw(subject: str, path: Path, begin_s: float, control: dict[str, Any]) -> Path:
    """Return the path with yaw from the setpoints.

    The path is divided at the setpoints, and within each piece yaw turns smoothly. A turn of more
    than half a circle between two setpoints is flown as it is written.
    """
    setpoints = control.get("setpoints")
    if not isinstance(setpoints, list) or not setpoints:
        return path
    times_s, yaws_deg = _yaw_setpoints(subject, setpoints)

    # setpoints before the path and after it end no piece
    inner_s = np.unique(times_s) - begin_s
    inner_s = inner_s[(inner_s > 0.0) & (inner_s < path.duration_s)]
    if len(inner_s) > MAX_PIECES:
        raise ConfigError(
            f"{subject}: it has {len(inner_s)} yaw setpoints; {MAX_PIECES} are the most that a "
            "vehicle can hold. Export the show with fewer."
        )
    pieces = divided(path, inner_s)
    durations_s = pieces[:, DURATION]

    # yaw at the start of the path and at the end of each piece
    knots_s = begin_s + np.concatenate([[0.0], np.cumsum(durations_s)])
    knots_rad = np.interp(knots_s, times_s, -np.radians(yaws_deg))  # clockwise in the file

    # a quintic from rest to rest: 10 s^3 - 15 s^4 + 6 s^5 of the turn, with the share s of the
    # duration
    yaw_coefficients = coefficients_of(pieces)[:, YAW]
    yaw_coefficients[:] = 0.0
    yaw_coefficients[:, 0] = knots_rad[:-1]
    for power, factor in ((3, 10.0), (4, -15.0), (5, 6.0)):
        yaw_coefficients[:, power] = factor * np.diff(knots_rad) / durations_s**power
    try:
        return path_of(pieces.tolist())
    except ConfigError as error:
        raise ConfigError(
            f"{subject}: with an end of a piece at each yaw setpoint, it is no path. {error} "
            "Export the show with fewer setpoints."
        ) from None


def _lights(subject: str, program: dict[str, Any], end_s: float) -> tuple[TimedColour, ...]:
    if program.get("version") != 1 or not isinstance(program.get("data"), str):
        return ()
    try:
        return colours(base64.b64decode(program["data"], validate=True), end_s)
    except (ValueError, binascii.Error) as error:
        raise ConfigError(f"{subject}: its light program cannot be read ({error}).") from None


def _number(subject: str, value: Any) -> float:
    # json_values has refused numbers that are not finite or have more than 64 bits
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{subject}: {str(value)[:40]!r} stands where a finite number is needed.")
    return float(value)


def _point(subject: str, value: Any) -> Xyz:
    if not isinstance(value, list) or len(value) != 3:
        raise ConfigError(f"{subject}: {str(value)[:40]!r} stands where [x, y, z] is needed.")
    x, y, z = (_number(subject, number) for number in value)
    return x, y, z
