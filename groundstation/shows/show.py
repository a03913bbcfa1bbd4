"""A show as it was read: homes, paths and lights of its drones, in the show's own frame and time.

The readers of all file formats use the checks and conversions of this file.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from groundstation.paths.lights import TimedColour
from groundstation.paths.pieces import GRID_S, fitted, moved
from onboard.config.earth import east_north_m
from onboard.config.fences import FARTHEST_M
from onboard.config.fleet import ConfigError, Origin
from onboard.control.path import (
    AXES,
    MAX_JUMP_M,
    MAX_JUMP_M_S,
    POWERS,
    Path,
    jumps,
    path_of,
    piece_of,
    sampled,
)
from onboard.tuples import Xyz

MAX_DRONES = 200
MAX_LIGHTS = 1_000_000  # colours of all drones together

# a path that exceeds these bounds is not in metres and seconds
_FAR_M = 2000.0
_FAST_M_S = 40.0

_SAME_PLACE_M = 0.005  # origins nearer than this to each other are one


@dataclass(frozen=True, slots=True)
class Drone:
    """One drone of a show."""

    name: str
    home_enu_m: Xyz
    path: Path
    # time on the show's clock at which the path begins; negative if it rests before the show does
    begin_s: float = 0.0
    lights: tuple[TimedColour, ...] = ()


@dataclass(frozen=True, slots=True)
class Show:
    """The content of a show's files, as far as an import uses it."""

    title: str
    drones: tuple[Drone, ...]
    is_outdoors: bool = False
    origin: Origin | None = None  # origin of the show's frame; None if the file gives none
    notes: tuple[str, ...] = ()  # sentences about values that were converted when they were read


def from_origin(show: Show, origin: Origin | None) -> Show:
    """Return a show in metres from another origin on Earth, so that it is flown at its own place.

    A show without an origin on Earth stays as it is, and so do heights: vehicles measure them from
    the ground.

    Args:
        show: the show in metres from its own origin.
        origin: origin of the fleet that flies it; None if the fleet has none on Earth.

    Raises:
        ConfigError: the two origins are far apart.
    """
    if not show.is_outdoors or show.origin is None or origin is None:
        return show

    east_m, north_m = east_north_m(origin, show.origin.latitude_deg, show.origin.longitude_deg)
    distance_m = math.hypot(east_m, north_m)
    if distance_m > FARTHEST_M:
        raise ConfigError(
            f"The show's place on Earth lies {distance_m / 1000.0:.0f} km from the fleet's origin; "
            f"{FARTHEST_M / 1000.0:g} km are the most. Write as fleet.origin a place where the "
            "show is flown."
        )
    if distance_m < _SAME_PLACE_M:
        return show

    by = np.array([east_m, north_m, 0.0, 0.0])  # x, y, z and yaw
    drones = []
    for drone in show.drones:
        x, y, z = drone.home_enu_m
        home_enu_m = (x + east_m, y + north_m, z)
        drones.append(replace(drone, home_enu_m=home_enu_m, path=moved(drone.path, by)))
    note = (
        f"the show's origin lies {east_m:.2f} m east and {north_m:.2f} m north of the fleet's: "
        "homes and paths are moved by that, to stay at their place on Earth"
    )
    return replace(show, drones=tuple(drones), origin=origin, notes=(*show.notes, note))


def check_light_count(name: str, drones: Sequence[Drone]) -> None:
    """Refuse a show with absurdly many colours, which a short light program with loops can make.

    Args:
        name: name of the show's file, for the message.
        drones: drones that were read so far.

    Raises:
        ConfigError: there are more than MAX_LIGHTS colours.
    """
    count = sum(len(drone.lights) for drone in drones)
    if count > MAX_LIGHTS:
        raise ConfigError(
            f"{name}: the light programs of {len(drones)} drones set {count} colours; "
            f"{MAX_LIGHTS} are the most for a whole show. Export it with simpler lights."
        )


def path_from_pieces(name: str, pieces: list[list[float]]) -> Path:
    """Return the path of a drone; pieces with kinks between them are smoothed.

    Raises:
        ConfigError: the pieces are not a path in metres with z up.
    """
    try:
        path = smooth(path_of(pieces))
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"{name}: its trajectory is no path: {error}") from None

    values, rates, _ = sampled(path, np.linspace(0.0, path.duration_s, 200))
    farthest = np.abs(values[:, :3]).max()
    fastest = np.abs(rates[:, :3]).max()
    if farthest > _FAR_M or fastest > _FAST_M_S:
        raise ConfigError(
            f"{name}: its path reaches {farthest:.0f} with up to {fastest:.0f} a second: that is "
            "not metres. Export the show in metres and seconds."
        )
    if np.median(values[:, 2]) < -0.5:
        raise ConfigError(
            f"{name}: most of its path lies below 0: z points down there. Export the show with z "
            "up."
        )
    return path


def smooth(path: Path) -> Path:
    """Return the path without kinks between its pieces.

    Raises:
        ValueError: its position jumps between two pieces.
    """
    jump_m, jump_m_s = jumps(path).max(axis=1, initial=0.0)
    if jump_m > MAX_JUMP_M:
        raise ValueError(
            f"its position jumps by {jump_m:.2f} m from one piece to the next; {MAX_JUMP_M:g} m "
            "are the most. Export the show again."
        )
    if jump_m_s <= MAX_JUMP_M_S:
        return path

    times_s = np.linspace(0.0, path.duration_s, math.ceil(path.duration_s / GRID_S) + 1)
    positions, _, _ = sampled(path, times_s)
    return fitted(times_s, positions)


def begin_of_path_s(path: Path, first_s: float, last_s: float) -> float:
    """Return the time on the show's clock at which a drone's path begins.

    A path that was fitted rests for the same time before its first and after its last position. So
    it begins earlier, and passes each position at the position's own time.

    Args:
        path: path of the drone.
        first_s: time of its first position.
        last_s: time of its last position.
    """
    rest_s = 0.5 * (path.duration_s - (last_s - first_s))
    return first_s - rest_s


def bezier_piece(duration_s: float, points: list[list[float]]) -> list[float]:
    """Return the piece of a path for a Bezier curve of first to third degree.

    Args:
        duration_s: duration of the piece.
        points: the two to four control points, each x, y, z.
    """
    control_points = np.array(points, dtype=float)

    # row k holds the factors of the control points in the coefficient of (t / duration)^k
    if len(control_points) == 2:
        rows = [[1, 0], [-1, 1]]
    elif len(control_points) == 3:
        rows = [[1, 0, 0], [-2, 2, 0], [1, -2, 1]]
    else:
        rows = [[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]

    # absurdly large points overflow; the caller refuses pieces that are not finite
    with np.errstate(all="ignore"):
        powers = np.array(rows, dtype=float) @ control_points
        per_time = powers / duration_s ** np.arange(len(control_points))[:, None]
    coefficients = np.zeros((AXES, POWERS))
    coefficients[:3, : len(control_points)] = per_time.T
    piece: list[float] = piece_of(duration_s, coefficients).tolist()
    return piece
