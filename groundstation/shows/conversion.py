"""Makes a show flyable.

The show's own take-off and landing are cut off, since Covey flies these. Homes are reassigned if
they are far from the paths. If the show is too fast, the whole show is slowed down. Vehicles whose
paths come too near to each other begin later.

No change is silent: each becomes a note, about one drone or about all, and ``covey import`` writes
the notes into the files.
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
from onboard.control.path import LONGEST_S, Path, path_of, point_at, sampled, start_of
from onboard.estimation.accuracies import Accuracy
from onboard.tuples import Xyz

# heights of the take-off above the highest home
_TAKEOFF_M = 1.0
_LOWEST_TAKEOFF_M = 0.5
_TAKEOFF_SHARE = 0.8  # a take-off reaches at most this share of the lowest path's greatest height
_LEVEL_M = 0.1  # homes at heights below this lie on level ground, at 0
# A path that begins or ends in motion gets a piece from or to rest. It replaces this time of the
# show, and takes twice this time.
_JOIN_S = 1.0
_SHORTEST_S = 2.5 * _JOIN_S  # both pieces, and some of the show between them
_GRID_S = 0.05  # time between two points at which a path is sampled
_STILL_M_S = 0.02  # a path whose end is slower than this counts as at rest there
_EXTRA_SLOWING = 1.005  # factor by which a show is slowed more than needed
_SLOWEST = 4.0  # a show that would have to be slowed by a larger factor is refused
# homes are reassigned if the longest flight to a path becomes shorter by this
_ASSIGN_ABOVE_M = 0.5

# bounds of a vertical separation that is proposed if heights would keep vehicles apart
_MAX_VERTICAL_M = 4.0
_MIN_VERTICAL_M = 1.5
_SHARE_OF_HEIGHT = 0.6

# starts are delayed in steps, one vehicle in each round
_SPREAD_STEP_S = 0.5
_MAX_SPREAD_S = 4.0
_SPREAD_ROUNDS = 24  # number of rounds at most


@dataclass(slots=True)
class Converted:
    """A flyable show; the keys of its mappings are names of vehicles."""

    takeoff_m: float
    homes: dict[str, Xyz]
    paths: dict[str, Path]
    lights: dict[str, tuple[TimedColour, ...]]
    begin_s: float = 0.0  # time on the show's own clock at which the paths begin
    slowing: float = 1.0  # duration divided by the duration in the show
    notes: list[str] = field(default_factory=list)  # notes about all vehicles
    own_notes: dict[str, list[str]] = field(default_factory=dict)  # notes about one vehicle

    def show_s(self, flight_s: float) -> float:
        """Return the time [s] on the show's own clock that belongs to a time of the flight."""
        return self.begin_s + flight_s / self.slowing

    def own_time_words(self) -> str:
        """Return words about how to convert times of the flight; empty if both are the same."""
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
    accuracy: Accuracy,
    height_share: float = 0.0,
) -> Converted:
    """Make a show flyable.

    Args:
        show: the show as it was read.
        names: name of a drone -> name of its vehicle.
        limits: limits of the vehicles.
        spacing_m: least separation of paths [m].
        home_spacing_m: least horizontal distance of homes [m].
        accuracy: accuracy of positions on which both distances depend.
        height_share: factor of height differences in the separation of paths; 0: they do not count.

    Returns:
        Homes, paths and lights by the vehicles' names, with a note for each change.

    Raises:
        ConfigError: homes or paths are too near to each other, or the show is far too fast.
    """
    homes = {names[drone.name]: drone.home_enu_m for drone in show.drones}
    is_level = all(abs(home_m) < _LEVEL_M for _, _, home_m in homes.values())
    if is_level:
        homes = {name: (x, y, 0.0) for name, (x, y, _) in homes.items()}
    highest_home_m = max(home_m for _, _, home_m in homes.values())

    takeoff_m = _takeoff_height_m(show, highest_home_m)
    flyable = Converted(
        takeoff_m=takeoff_m,
        homes=homes,
        paths={},
        lights={},
        notes=list(show.notes),
    )
    for drone in show.drones:
        flyable.own_notes[names[drone.name]] = [f"{drone.name!r} of the show {show.title!r}"]
    _check_homes(flyable.homes, home_spacing_m, accuracy)

    flown_parts = {drone.name: _flown_part(drone, takeoff_m) for drone in show.drones}
    flight_begin_s = min(begin_s for begin_s, _ in flown_parts.values())
    flyable.begin_s = flight_begin_s
    flyable.notes.append(
        f"take-off to {takeoff_m:g} m and landing are Covey's own; the show is flown above that "
        "height"
    )
    if not is_level:
        lowest_home_m = min(home_m for _, _, home_m in homes.values())
        flyable.notes.append(
            f"homes lie at heights from {lowest_home_m:.1f} to {highest_home_m:.1f} m (start_enu_m "
            "in the fleet file): all take off to a height above the highest one"
        )

    for drone in show.drones:
        begin_s, pieces = flown_parts[drone.name]
        waiting_s = begin_s - flight_begin_s
        if waiting_s > 1e-3:
            waiting = resting(waiting_s, start_of(pieces[0]))
            pieces = np.concatenate([[waiting], pieces])
        vehicle = names[drone.name]
        flyable.paths[vehicle] = _path(drone.name, pieces.tolist())
        flyable.lights[vehicle] = tuple(
            (max(time_s - flight_begin_s, 0.0), red, green, blue)
            for time_s, red, green, blue in drone.lights
        )

    _assign_homes(flyable)
    _slow_down(flyable, limits)
    _spread_starts(flyable, spacing_m, height_share, accuracy)
    return flyable


