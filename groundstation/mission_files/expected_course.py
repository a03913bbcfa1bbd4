"""The expected course of a mission: each step with its order, its goals and its duration. Pure.

The course goes through the steps one after the other, and keeps the fleet in the state in which the
steps so far would leave it: where each vehicle is, whether it flies, and the present formation.
After a react, whether a vehicle flies may depend on whether the reaction has come.

The course has three users. Checks refuse an order that makes no sense at its place, findings
compare the time limit of a step with its duration, and the runner says how long the rest of a
flight takes.

The avoidance law is not simulated: durations are those of vehicles that fly alone.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs

from groundstation.fleet.slot_owners import by_slot_owner
from groundstation.formations.assignment import nearest_slots
from groundstation.formations.frame import FormationPaths, FormationStart, frame_paths
from groundstation.formations.slots import formation_names, formation_slots
from groundstation.mission_files.steps import (
    BlockStep,
    FlyFormationStep,
    FollowPathStep,
    MissionStep,
    ParallelStep,
    ReactStep,
    RepeatStep,
    Until,
    WaitStep,
)
from groundstation.orders.goals import ExpectedFleet
from groundstation.orders.grammar import default_formation
from groundstation.orders.held_formation import HeldFormation, held_slots, slots_of
from groundstation.orders.intents import (
    Arm,
    Disarm,
    Formation,
    GoalIntent,
    Goto,
    Home,
    Intent,
    Land,
    Rotate,
    Takeoff,
    means_all,
)
from groundstation.orders.plan import PlannedOrder, plan_order
from groundstation.orders.reachable_goals import route_length_m, shortest_leg_s, shortest_move_s
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.config.ground import ground_at_m
from onboard.control.climb_duration import climb_duration_s
from onboard.control.path import Path, point_at
from onboard.control.trajectory import PEAK_OF_MEAN_SPEED
from onboard.tuples import Xyz

_START_S = 3.0  # time of arming and spinning up before a climb
_SETTLE_S = 1.0  # time from the end of a move until the vehicle counts as arrived
_PATH_SETTLE_S = 5.0  # time from the arrival at the first points of paths to their start
_SHORT_ORDER_S = 1.0  # duration of an order that does not move a vehicle
_MIN_HEIGHT_M = 1.0  # smallest height that is assumed for a climb or a descent
_VerticalIntent = Takeoff | Land | Home  # orders with a climb or a descent
_GroundIntent = Arm | Disarm | Land | Home  # orders after which a vehicle is on the ground

PathsOf = Callable[[FollowPathStep], Mapping[str, Path]]


class Branch(NamedTuple):
    """One of the lists of steps that a parallel step flies at the same time."""

    block: str  # key of the parallel step
    number: int  # of the branch in it, from 0


class InnerStep(NamedTuple):
    """A step inside another one."""

    key: str  # key of the step in the file
    step: MissionStep
    times: int = 1  # number of times that it is flown
    branch: Branch | None = None  # the branch that it belongs to, if the outer step is a parallel


class SharedVehicles(NamedTuple):
    """The vehicles that several branches of a parallel step order."""

    block: str  # key of the parallel step
    vehicles: tuple[str, ...]
    at_once: tuple[str, ...]  # those of them that the first steps of several branches order


@dataclass(frozen=True, slots=True)
class CourseStep:
    """One step of a mission as it is expected to be flown."""

    key: str  # key of the step in the file, such as step[2].steps[0]
    step: MissionStep
    positions: Mapping[str, Xyz]  # positions of all vehicles before the step
    flying: frozenset[str]  # vehicles that fly before the step
    # other vehicles that may fly or not, each with the key of the react that decides it
    unsure: Mapping[str, str]
    armed: frozenset[str]  # vehicles that are armed on the ground before the step
    is_known: bool  # whether all this is certain; not after a fault
    # vehicles that may fly or not, since another branch takes them off or lands them meanwhile, or
    # since a condition has waited until they had landed
    doubtful: frozenset[str] = frozenset()
    index: int = 0  # index of the mission's step that is, or contains, this one
    branches: tuple[Branch, ...] = ()  # branches that contain the step, the outermost first
    times: int = 1  # number of times that the step is flown
    planned: PlannedOrder | None = None  # the order, if the step is one
    goals: Mapping[str, Xyz] = field(default_factory=dict)  # positions of vehicles after the step
    paths: Mapping[str, Path] = field(default_factory=dict)
    # time that each vehicle needs if it flies alone
    durations_alone_s: Mapping[str, float] = field(default_factory=dict)
    expected_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """Time [s] that the step is expected to take, all times together."""
        return self.times * self.expected_s

    @property
    def ordered(self) -> frozenset[str]:
        """Vehicles that the step orders, or sends along paths."""
        if self.planned is None:
            return frozenset(self.goals)
        return frozenset(self.planned.orders)

    @property
    def may_fly_before(self) -> frozenset[str]:
        """Vehicles that may fly before the step, if this is known at all."""
        return self.flying.union(self.unsure, self.doubtful)

    @property
    def on_ground(self) -> frozenset[str]:
        """Vehicles that certainly stand on the ground before the step."""
        if not self.is_known:
            return frozenset()
        return frozenset(self.positions) - self.may_fly_before

    @property
    def flying_after(self) -> frozenset[str]:
        """Vehicles that fly after the step."""
        if isinstance(self.step, _GroundIntent):
            return self.flying - self.ordered
        return self.flying | self.ordered

    @property
    def unsure_after(self) -> dict[str, str]:
        """Other vehicles that may fly or not after the step, as in `unsure`."""
        return {name: key for name, key in self.unsure.items() if name not in self.ordered}

    @property
    def armed_after(self) -> frozenset[str]:
        """Vehicles that are armed on the ground after the step."""
        if isinstance(self.step, Arm):
            return self.armed | self.ordered
        return self.armed - self.ordered

    def may_fly(self, name: str) -> bool:
        """Return whether a vehicle may fly during the step, or begins or ends a flight with it."""
        if not self.is_known:
            return True
        return name in self.flying or name in self.unsure or name in self.goals

    def may_fly_after(self, name: str) -> bool:
        """Return whether a vehicle may fly after the step."""
        if not self.is_known:
            return True
        return name in self.flying_after or name in self.unsure_after


@dataclass(slots=True)
class _CourseFleet:
    """The fleet at the present point of the course; each step changes it."""

    positions: dict[str, Xyz]
    held: HeldFormation
    flying: frozenset[str] = frozenset()
    unsure: Mapping[str, str] = field(default_factory=dict)
    armed: frozenset[str] = frozenset()
    doubtful: frozenset[str] = frozenset()
    is_known: bool = True


def course(
    fleet: FleetConfig, steps: Sequence[MissionStep], paths_of: PathsOf, path: str
) -> Iterator[CourseStep]:
    """Yield the steps of a mission in the order in which they are flown.

    Branches that are flown side by side are yielded one after the other.

    Args:
        fleet: the fleet file.
        steps: steps of the mission.
        paths_of: function that returns the paths of a step that follows paths.
        path: path of the mission file, for the sentences.

    Raises:
        ConfigError: a step names a vehicle or a formation that does not exist.
    """
    starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    course_fleet = _CourseFleet(starts, HeldFormation(default_formation(fleet)))
    for index, step in enumerate(steps):
        key = f"step[{index}]"
        for course_step in _course_steps(fleet, step, key, course_fleet, paths_of, path):
            yield replace(course_step, index=index)


def first_points(paths: Mapping[str, Path]) -> dict[str, Xyz]:
    """Return the first point of each path [m], ENU.

    Args:
        paths: paths of vehicles.
    """
    return {name: _point(path, 0.0) for name, path in paths.items()}


def expected_duration_s(course_steps: Iterable[CourseStep]) -> float:
    """Return the time [s] that steps are expected to take together.

    Branches that are flown side by side take as long as the longest of them.

    Args:
        course_steps: steps of one mission.
    """
    return _duration_s(course_steps, 0)


def shared_vehicles(course_steps: Iterable[CourseStep]) -> Iterator[SharedVehicles]:
    """Yield the vehicles that several branches of a parallel step order, for each such step.

    Args:
        course_steps: steps of one mission.
    """
    blocks: dict[str, dict[int, list[frozenset[str]]]] = {}
    for course_step in course_steps:
        for branch in course_step.branches:
            orders = blocks.setdefault(branch.block, {}).setdefault(branch.number, [])
            orders.append(course_step.ordered)

    for block, branches in blocks.items():
        at_once = _in_several(orders[0] for orders in branches.values())
        vehicles = _in_several(frozenset().union(*orders) for orders in branches.values())
        if vehicles:
            yield SharedVehicles(block, vehicles, at_once)


def _in_several(groups: Iterable[frozenset[str]]) -> tuple[str, ...]:
    """Return the names that are in more than one of several groups, sorted."""
    counts = Counter(itertools.chain.from_iterable(groups))
    return tuple(sorted(name for name, count in counts.items() if count > 1))


def expected_flight_s(course_steps: Iterable[CourseStep], name: str) -> float:
    """Return the time [s] for which a vehicle is expected to fly.

    After a fault or a reaction it is not known which vehicles fly: then all do.

    Args:
        course_steps: steps of one mission.
        name: the vehicle.
    """
    return _flight_s(course_steps, 0, name)


def _duration_s(steps: Iterable[CourseStep], depth: int) -> float:
    """Return the time [s] of steps that have `depth` branches around them in common."""
    outside, blocks = _in_blocks(steps, depth)
    total_s = sum(course_step.duration_s for course_step in outside)
    for branches in blocks:
        total_s += max(_duration_s(branch, depth + 1) for branch in branches)
    return total_s


def _flight_s(steps: Iterable[CourseStep], depth: int, name: str) -> float:
    """Return the time [s] of steps for which a vehicle flies."""
    outside, blocks = _in_blocks(steps, depth)
    total_s = sum(course_step.duration_s for course_step in outside if course_step.may_fly(name))
    for branches in blocks:
        total_s += _flight_in_block_s(branches, depth + 1, name)
    return total_s


def _flight_in_block_s(branches: Sequence[Sequence[CourseStep]], depth: int, name: str) -> float:
    """Return the time [s] for which a vehicle flies while branches are flown side by side.

    The course lists branches one after another although they are flown at the same time. So the
    step before does not show whether the vehicle flies; only the branch in which it takes off or
    lands does. At the end of that branch, the vehicle waits for the other branches.
    """
    block_s = max(_duration_s(branch, depth) for branch in branches)
    for branch in branches:
        if not _begins_or_ends_flight(branch, name):
            continue
        flight_s = _flight_s(branch, depth, name)
        if branch[-1].may_fly_after(name):
            flight_s += block_s - _duration_s(branch, depth)
        return flight_s

    may_fly = any(course_step.may_fly(name) for branch in branches for course_step in branch)
    return block_s if may_fly else 0.0


def _begins_or_ends_flight(branch: Iterable[CourseStep], name: str) -> bool:
    """Return whether a vehicle takes off or lands in a branch."""
    return any(
        isinstance(course_step.step, _VerticalIntent) and name in course_step.goals
        for course_step in branch
    )


def _in_blocks(
    steps: Iterable[CourseStep], depth: int
) -> tuple[list[CourseStep], list[list[list[CourseStep]]]]:
    """Return the steps outside of parallel steps, and the branches of each parallel step.

    Args:
        steps: steps that are in the same branches, as far as these are counted by the depth.
        depth: number of parallel steps around all of them.
    """
    outside = []
    blocks: dict[str, dict[int, list[CourseStep]]] = {}
    for course_step in steps:
        if len(course_step.branches) <= depth:
            outside.append(course_step)
            continue
        branch = course_step.branches[depth]
        blocks.setdefault(branch.block, {}).setdefault(branch.number, []).append(course_step)
    return outside, [list(branches.values()) for branches in blocks.values()]


def resolved(intent: Intent, fleet: FleetConfig) -> Intent:
    """Return the order of a step with the names of its vehicles instead of "all" or indices.

    Args:
        intent: order as it stands in the mission file.
        fleet: the fleet file.

    Raises:
        ConfigError: a vehicle or a formation is unknown.
    """
    names = fleet.select(intent.vehicles)
    is_everybody = means_all(intent.vehicles)

    if isinstance(intent, Goto):
        goals = by_slot_owner(intent.goals.items(), fleet, "position")
        if not goals:
            raise ConfigError("'goals' is empty. Write goals = { mav0 = [0, 0, 1] }.")
        others = ", ".join(name for name in goals if name not in names)
        if others and not is_everybody:
            raise ConfigError(
                f"'goals' has {others}, which 'vehicles' does not name. Remove 'vehicles': the "
                "order goes to the vehicles that have goals."
            )
        return structs.replace(intent, vehicles=tuple(goals), goals=goals)

    if isinstance(intent, Formation):
        if intent.name not in formation_names(fleet):
            known = ", ".join(formation_names(fleet)) or "it has none"
            raise ConfigError(
                f"'{intent.name}' is no formation of fleet '{fleet.fleet.name}': {known}. "
                "Correct 'name'."
            )
        if is_everybody:
            slots = formation_slots(fleet, intent.name)
            names = tuple(name for name in names if name in slots)

    return structs.replace(intent, vehicles=names, is_everybody=is_everybody)


def refuse_disabled(names: Iterable[str], fleet: FleetConfig) -> None:
    """Refuse vehicles that the fleet file disables; missions fly without them.

    Args:
        names: vehicles that a step names, or that its order goes to.
        fleet: the fleet file.

    Raises:
        ConfigError: one of them is disabled.
    """
    for name in names:
        if name not in fleet.enabled_names:
            raise ConfigError(
                f"{name} is not enabled in the fleet file. Set enabled = true, or name others."
            )


def with_speed(
    intent: Intent, fleet: FleetConfig, goals: Mapping[str, Xyz], positions: Mapping[str, Xyz]
) -> Intent:
    """Return an order with the duration that its speed gives for the longest route.

    Args:
        intent: an order; an order without a speed is returned unchanged.
        fleet: the fleet file.
        goals: goals of the vehicles [m], ENU.
        positions: present positions of the vehicles [m], ENU.
    """
    if not isinstance(intent, GoalIntent) or intent.speed_m_s is None:
        return intent
    lengths_m = [
        route_length_m(fleet, name, positions[name], goal)
        for name, goal in goals.items()
        if name in positions
    ]
    if not lengths_m:
        return intent

    duration_s = PEAK_OF_MEAN_SPEED * max(lengths_m) / intent.speed_m_s
    return structs.replace(intent, duration_s=duration_s)


def formation_paths(
    step: FlyFormationStep, fleet: FleetConfig, positions: Mapping[str, Xyz]
) -> FormationPaths:
    """Return the paths of a formation's flight, and the formation at their end.

    Args:
        step: step of a mission file.
        fleet: the fleet file.
        positions: positions of the vehicles before the step [m], ENU.

    Raises:
        ConfigError: see :func:`groundstation.formations.frame.frame_paths`.
    """
    start = FormationStart(
        name=step.name,
        position_enu_m=step.position_enu_m,
        rotation_deg=step.rotation_deg,
        spacing_m=step.spacing_m,
        leader=step.leader,
    )
    if step.assign == "nearest":
        return frame_paths(fleet, start, step.to, positions)
    return frame_paths(fleet, start, step.to, None)


# -- one step after the other ----------------------------------------------------------------------


def _course_steps(
    fleet: FleetConfig,
    step: MissionStep,
    key: str,
    course_fleet: _CourseFleet,
    paths_of: PathsOf,
    path: str,
) -> Iterator[CourseStep]:
    """Yield a step, or the steps inside it, and change the fleet as they would change it."""
    if isinstance(step, ReactStep):
        yield from _react_steps(fleet, step, key, course_fleet, paths_of, path)
        return
    if isinstance(step, ParallelStep):
        yield from _parallel_steps(fleet, step, key, course_fleet, paths_of, path)
        return
    if isinstance(step, BlockStep):
        for inner in inner_steps(step, key):
            yield from _steps_inside(fleet, inner, course_fleet, paths_of, path)
        return

    try:
        course_step = _course_step(fleet, step, key, course_fleet, paths_of)
    except ConfigError as error:
        raise ConfigError(f"{path}: '{key}' ({step.do}): {error}") from None
    yield course_step

    course_fleet.positions.update(course_step.goals)
    if course_step.planned is not None:
        course_fleet.held = course_step.planned.held
    if isinstance(course_step.paths, FormationPaths):
        course_fleet.held = course_step.paths.end
    course_fleet.flying = course_step.flying_after
    course_fleet.unsure = course_step.unsure_after
    course_fleet.armed = course_step.armed_after
    course_fleet.doubtful -= course_step.ordered
    if step.do == "fault":
        course_fleet.is_known = False
    if isinstance(step, WaitStep) and step.until is not None:
        _doubt_landed(step.until, fleet, f"{path}: '{key}.until'", course_fleet)


def _steps_inside(
    fleet: FleetConfig, inner: InnerStep, course_fleet: _CourseFleet, paths_of: PathsOf, path: str
) -> Iterator[CourseStep]:
    """Yield the steps of the course for a step inside another one."""
    for course_step in _course_steps(fleet, inner.step, inner.key, course_fleet, paths_of, path):
        yield _inside(inner, course_step)


def _parallel_steps(
    fleet: FleetConfig,
    parallel: ParallelStep,
    key: str,
    course_fleet: _CourseFleet,
    paths_of: PathsOf,
    path: str,
) -> Iterator[CourseStep]:
    """Yield the steps of branches one branch after the other, as the file has them.

    Of a vehicle that one branch takes off or lands, the others do not know whether it flies.
    """
    own = [_taken_off_or_landed(fleet, branch) for branch in parallel.branches]
    inner_list = list(inner_steps(parallel, key))

    for number, own_names in enumerate(own):
        others = frozenset().union(*own[:number], *own[number + 1 :])
        before = _state(parallel, key, course_fleet)

        for inner in inner_list:
            if inner.branch != Branch(key, number):
                continue
            for course_step in _steps_inside(fleet, inner, course_fleet, paths_of, path):
                yield replace(course_step, doubtful=course_step.doubtful | others)
        _leave_as_before(others - own_names, before, course_fleet)


def _taken_off_or_landed(fleet: FleetConfig, steps: Iterable[MissionStep]) -> frozenset[str]:
    """Return the vehicles that steps, and the steps inside them, take off or land."""
    names: set[str] = set()
    for step in steps:
        if isinstance(step, BlockStep):
            inside = (inner.step for inner in inner_steps(step, ""))
            names |= _taken_off_or_landed(fleet, inside)
        elif isinstance(step, _VerticalIntent):
            # the course refuses unknown names where it comes to the step
            with contextlib.suppress(ConfigError):
                names.update(fleet.select(step.vehicles))
    return frozenset(names)


def _leave_as_before(names: frozenset[str], before: CourseStep, course_fleet: _CourseFleet) -> None:
    """Let vehicles fly, or be armed, as in an earlier state."""
    kept = {name: react for name, react in course_fleet.unsure.items() if name not in names}
    earlier = {name: react for name, react in before.unsure.items() if name in names}

    course_fleet.flying = (course_fleet.flying - names) | (before.flying & names)
    course_fleet.armed = (course_fleet.armed - names) | (before.armed & names)
    course_fleet.unsure = {**kept, **earlier}


def _doubt_landed(
    condition: Until, fleet: FleetConfig, written_key: str, course_fleet: _CourseFleet
) -> None:
    """Count vehicles as doubtful that are down when a condition holds, without an order."""
    if condition.landed is None:
        return
    try:
        landed = fleet.select(condition.landed)
    except ConfigError as error:
        raise ConfigError(f"{written_key}: {error}") from None
    may_fly = course_fleet.flying.union(course_fleet.unsure, course_fleet.doubtful)
    course_fleet.doubtful = course_fleet.doubtful.union(may_fly.intersection(landed))


def _react_steps(
    fleet: FleetConfig,
    react: ReactStep,
    key: str,
    course_fleet: _CourseFleet,
    paths_of: PathsOf,
    path: str,
) -> Iterator[CourseStep]:
    """Yield the steps of a react and those of its reaction, and leave the fleet as either may.

    The reaction may begin before each of the steps, and during the last one. There it is judged
    for each vehicle as if it had begun where the vehicle last flew.
    """
    inner_list = list(inner_steps(react, key))
    states = []  # in which the reaction may begin
    for inner in inner_list[: len(react.steps)]:
        for course_step in _steps_inside(fleet, inner, course_fleet, paths_of, path):
            yield course_step
            states.append(course_step)
    end = _state(react, key, course_fleet)
    states.append(end)

    for state in states:
        for name in state.flying:
            course_fleet.positions[name] = state.positions[name]
    _leave_as_in_any(states, key, course_fleet)
    _doubt_landed(react.when, fleet, f"{path}: '{key}.when'", course_fleet)
    begins = dict(course_fleet.positions)

    for inner in inner_list[len(react.steps) :]:
        yield from _steps_inside(fleet, inner, course_fleet, paths_of, path)

    for name, begin in begins.items():
        if course_fleet.positions[name] == begin:  # the reaction does not move it
            course_fleet.positions[name] = end.positions[name]
    _leave_as_in_any([end, _state(react, key, course_fleet)], key, course_fleet)


def _leave_as_in_any(states: Sequence[CourseStep], key: str, course_fleet: _CourseFleet) -> None:
    """Let those vehicles fly that fly in all of several states; those in some only are unsure.

    Vehicles that are armed in some of the states are armed.

    Args:
        states: the states, one of which will be the fleet's.
        key: key of the react that decides which one.
        course_fleet: the fleet, which is changed.
    """
    may_fly: set[str] = set()
    for state in states:
        may_fly.update(state.flying, state.unsure)
    flying = frozenset.intersection(*(state.flying for state in states))

    course_fleet.flying = flying
    course_fleet.armed = frozenset().union(*(state.armed for state in states)) - may_fly
    course_fleet.unsure = {
        **dict.fromkeys(sorted(may_fly - flying), key),
        **states[0].unsure,  # another react decides about these
    }


def _inside(inner: InnerStep, course_step: CourseStep) -> CourseStep:
    """Return a step of the course with the times and the branch of the inner step around it."""
    branches = course_step.branches
    if inner.branch is not None:
        branches = (inner.branch, *branches)
    return replace(course_step, times=inner.times * course_step.times, branches=branches)


def inner_steps(step: BlockStep, key: str) -> Iterator[InnerStep]:
    """Yield the steps inside a step.

    The steps of a repetition are yielded twice: for its first time, and for all later times. The
    vehicles begin the first time where the step before has left them, and each later time where the
    repetition itself has left them.

    Args:
        step: a step that holds others.
        key: its key in the mission file.
    """
    if isinstance(step, RepeatStep):
        counts = [1]
        if step.times > 1:
            counts.append(step.times - 1)
        for count in counts:
            for index, inner in enumerate(step.steps):
                yield InnerStep(f"{key}.steps[{index}]", inner, times=count)

    elif isinstance(step, ParallelStep):
        for branch_index, steps in enumerate(step.branches):
            branch = Branch(key, branch_index)
            for index, inner in enumerate(steps):
                inner_key = f"{key}.branches[{branch_index}][{index}]"
                yield InnerStep(inner_key, inner, branch=branch)

    else:
        for index, inner in enumerate(step.steps):
            yield InnerStep(f"{key}.steps[{index}]", inner)
        for index, inner in enumerate(step.then):
            yield InnerStep(f"{key}.then[{index}]", inner)


def _course_step(
    fleet: FleetConfig, step: MissionStep, key: str, course_fleet: _CourseFleet, paths_of: PathsOf
) -> CourseStep:
    """Return one step as it is expected to be flown."""
    course_step = _state(step, key, course_fleet)
    if isinstance(step, FollowPathStep):
        return _with_paths(course_step, fleet, paths_of(step))
    if isinstance(step, FlyFormationStep):
        return _with_paths(course_step, fleet, formation_paths(step, fleet, course_fleet.positions))
    if isinstance(step, WaitStep):
        return replace(course_step, expected_s=step.duration_s)
    if isinstance(step, Intent):
        return _with_order(course_step, step, fleet, course_fleet)
    return course_step


def _state(step: MissionStep, key: str, course_fleet: _CourseFleet) -> CourseStep:
    """Return a step with the fleet as it is before it."""
    return CourseStep(
        key=key,
        step=step,
        positions=dict(course_fleet.positions),
        flying=course_fleet.flying,
        unsure=course_fleet.unsure,
        armed=course_fleet.armed,
        is_known=course_fleet.is_known,
        doubtful=course_fleet.doubtful,
    )


def _with_paths(
    course_step: CourseStep, fleet: FleetConfig, paths: Mapping[str, Path]
) -> CourseStep:
    """Return a step with its paths, their ends, and the time to and along its paths."""
    course_step = replace(course_step, paths=paths)
    if not paths or not set(paths) <= set(fleet.enabled_names):
        return course_step

    ends = {name: _point(path, math.inf) for name, path in paths.items()}
    to_first_points_s = max(
        _move_s(fleet, name, course_step.positions[name], point, 0.0)
        for name, point in first_points(paths).items()
    )
    longest_s = max(path.duration_s for path in paths.values())
    return replace(
        course_step, goals=ends, expected_s=to_first_points_s + _PATH_SETTLE_S + longest_s
    )


def _with_order(
    course_step: CourseStep, written: Intent, fleet: FleetConfig, course_fleet: _CourseFleet
) -> CourseStep:
    """Return a step with its order, its goals, and the time that each vehicle needs alone.

    Args:
        course_step: the step without these.
        written: the intent of the step, as the mission has it.
        fleet: the fleet file.
        course_fleet: the fleet as it is expected to be before the step.
    """
    intent = _with_planned_fields(resolved(written, fleet), fleet, course_fleet)
    planned = plan_order(
        intent,
        fleet,
        None,
        held=course_fleet.held,
        author="check",
        now_ns=0,
        expected=ExpectedFleet(course_fleet.positions, course_step.on_ground),
    )
    refuse_disabled(planned.orders, fleet)
    goals = {
        name: _position_after(fleet, written, course_fleet.positions[name], order.position_enu_m)
        for name, order in planned.orders.items()
    }
    course_step = replace(course_step, planned=planned)
    if not isinstance(written, GoalIntent | Rotate | _VerticalIntent):
        return replace(course_step, expected_s=_SHORT_ORDER_S)

    intent = with_speed(intent, fleet, goals, course_fleet.positions)
    duration_s = intent.message_values().duration_s
    durations_alone_s = {}
    for name, goal in goals.items():
        position = course_fleet.positions[name]
        if isinstance(written, _VerticalIntent):
            durations_alone_s[name] = _vertical_order_s(fleet, name, position, goal, duration_s)
        else:
            durations_alone_s[name] = _move_or_stay_s(fleet, name, position, goal, duration_s)

    expected_s = max(durations_alone_s.values(), default=0.0) + _SETTLE_S
    if isinstance(intent, Takeoff):
        later_waves = max(0, len(intent.waves) - 1)
        expected_s += later_waves * (expected_s + intent.every_s)
    return replace(
        course_step, goals=goals, durations_alone_s=durations_alone_s, expected_s=expected_s
    )


def _with_planned_fields(intent: Intent, fleet: FleetConfig, course_fleet: _CourseFleet) -> Intent:
    """Return the intent with the fields that a flight derives from the vehicles' positions."""
    positions = {
        name: course_fleet.positions[name]
        for name in intent.names
        if name in course_fleet.positions
    }

    if isinstance(intent, Formation):
        if intent.assign != "nearest" or intent.position_enu_m is None:
            return intent
        slots = slots_of(fleet, intent.name, intent.spacing_m, intent.rotation_deg)
        own_slots = {name: slots[name] for name in intent.names if name in slots}
        takes = nearest_slots(own_slots, positions, intent.position_enu_m)
        return structs.replace(intent, takes=takes)

    if isinstance(intent, Rotate):
        slots = held_slots(fleet, course_fleet.held)
        centers = [
            np.array(position) - np.array(slots[name])
            for name, position in positions.items()
            if name in slots
        ]
        if centers:
            x, y, z = np.mean(centers, axis=0).tolist()
            return structs.replace(intent, center_enu_m=(x, y, z))

    return intent


