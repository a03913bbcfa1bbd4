"""The flights of a scene: its vehicles and their settings, and starts and goals by the seed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array
from onboard.avoidance.params import Capsule
from onboard.config.config_error import ConfigError
from onboard.vectors import Vec2
from sitl.monte_carlo import campaign_settings
from sitl.monte_carlo.clutter import Outlines
from sitl.monte_carlo.open_benchmark.scene_file import (
    Circle,
    Listed,
    Scene,
    Square,
    least_distance_m,
)
from sitl.monte_carlo.scenarios import HEIGHT_M, FlightPlan, OtherLaw

_STREAM = 31  # random numbers of scenes; no other part of a flight draws from this stream
_ATTEMPTS = 400  # attempts for each point before the square is emptied
_MAX_ATTEMPTS = 50_000  # total attempts, which take a second
_BODY_M = 0.5  # diameter of a vehicle
_FREE_M = 0.4  # least gap between the body of a vehicle at a drawn point and an obstacle


def setup(
    scene: Scene,
    *,
    law: str | None = None,
    changes: Sequence[str] = (),
    fleet_path: str | None = None,
) -> campaign_settings.Setup:
    """Return the settings of all flights of a scene.

    Args:
        scene: the scene.
        law: the law that is judged; by default Covey's.
        changes: further changes as ``key=value``, after those of the scene.
        fleet_path: a fleet file with the vehicle types.

    Raises:
        ConfigError: type, errors, a key or a value is wrong, or vehicles begin or end too close to
            each other or to an obstacle.
    """
    types: str | None = scene.type
    if types == campaign_settings.DEFAULT_TYPE:
        types = None  # a fleet file may have no type of that name
    made = campaign_settings.setup_for(
        law=law,
        types=types,
        fleet_path=fleet_path,
        errors=scene.errors,
        changes=(*scene.changes, *changes),
    )
    if scene.others is not None:
        made = made.with_law_source(scene.others.law)
    _check_places(scene, made)
    return made


def _check_places(scene: Scene, setup: campaign_settings.Setup) -> None:
    """Refuse a scene whose starts or goals are too close to each other or to an obstacle."""
    count = vehicle_count(scene)
    fleet = setup.fleet(count).fleet
    exact = plan(scene, seed=0, is_jittered=False)
    members = scene.placing.vehicles

    points_by_verb = {
        "start": exact.start_enu_m[:members],
        "end": exact.goals_enu_m[-1, :members],
    }
    for verb, points_enu_m in points_by_verb.items():
        nearest_m = least_distance_m([(x, y) for x, y, _ in points_enu_m.tolist()])
        if nearest_m < fleet.safety_distance_m:
            raise ConfigError(
                f"the scene {scene.name}: two vehicles {verb} {nearest_m:.2f} m from each other, "
                f"and the safety distance is {fleet.safety_distance_m:g} m. Move them apart."
            )

        outlines = Outlines(exact.obstacles)
        gap_m = outlines.gaps_m(points_enu_m[None, :, :2]).min() - 0.5 * fleet.body_diameter_m
        if gap_m < 0.0:
            raise ConfigError(
                f"the scene {scene.name}: a vehicle would {verb} in an obstacle, "
                f"{-gap_m:.2f} m deep. Move it away."
            )


def vehicle_count(scene: Scene) -> int:
    """Return the number of vehicles of a scene, with its intruder."""
    if scene.intruder is None:
        return scene.placing.vehicles
    return scene.placing.vehicles + 1


def plan(scene: Scene, seed: int, *, is_jittered: bool = True) -> FlightPlan:
    """Return the flight of a scene and a seed.

    Args:
        scene: the scene.
        seed: the seed of all random numbers.
        is_jittered: whether the starts have their jitter.

    Raises:
        ConfigError: the square of the scene is too full for its points.
    """
    rng = np.random.default_rng([seed, _STREAM])
    obstacles = _capsules(scene)
    start, goals = _points(scene, rng, obstacles)

    earliest_s = 0.0
    intruder_m_s = None
    intruder_radius_m = 0.0
    if scene.intruder is not None:
        entry = np.array([scene.intruder.start_enu_m])
        intruder_m_s = np.array([*scene.intruder.velocity_enu_m_s, 0.0])
        intruder_radius_m = scene.intruder.person_radius_m
        earliest_s = scene.intruder.leaves_s
        exit_ = entry + earliest_s * intruder_m_s[:2]
        start = np.concatenate([start, entry])
        goals = np.concatenate([goals, np.broadcast_to(exit_, (len(goals), 1, 2))], axis=1)

    if is_jittered:
        start = start + rng.normal(0.0, 1.0, start.shape) * scene.jitter_m

    longest_s = 0.0
    if scene.within_s is not None:
        longest_s = scene.within_s

    later_goals = None
    if len(goals) > 1:
        later_goals = _raised(goals[1:])
    other_law = None
    if scene.others is not None:
        other_law = OtherLaw(name=scene.others.law, vehicles=scene.others.vehicles)

    return FlightPlan(
        scenario=scene.name,
        seed=seed,
        start_enu_m=_raised(start),
        goal_enu_m=_raised(goals[0]),
        earliest_s=earliest_s,
        intruder_m_s=intruder_m_s,
        intruder_radius_m=intruder_radius_m,
        obstacles=obstacles,
        later_goals_enu_m=later_goals,
        blind=scene.blind,
        other_law=other_law,
        longest_s=longest_s,
    )


def _points(
    scene: Scene, rng: np.random.Generator, obstacles: Sequence[Capsule]
) -> tuple[Array, Array]:
    """Return the starts (N, 2) of the fleet's members, and their goals (G, N, 2) in order."""
    placing = scene.placing
    if isinstance(placing, Circle):
        angle = 2.0 * math.pi * np.arange(placing.vehicles) / placing.vehicles
        start = placing.radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return start, -start[None]

    if isinstance(placing, Listed):
        return np.array(placing.start_enu_m), np.array([placing.goal_enu_m])

    start = _drawn(scene.name, placing, placing.vehicles, rng, obstacles)
    return start, _drawn_goals(scene.name, placing, rng, obstacles)