def _takeoff_height_m(show: Show, highest_home_m: float) -> float:
    """Return the take-off height, from which the show is flown; every path reaches it.

    Args:
        show: the show as it was read.
        highest_home_m: height of the highest home, above which all vehicles take off.
    """
    highest_m = {
        drone.name: float(_heights_m(drone.path, _grid(drone.path)).max()) for drone in show.drones
    }
    room_m = min(highest_m.values()) - highest_home_m  # for all paths above the highest home
    climb_m = min(_TAKEOFF_M, round(_TAKEOFF_SHARE * room_m, 2))
    if climb_m < _LOWEST_TAKEOFF_M:
        least_m = highest_home_m + _LOWEST_TAKEOFF_M / _TAKEOFF_SHARE
        low = [name for name, height_m in highest_m.items() if height_m < least_m]
        deepest_m = min(
            float(_heights_m(drone.path, _grid(drone.path)).min()) for drone in show.drones
        )
        if deepest_m < -least_m:
            raise ConfigError(
                f"{', '.join(low)}: the path lies below the ground: z points down there. Export the"
                " show with z up."
            )
        raise ConfigError(
            f"{', '.join(low)}: the path does not rise to {least_m:.2f} m, "
            f"{least_m - highest_home_m:.2f} m above the highest home. Take these drones out of "
            "the show, or export it higher."
        )
    return round(highest_home_m + climb_m, 2)


def _grid(path: Path) -> Array:
    """Return times from the start to the end of a path."""
    count = max(2, math.ceil(path.duration_s / _GRID_S) + 1)
    return np.linspace(0.0, path.duration_s, count)


def _heights_m(path: Path, times_s: Array) -> Array:
    """Return the heights of a path at some times."""
    values, _, _ = sampled(path, times_s)
    heights_m: Array = values[:, 2]
    return heights_m


