"""A show made flyable.

Its own take-off and landing are cut off, since Covey flies these; homes are dealt out again where
they are far from the paths; the whole show is slowed where it is too fast; vehicles whose paths
come too near begin later.

Nothing is changed silently: every change is a note, for one drone or for all, and import writes
them into its files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from groundstation.paths.lights import TimedColour
from groundstation.paths.pieces import cut, quintic, resting, slowed
from groundstation.shows.show import Drone, Show
from onboard.arrays import Array
from onboard.config.fleet import ConfigError
from onboard.control.path import LONGEST_S, Path, path_of, point_at, sampled
from onboard.tuples import Xyz

_TAKEOFF_M = 1.0
_LOWEST_TAKEOFF_M = 0.5
_JOIN_S = 1.0  # on either side of the height at which the show is taken over from the take-off
_GRID_S = 0.05
_STILL_M_S = 0.02  # a path that is slower at its end needs no piece that brings it to rest
_ROOM = 1.005  # by which a show is slowed beyond what is needed
_SLOWEST = 4.0
_DEAL_ABOVE_M = 0.5  # by which the longest distance from home to path must become shorter

# a vertical separation that is proposed where heights would do
_MOST_VERTICAL_M = 4.0
_LEAST_VERTICAL_M = 1.5
_SHARE_OF_HEIGHT = 0.6

# starts are spread in steps, one vehicle a round
_SPREAD_STEP_S = 0.5
_MOST_SPREAD_S = 4.0
_SPREAD_ROUNDS = 24


@dataclass(slots=True)
class Converted:
    """A show ready to be written."""

    takeoff_m: float
    homes: dict[str, Xyz]
    paths: dict[str, Path]
    lights: dict[str, tuple[TimedColour, ...]]
    begin_s: float = 0.0  # of the flight along the paths, on the show's own clock
    slowing: float = 1.0  # times as long as in the show
    notes: list[str] = field(default_factory=list)  # for all
    own_notes: dict[str, list[str]] = field(default_factory=dict)  # by name

    def show_s(self, flight_s: float) -> float:
        """Return a time of the flight on the show's own clock, as its designer knows it [s]."""
        return self.begin_s + flight_s / self.slowing

    def own_time_words(self) -> str:
        """Return how times of the flight become the designer's; empty where they are the same."""
        if self.slowing == 1.0 and not self.begin_s:
            return ""
        return (
            f" (T s of the flight are {self.begin_s:.1f} + T / {self.slowing:.3f} s of the show.)"
        )


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
    takeoff_m = _takeoff_height_m(show)
    made = Converted(
        takeoff_m=takeoff_m,
        homes={names[drone.name]: (*drone.home_enu_m[:2], 0.0) for drone in show.drones},
        paths={},
        lights={},
    )
    for drone in show.drones:
        made.own_notes[names[drone.name]] = [f"{drone.name!r} of the show {show.title!r}"]
    _check_homes(made.homes, home_spacing_m)

    flown = {drone.name: _flown(drone, takeoff_m) for drone in show.drones}
    zero_s = min(begin_s for begin_s, _ in flown.values())
    made.begin_s = zero_s
    made.notes.append(
        f"take-off to {takeoff_m:g} m and landing are Covey's own; the show is flown above that "
        "height"
    )

    for drone in show.drones:
        begin_s, pieces = flown[drone.name]
        waiting_s = begin_s - zero_s
        if waiting_s > 1e-3:
            pieces = np.concatenate([[resting(waiting_s, pieces[0][1::8])], pieces])
        vehicle = names[drone.name]
        made.paths[vehicle] = _path(drone.name, pieces.tolist())
        made.lights[vehicle] = tuple(
            (max(t - zero_s, 0.0), red, green, blue) for t, red, green, blue in drone.lights
        )

    _deal_homes(made)
    _slow_down(made, limits)
    _spread_starts(made, spacing_m, height_share)
    return made


def _takeoff_height_m(show: Show) -> float:
    """Return the height from which the show is flown: one that every path of it reaches."""
    highest_m = {
        drone.name: float(sampled(drone.path, _grid(drone.path))[0][:, 2].max())
        for drone in show.drones
    }
    takeoff_m = min(_TAKEOFF_M, round(0.8 * min(highest_m.values()), 2))
    if takeoff_m < _LOWEST_TAKEOFF_M:
        low = [name for name, height_m in highest_m.items() if 0.8 * height_m < _LOWEST_TAKEOFF_M]
        raise ConfigError(
            f"{', '.join(low)}: the path stays on the ground. Take these drones out of the show."
        )
    return takeoff_m