def _position_after(fleet: FleetConfig, step: Intent, position: Xyz, ordered: Xyz | None) -> Xyz:
    """Return the position of a vehicle after an order; `ordered` is the goal in the order."""
    x, y, z = position if ordered is None else ordered
    if isinstance(step, Takeoff):
        x, y, _ = position
        return (x, y, step.height_m)
    if isinstance(step, Land | Home):
        z = float(ground_at_m(fleet, x, y))
    return (x, y, z)


# -- durations -------------------------------------------------------------------------------------


def _vertical_order_s(
    fleet: FleetConfig, name: str, position: Xyz, goal: Xyz, duration_s: float
) -> float:
    """Return the duration of an order with a climb or a descent [s].

    It consists of the horizontal flight, of the start, and of the climb or descent.
    """
    x, y, z = position
    goal_x, goal_y, goal_z = goal
    across_s = _move_or_stay_s(fleet, name, (x, y, goal_z), goal, duration_s)
    ground_m = float(ground_at_m(fleet, goal_x, goal_y))
    height_m = max(max(z, goal_z) - ground_m, _MIN_HEIGHT_M)
    vehicle = fleet.vehicles[name]
    vertical_s = max(
        climb_duration_s(height_m, vehicle.max_speed_m_s),
        shortest_leg_s(vehicle, height_m, height_m),
    )
    return across_s + (_START_S + vertical_s)


def _move_or_stay_s(
    fleet: FleetConfig, name: str, position: Xyz, goal: Xyz, duration_s: float
) -> float:
    """Return the time that a vehicle needs to a goal [s]; 0 if it is at the goal already."""
    if position == goal:
        return 0.0
    return _move_s(fleet, name, position, goal, duration_s)


def _move_s(fleet: FleetConfig, name: str, position: Xyz, goal: Xyz, duration_s: float) -> float:
    """Return the time that a vehicle needs to a goal [s]."""
    shortest_s = shortest_move_s(fleet, name, position, goal)
    return _SETTLE_S + max(shortest_s, duration_s)


def _point(path: Path, time_s: float) -> Xyz:
    """Return the position of a path at a time [s]; an infinite time gives its end."""
    x, y, z = point_at(path, time_s).position_enu_m
    return (x, y, z)
