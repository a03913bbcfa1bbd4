"""The scenarios of ``covey simulate``: the starts and goals of a flight, given a name and a seed.

The name holds all options: ``swap8`` (jittered) or ``swap8x`` (exact), ``rand16`` or ``rand16d4``
(4 m^2 per vehicle), ``cross8@180``, ``intruder6@2``, ``lost8@silent``, ``forest8``, ``gap6``.
Positions are in the fleet's ENU frame. All vehicles are at the same height, except in ``layers8``,
``heights8`` and ``climb8``.

Each scenario draws its random numbers in a fixed order, which is part of the scenario: with a
different order, the same seed would give a different flight.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.params import Capsule
from onboard.config.fleet import ConfigError
from sitl.monte_carlo import clutter
from sitl.monte_carlo.member_lie import MemberLie

HEIGHT_M = 1.0
_UP = np.array([0.0, 0.0, 2.0])  # offset from one layer to the next

MIX = (
    "form3",
    "swap4",
    "swap8",
    "swap16",
    "swap32",
    "swap4x",
    "swap8x",
    "swap16x",
    "swap32x",
    "rand8",
    "rand16",
    "rand32",
)
_MAX_VEHICLES = 250
KNOWN = (
    "form3, swapN (jittered) and swapNx (exact), randN and randNdA (A m^2 per vehicle), "
    "crossN@90, crossN@180, layersN (two swaps above each other), heightsN (pairs swap heights), "
    "climbN (half climbs through the way of the other), squeeze, forestN (through pillars), "
    "gapN (both ways through a gap in a wall), intruderN@1 to @3, personN@1.5, "
    "lostN@frozen, lostN@silent, lostN@dead, and mix (the benchmark); "
    f"N is a number up to {_MAX_VEHICLES}"
)

_TRIANGLE_SIDE_M = 1.6
_PERMUTATIONS = tuple(itertools.permutations(range(3)))
_RAND_SPACING_M = 1.4
_CROSS_SPACING_M = 1.2
_PERSON_RADIUS_M = 0.4
_JITTER_STD_M = 0.05  # standard deviation of a start, per horizontal axis


@dataclass(frozen=True, slots=True)
class OtherLaw:
    """A second law that flies some of the vehicles."""

    name: str
    vehicles: tuple[int, ...]  # their indexes


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """One flight to be flown; N vehicles.

    Kinds of lost vehicles: "frozen" stops, does not avoid and says so in its messages; "silent"
    flies on and receives messages, but sends none; "dead" stops, does not avoid and sends nothing.
    """

    scenario: str
    seed: int
    start_enu_m: Array  # (N, 3)
    goal_enu_m: Array  # (N, 3)
    duration_s: float = 0.0  # duration of the trajectories; 0: as fast as the limits allow
    earliest_s: float = 0.0  # the flight does not end before this time
    # (3,) velocity of the last vehicle, which then is an outsider and does not avoid
    intruder_m_s: Array | None = None
    # If not 0, the last vehicle stands for a walking person within a circle of this radius.
    intruder_radius_m: float = 0.0
    # index, time [s] and kind of a vehicle that is lost on the way
    lost: tuple[int, float, str] | None = None
    lie: MemberLie | None = None  # the false position of one vehicle
    obstacles: tuple[Capsule, ...] = ()  # static; the same for all seeds of a scenario

    # Only scenes in files (open_benchmark) use the fields from here on.
    later_goals_enu_m: Array | None = None  # (G, N, 3): each vehicle's next goals after its first
    blind: tuple[int, ...] = ()  # indexes of vehicles that receive no messages
    other_law: OtherLaw | None = None  # the same for all seeds of a scene
    longest_s: float = 0.0  # time after which the flight has failed; 0: by its straight-line time

    @property
    def count(self) -> int:
        """Number of vehicles."""
        return int(self.start_enu_m.shape[0])

    @property
    def goals_enu_m(self) -> Array:
        """All goals of each vehicle in their order, (G, N, 3)."""
        first = self.goal_enu_m[None]
        if self.later_goals_enu_m is None:
            return first
        return np.concatenate([first, self.later_goals_enu_m])

    @property
    def legs_m(self) -> Array:
        """Lengths (G, N) of the straight lines from goal to goal."""
        goals = self.goals_enu_m
        begins = np.concatenate([self.start_enu_m[None], goals[:-1]])
        return np.asarray(np.linalg.norm(goals - begins, axis=-1))


def person_radii_m(plans: Sequence[FlightPlan]) -> Array:
    """Return the radii (F, N) of the circles around persons; 0 for a vehicle."""
    radii_m = np.zeros((len(plans), plans[0].count))
    radii_m[:, -1] = [each.intruder_radius_m for each in plans]
    return radii_m


def expand(names: Iterable[str]) -> list[str]:
    """Return each scenario name once; ``mix`` is replaced by the twelve names of the benchmark.

    Raises:
        ConfigError: a name is unknown.
    """
    expanded: list[str] = []
    for name in names:
        if name == "mix":
            expanded.extend(MIX)
        else:
            expanded.append(name)

    # raises for an unknown name
    for name in expanded:
        vehicle_count(name)
    return list(dict.fromkeys(expanded))


def vehicle_count(name: str) -> int:
    """Return the number of vehicles of a scenario.

    Raises:
        ConfigError: there is no such scenario.
    """
    return plan(name, 0).count


def plan(name: str, seed: int, *, scale: float = 1.0) -> FlightPlan:
    """Return the flight of a scenario and a seed.

    Args:
        name: name of the scenario, with its number of vehicles and options.
        seed: the seed of all random numbers.
        scale: factor of all horizontal positions, and of the times.

    Raises:
        ConfigError: there is no such scenario.
    """
    for pattern, make in _SCENARIOS.items():
        match = re.fullmatch(pattern, name)
        if match:
            return _scaled(make(name, seed, *match.groups()), scale)
    raise ConfigError(f"'{name}' is not a scenario. Known: {KNOWN}.")


def _scaled(unscaled: FlightPlan, scale: float) -> FlightPlan:
    stretch = np.array([scale, scale, 1.0])  # heights stay
    return replace(
        unscaled,
        start_enu_m=unscaled.start_enu_m * stretch,
        goal_enu_m=unscaled.goal_enu_m * stretch,
        duration_s=unscaled.duration_s * scale,
        earliest_s=unscaled.earliest_s * scale,
        obstacles=clutter.scaled(unscaled.obstacles, scale),
    )


def is_stacked(name: str) -> bool:
    """Return whether the vehicles of a scenario start at different heights."""
    start = plan(name, 0).start_enu_m
    height_steps_m = np.diff(np.sort(start[:, 2]))
    return bool((np.abs(height_steps_m) > 0.0).any())


# What the scenarios share


def _raised(points: Array) -> Array:
    """Return horizontal points (N, 2) with the common height added, (N, 3)."""
    heights = np.full((len(points), 1), HEIGHT_M)
    return np.concatenate([points, heights], axis=1)


def _jitter(seed: int, count: int) -> Array:
    """Return offsets (N, 2) of the starts: the first numbers that a scenario draws."""
    return np.random.default_rng(seed).normal(0.0, _JITTER_STD_M, (count, 2))


def _level_jitter(seed: int, count: int) -> Array:
    """Return offsets (N, 3) of the starts, none of them in height."""
    return np.concatenate([_jitter(seed, count), np.zeros((count, 1))], axis=1)


def _number(name: str, text: str | None, default: int, *, low: int = 2) -> int:
    """Return the number of vehicles in a scenario's name.

    Args:
        name: name of the scenario.
        text: the digits in the name; None if the name has no number.
        default: number of vehicles if the name has none.
        low: least number of vehicles.

    Raises:
        ConfigError: the number is below ``low`` or too large.
    """
    count = default
    if text is not None:
        count = int(text)
    if not low <= count <= _MAX_VEHICLES:
        raise ConfigError(
            f"'{name}' asks for {count} vehicles; this scenario takes {low} to {_MAX_VEHICLES}."
        )
    return count


def _half_of(name: str, number: str | None, default: int = 4) -> int:
    """Return half the number of vehicles; the number must be even, and 2 or more.

    Raises:
        ConfigError: the number is odd, too small or too large.
    """
    count = _number(name, number, default)
    if count % 2:
        raise ConfigError(
            f"'{name}' asks for {count} vehicles; this scenario takes an even number of them."
        )
    return count // 2


# The scenarios


def _form3(name: str, seed: int) -> FlightPlan:
    """Three vehicles fly into a triangle of side 1.6 m about (0, 1.2).

    The seed decides which of 6 permutations they fly, and whether in 7 s or in 5 s.
    """
    rng = np.random.default_rng(seed)
    row = np.array([[-1.5, -1.5], [0.0, -1.5], [1.5, -1.5]])
    start = row + rng.normal(0.0, 0.1, (3, 2))

    radius = _TRIANGLE_SIDE_M / math.sqrt(3.0)
    corners = np.array([[0.0, radius], [-0.8, -0.5 * radius], [0.8, -0.5 * radius]])
    slots = corners + np.array([0.0, 1.2])
    permutation = list(_PERMUTATIONS[seed % 6])

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(start),
        goal_enu_m=_raised(slots[permutation]),
        # seeds 0 to 5 fly all permutations in 7 s, seeds 6 to 11 in 5 s, and so on
        duration_s=(7.0, 5.0)[seed // 6 % 2],
    )


def _circle(count: int) -> Array:
    """Return points (N, 2), at least 1.25 m apart along a circle about the origin."""
    radius = max(2.5, 1.25 * count / (2.0 * math.pi))
    angle = 2.0 * math.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _swap(name: str, seed: int, number: str, exact: str) -> FlightPlan:
    """All vehicles fly through the centre of a circle to its opposite point.

    With ``exact`` the starts have no jitter, so all seeds have the same starts.
    """
    count = _number(name, number, 2)
    points = _circle(count)

    start = points
    if not exact:
        start = points + _jitter(seed, count)

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(start),
        goal_enu_m=_raised(-points),
    )


def _rand(name: str, seed: int, number: str, density: str | None) -> FlightPlan:
    """Starts and goals are random in a square; within each set, points are 1.4 m apart."""
    count = _number(name, number, 2, low=1)
    area = 6.0  # m^2 per vehicle
    if density is not None:
        area = float(density)
    if not 3.5 <= area <= 1000.0:
        raise ConfigError(
            f"'{name}' asks for {area:g} m^2 per vehicle; spacings of 1.4 m fit from 3.5 m^2 on."
        )

    side_m = math.sqrt(area * count)
    rng = np.random.default_rng(seed)
    start = _scatter(rng, count, side_m)
    goal = _scatter(rng, count, side_m)

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(start),
        goal_enu_m=_raised(goal),
    )


def _scatter(rng: np.random.Generator, count: int, side_m: float) -> Array:
    """Return ``count`` points (N, 2) in a square about the origin, drawn one by one.

    If they do not fit after many attempts, the square is emptied and filled anew.
    """
    while True:
        points = np.empty((0, 2))
        for _ in range(400 * count):
            point = rng.uniform(-0.5 * side_m, 0.5 * side_m, 2)

            distances_2 = ((points - point) ** 2).sum(1)
            if distances_2.min(initial=np.inf) < _RAND_SPACING_M**2:
                continue

            points = np.concatenate([points, point[None]])
            if len(points) == count:
                return points


def _cross(name: str, seed: int, number: str | None, angle: str | None) -> FlightPlan:
    """Two blocks, spacing 1.2 m, fly through each other at 90 or 180 degrees; starts jittered."""
    count = _number(name, number, 8)
    turn_rad = math.radians(90.0)
    if angle is not None:
        turn_rad = math.radians(float(angle))
    first = count // 2  # vehicles in the first block; if the number is odd, the second has one more

    # the second block, centred on the origin, (M, 2)
    width = math.ceil(math.sqrt(count - first))
    slot = np.arange(count - first)
    block = _CROSS_SPACING_M * np.stack([slot // width, slot % width], axis=1).astype(np.float64)
    block -= 0.5 * (block.min(0) + block.max(0))

    reach = np.array([2.0 + 0.5 * _CROSS_SPACING_M * width, 0.0])
    rotation = np.array(
        [
            [math.cos(turn_rad), -math.sin(turn_rad)],
            [math.sin(turn_rad), math.cos(turn_rad)],
        ]
    )
    start = np.concatenate([block[:first] - reach, (block - reach) @ rotation.T])
    goal = np.concatenate([block[:first] + reach, (block + reach) @ rotation.T])

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(start + _jitter(seed, count)),
        goal_enu_m=_raised(goal),
    )


def _layers(name: str, seed: int, number: str) -> FlightPlan:
    """Two jittered swaps, one exactly above the other."""
    half = _half_of(name, number)
    low = _swap(name, seed, str(half), "")

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=np.concatenate([low.start_enu_m, low.start_enu_m + _UP]),
        goal_enu_m=np.concatenate([low.goal_enu_m, low.goal_enu_m + _UP]),
    )


def _heights(name: str, seed: int, number: str) -> FlightPlan:
    """Pairs of vehicles above each other, 3 m from pair to pair, exchange their heights."""
    half = _half_of(name, number)
    row = np.stack([3.0 * np.arange(half), np.zeros(half)], axis=1)
    low = _raised(row)
    high = _raised(row) + _UP

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=np.concatenate([low, high]) + _level_jitter(seed, 2 * half),
        goal_enu_m=np.concatenate([high, low]),
    )


def _climb(name: str, seed: int, number: str) -> FlightPlan:
    """One half climbs, in a row 1.5 m apart; the other half flies along the row, at half height."""
    half = _half_of(name, number)
    along_row_m = 1.5 * (np.arange(half) - 0.5 * (half - 1))
    row = _raised(np.stack([along_row_m, np.zeros(half)], axis=1))
    reach = np.array([1.5 * half + 1.0, 0.0, 0.0])

    start = np.concatenate([row, row - reach + 0.5 * _UP])
    goal = np.concatenate([row + _UP, row + reach + 0.5 * _UP])

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=start + _level_jitter(seed, 2 * half),
        goal_enu_m=goal,
    )


def _squeeze(name: str, seed: int) -> FlightPlan:
    """Three vehicles in a line; the outer two move to 1.1 m beside the middle one."""
    start = np.array([[-2.5, 0.0], [0.0, 0.0], [2.5, 0.0]])
    goal = np.array([[-1.1, 0.0], [0.0, 0.0], [1.1, 0.0]])

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(start + _jitter(seed, 3)),
        goal_enu_m=_raised(goal),
    )


def _forest(name: str, seed: int, number: str | None) -> FlightPlan:
    """One half comes from the left and one half from the right, all through the same pillars.

    Each vehicle flies to the start of a vehicle of the other side.
    """
    half = _half_of(name, number, 8)
    rng = np.random.default_rng(seed)
    along_side_m = 1.5 * (np.arange(half) - 0.5 * (half - 1))

    sides = []
    for x_m in (-5.0, 5.0):
        exact = np.stack([np.full(half, x_m), along_side_m], axis=1)
        sides.append(exact + rng.normal(0.0, _JITTER_STD_M, (half, 2)))
    left, right = sides

    goals_of_left = right[rng.permutation(half)]
    goals_of_right = left[rng.permutation(half)]

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(np.concatenate([left, right])),
        goal_enu_m=_raised(np.concatenate([goals_of_left, goals_of_right])),
        obstacles=clutter.forest(rows=half // 2 + 2, seed=half),
    )


def _gap(name: str, seed: int, number: str | None) -> FlightPlan:
    """One half comes from the left and one half from the right, in two lanes, through one gap."""
    half = _half_of(name, number, 6)
    slot = np.arange(half)
    x_m = 2.5 + 1.4 * (slot // 2)
    y_m = 0.7 * (1.0 - 2.0 * (slot % 2))
    right = np.stack([x_m, y_m], axis=1)
    mirrored = (-1.0, 1.0)  # factors of x and y

    start = np.concatenate([right * mirrored, right])
    # The vehicle nearest to the gap flies to the place farthest behind it, the next vehicle to the
    # next place, and so on.
    farthest_first = right[::-1]
    goal = np.concatenate([farthest_first, farthest_first * mirrored])

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(start + _jitter(seed, 2 * half)),
        goal_enu_m=_raised(goal),
        obstacles=clutter.gap(),
    )


def _intruder(name: str, seed: int, number: str | None, speed: str | None) -> FlightPlan:
    """A vehicle that is not a member of the fleet flies straight through a hovering formation.

    The formation has rows of three with a spacing of 2 m.
    """
    count = _number(name, number, 6, low=1)
    speed_m_s = 1.0
    if speed is not None:
        speed_m_s = float(speed)
    rng = np.random.default_rng(seed)

    slot = np.arange(count)
    slots = 2.0 * np.stack([slot % 3, slot // 3], axis=1)
    slots = slots - 0.5 * (slots.min(0) + slots.max(0))

    angle_rad = rng.uniform(0.0, 2.0 * math.pi)
    aside_m = rng.uniform(-1.5, 1.5)  # distance by which the intruder misses the middle
    along = np.array([math.cos(angle_rad), math.sin(angle_rad)])
    across = np.array([-along[1], along[0]])

    reach_m = float(np.hypot(*slots.T).max()) + 3.0
    entry = aside_m * across - reach_m * along
    exit_ = entry + 2.0 * reach_m * along

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=_raised(np.concatenate([slots, entry[None]])),
        goal_enu_m=_raised(np.concatenate([slots, exit_[None]])),
        earliest_s=2.0 * reach_m / speed_m_s,
        intruder_m_s=np.array([*(speed_m_s * along), 0.0]),
    )


def _person(name: str, seed: int, number: str | None, speed: str | None) -> FlightPlan:
    """A person walks straight through a hovering formation."""
    plan_of_intruder = _intruder(name, seed, number, speed)
    return replace(plan_of_intruder, intruder_radius_m=_PERSON_RADIUS_M)


def _lost(name: str, seed: int, number: str | None, kind: str | None) -> FlightPlan:
    """A jittered swap in which one vehicle is lost after 1 to 5 s.

    If the name gives no kind, it is "frozen" for even seeds and "silent" for odd ones.
    """
    count = _number(name, number, 8)
    swap = _swap(name, seed, str(count), "")

    rng = np.random.default_rng([seed, 9])  # different random numbers from the swap's jitter
    index = int(rng.integers(count))
    time_s = float(rng.uniform(1.0, 5.0))
    if kind is None:
        kind = ("frozen", "silent")[seed % 2]

    return FlightPlan(
        scenario=name,
        seed=seed,
        start_enu_m=swap.start_enu_m,
        goal_enu_m=swap.goal_enu_m,
        lost=(index, time_s, kind),
    )


_SCENARIOS: dict[str, Callable[..., FlightPlan]] = {
    r"form3": _form3,
    r"swap(\d{1,4})(x?)": _swap,
    r"rand(\d{1,4})(?:d(\d+(?:\.\d+)?))?": _rand,
    r"cross(\d{1,4})?(?:@(90|180))?": _cross,
    r"layers(\d{1,4})": _layers,
    r"heights(\d{1,4})": _heights,
    r"climb(\d{1,4})": _climb,
    r"squeeze": _squeeze,
    r"forest(\d{1,4})?": _forest,
    r"gap(\d{1,4})?": _gap,
    r"intruder(\d{1,4})?(?:@(1|2|3))?": _intruder,
    r"person(\d{1,4})?(?:@(0\.5|1|1\.5))?": _person,
    r"lost(\d{1,4})?(?:@(frozen|silent|dead))?": _lost,
}
