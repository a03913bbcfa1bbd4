"""The course of a mission before it flies: each step with its order, from where to where, and its
duration. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from groundstation.formations.assignment import nearest_slots
from groundstation.formations.frame import Begin, frame_paths
from groundstation.formations.slots import formation_names, formation_slots
from groundstation.mission_files.steps import (
    BlockStep,
    FlyFormationStep,
    FollowPathStep,
    FormationStep,
    GotoStep,
    HomeStep,
    LandStep,
    MissionStep,
    MoveStep,
    OrderStep,
    ParallelStep,
    ReactStep,
    RepeatStep,
    RotateStep,
    TakeoffStep,
    WaitStep,
    YawStep,
)
from groundstation.orders.grammar import Intent, Verb, default_formation
from groundstation.orders.plan import HeldFormation, PlannedOrder, held_slots, plan_order, slots_of
from onboard.config.fleet import ConfigError, FleetConfig, Vec3
from onboard.control.path import Path, point_at
from onboard.control.trajectory import TrajectoryParams, shortest_duration_s
from onboard.control.vertical import vertical_s

_START_S, _SETTLE_S = 3.0, 1.0
_PEAK = 1.875  # of a move's speed, times its mean
_GROUND = TakeoffStep | LandStep | HomeStep

PathsOf = Callable[[FollowPathStep], Mapping[str, Path]]


@dataclass(frozen=True, slots=True)
class Stage:
    """One step of a mission as it is expected to be flown."""

    key: str  # of the step in the file: step[2].steps[0]
    step: MissionStep
    positions: Mapping[str, Vec3]  # of all vehicles before it
    flying: frozenset[str]  # before it
    is_known: bool  # whether that is certain; after a fault or a reaction it is not
    times: int = 1  # that it is flown so
    planned: PlannedOrder | None = None  # of a step that is an order
    goals: Mapping[str, Vec3] = field(default_factory=dict)  # where vehicles are after it
    paths: Mapping[str, Path] = field(default_factory=dict)
    # what each vehicle needs without the others
    alone_s: Mapping[str, float] = field(default_factory=dict)
    expected_s: float = 0.0


@dataclass(slots=True)
class _Fleet:
    """Where the vehicles are at one time of the course."""

    positions: dict[str, Vec3]
    held: HeldFormation
    flying: set[str] = field(default_factory=set)
    is_known: bool = True


def course(
    fleet: FleetConfig, steps: Sequence[MissionStep], paths_of: PathsOf, path: str
) -> Iterator[Stage]:
    """Yield the stages of a mission in the order in which they are flown; branches side by side
    come one by one.

    Args:
        fleet: the fleet file.
        steps: of the mission.
        paths_of: the paths of a step that follows some.
        path: of the mission file, for the sentences.

    Raises:
        ConfigError: a step names a vehicle or a formation that does not exist.
    """
    starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    now = _Fleet(starts, HeldFormation(default_formation(fleet)))
    for index, step in enumerate(steps):
        yield from _stages(fleet, step, f"step[{index}]", now, paths_of, path)


def intent_of(step: OrderStep, fleet: FleetConfig) -> Intent:
    """Return the order that a step gives.

    Args:
        step: of a mission file.
        fleet: the fleet file.

    Returns:
        Its intent; a speed is not in it.

    Raises:
        ConfigError: a vehicle or a formation is unknown.
    """
    names = fleet.select(step.vehicles)
    if isinstance(step, TakeoffStep | HomeStep):
        intent = Intent(
            "home" if isinstance(step, HomeStep) else "takeoff", names, height_m=step.height_m
        )
        return replace(intent, duration_s=step.duration_s) if isinstance(step, HomeStep) else intent
    if isinstance(step, RotateStep):
        return Intent("rotate", names, rotation_deg=step.angle_deg, duration_s=step.duration_s)
    if isinstance(step, YawStep):
        return Intent("yaw", names, yaw_deg=step.yaw_deg)
    if isinstance(step, GotoStep):
        own = fleet.select(list(step.goals))
        goals = dict(zip(own, step.goals.values(), strict=True))
        return Intent("goto", own, goals=goals, duration_s=step.duration_s, yaw_deg=step.yaw_deg)
    if isinstance(step, MoveStep):
        intent = Intent("move", names, position_enu_m=step.position_enu_m)
        return replace(intent, duration_s=step.duration_s, yaw_deg=step.yaw_deg)
    if isinstance(step, FormationStep):
        if step.name not in formation_names(fleet):
            known = ", ".join(formation_names(fleet)) or "it has none"
            raise ConfigError(
                f"'{step.name}' is no formation of fleet '{fleet.fleet.name}': {known}. Correct 'name'."
            )
        if step.vehicles in ("all", ["all"]):
            names = tuple(name for name in names if name in formation_slots(fleet, step.name))
        return Intent(
            "formation",
            names,
            position_enu_m=step.position_enu_m,
            formation=step.name,
            duration_s=step.duration_s,
            spacing_m=step.spacing_m,
            yaw_deg=step.yaw_deg,
            rotation_deg=step.rotation_deg or None,
            is_nearest=step.assign == "nearest",
        )
    return Intent(cast(Verb, step.do), names)


def with_speed(
    intent: Intent, speed_m_s: float | None, goals: Mapping[str, Vec3], spots: Mapping[str, Vec3]
) -> Intent:
    """Return a move that takes as long as its longest way at this speed.

    Args:
        intent: a move.
        speed_m_s: the most on that way [m/s]; None leaves the intent as it is.
        goals: of the vehicles [m].
        spots: where they are [m].
    """
    ways_m = [math.dist(goals[name], spots[name]) for name in goals if name in spots]
    if speed_m_s is None or not ways_m:
        return intent
    return replace(intent, duration_s=min(600.0, _PEAK * max(ways_m) / speed_m_s))


def formation_paths(
    step: FlyFormationStep, fleet: FleetConfig, positions: Mapping[str, Vec3]
) -> dict[str, Path]:
    """Return the paths of a formation's flight.

    Args:
        step: of a mission file.
        fleet: the fleet file.
        positions: of the vehicles before it [m].

    Raises:
        ConfigError: see :func:`groundstation.formations.frame.frame_paths`.
    """
    begin = Begin(
        name=step.name,
        position_enu_m=step.position_enu_m,
        rotation_deg=step.rotation_deg,
        spacing_m=step.spacing_m,
        leader=step.leader,
    )
    return frame_paths(fleet, begin, step.to, positions if step.assign == "nearest" else None)


def _stages(
    fleet: FleetConfig,
    step: MissionStep,
    key: str,
    now: _Fleet,
    paths_of: PathsOf,
    path: str,
    times: int = 1,
) -> Iterator[Stage]:
    if isinstance(step, BlockStep):
        for inner, inner_key, count in _inner(step, key):
            yield from _stages(fleet, inner, inner_key, now, paths_of, path, times * count)
        now.is_known = now.is_known and not isinstance(step, ReactStep)
        return
    try:
        stage = _stage(fleet, step, key, now, paths_of)
    except ConfigError as error:
        raise ConfigError(f"{path}: '{key}' ({step.do}): {error}") from None
    yield replace(stage, times=times)
    now.positions.update(stage.goals)
    if stage.planned is not None:
        now.held = stage.planned.held
    if isinstance(step, TakeoffStep):
        now.flying.update(stage.goals)
    elif isinstance(step, LandStep | HomeStep):
        now.flying.difference_update(stage.goals)
    now.is_known = now.is_known and step.do != "fault"


def _inner(step: BlockStep, key: str) -> Iterator[tuple[MissionStep, str, int]]:
    """Yield the steps within a step with their keys; of repetitions the first, and the second for
    all others.
    """
    if isinstance(step, RepeatStep):
        for count in (1, step.times - 1) if step.times > 1 else (1,):
            yield from ((inner, f"{key}.steps[{k}]", count) for k, inner in enumerate(step.steps))
    elif isinstance(step, ParallelStep):
        for j, branch in enumerate(step.branches):
            yield from ((inner, f"{key}.branches[{j}][{k}]", 1) for k, inner in enumerate(branch))
    else:
        yield from ((inner, f"{key}.steps[{k}]", 1) for k, inner in enumerate(step.steps))
        yield from ((inner, f"{key}.then[{k}]", 1) for k, inner in enumerate(step.then))


def _stage(
    fleet: FleetConfig, step: MissionStep, key: str, now: _Fleet, paths_of: PathsOf
) -> Stage:
    stage = Stage(key, step, dict(now.positions), frozenset(now.flying), now.is_known)
    if isinstance(step, FollowPathStep | FlyFormationStep):
        is_own = isinstance(step, FollowPathStep)
        paths = paths_of(step) if is_own else formation_paths(step, fleet, now.positions)  # type: ignore[arg-type]
        if not paths or not set(paths) <= set(fleet.enabled_names):
            return replace(stage, paths=paths)
        begins, ends = (
            {name: _point(one, time_s) for name, one in paths.items()} for time_s in (0.0, math.inf)
        )
        there_s = max(
            _move_s(fleet, name, now.positions[name], begins[name], 0.0) for name in paths
        )
        longest_s = max(one.duration_s for one in paths.values())
        return replace(stage, paths=paths, goals=ends, expected_s=there_s + 5.0 + longest_s)
    if isinstance(step, WaitStep):
        return replace(stage, expected_s=step.duration_s)
    if not isinstance(step, OrderStep):
        return stage
    intent = _filled(intent_of(step, fleet), fleet, now)
    planned = plan_order(intent, fleet, None, held=now.held, author="check", now_ns=0)
    goals = {
        name: _goal(step, now.positions[name], order.position_enu_m)
        for name, order in planned.orders.items()
    }
    if not isinstance(step, MoveStep | GotoStep | FormationStep | RotateStep | _GROUND):
        return replace(stage, planned=planned, expected_s=1.0)
    intent = with_speed(intent, getattr(step, "speed_m_s", None), goals, now.positions)
    alone_s = {}
    for name, goal in goals.items():
        before = now.positions[name]
        above_m = max(before[2], goal[2], 1.0) if isinstance(step, _GROUND) else 0.0
        across = (before[0], before[1], goal[2]) if above_m else before
        alone_s[name] = (
            _move_s(fleet, name, across, goal, intent.duration_s) if across != goal else 0.0
        )
        alone_s[name] += (
            _START_S + vertical_s(above_m, fleet.vehicles[name].max_speed_m_s) if above_m else 0.0
        )
    return replace(
        stage,
        planned=planned,
        goals=goals,
        alone_s=alone_s,
        expected_s=max(alone_s.values(), default=0.0) + _SETTLE_S,
    )


def _filled(intent: Intent, fleet: FleetConfig, now: _Fleet) -> Intent:
    """Return the intent with what a flight would take from where the vehicles are then."""
    spots = {name: now.positions[name] for name in intent.vehicles if name in now.positions}
    position = intent.position_enu_m
    if intent.is_nearest and position is not None:
        slots = slots_of(
            fleet, intent.formation or "", intent.spacing_m, intent.rotation_deg or 0.0
        )
        wanted = {name: slots[name] for name in intent.vehicles if name in slots}
        return replace(intent, takes=nearest_slots(wanted, spots, position))
    if intent.verb == "rotate":
        slots = held_slots(fleet, now.held)
        known = [np.array(spots[name]) - np.array(slots[name]) for name in spots if name in slots]
        if known:
            x, y, z = np.mean(known, axis=0).tolist()
            return replace(intent, position_enu_m=(x, y, z))
    return intent


def _goal(step: OrderStep, position: Vec3, ordered: Vec3 | None) -> Vec3:
    if isinstance(step, TakeoffStep):
        return (position[0], position[1], step.height_m)
    if isinstance(step, LandStep | HomeStep):
        x, y, _ = ordered or position
        return (x, y, 0.0)
    return ordered or position


def _move_s(fleet: FleetConfig, name: str, position: Vec3, goal: Vec3, duration_s: float) -> float:
    vehicle = fleet.vehicles[name]
    bounds = TrajectoryParams(vehicle.max_speed_m_s, vehicle.max_acceleration_m_s2)
    return _SETTLE_S + max(shortest_duration_s(math.dist(position, goal), bounds), duration_s)


def _point(path: Path, time_s: float) -> Vec3:
    x, y, z = point_at(path, time_s).position_enu_m
    return (x, y, z)