def _grid(path: Path) -> Array:
    """Return times from the begin to the end of a path."""
    count = max(2, math.ceil(path.duration_s / _GRID_S) + 1)
    return np.linspace(0.0, path.duration_s, count)


def _flown(drone: Drone, takeoff_m: float) -> tuple[float, Array]:
    """Return when a path's part above the take-off's height begins in the show, and its pieces.

    It begins and ends at rest; where the show is moving there, a piece is added that leads to or
    from rest.
    """
    times_s = _grid(drone.path)
    heights_m = sampled(drone.path, times_s)[0][:, 2]
    high = np.flatnonzero(heights_m >= takeoff_m - 1e-3)
    begin_s = float(times_s[high[0]])
    end_s = float(times_s[high[-1]])
    if end_s - begin_s < 2.5 * _JOIN_S:
        raise ConfigError(
            f"'{drone.name}' is above {takeoff_m:g} m for less than {2.5 * _JOIN_S:g} s: no path."
        )

    # (3, 4, 4): motion at the begin, after the first join, before the last one, and at the end
    at = sampled(drone.path, np.array([begin_s, begin_s + _JOIN_S, end_s - _JOIN_S, end_s]))
    is_moving_first = np.abs(at[1, 0]).max() > _STILL_M_S
    is_moving_last = np.abs(at[1, 3]).max() > _STILL_M_S
    parts = []
    starts_s = drone.begin_s + begin_s

    if is_moving_first:
        rest = np.zeros((3, 4))
        rest[0] = at[0, 0]
        parts.append([quintic(2.0 * _JOIN_S, rest, at[:, 1])])
        starts_s -= _JOIN_S
        begin_s += _JOIN_S

    last_part = []
    if is_moving_last:
        rest = np.concatenate([at[:1, 3], np.zeros((2, 4))])
        last_part.append([quintic(2.0 * _JOIN_S, at[:, 2], rest)])
        end_s -= _JOIN_S

    return starts_s, np.concatenate([*parts, cut(drone.path, begin_s, end_s), *last_part])


def _path(name: str, pieces: Sequence[Sequence[float]]) -> Path:
    """Return the path of a drone or a vehicle with what was added to it."""
    try:
        return path_of(pieces)
    except ConfigError as error:
        raise ConfigError(
            f"'{name}': with its wait, and with its begin and its end at rest, no vehicle can hold "
            f"its path. {error} Design it shorter, or with fewer points."
        ) from None


def _slowed(paths: Mapping[str, Path], factor: float) -> dict[str, Path]:
    """Return paths that take ``factor`` times as long."""
    try:
        return {name: slowed(path, factor) for name, path in paths.items()}
    except ConfigError:
        raise ConfigError(
            f"The show has to take {factor:.2f} times as long, and then lasts longer than "
            f"{LONGEST_S:.0f} s, which is the most. Cut it in two."
        ) from None


def _check_homes(homes: Mapping[str, Xyz], spacing_m: float) -> None:
    """Refuse homes that stand nearer than a distance."""
    names = list(homes)
    spots = np.array([home[:2] for home in homes.values()])
    distances_m = np.sqrt(((spots[:, None] - spots[None]) ** 2).sum(-1))

    pairs = sorted(
        (distances_m[i, j], names[i], names[j])
        for i, j in zip(*np.triu_indices(len(names), 1), strict=True)
    )
    words = [
        f"{first} and {second} {distance_m:.2f} m"
        for distance_m, first, second in pairs
        if distance_m < spacing_m - 1e-6
    ]
    if words:
        raise ConfigError(
            f"Homes stand too near to each other: {listed_words(words)}. "
            f"The law needs {spacing_m:.2f} m."
        )


def _deal_homes(made: Converted) -> None:
    """Give each vehicle a home near the begin of its path, where the show's own are far from it."""
    begins = {name: point_at(path, 0.0).position_enu_m for name, path in made.paths.items()}
    # each home, at the height at which its path begins
    above_home = {name: (x, y, begins[name][2]) for name, (x, y, _) in made.homes.items()}
    dealt = nearest_slots(above_home, begins, (0.0, 0.0, 0.0))

    before_m = {name: math.dist(above_home[name], begins[name]) for name in above_home}
    after_m = {name: math.dist(above_home[home], begins[name]) for name, home in dealt.items()}
    if max(before_m.values()) - max(after_m.values()) < _DEAL_ABOVE_M:
        return

    homes = dict(made.homes)
    for name, home_of in dealt.items():
        if name == home_of:
            continue
        made.homes[name] = homes[home_of]
        made.own_notes[name].append(
            f"starts from {home_of}'s home, {after_m[name]:.2f} m from the begin of its path "
            f"instead of {before_m[name]:.2f} m: homes are dealt out such that the longest way to "
            "a path is short"
        )