def _drawn_goals(
    name: str, placing: Square, rng: np.random.Generator, obstacles: Sequence[Capsule]
) -> Array:
    """Return the goals (G, N, 2) of a square, in order.

    A vehicle stays at its last goal. So no other goal is near a last one, or it could not be
    reached.
    """
    count = placing.vehicles * placing.goals_each
    if placing.goals_apart == "all":
        goals = _drawn(name, placing, count, rng, obstacles)
        return goals.reshape(placing.goals_each, placing.vehicles, 2)

    last = _drawn(name, placing, placing.vehicles, rng, obstacles)
    earlier = [
        _drawn(name, placing, placing.vehicles, rng, obstacles, beside=last)
        for _ in range(placing.goals_each - 1)
    ]
    return np.stack([*earlier, last])


def _drawn(
    name: str,
    placing: Square,
    count: int,
    rng: np.random.Generator,
    obstacles: Sequence[Capsule],
    beside: Array | None = None,
) -> Array:
    """Return points (count, 2) of a square, apart from each other and from obstacles.

    If they do not fit after many attempts, the square is emptied and filled anew.

    Args:
        beside: points (K, 2) that the drawn ones are apart from, too.
    """
    half_m = 0.5 * placing.side_m
    known = np.empty((0, 2)) if beside is None else beside
    points = known
    outlines = Outlines(obstacles)
    for attempt in range(_MAX_ATTEMPTS):
        if attempt % (_ATTEMPTS * count) == 0:
            points = known

        point = rng.uniform(-half_m, half_m, 2)
        distances_m = np.hypot(*(points - point).T)
        if distances_m.min(initial=math.inf) < placing.spacing_m:
            continue
        gap_m = outlines.gaps_m(point[None, None]).item()
        if gap_m < 0.5 * _BODY_M + _FREE_M:
            continue

        points = np.concatenate([points, point[None]])
        drawn = points[len(known) :]
        if len(drawn) == count:
            return drawn
    raise ConfigError(
        f"the scene {name}: {count} points that are {placing.spacing_m:g} m apart were not found "
        f"in a square of {placing.side_m:g} m between its obstacles. Make it larger."
    )


def _capsules(scene: Scene) -> tuple[Capsule, ...]:
    """Return the obstacles as the law and the metrics take them."""
    capsules = []
    for obstacle in scene.obstacles:
        begin = Vec2(*map(float, obstacle.begin_enu_m))
        end = begin
        if obstacle.end_enu_m is not None:
            end = Vec2(*map(float, obstacle.end_enu_m))
        capsules.append(Capsule(begin, end, obstacle.radius_m))
    return tuple(capsules)


def _raised(points: Array) -> Array:
    """Return horizontal points (..., 2) with the common height added, (..., 3)."""
    heights = np.full((*points.shape[:-1], 1), HEIGHT_M)
    return np.concatenate([points, heights], axis=-1)
