"""Starts and goals: public scenarios, each drawn from its seed alone.

A name says everything: ``swap8`` (jittered) or ``swap8x`` (exact), ``rand16`` or ``rand16d4`` (4
m^2 per vehicle), ``cross8@180``, ``intruder6@2``, ``lost8@silent``, ``forest8``, ``gap6``.
Positions are fleet ENU, everybody at one height but for ``layers8``, ``heights8`` and ``climb8``.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.params import Capsule
from onboard.config.fleet import ConfigError
from sitl.monte_carlo import clutter

HEIGHT_M = 1.0
_UP = np.array([0.0, 0.0, 2.0])  # from one layer to the next
MIX = (
    *("form3", "swap4", "swap8", "swap16", "swap32", "swap4x", "swap8x", "swap16x", "swap32x"),
    *("rand8", "rand16", "rand32"),
)
_MAX_VEHICLES = 250
KNOWN = (
    "form3, swapN (jittered) and swapNx (exact), randN and randNdA (A m^2 per vehicle), crossN@90, crossN@180, "
    "layersN (two swaps above each other), heightsN (pairs swap heights), climbN (half climbs through the way of the "
    "other), squeeze, forestN (through pillars), gapN (both ways through a gap in a wall), intruderN@1, intruderN@2, "
    "lostN@frozen, lostN@silent, lostN@dead, and mix (the benchmark); "
    f"N is a number up to {_MAX_VEHICLES}"
)
_TRIANGLE_SIDE_M = 1.6
_PERMUTATIONS = tuple(itertools.permutations(range(3)))
_RAND_SPACING_M = 1.4
_CROSS_SPACING_M = 1.2


@dataclass(frozen=True, slots=True)
class Plan:
    """One flight to be flown; N vehicles.

    Kinds of lost vehicles: "frozen" stops and avoids nobody, which its messages say; "silent" flies
    on, receives the others and is not received; "dead" stops, avoids nobody and is not received.
    """

    scenario: str
    seed: int
    start_enu_m: Array  # (N, 3)
    goal_enu_m: Array  # (N, 3)
    duration_s: float = 0.0  # of the trajectory; 0: as fast as the limits allow
    earliest_s: float = 0.0  # the flight is not over before
    # (3,) velocity of the last vehicle, which is of no fleet and avoids nobody
    intruder_m_s: Array | None = None
    # index, time [s] and kind of a vehicle that is lost on the way
    lost: tuple[int, float, str] | None = None
    obstacles: tuple[Capsule, ...] = ()  # that stand still; the same for all seeds of a scenario

    @property
    def count(self) -> int:
        """Number of vehicles."""
        return int(self.start_enu_m.shape[0])


def expand(names: Iterable[str]) -> list[str]:
    """Scenario names with ``mix`` replaced by the twelve of the benchmark; ConfigError on an
    unknown one.
    """
    wanted = [name for given in names for name in (MIX if given == "mix" else (given,))]
    for name in wanted:
        vehicle_count(name)
    return list(dict.fromkeys(wanted))


def vehicle_count(name: str) -> int:
    """Vehicles of a scenario; ConfigError with a sentence when there is none of that name."""
    return plan(name, 0).count


def plan(name: str, seed: int, *, scale: float = 1.0) -> Plan:
    """The flight of a scenario and a seed; ``scale`` multiplies every position in the plane.

    Raises:
        ConfigError: no such scenario.
    """
    for pattern, make in _SCENARIOS.items():
        match = re.fullmatch(pattern, name)
        if match:
            made = make(name, seed, *match.groups())
            stretch = np.array([scale, scale, 1.0])
            return replace(
                made,
                start_enu_m=made.start_enu_m * stretch,
                goal_enu_m=made.goal_enu_m * stretch,
                duration_s=made.duration_s * scale,
                earliest_s=made.earliest_s * scale,
                obstacles=clutter.scaled(made.obstacles, scale),
            )
    raise ConfigError(f"'{name}' is not a scenario. Known: {KNOWN}.")


def _raised(points: Array) -> Array:
    """Points (N, 2) at the common height."""
    return np.concatenate([points, np.full((len(points), 1), HEIGHT_M)], axis=1)


def _number(name: str, text: str | None, default: int, *, low: int = 2) -> int:
    count = default if text is None else int(text)
    if not low <= count <= _MAX_VEHICLES:
        raise ConfigError(
            f"'{name}' asks for {count} vehicles; this scenario takes {low} to {_MAX_VEHICLES}."
        )
    return count


def _form3(name: str, seed: int) -> Plan:
    """Into a triangle of side 1.6 m about (0, 1.2) by the 6 permutations, trajectories of 7 s and 5
    s in turn.
    """
    rng = np.random.default_rng(seed)
    start = np.array([[-1.5, -1.5], [0.0, -1.5], [1.5, -1.5]]) + rng.normal(0.0, 0.1, (3, 2))
    radius = _TRIANGLE_SIDE_M / math.sqrt(3.0)
    slots = np.array([[0.0, radius], [-0.8, -0.5 * radius], [0.8, -0.5 * radius]]) + np.array(
        [0.0, 1.2]
    )
    goal = slots[list(_PERMUTATIONS[seed % 6])]
    return Plan(name, seed, _raised(start), _raised(goal), duration_s=(7.0, 5.0)[seed // 6 % 2])


def _circle(count: int) -> Array:
    radius = max(2.5, 1.25 * count / (2.0 * math.pi))
    angle = 2.0 * math.pi * np.arange(count) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _swap(name: str, seed: int, number: str, exact: str) -> Plan:
    """Everybody to the opposite place of a circle; all through its centre. Without jitter all seeds
    start alike.
    """
    count = _number(name, number, 2)
    places = _circle(count)
    jitter = np.random.default_rng(seed).normal(0.0, 0.05, (count, 2))
    return Plan(name, seed, _raised(places if exact else places + jitter), _raised(-places))


def _rand(name: str, seed: int, number: str, density: str | None) -> Plan:
    """Random starts and goals in a square, each set spaced by 1.4 m or more."""
    count = _number(name, number, 2, low=1)
    area = 6.0 if density is None else float(density)
    if not 3.5 <= area <= 1000.0:
        raise ConfigError(
            f"'{name}' asks for {area:g} m^2 per vehicle; spacings of 1.4 m fit from 3.5 m^2 on."
        )
    side = math.sqrt(area * count)
    rng = np.random.default_rng(seed)
    return Plan(
        name, seed, _raised(_scatter(rng, count, side)), _raised(_scatter(rng, count, side))
    )


def _scatter(rng: np.random.Generator, count: int, side_m: float) -> Array:
    """``count`` points of a square about the origin, drawn one by one; begun anew when there is no
    room left.
    """
    while True:
        points = np.empty((0, 2))
        for _ in range(400 * count):
            point = rng.uniform(-0.5 * side_m, 0.5 * side_m, 2)
            if ((points - point) ** 2).sum(1).min(initial=np.inf) >= _RAND_SPACING_M**2:
                points = np.concatenate([points, point[None]])
                if len(points) == count:
                    return points


def _cross(name: str, seed: int, number: str | None, angle: str | None) -> Plan:
    """Two blocks, spacing 1.2 m, fly through each other at 90 or 180 degrees; starts jittered by 5
    cm.
    """
    count = _number(name, number, 8)
    turn = math.radians(float(angle or 90))
    first = count // 2
    width = math.ceil(math.sqrt(count - first))
    slot = np.arange(count - first)
    block = _CROSS_SPACING_M * np.stack([slot // width, slot % width], axis=1).astype(np.float64)
    block -= 0.5 * (block.min(0) + block.max(0))
    reach = np.array([2.0 + 0.5 * _CROSS_SPACING_M * width, 0.0])
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    start = np.concatenate([block[:first] - reach, (block - reach) @ turned.T])
    goal = np.concatenate([block[:first] + reach, (block + reach) @ turned.T])
    jitter = np.random.default_rng(seed).normal(0.0, 0.05, (count, 2))
    return Plan(name, seed, _raised(start + jitter), _raised(goal))


def _layers(name: str, seed: int, number: str) -> Plan:
    """Two jittered swaps, one above the other, whose places lie above each other."""
    half = _even(name, number)
    low = _swap(name, seed, str(half), "")
    start, goal = (np.concatenate([at, at + _UP]) for at in (low.start_enu_m, low.goal_enu_m))
    return Plan(name, seed, start, goal)


def _heights(name: str, seed: int, number: str) -> Plan:
    """Pairs of vehicles above each other, 3 m from pair to pair, change their heights."""
    half = _even(name, number)
    row = np.stack([3.0 * np.arange(half), np.zeros(half)], axis=1)
    low, high = _raised(row), _raised(row) + _UP
    jitter = np.concatenate(
        [np.random.default_rng(seed).normal(0.0, 0.05, (2 * half, 2)), np.zeros((2 * half, 1))], 1
    )
    return Plan(name, seed, np.concatenate([low, high]) + jitter, np.concatenate([high, low]))


def _climb(name: str, seed: int, number: str) -> Plan:
    """Half of them climb, 1.5 m apart in a row; the others fly along the row above them, in the
    middle of the climb.
    """
    half = _even(name, number)
    place = 1.5 * (np.arange(half) - 0.5 * (half - 1))
    row = _raised(np.stack([place, np.zeros(half)], axis=1))
    reach = np.array([1.5 * half + 1.0, 0.0, 0.0])
    jitter = np.concatenate(
        [np.random.default_rng(seed).normal(0.0, 0.05, (2 * half, 2)), np.zeros((2 * half, 1))], 1
    )
    start = np.concatenate([row, row - reach + 0.5 * _UP]) + jitter
    return Plan(name, seed, start, np.concatenate([row + _UP, row + reach + 0.5 * _UP]))


def _even(name: str, number: str) -> int:
    """Half of the number of vehicles."""
    count = _number(name, number, 4)
    if count % 2:
        raise ConfigError(
            f"'{name}' asks for {count} vehicles; this scenario takes an even number of them."
        )
    return count // 2


def is_stacked(name: str) -> bool:
    """Whether vehicles of a scenario begin above each other."""
    start = plan(name, 0).start_enu_m
    return bool((np.abs(np.diff(np.sort(start[:, 2]))) > 0.0).any())


def _squeeze(name: str, seed: int) -> Plan:
    """Three in a line; the outer two move in to 1.1 m beside the middle one."""
    start = np.array([[-2.5, 0.0], [0.0, 0.0], [2.5, 0.0]])
    goal = np.array([[-1.1, 0.0], [0.0, 0.0], [1.1, 0.0]])
    jitter = np.random.default_rng(seed).normal(0.0, 0.05, (3, 2))
    return Plan(name, seed, _raised(start + jitter), _raised(goal))


def _forest(name: str, seed: int, number: str | None) -> Plan:
    """Half from the left and half from the right, each to a place of the other side, through the
    same pillars.
    """
    half = _even(name, number or "8")
    rng = np.random.default_rng(seed)
    place = 1.5 * (np.arange(half) - 0.5 * (half - 1))
    sides = [
        np.stack([np.full(half, x), place], axis=1) + rng.normal(0.0, 0.05, (half, 2))
        for x in (-5.0, 5.0)
    ]
    start = np.concatenate(sides)
    goal = np.concatenate([sides[1][rng.permutation(half)], sides[0][rng.permutation(half)]])
    return Plan(
        name, seed, _raised(start), _raised(goal), obstacles=clutter.forest(half // 2 + 2, half)
    )


def _gap(name: str, seed: int, number: str | None) -> Plan:
    """Half from the left and half from the right, in two lanes, through one gap to the other side."""
    half = _even(name, number or "6")
    slot = np.arange(half)
    lanes = np.stack([2.5 + 1.4 * (slot // 2), 0.7 * (1.0 - 2.0 * (slot % 2))], axis=1)
    jitter = np.random.default_rng(seed).normal(0.0, 0.05, (2 * half, 2))
    start = np.concatenate([lanes * (-1.0, 1.0), lanes]) + jitter
    goal = np.concatenate([lanes[::-1], lanes[::-1] * (-1.0, 1.0)])
    return Plan(name, seed, _raised(start), _raised(goal), obstacles=clutter.gap())


def _intruder(name: str, seed: int, number: str | None, speed: str | None) -> Plan:
    """A hovering formation (rows of three, spacing 2 m); somebody else's vehicle flies straight
    through it.
    """
    count = _number(name, number, 6, low=1)
    speed_m_s = float(speed or 1)
    rng = np.random.default_rng(seed)
    slot = np.arange(count)
    slots = 2.0 * np.stack([slot % 3, slot // 3], axis=1)
    slots = slots - 0.5 * (slots.min(0) + slots.max(0))
    angle, aside = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-1.5, 1.5)
    along = np.array([math.cos(angle), math.sin(angle)])
    reach = float(np.hypot(*slots.T).max()) + 3.0
    entry = aside * np.array([-along[1], along[0]]) - reach * along
    exit_ = entry + 2.0 * reach * along
    return Plan(
        name,
        seed,
        _raised(np.concatenate([slots, entry[None]])),
        _raised(np.concatenate([slots, exit_[None]])),
        earliest_s=2.0 * reach / speed_m_s,
        intruder_m_s=np.array([*(speed_m_s * along), 0.0]),
    )


def _lost(name: str, seed: int, number: str | None, kind: str | None) -> Plan:
    """A jittered swap; one vehicle is lost after 1 to 5 s, frozen or silent in turn if the name
    does not say.
    """
    count = _number(name, number, 8)
    base = _swap(name, seed, str(count), "")
    rng = np.random.default_rng([seed, 9])
    lost = (
        int(rng.integers(count)),
        float(rng.uniform(1.0, 5.0)),
        kind or ("frozen", "silent")[seed % 2],
    )
    return Plan(name, seed, base.start_enu_m, base.goal_enu_m, lost=lost)


_SCENARIOS: dict[str, Callable[..., Plan]] = {
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
    r"intruder(\d{1,4})?(?:@(1|2))?": _intruder,
    r"lost(\d{1,4})?(?:@(frozen|silent|dead))?": _lost,
}
