"""A show made flyable: its take-off and landing cut off, slowed where it is too fast, starts spread
where they collide.

Nothing is changed silently: every change is a note, for one drone or for all, and import writes
them into its files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from groundstation.formations.assignment import nearest_slots
from groundstation.paths.checks import (
    ClosestApproach,
    FlightLimits,
    closest_pairs,
    listed_words,
    needed_slowing,
    pair_words,
    sample,
)
from groundstation.paths.lights import Light
from groundstation.paths.pieces import cut, quintic, resting, slowed
from groundstation.shows.show import Drone, Show
from onboard.arrays import Array
from onboard.config.fleet import ConfigError, Vec3
from onboard.control.path import Path, path_of, point_at, sampled

_TAKEOFF_M, _LOWEST_TAKEOFF_M = 1.0, 0.5
_JOIN_S = 1.0  # on either side of the height at which the show is taken over from the take-off
_GRID_S = 0.05
_STILL_M_S = 0.02
_ROOM = 1.005
_SLOWEST = 4.0
_DEAL_ABOVE_M = 0.5  # by which the longest way to the begin of a path must become shorter
_SPREAD_STEP_S, _MOST_SPREAD_S, _SPREAD_ROUNDS = 0.5, 4.0, 24


@dataclass(slots=True)
class Converted:
    """A show ready to be written."""

    takeoff_m: float
    homes: dict[str, Vec3]
    paths: dict[str, Path]
    lights: dict[str, tuple[Light, ...]]
    notes: list[str] = field(default_factory=list)  # for all
    own_notes: dict[str, list[str]] = field(default_factory=dict)  # by name


def converted(
    show: Show,
    names: Mapping[str, str],
    limits: FlightLimits,
    spacing_m: float,
    home_spacing_m: float,
    height_share: float = 0.0,
) -> Converted:
    """Make a show flyable.

    Args:
        show: as it was read.
        names: of the vehicles, by those of the drones.
        limits: of the vehicles.
        spacing_m: separation that paths keep [m].
        home_spacing_m: that homes keep, horizontally [m].
        height_share: what a metre of height counts in the separation of paths; 0: nothing.

    Returns:
        Homes, paths and lights by the vehicles' names, with a note for each change.

    Raises:
        ConfigError: homes or paths are too near to each other, or the show is far too fast.
    """
    highest = {
        one.name: float(sampled(one.path, _grid(one.path))[0][:, 2].max()) for one in show.drones
    }
    takeoff_m = min(_TAKEOFF_M, round(0.8 * min(highest.values()), 2))
    if takeoff_m < _LOWEST_TAKEOFF_M:
        low = [name for name, height_m in highest.items() if 0.8 * height_m < _LOWEST_TAKEOFF_M]
        raise ConfigError(
            f"{', '.join(low)}: the path stays on the ground. Take these drones out of the show."
        )
    made = Converted(
        takeoff_m, {names[one.name]: (*one.home_enu_m[:2], 0.0) for one in show.drones}, {}, {}
    )
    made.own_notes = {
        names[one.name]: [f"{one.name!r} of the show {show.title!r}"] for one in show.drones
    }
    _check_homes(made.homes, home_spacing_m)
    flown = {one.name: _flown(one, takeoff_m) for one in show.drones}
    zero_s = min(begin_s for begin_s, _ in flown.values())
    made.notes.append(
        f"take-off to {takeoff_m:g} m and landing are Covey's own; the show is flown above that height"
    )
    for one in show.drones:
        begin_s, pieces = flown[one.name]
        waiting_s = begin_s - zero_s
        if waiting_s > 1e-3:
            pieces = np.concatenate([[resting(waiting_s, pieces[0][1::8])], pieces])
        made.paths[names[one.name]] = path_of(pieces.tolist())
        made.lights[names[one.name]] = tuple(
            (max(t - zero_s, 0.0), r, g, b) for t, r, g, b in one.lights
        )
    _deal_homes(made)
    _slow_down(made, limits)
    _spread_starts(made, spacing_m, height_share)
    return made


def _grid(path: Path) -> Array:
    return np.linspace(0.0, path.duration_s, max(2, math.ceil(path.duration_s / _GRID_S) + 1))


def _flown(drone: Drone, takeoff_m: float) -> tuple[float, Array]:
    """Return the part of a path above the take-off's height, from rest to rest, and when it begins
    in the show.
    """
    times_s = _grid(drone.path)
    is_high = np.flatnonzero(sampled(drone.path, times_s)[0][:, 2] >= takeoff_m - 1e-3)
    begin_s, end_s = float(times_s[is_high[0]]), float(times_s[is_high[-1]])
    if end_s - begin_s < 2.5 * _JOIN_S:
        raise ConfigError(
            f"'{drone.name}' is above {takeoff_m:g} m for less than {2.5 * _JOIN_S:g} s: no path."
        )
    at = sampled(drone.path, np.array([begin_s, begin_s + _JOIN_S, end_s - _JOIN_S, end_s]))
    rest = np.zeros((3, 4))
    first, last = [], []
    if np.abs(at[1, 0]).max() > _STILL_M_S:
        rest[0] = at[0, 0]
        first = [quintic(2.0 * _JOIN_S, rest, at[:, 1])]
    if np.abs(at[1, 3]).max() > _STILL_M_S:
        last = [quintic(2.0 * _JOIN_S, at[:, 2], np.concatenate([at[:1, 3], np.zeros((2, 4))]))]
    middle = cut(
        drone.path, begin_s + _JOIN_S if first else begin_s, end_s - _JOIN_S if last else end_s
    )
    pieces = np.concatenate([*([first] if first else []), middle, *([last] if last else [])])
    return drone.begin_s + begin_s - (_JOIN_S if first else 0.0), pieces


def _check_homes(homes: Mapping[str, Vec3], spacing_m: float) -> None:
    names, spots = list(homes), np.array([home[:2] for home in homes.values()])
    apart = np.sqrt(((spots[:, None] - spots[None]) ** 2).sum(-1))
    near = [
        (apart[i, j], names[i], names[j])
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
    ]
    words = [
        f"{first} and {second} {away:.2f} m"
        for away, first, second in sorted(near)
        if away < spacing_m - 1e-6
    ]
    if words:
        raise ConfigError(
            f"The homes of {listed_words(words)} stand nearer than {spacing_m:.2f} m, which the law needs."
        )


def _deal_homes(made: Converted) -> None:
    """Give each vehicle a home near the begin of its path, where the show's own are far from it."""
    begins = {name: point_at(path, 0.0).position_enu_m for name, path in made.paths.items()}
    over = {name: (x, y, begins[name][2]) for name, (x, y, _) in made.homes.items()}
    takes = nearest_slots(over, begins, (0.0, 0.0, 0.0))
    before_m, after_m = (
        {name: math.dist(over[taken], begins[name]) for name, taken in deal.items()}
        for deal in ({name: name for name in over}, takes)
    )
    if max(before_m.values()) - max(after_m.values()) < _DEAL_ABOVE_M:
        return
    homes = dict(made.homes)
    for name, taken in takes.items():
        if name != taken:
            made.homes[name] = homes[taken]
            made.own_notes[name].append(
                f"starts from {taken}'s home, {after_m[name]:.2f} m from the begin of its path instead of "
                f"{before_m[name]:.2f} m: homes are dealt out such that the longest way to a path is short"
            )


