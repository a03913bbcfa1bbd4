"""Skybrush's compiled shows, ``.skyc``: a zip with ``show.json`` and the members that its ``$ref``
name.

Lengths are metres with z up, times seconds, yaw degrees counterclockwise; a point's control points
belong to the Bezier curve that ends at it.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import os
import posixpath
import zipfile
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from groundstation.paths.lights import Light
from groundstation.shows.light_program import colours
from groundstation.shows.show import MOST_DRONES, Drone, Show, bezier_piece, path_from_pieces
from onboard.config.fleet import ConfigError, Origin, Vec3
from onboard.control.path import Path, path_of

# unpacked, in the zip, of references within references
_MOST_BYTES, _MOST_MEMBERS, _DEEPEST = 268_435_456, 20_000, 20


def read_skyc(file: str | os.PathLike[str]) -> Show:
    """Read a show.

    Args:
        file: of the ending .skyc.

    Returns:
        Its drones.

    Raises:
        ConfigError: no such file, no zip, truncated, too large, of another version, or without
            paths.
    """
    name = os.fspath(file)
    try:
        with zipfile.ZipFile(name) as archive:
            if len(archive.infolist()) > _MOST_MEMBERS:
                raise ConfigError(f"{name}: a zip of {len(archive.infolist())} members is no show.")
            return _show(name, _Members(name, archive).read("show.json"))
    except FileNotFoundError:
        raise ConfigError(
            f"{name}: there is no such show. Give the path of an existing one."
        ) from None
    except (
        OSError,
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
    ) as error:
        raise ConfigError(
            f"{name}: this is no .skyc, or it is truncated ({error}). Export it again."
        ) from None


class _Members:
    """JSON members of a zip, with references resolved, as long as all of them stay within the
    limit.
    """

    def __init__(self, name: str, archive: zipfile.ZipFile) -> None:
        self._name, self._archive, self._left = name, archive, _MOST_BYTES
        self._read: dict[str, Any] = {}

    def read(self, member: str, depth: int = 0) -> Any:
        """Return the content of a member."""
        if member not in self._read:
            try:
                with self._archive.open(member) as stream:
                    data = stream.read(self._left + 1)
            except KeyError:
                raise ConfigError(
                    f"{self._name}: the show has no member '{member}'. Export it again."
                ) from None
            self._left -= len(data)
            if self._left < 0:
                raise ConfigError(
                    f"{self._name}: it unpacks to more than {_MOST_BYTES >> 20} MB: that is no show."
                )
            try:
                self._read[member] = self._resolved(
                    json.loads(data), posixpath.dirname(member), depth
                )
            except (ValueError, RecursionError) as error:
                raise ConfigError(
                    f"{self._name}: '{member}' is no JSON ({error}). Export the show again."
                ) from None
        return self._read[member]

    def _resolved(self, value: Any, folder: str, depth: int) -> Any:
        if depth > _DEEPEST:
            raise ConfigError(
                f"{self._name}: references within references without end. Export the show again."
            )
        if isinstance(value, dict):
            reference = value.get("$ref")
            if isinstance(reference, str):
                member, _, pointer = reference.partition("#")
                target = self.read(posixpath.normpath(posixpath.join(folder, member)), depth + 1)
                for key in filter(None, pointer.split("/")):
                    target = target[key] if isinstance(target, dict) and key in target else None
                return target
            return {key: self._resolved(one, folder, depth + 1) for key, one in value.items()}
        if isinstance(value, list) and any(isinstance(one, dict) for one in value):
            return [self._resolved(one, folder, depth + 1) for one in value]
        return value


def _show(name: str, data: Any) -> Show:
    data = data if isinstance(data, dict) else {}
    if data.get("version") != 1:
        raise ConfigError(
            f"{name}: show.json has version {data.get('version')!r}; version 1 can be read."
        )
    drones = _table(data, "swarm").get("drones")
    if not isinstance(drones, list) or not 1 <= len(drones) <= MOST_DRONES:
        raise ConfigError(f"{name}: 'swarm.drones' must list 1 to {MOST_DRONES} drones.")
    environment = _table(data, "environment")
    read = tuple(_drone(name, index, _table(one, "settings")) for index, one in enumerate(drones))
    return Show(
        str(_table(data, "meta").get("title") or os.path.splitext(os.path.basename(name))[0]),
        read,
        environment.get("type") == "outdoor",
        _origin(_table(environment, "location")),
    )


def _table(value: Any, key: str) -> dict[str, Any]:
    part = value.get(key) if isinstance(value, dict) else None
    return part if isinstance(part, dict) else {}


def _origin(location: dict[str, Any]) -> Origin | None:
    try:
        latitude, longitude, *altitude = (float(str(number)) for number in location["origin"])
    except (KeyError, TypeError, ValueError):
        return None
    return Origin(latitude, longitude, altitude[0] if altitude else 0.0)


def _drone(file: str, index: int, settings: dict[str, Any]) -> Drone:
    name = str(settings.get("name") or f"drone {index + 1}")
    where = f"{file}, '{name}'"
    trajectory = _table(settings, "trajectory")
    if trajectory.get("version") != 1:
        raise ConfigError(
            f"{where}: its trajectory has version {trajectory.get('version')!r}; version 1 can be read."
        )
    times_s, pieces, first = _pieces(where, trajectory.get("points"))
    path = path_from_pieces(where, pieces)
    begin_s = times_s + _number(where, trajectory.get("takeoffTime", 0.0))
    path = _with_yaw(where, path, begin_s, _table(settings, "yawControl"))
    home = settings.get("home")
    x, y, z = _point(where, home) if home is not None else first
    return Drone(name, (x, y, z), path, begin_s, _lights(where, _table(settings, "lights")))


def _pieces(where: str, points: Any) -> tuple[float, list[list[float]], Vec3]:
    """Return the time of the first point, the pieces after it, and where it is."""
    if not isinstance(points, list) or len(points) < 2:
        raise ConfigError(f"{where}: its trajectory has fewer than two points: it is no path.")
    pieces: list[list[float]] = []
    last_s, last = math.nan, (0.0, 0.0, 0.0)
    for k, keypoint in enumerate(points):
        if not isinstance(keypoint, list) or len(keypoint) < 2:
            raise ConfigError(f"{where}: points[{k}] is no [time, [x, y, z], [control points]].")
        time_s, point = _number(where, keypoint[0]), _point(where, keypoint[1])
        controls = [
            _point(where, one) for one in (keypoint[2] if len(keypoint) > 2 and keypoint[2] else ())
        ]
        if k:
            if not time_s > last_s or len(controls) > 2:
                raise ConfigError(
                    f"{where}: points[{k}]: time does not rise, or it has more than two control points."
                )
            pieces.append(
                bezier_piece(time_s - last_s, [list(one) for one in (last, *controls, point)])
            )
        last_s, last = time_s, point
    return _number(where, points[0][0]), pieces, _point(where, points[0][1])


def _with_yaw(where: str, path: Path, begin_s: float, control: dict[str, Any]) -> Path:
    """Return the path with the yaw of its setpoints, smoothed over the pieces of the path."""
    setpoints = control.get("setpoints")
    if not isinstance(setpoints, list) or not setpoints:
        return path
    times_s = [_number(where, one[0]) for one in setpoints]
    yaws = np.unwrap(np.radians([_number(where, one[1]) for one in setpoints]))
    pieces, ends_s = np.array(path.pieces), np.array(path.ends_s)
    at = np.interp(begin_s + np.concatenate([[0.0], ends_s]), times_s, yaws)
    duration = pieces[:, 0]
    pieces[:, 25:33] = 0.0
    pieces[:, 25] = at[:-1]
    for power, share in ((3, 10.0), (4, -15.0), (5, 6.0)):  # from rest to rest within each piece
        pieces[:, 25 + power] = share * np.diff(at) / duration**power
    return path_of(pieces.tolist())


def _lights(where: str, program: dict[str, Any]) -> tuple[Light, ...]:
    if program.get("version") != 1 or not isinstance(program.get("data"), str):
        return ()
    try:
        return colours(base64.b64decode(program["data"], validate=True))
    except (ValueError, binascii.Error) as error:
        raise ConfigError(f"{where}: its light program cannot be read ({error}).") from None


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ConfigError(f"{where}: {str(value)[:40]!r} stands where a finite number is needed.")
    return float(value)


def _point(where: str, value: Any) -> Vec3:
    if not isinstance(value, list) or len(value) != 3:
        raise ConfigError(f"{where}: {str(value)[:40]!r} stands where [x, y, z] is needed.")
    x, y, z = _numbers(where, value)
    return x, y, z


def _numbers(where: str, values: list[Any]) -> Iterator[float]:
    return (_number(where, value) for value in values)