def _slow_down(made: Converted, limits: FlightLimits) -> None:
    """Slow the whole show until every vehicle can fly its path."""
    needed, words = needed_slowing(sample(made.paths), limits, begin_s=made.begin_s)
    if needed <= 1.0:
        return

    factor = 1.0
    slower = made.paths
    while needed > 1.0 and factor <= _SLOWEST:
        # a slower path is sampled at more of its points, and may show a larger acceleration
        factor *= needed * _ROOM
        slower = _slowed(made.paths, factor)
        needed, _ = needed_slowing(sample(slower), limits)

    if factor > _SLOWEST:
        raise ConfigError(
            f"The show would take {factor:.1f} times as long: {words}. Design it slower."
        )
    made.slowing = factor
    made.notes.append(f"slowed to {factor:.3f} times its duration: {words}")
    made.paths = slower
    for name, lights in made.lights.items():
        made.lights[name] = tuple((factor * t, red, green, blue) for t, red, green, blue in lights)


def _spread_starts(made: Converted, spacing_m: float, height_share: float) -> None:
    """Let vehicles that would come too near begin later, one after the other.

    Raises:
        ConfigError: that does not keep them apart.
    """
    delays_s = dict.fromkeys(made.paths, 0.0)
    paths = dict(made.paths)
    pairs = _too_near(paths, spacing_m, height_share)
    first_pairs = pairs

    # a show in which everybody is near somebody is not mended by delays
    can_be_mended = 0 < len(pairs) <= 2 * len(paths)
    rounds = _SPREAD_ROUNDS if can_be_mended else 0
    for _ in range(rounds):
        late = max((pairs[0].first, pairs[0].second), key=lambda name: (delays_s[name], name))
        delays_s[late] += _SPREAD_STEP_S
        if delays_s[late] > _MOST_SPREAD_S:
            break

        waiting = resting(delays_s[late], np.array(made.paths[late].pieces[0][1::8]))
        paths[late] = _path(late, [waiting.tolist(), *made.paths[late].pieces])
        pairs = _too_near(paths, spacing_m, height_share)
        if not pairs:
            break

    if pairs:
        anyhow = ""
        if not height_share:
            anyhow = " at any height, since vehicles do not fly above each other"
        in_show = [one._replace(time_s=made.show_s(one.time_s)) for one in first_pairs]
        listed = listed_words([pair_words(one) for one in in_show])
        raise ConfigError(
            f"Paths come nearer than {spacing_m:.2f} m, which the law needs{anyhow}: {listed} "
            f"(times of the show). Move them apart.{_heights_words(first_pairs, height_share)}"
        )

    made.paths = paths
    for name, delay_s in delays_s.items():
        if not delay_s:
            continue
        made.own_notes[name].append(
            f"begins {delay_s:g} s later, to keep {spacing_m:.2f} m from the others"
        )
        made.lights[name] = tuple(
            (t + delay_s, red, green, blue) for t, red, green, blue in made.lights[name]
        )


def _heights_words(pairs: Sequence[ClosestApproach], height_share: float) -> str:
    """Return how vehicles may fly above each other, where that would do for all these pairs."""
    least_m = min(pair.height_m for pair in pairs)
    vertical_m = min(_MOST_VERTICAL_M, math.floor(10.0 * _SHARE_OF_HEIGHT * least_m) / 10.0)
    if height_share or vertical_m < _LEAST_VERTICAL_M:
        return ""
    return (
        f" Or use their heights, which differ by {least_m:.1f} m or more there: "
        f"--vertical {vertical_m:g}, which is vertical_separation_m of the fleet file, lets "
        "vehicles pass above each other."
    )


def _too_near(
    paths: Mapping[str, Path], spacing_m: float, height_share: float
) -> list[ClosestApproach]:
    """Return the pairs that come nearer than a distance, the nearest first."""
    if len(paths) < 2:
        return []
    pairs = closest_pairs(sample(paths), spacing_m, height_share)
    return [pair for pair in pairs if pair.distance_m < spacing_m]
