"""A show as it was read: homes, paths and lights of its drones, in the show's own frame and time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groundstation.paths.lights import Light
from groundstation.paths.pieces import fitted
from onboard.config.fleet import ConfigError, Origin, Vec3
from onboard.control.path import NUMBERS, Path, path_of, sampled

MOST_DRONES = 200
_KINK_M_S = 0.05  # a jump of the speed beyond it is smoothed away
_FAR_M, _FAST_M_S = 2000.0, 40.0


@dataclass(frozen=True, slots=True)
class Drone:
    """One drone of a show."""

    name: str
    home_enu_m: Vec3
    path: Path
    begin_s: float = 0.0  # of the path, on the show's clock
    lights: tuple[Light, ...] = ()


@dataclass(frozen=True, slots=True)
class Show:
    """All that an import takes from a show's files."""

    title: str
    drones: tuple[Drone, ...]
    is_outdoors: bool = False
    origin: Origin | None = None  # of the show's frame, where the file gives one
    notes: tuple[str, ...] = ()  # what was read differently than it stands there


def path_from_pieces(name: str, pieces: list[list[float]]) -> Path:
    """Return the path of a drone; pieces with kinks between them are smoothed.

    Raises:
        ConfigError: it is no path in metres with z up.
    """
    try:
        path = path_of(pieces)
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"{name}: its trajectory is no path: {error}") from None
    ends = np.array(path.ends_s)
    before, after = sampled(path, ends[:-1] - 1e-4), sampled(path, ends[:-1] + 1e-4)
    if len(ends) > 1 and np.abs(after[1] - before[1]).max() > _KINK_M_S:
        times_s = np.arange(0.0, path.duration_s, 0.05)
        path = fitted(times_s, sampled(path, times_s)[0])
    values, rates, _ = sampled(path, np.linspace(0.0, path.duration_s, 200))
    if np.abs(values[:, :3]).max() > _FAR_M or np.abs(rates[:, :3]).max() > _FAST_M_S:
        raise ConfigError(
            f"{name}: its path reaches {np.abs(values[:, :3]).max():.0f} with up to {np.abs(rates[:, :3]).max():.0f} a "
            "second: that is not metres. Export the show in metres and seconds."
        )
    if np.median(values[:, 2]) < -0.5:
        raise ConfigError(
            f"{name}: most of its path lies below 0: z points down there. Export the show with z up."
        )
    return path


def bezier_piece(duration_s: float, points: list[list[float]]) -> list[float]:
    """Return the piece of a Bezier curve of first to third degree; points are x, y, z."""
    p = np.array(points, dtype=float)
    rows = {2: [[1, 0], [-1, 1]], 3: [[1, 0, 0], [-2, 2, 0], [1, -2, 1]]}
    cubic = [[1, 0, 0, 0], [-3, 3, 0, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]
    coefficients = np.zeros((4, 8))
    powers = np.array(rows.get(len(p), cubic), dtype=float) @ p
    coefficients[:3, : len(p)] = (powers / duration_s ** np.arange(len(p))[:, None]).T
    return [duration_s, *coefficients.reshape(NUMBERS - 1).tolist()]