def _flown_part(drone: Drone, takeoff_m: float) -> tuple[float, Array]:
    """Return the part of a path above the take-off height: its time in the show, and its pieces.

    The part begins and ends at rest. If the drone moves there in the show, a piece is added that
    leads from or to rest.
    """
    times_s = _grid(drone.path)
    high = np.flatnonzero(_heights_m(drone.path, times_s) >= takeoff_m - 1e-3)
    begin_s = float(times_s[high[0]])
    end_s = float(times_s[high[-1]])
    if end_s - begin_s < _SHORTEST_S:
        raise ConfigError(
            f"'{drone.name}' is above {takeoff_m:g} m for less than {_SHORTEST_S:g} s: no path."
        )

    # motions (3, 4): value, first and second derivative of x, y, z and yaw
    motions = sampled(drone.path, np.array([begin_s, begin_s + _JOIN_S, end_s - _JOIN_S, end_s]))
    at_begin = motions[:, 0]
    after_join = motions[:, 1]
    before_join = motions[:, 2]
    at_end = motions[:, 3]
    begin_value, begin_velocity, _ = at_begin
    end_value, end_velocity, _ = at_end
    begins_in_motion = np.abs(begin_velocity).max() > _STILL_M_S
    ends_in_motion = np.abs(end_velocity).max() > _STILL_M_S
    show_begin_s = drone.begin_s + begin_s

    first_part = []
    if begins_in_motion:
        standstill = np.zeros((3, 4))
        standstill[0] = begin_value
        first_part.append([quintic(2.0 * _JOIN_S, standstill, after_join)])
        show_begin_s -= _JOIN_S
        begin_s += _JOIN_S

    last_part = []
    if ends_in_motion:
        standstill = np.zeros((3, 4))
        standstill[0] = end_value
        last_part.append([quintic(2.0 * _JOIN_S, before_join, standstill)])
        end_s -= _JOIN_S

    return show_begin_s, np.concatenate([*first_part, cut(drone.path, begin_s, end_s), *last_part])


def _path(name: str, pieces: Sequence[Sequence[float]]) -> Path:
    """Return the path of a drone or a vehicle from its pieces, including the added ones."""
    try:
        return path_of(pieces)
    except ConfigError as error:
        raise ConfigError(
            f"'{name}': with its wait, and at rest at its first and last points, no vehicle can "
            f"hold its path. {error} Design it shorter, or with fewer points."
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


def _check_homes(homes: Mapping[str, Xyz], spacing_m: float, accuracy: Accuracy) -> None:
    """Refuse homes that are nearer to each other than a distance."""
    names = list(homes)
    positions_m = np.array([home[:2] for home in homes.values()])
    distances_m = np.sqrt(((positions_m[:, None] - positions_m[None]) ** 2).sum(-1))

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
            f"The law needs {spacing_m:.2f} m with positions as accurate as '{accuracy.name}'. "
            f"Move them apart.{_accuracy_proposal(accuracy)}"
        )


def _accuracy_proposal(accuracy: Accuracy) -> str:
    """Return words that propose more accurate positions; empty if none are more accurate."""
    if accuracy.name == "mocap":
        return ""
    return (
        " With more accurate positions, such as by motion capture, less is enough: --fleet names "
        "such a fleet."
    )


def _assign_homes(flyable: Converted) -> None:
    """Assign homes near the starts of the paths, if that shortens the longest flight to a path."""
    first_points = {
        name: point_at(path, 0.0).position_enu_m for name, path in flyable.paths.items()
    }
    # each home, raised to the height at which its path begins
    above_home = {name: (x, y, first_points[name][2]) for name, (x, y, _) in flyable.homes.items()}
    assigned = nearest_slots(above_home, first_points, (0.0, 0.0, 0.0))

    before_m = {name: math.dist(above_home[name], first_points[name]) for name in above_home}
    after_m = {
        name: math.dist(above_home[home], first_points[name]) for name, home in assigned.items()
    }
    if max(before_m.values()) - max(after_m.values()) < _ASSIGN_ABOVE_M:
        return

    homes = dict(flyable.homes)
    for name, home_owner in assigned.items():
        if name == home_owner:
            continue
        flyable.homes[name] = homes[home_owner]
        flyable.own_notes[name].append(
            f"starts from {home_owner}'s home, {after_m[name]:.2f} m from the first point of its "
            f"path instead of {before_m[name]:.2f} m: homes are dealt out such that the longest "
            "way to a path is short"
        )