def _slow_down(made: Converted, limits: FlightLimits) -> None:
    """Slow the whole show until every vehicle can fly its path."""
    factor, words = needed_slowing(sample(made.paths), limits)
    if factor <= 1.0:
        return
    if factor > _SLOWEST:
        raise ConfigError(
            f"The show would take {factor:.1f} times as long: {words}. Design it slower."
        )
    factor *= _ROOM
    made.notes.append(f"slowed to {factor:.3f} times its duration: {words}")
    made.paths = {name: slowed(path, factor) for name, path in made.paths.items()}
    for name, lights in made.lights.items():
        made.lights[name] = tuple((factor * t, red, green, blue) for t, red, green, blue in lights)


def _spread_starts(made: Converted, spacing_m: float, height_share: float) -> None:
    """Let vehicles that would come too near begin later, one after the other; refuse what that does
    not mend.
    """
    delays_s = dict.fromkeys(made.paths, 0.0)
    paths = dict(made.paths)
    pairs = _too_near(paths, spacing_m, height_share)
    first_pairs, best = pairs, len(pairs)
    for _ in range(_SPREAD_ROUNDS if 0 < best <= 2 * len(paths) else 0):
        late = max((pairs[0].first, pairs[0].second), key=lambda name: (delays_s[name], name))
        delays_s[late] += _SPREAD_STEP_S
        if delays_s[late] > _MOST_SPREAD_S:
            break
        waiting = resting(delays_s[late], np.array(made.paths[late].pieces[0][1::8]))
        paths[late] = path_of([waiting.tolist(), *made.paths[late].pieces])
        pairs = _too_near(paths, spacing_m, height_share)
        if not pairs:
            break
    if pairs:
        anyhow = (
            "" if height_share else " at any height, since vehicles do not fly above each other"
        )
        listed = listed_words([pair_words(one) for one in first_pairs])
        raise ConfigError(
            f"Paths come nearer than {spacing_m:.2f} m, which the law needs{anyhow}: {listed}. Move them apart."
        )
    made.paths = paths
    for name, delay_s in delays_s.items():
        if delay_s:
            made.own_notes[name].append(
                f"begins {delay_s:g} s later, to keep {spacing_m:.2f} m from the others"
            )
            made.lights[name] = tuple((t + delay_s, r, g, b) for t, r, g, b in made.lights[name])


def _too_near(
    paths: Mapping[str, Path], spacing_m: float, height_share: float
) -> list[ClosestApproach]:
    if len(paths) < 2:
        return []
    return [
        one
        for one in closest_pairs(sample(paths), spacing_m, height_share)
        if one.distance_m < spacing_m
    ]
