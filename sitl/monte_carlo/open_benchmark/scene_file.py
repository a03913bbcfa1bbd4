"""Scenes of the open benchmark: JSON files that say what is flown; see docs/open-benchmark.md.

A scene file is untrusted, so its size is limited, unknown keys are refused, and every number has
bounds. Reading a scene runs no code; a law that it names is imported when it flies.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Literal

import msgspec

from onboard.config.config_error import ConfigError
from onboard.config.file_reading import SCENE_FILE, json_values, read_bytes
from onboard.config.law import LawConfig
from onboard.config.law_import import find_own_law
from onboard.config.toml_reading import bound_problems, convert, table
from sitl.monte_carlo.campaign_settings import parsed_change

SCHEMA = 1
_PACKAGE = "sitl.monte_carlo.open_benchmark"
_SUFFIX = ".json"

_MAX_OBSTACLES = 500
_LARGEST_M = 1000.0  # largest coordinate
_LARGEST_M_S = 20.0
# key -> smallest and largest value
BOUNDS: dict[str, tuple[float, float]] = {
    "vehicles": (1, 250),
    "radius_m": (0.01, _LARGEST_M),
    "side_m": (0.1, _LARGEST_M),
    "spacing_m": (0.1, 100.0),
    "goals_each": (1, 200),
    "jitter_m": (0.0, 1.0),
    "leaves_s": (0.0, 3600.0),
    "person_radius_m": (0.0, 5.0),
    "within_s": (1.0, 3600.0),
}
# least area per drawn point, in squares of the spacing; random draws rarely find denser points
_AREA_OF_SPACING = 1.75

Point = tuple[float, float]  # east, north


class Circle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="circle"):
    """Vehicles on a circle about the origin; each flies to the opposite point."""

    vehicles: int  # number of the fleet's vehicles
    radius_m: float  # of the circle


class Square(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="square"):
    """Starts and goals drawn by the seed, in a square about the origin."""

    vehicles: int  # number of the fleet's vehicles
    side_m: float  # of the square
    spacing_m: float = 1.4  # least distance of two starts, and of two goals
    # goals of each vehicle; the next one is given on arrival, and all must be reached
    goals_each: int = 1
    # "all": the spacing holds for any two goals of a flight; "last": for the first goals of all
    # vehicles, for their second goals and so on, and between the last goals and all others. So a
    # vehicle's next goal may be near another vehicle that has not left yet.
    goals_apart: Literal["all", "last"] = "all"

    @property
    def drawn_at_once(self) -> int:
        """Number of points that are drawn together, all of them apart from each other."""
        if self.goals_apart == "all":
            return self.vehicles * self.goals_each
        return 2 * self.vehicles


class Listed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag="listed"):
    """Starts and goals one by one."""

    start_enu_m: tuple[tuple[float, float], ...]  # of each vehicle: east, north
    goal_enu_m: tuple[tuple[float, float], ...]  # of each vehicle, in the same order

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        return len(self.start_enu_m)


class Obstacle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A pillar, or a wall with round ends; without a limit of height."""

    begin_enu_m: tuple[float, float]  # middle of a pillar, or of one end of a wall
    radius_m: float  # of the pillar; half the thickness of a wall
    end_enu_m: tuple[float, float] | None = None  # middle of a wall's other end