def _slow_down(flyable: Converted, limits: FlightLimits) -> None:
    """Slow the whole show until every vehicle can fly its path."""
    needed_factor, words = needed_slowing(sample(flyable.paths), limits, begin_s=flyable.begin_s)
    if needed_factor <= 1.0:
        return

    factor = 1.0
    slower = flyable.paths
    while needed_factor > 1.0 and factor <= _SLOWEST:
        # a slower path is sampled at more points, which may show a larger acceleration
        factor *= needed_factor * _EXTRA_SLOWING
        slower = _slowed(flyable.paths, factor)
        needed_factor, _ = needed_slowing(sample(slower), limits)

    if factor > _SLOWEST:
        raise ConfigError(
            f"The show would take {factor:.1f} times as long: {words}. Design it slower."
        )
    flyable.slowing = factor
    flyable.notes.append(f"slowed to {factor:.3f} times its duration: {words}")
    flyable.paths = slower
    for name, lights in flyable.lights.items():
        flyable.lights[name] = tuple(
            (factor * time_s, red, green, blue) for time_s, red, green, blue in lights
        )


def _spread_starts(
    flyable: Converted, spacing_m: float, height_share: float, accuracy: Accuracy
) -> None:
    """Delay vehicles that would come too near to others, one after the other.

    Raises:
        ConfigError: delays do not keep them apart.
    """
    delays_s = dict.fromkeys(flyable.paths, 0.0)
    paths = dict(flyable.paths)
    pairs = _too_near(paths, spacing_m, height_share)
    first_pairs = pairs

    rounds = _SPREAD_ROUNDS
    if not pairs or len(pairs) > 2 * len(paths):  # with so many pairs, delays do not help
        rounds = 0
    for _ in range(rounds):
        # Delay one vehicle of the nearest pair. If one of them is delayed already, delay it more,
        # so that the other one need not wait.
        nearest = pairs[0]
        delayed = max((nearest.first, nearest.second), key=lambda name: (delays_s[name], name))
        delays_s[delayed] += _SPREAD_STEP_S
        if delays_s[delayed] > _MAX_SPREAD_S:
            break

        undelayed = flyable.paths[delayed].pieces
        waiting = resting(delays_s[delayed], start_of(np.array(undelayed[0])))
        paths[delayed] = _path(delayed, [waiting.tolist(), *undelayed])
        pairs = _too_near(paths, spacing_m, height_share)
        if not pairs:
            break

    if pairs:
        height_words = ""
        if not height_share:
            height_words = " at any height, since vehicles do not fly above each other"
        in_show = [pair._replace(time_s=flyable.show_s(pair.time_s)) for pair in first_pairs]
        listed = listed_words([pair_words(pair) for pair in in_show])
        missing_m = spacing_m - min(pair.distance_m for pair in first_pairs)
        raise ConfigError(
            f"Paths come nearer than {spacing_m:.2f} m, which the law needs with positions as "
            f"accurate as '{accuracy.name}'{height_words}: {listed} (times of the show). Move them "
            f"apart, the nearest by {100.0 * missing_m:.1f} cm."
            f"{_vertical_proposal(first_pairs, height_share)}{_accuracy_proposal(accuracy)}"
        )

    flyable.paths = paths
    for name, delay_s in delays_s.items():
        if not delay_s:
            continue
        flyable.own_notes[name].append(
            f"begins {delay_s:g} s later, to keep {spacing_m:.2f} m from the others"
        )
        flyable.lights[name] = tuple(
            (time_s + delay_s, red, green, blue)
            for time_s, red, green, blue in flyable.lights[name]
        )


def _vertical_proposal(pairs: Sequence[ClosestApproach], height_share: float) -> str:
    """Return words that propose a vertical separation; empty if it would not keep pairs apart."""
    least_m = min(pair.height_m for pair in pairs)
    vertical_m = min(_MAX_VERTICAL_M, math.floor(10.0 * _SHARE_OF_HEIGHT * least_m) / 10.0)
    if height_share or vertical_m < _MIN_VERTICAL_M:
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
