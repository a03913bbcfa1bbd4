"""A show as it was read: homes, paths and lights of its drones, in its own frame and time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groundstation.paths.lights import TimedColour
from groundstation.paths.pieces import fitted
from onboard.config.fleet import ConfigError, Origin
from onboard.control.path import NUMBERS, Path, path_of, sampled
from onboard.tuples import Xyz

MOST_DRONES = 200
MOST_LIGHTS = 1_000_000  # colours of all drones together
_KINK_M_S = 0.05  # a jump of the speed beyond it is smoothed away

# beyond these the numbers are no metres and seconds
_FAR_M = 2000.0
_FAST_M_S = 40.0


@dataclass(frozen=True, slots=True)
class Drone:
    """One drone of a show."""

    name: str
    home_enu_m: Xyz
    path: Path
    begin_s: float = 0.0  # of the path, on the show's clock
    lights: tuple[TimedColour, ...] = ()


@dataclass(frozen=True, slots=True)
class Show:
    """All that an import takes from a show's files."""

    title: str
    drones: tuple[Drone, ...]
    is_outdoors: bool = False
    origin: Origin | None = None  # of the show's frame, where the file gives one
    notes: tuple[str, ...] = ()  # what was read differently than it stands there


def check_light_count(name: str, drones: Sequence[Drone]) -> None:
    """Refuse a show with more colours than its file can reasonably mean.

    A light program of few bytes with loops makes many.

    Args:
        name: of the show's file, for the sentence.
        drones: that were read so far.

    Raises:
        ConfigError: there are more than MOST_LIGHTS.
    """
    count = sum(len(drone.lights) for drone in drones)
    if count > MOST_LIGHTS:
        raise ConfigError(
            f"{name}: the light programs of {len(drones)} drones set {count} colours; "
            f"{MOST_LIGHTS} are the most for a whole show. Export it with simpler lights."
        )


def path_from_pieces(name: str, pieces: list[list[float]]) -> Path:
    """Return the path of a drone; pieces with kinks between them are smoothed.

    Raises:
        ConfigError: it is no path in metres with z up.
    """
    try:
        path = _smooth(path_of(pieces))
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


def _smooth(path: Path) -> Path:
    """Return the path without kinks between its pieces."""
    # speeds a moment before and after the end of each piece but the last
    ends_s = np.array(path.ends_s)[:-1]
    before = sampled(path, ends_s - 1e-4)
    after = sampled(path, ends_s + 1e-4)
    if not len(ends_s) or np.abs(after[1] - before[1]).max() <= _KINK_M_S:
        return path

    times_s = np.arange(0.0, path.duration_s, 0.05)
    return fitted(times_s, sampled(path, times_s)[0])


def bezier_piece(duration_s: float, points: list[list[float]]) -> list[float]:
    """Return the piece of a Bezier curve of first to third degree; points are x, y, z."""
    p = np.array(points, dtype=float)

    # rows: what each power of the share of the duration takes of each control point
    linear = [[1, 0], [-1, 1]]
    quadratic = [[1, 0, 0], [-2, 2, 0], [1, -2, 1]]
    cubic = [[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]
    rows = {2: linear, 3: quadratic}.get(len(p), cubic)

    # absurdly large points overflow, and whoever reads the piece refuses what is not finite
    with np.errstate(all="ignore"):
        powers = np.array(rows, dtype=float) @ p
        per_time = powers / duration_s ** np.arange(len(p))[:, None]
    coefficients = np.zeros((4, 8))
    coefficients[:3, : len(p)] = per_time.T
    return [duration_s, *coefficients.reshape(NUMBERS - 1).tolist()]