class Intruder(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An outside vehicle or a walking person that goes straight on without avoiding others."""

    start_enu_m: tuple[float, float]  # east, north
    velocity_enu_m_s: tuple[float, float]  # east, north
    leaves_s: float  # the flight does not end before this time
    # radius of the circle around a person, to which all distances are measured; 0: a vehicle
    person_radius_m: float = 0.0


class Others(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Vehicles that use a different law from the one that is judged."""

    law: str  # as --law takes it
    vehicles: tuple[int, ...]  # indexes, from 0 on


class Scene(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A scene as its file describes it."""

    schema: int  # 1
    name: str  # up to 40 letters, digits, - and _
    about: str  # what happens, in a sentence
    placing: Circle | Square | Listed  # starts and goals; its "type" is circle, square or listed
    jitter_m: float = 0.05  # standard deviation of each start per axis; 0: none
    obstacles: tuple[Obstacle, ...] = ()  # the same for all seeds
    # vehicle types separated by commas, assigned to the vehicles in turn; "sih" stands for the
    # first type of a fleet file that has none of that name
    type: str = "sih"
    errors: str = "mocap"  # accuracy of the estimates
    # values as --set of covey simulate takes them: delay, loss, wind, limits
    set: dict[str, float | int | bool | str] = {}
    intruder: Intruder | None = None  # an outside vehicle, or a person
    blind: tuple[int, ...] = ()  # indexes of vehicles that receive no messages
    others: Others | None = None  # vehicles that use another law
    # time in which all must arrive; without it 5.5 times the straight-line time
    within_s: float | None = None

    @property
    def changes(self) -> tuple[str, ...]:
        """Return the values of ``set`` as arguments of --set."""
        changes = []
        for key, value in self.set.items():
            text = str(value)
            if isinstance(value, bool):
                text = text.lower()
            changes.append(f"{key}={text}")
        return tuple(changes)


def is_scene(name: str) -> bool:
    """Return whether a name on the command line is that of a scene file."""
    return name.endswith(_SUFFIX)


def names() -> list[str]:
    """Return the names of the scenes that are part of this software."""
    folder = files(_PACKAGE).joinpath("scenes")
    found = [entry.name for entry in folder.iterdir() if entry.name.endswith(_SUFFIX)]
    return sorted(name.removesuffix(_SUFFIX) for name in found)


def load(path: str | os.PathLike[str]) -> Scene:
    """Read a scene.

    Args:
        path: path of the file. If it does not exist, one of Covey's scenes of that name is read,
            for instance ``circle.json``.

    Raises:
        ConfigError: the file is missing, too large, not JSON, or not a scene.
    """
    found = Path(path)
    is_name_only = found.parent == Path()
    if not found.exists() and is_name_only:
        if found.stem not in names():
            known = ", ".join(f"{name}{_SUFFIX}" for name in names())
            raise ConfigError(
                f"{path}: there is no such scene. Give the path of an existing one, or one of "
                f"Covey's: {known}."
            )
        return packaged(found.stem)
    return parsed(read_bytes(found, SCENE_FILE), str(path))


def packaged(name: str) -> Scene:
    """Return a scene of this software, whatever files of its name exist elsewhere.

    Args:
        name: one of :func:`names`.
    """
    file = f"{name}{_SUFFIX}"
    path = str(files(_PACKAGE).joinpath("scenes", file))
    return parsed(read_bytes(path, SCENE_FILE), file)


def parsed(data: bytes, path: str) -> Scene:
    """Return the scene in a file's bytes.

    Args:
        data: content of the file.
        path: its path, for messages.

    Raises:
        ConfigError: see :func:`load`.
    """
    values = table(json_values(data, path), path, "scene")
    if values.get("schema") != SCHEMA:
        raise ConfigError(
            f"{path}: schema is {values.get('schema', 'missing')!r}, and this version reads scenes "
            f'of schema {SCHEMA}. Write "schema": {SCHEMA}.'
        )

    scene: Scene = convert(values, Scene, path, "scene")
    for problem in _problems(scene):  # the first one is enough
        raise ConfigError(f"{path}: {problem}")
    return scene


def _problems(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each value that cannot be flown; a check relies on those before it."""
    without_dashes = scene.name.replace("-", "").replace("_", "")
    is_plain = without_dashes.isalnum() and without_dashes.isascii()
    if not is_plain or len(scene.name) > 40:
        yield (
            f"'name' is {scene.name!r}; write up to 40 letters, digits, - and _, because files "
            "are named after it."
        )

    yield from _number_problems(scene, "jitter_m")
    if scene.within_s is not None:
        yield from _number_problems(scene, "within_s")
    yield from _placing_problems(scene.placing)

    if len(scene.obstacles) > _MAX_OBSTACLES:
        yield (
            f"there are {len(scene.obstacles)} obstacles; {_MAX_OBSTACLES} are the most. Join "
            "pillars to walls."
        )
    for obstacle in scene.obstacles:
        yield from _number_problems(obstacle, "radius_m", "obstacles.")
    if scene.intruder is not None:
        yield from _number_problems(scene.intruder, "leaves_s", "intruder.")
        yield from _number_problems(scene.intruder, "person_radius_m", "intruder.")
        for speed_m_s in scene.intruder.velocity_enu_m_s:
            key = "intruder.velocity_enu_m_s"
            yield from bound_problems(key, speed_m_s, -_LARGEST_M_S, _LARGEST_M_S)

    for key, point in _points(scene):
        for coordinate_m in point:
            yield from bound_problems(key, coordinate_m, -_LARGEST_M, _LARGEST_M)

    yield from _index_problems(scene)
    if scene.others is not None and LawConfig(name=scene.others.law).is_own:
        try:
            find_own_law(scene.others.law, (os.getcwd(),), "'others.law'")
        except ConfigError as error:
            yield str(error)

    for change in scene.changes:
        try:
            parsed_change(change)
        except ConfigError as error:
            yield f"'set' has {error}"


def _number_problems(struct: msgspec.Struct, key: str, prefix: str = "") -> Iterator[str]:
    """Yield a sentence if a number is out of its bounds."""
    low, high = BOUNDS[key]
    yield from bound_problems(f"{prefix}{key}", getattr(struct, key), low, high)


def _placing_problems(placing: Circle | Square | Listed) -> Iterator[str]:
    yield from _number_problems(placing, "vehicles", "placing.")

    if isinstance(placing, Circle):
        yield from _number_problems(placing, "radius_m", "placing.")
    elif isinstance(placing, Square):
        yield from _number_problems(placing, "goals_each", "placing.")
        yield from _number_problems(placing, "spacing_m", "placing.")
        least_m = placing.spacing_m * math.sqrt(_AREA_OF_SPACING * placing.drawn_at_once)
        for sentence in bound_problems("placing.side_m", placing.side_m, least_m, _LARGEST_M):
            yield (
                f"{sentence} {placing.drawn_at_once} places that are spacing_m = "
                f"{placing.spacing_m:g} m apart need that."
            )
    elif len(placing.goal_enu_m) != placing.vehicles:
        yield (
            f"'placing' lists {placing.vehicles} starts and {len(placing.goal_enu_m)} goals. Give "
            "each vehicle one of both."
        )


def _points(scene: Scene) -> Iterator[tuple[str, Point]]:
    """Yield all points of a scene with their keys."""
    if isinstance(scene.placing, Listed):
        for start in scene.placing.start_enu_m:
            yield "placing.start_enu_m", start
        for goal in scene.placing.goal_enu_m:
            yield "placing.goal_enu_m", goal
    for obstacle in scene.obstacles:
        yield "obstacles.begin_enu_m", obstacle.begin_enu_m
        if obstacle.end_enu_m is not None:
            yield "obstacles.end_enu_m", obstacle.end_enu_m
    if scene.intruder is not None:
        yield "intruder.start_enu_m", scene.intruder.start_enu_m


def _index_problems(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each index that is not a vehicle of the scene."""
    last = scene.placing.vehicles - 1
    for index in scene.blind:
        yield from bound_problems("blind", index, 0, last)
    if scene.others is not None:
        for index in scene.others.vehicles:
            yield from bound_problems("others.vehicles", index, 0, last)


def least_distance_m(points: Sequence[Point]) -> float:
    """Return the smallest distance [m] of two points; infinite for fewer than two."""
    pairs = itertools.combinations(points, 2)
    return min((math.dist(one, other) for one, other in pairs), default=math.inf)
