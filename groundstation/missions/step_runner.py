"""Flies the steps of a mission file.

Steps may be flown one after the other, side by side, several times, or until a condition holds.
Sentences name a step by its key in the mission file, such as ``step[2].branches[0][1]``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence

from msgspec.structs import replace

from groundstation.fleet.slot_owners import (
    by_slot_owner,
    by_vehicle,
    slot_owner_of,
    vehicles_of_slots,
)
from groundstation.fleet.state import FleetState
from groundstation.formations.frame import FormationPaths
from groundstation.mission_files.expected_course import (
    expected_duration_s,
    formation_paths,
    resolved,
    with_speed,
)
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.steps import (
    ExpectStep,
    FaultStep,
    FlyFormationStep,
    FollowPathStep,
    MissionStep,
    ParallelStep,
    ReactStep,
    RepeatStep,
    Until,
    WaitStep,
)
from groundstation.mission_files.wall_time import WallTime
from groundstation.missions import conditions
from groundstation.missions.api import Fleet
from groundstation.missions.conditions import WaitCondition
from groundstation.missions.path_following import Lights
from groundstation.orders.intents import (
    GoalIntent,
    Goto,
    Hold,
    Intent,
    for_fewer,
    means_all,
)
from groundstation.verdict.expectations import check
from onboard.control.path import Path
from onboard.tuples import Xyz


class MissionFailed(RuntimeError):
    """An expectation in the middle of a mission was not met."""


class StepRunner:
    """Does the steps of one mission.

    Args:
        mission: mission file, loaded and checked.
        fleet: fleet that flies it.
        times: wall-clock times, by their text in the file; empty in simulated time.
    """

    def __init__(self, mission: Mission, fleet: Fleet, times: Mapping[str, WallTime]) -> None:
        self._mission = mission
        self._fleet = fleet
        self._times = times

    async def run(self) -> None:
        """Do all steps, and say before each one which it is and how long the rest takes."""
        steps = self._mission.steps
        course = list(self._mission.course())

        for index, step in enumerate(steps):
            left_s = expected_duration_s(
                course_step for course_step in course if course_step.index >= index
            )
            self._fleet.say(f"[{index + 1}/{len(steps)}] {step.do}; about {left_s:.0f} s left")
            await self._do(step, f"step[{index}]")

    async def rehearse_faults(self, steps: Sequence[MissionStep] | None = None) -> None:
        """Check every fault before the take-off.

        Args:
            steps: steps to check, and the steps inside them; None: all.

        Raises:
            FaultRefused: a fault will be impossible.
        """
        if steps is None:
            steps = self._mission.steps

        for step in steps:
            if isinstance(step, FaultStep):
                await self._fault(step, is_rehearsal=True)
            for inner_steps in _blocks(step):
                await self.rehearse_faults(inner_steps)

    async def _do_all(self, steps: Sequence[MissionStep], key: str) -> None:
        """Do steps one after the other."""
        for index, step in enumerate(steps):
            await self._do(step, f"{key}[{index}]")

    async def _do(self, step: MissionStep, key: str) -> None:
        """Do one step."""
        if isinstance(step, Intent):
            await self._order(step)
        elif isinstance(step, WaitStep):
            await self._wait(step)
        elif isinstance(step, FaultStep):
            await self._fault(step)
        elif isinstance(step, ExpectStep):
            self._expect_now(key, step)
        elif isinstance(step, FollowPathStep):
            await self._follow(step, self._mission.paths_of(step), self._mission.lights_of(step))
        elif isinstance(step, FlyFormationStep):
            paths = formation_paths(step, self._fleet.config, self._positions_by_slot_owner())
            await self._follow(step, paths, {})
        elif isinstance(step, RepeatStep):
            for _ in range(step.times):
                await self._do_all(step.steps, f"{key}.steps")
        elif isinstance(step, ParallelStep):
            await self._side_by_side(step, key)
        else:
            await self._react(step, key)

    async def _order(self, step: Intent) -> None:
        """Give a step's order to those of its vehicles that still take part."""
        fleet = self._fleet
        fleet.ground.note_other_ends()  # leaves out who has come down since the last order
        intent = _with_spares(resolved(step, fleet.config), fleet.state)
        names = tuple(name for name in intent.names if name not in fleet.ground.left_out)
        is_for_lost = intent.brings_down and not isinstance(intent, Hold)
        if means_all(step.vehicles) and not is_for_lost:
            names = fleet.ground.without_lost(names)
        if not names:
            return
        intent = for_fewer(intent, names)

        if isinstance(intent, GoalIntent) and intent.speed_m_s is not None:
            goals = {}
            for name, order in fleet.client.plan(intent).orders.items():
                if order.position_enu_m is not None:
                    goals[name] = order.position_enu_m
            intent = with_speed(intent, fleet.config, goals, self._positions())

        await fleet.order(intent, step.timeout_s)

    async def _follow(
        self, step: FollowPathStep | FlyFormationStep, paths: Mapping[str, Path], lights: Lights
    ) -> None:
        """Let the vehicles that still take part follow their paths; return at once if none does."""
        self._fleet.ground.note_other_ends()  # leaves out who has come down since the last order
        own_paths = self._taking_part(paths)
        if not own_paths:
            return

        await self._fleet.follow_path(
            own_paths,
            lights=lights,
            on_lag=step.on_lag,
            at=self._start_of(step),
            timeout_s=step.timeout_s,
        )

    async def _wait(self, step: WaitStep) -> None:
        await self._fleet.countdown(self._start_of(step))
        await self._fleet.wait(step.duration_s)
        if step.until is not None:
            await self._fleet.until(condition(step.until, self._fleet), step.timeout_s)

    def _start_of(self, step: WaitStep | FollowPathStep | FlyFormationStep) -> WallTime | str:
        """Return the time at which a step starts; in simulated time, as it is written."""
        return self._times.get(step.at, step.at)

    async def _side_by_side(self, step: ParallelStep, key: str) -> None:
        """Do branches at the same time; the first failure ends all branches."""
        try:
            async with asyncio.TaskGroup() as group:
                for index, branch in enumerate(step.branches):
                    group.create_task(self._do_all(branch, f"{key}.branches[{index}]"))
        except BaseExceptionGroup as failures:
            raise first_failure(failures) from None

    async def _react(self, step: ReactStep, key: str) -> None:
        """Do steps until a condition holds; then do the steps of the reaction."""

        async def reaction() -> None:
            await self._do_all(step.then, f"{key}.then")

        when = condition(step.when, self._fleet)
        async with self._fleet.reacting(when, reaction, ends=True):
            await self._do_all(step.steps, f"{key}.steps")

    async def _fault(self, step: FaultStep, *, is_rehearsal: bool = False) -> None:
        await self._fleet.fault(
            step.name,
            step.vehicles,
            after_s=step.after_s,
            duration_s=step.duration_s,
            is_rehearsal=is_rehearsal,
            **step.parameters,
        )

    def _expect_now(self, key: str, step: ExpectStep) -> None:
        """Judge the flight so far; the first expectation that is not met ends the mission."""
        fleet = self._fleet
        landed = {name: fleet.state.is_landed(name) for name in fleet.names}
        closest = fleet.state.smallest_known
        results = check(step, self._mission.fleet, closest, fleet.arrivals, landed)

        for result in results:
            fleet.say(f"  {result.sentence}")
            if not result.has_come_true:
                raise MissionFailed(f"{key} expected: {result.sentence}")

    def _taking_part(self, paths: Mapping[str, Path]) -> Mapping[str, Path]:
        """Return the paths without those of vehicles that the mission goes on without."""
        left_out = self._fleet.ground.left_out
        all_paths = by_vehicle(paths, self._fleet.state)
        own_paths = {name: path for name, path in all_paths.items() if name not in left_out}
        if isinstance(paths, FormationPaths):
            return FormationPaths(own_paths, paths.end)
        return own_paths

    def _positions_by_slot_owner(self) -> dict[str, Xyz]:
        """Return the reported positions, by the names that the mission file uses.

        A spare that was swapped in has the name of the vehicle that it replaces.
        """
        state = self._fleet.state
        return {
            slot_owner_of(name, state): position for name, position in self._positions().items()
        }

    def _positions(self) -> dict[str, Xyz]:
        """Return the positions of the vehicles that report one [m], ENU."""
        now_ns = self._fleet.client.now_ns()
        positions = {}
        for name in self._fleet.names:
            position_enu_m = self._fleet.state.vehicles[name].position_enu_m(now_ns)
            if position_enu_m is not None:
                positions[name] = position_enu_m
        return positions


def condition(until: Until, fleet: Fleet) -> WaitCondition:
    """Return the condition that a step waits for.

    Args:
        until: the keys of the file; at least one.
        fleet: fleet that flies the mission.

    Raises:
        ConfigError: a vehicle is unknown.
    """
    vehicles = None
    if until.vehicles is not None:
        vehicles = fleet.select(until.vehicles, with_lost=True)

    parts = []
    if until.reached:
        goals = by_slot_owner(until.reached.items(), fleet.config, "position")
        parts.append(conditions.reached(by_vehicle(goals, fleet.state), until.within_m))
    if until.separation_above_m is not None:
        parts.append(conditions.separation_above(until.separation_above_m))
    if until.separation_below_m is not None:
        parts.append(conditions.separation_below(until.separation_below_m))
    if until.battery_below_pct is not None:
        parts.append(conditions.battery_below(until.battery_below_pct, vehicles))
    if until.landed is not None:
        parts.append(conditions.landed(fleet.select(until.landed, with_lost=True)))
    if until.flying is not None:
        parts.append(conditions.flying(fleet.select(until.flying)))
    if until.fails:
        parts.append(conditions.fails(vehicles))
    if until.event is not None:
        parts.append(conditions.event(until.event, vehicles))

    if len(parts) == 1:
        return parts[0]
    return conditions.all_of(*parts)


def _with_spares(intent: Intent, state: FleetState) -> Intent:
    """Return an order with the spares that were swapped in, instead of the vehicles it names."""
    names = vehicles_of_slots(intent.names, state)
    if isinstance(intent, Goto):
        goals = by_vehicle(intent.goals, state)
        return replace(intent, vehicles=tuple(goals), goals=goals)
    return replace(intent, vehicles=names)


def _blocks(step: MissionStep) -> tuple[Sequence[MissionStep], ...]:
    """Return the lists of steps that a step holds."""
    if isinstance(step, ParallelStep):
        return step.branches
    if isinstance(step, ReactStep):
        return (step.steps, step.then)
    if isinstance(step, RepeatStep):
        return (step.steps,)
    return ()


def first_failure(failures: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the first exception of a group, which has caused the others.

    Args:
        failures: failures of tasks that ran at the same time.
    """
    first = failures.exceptions[0]
    if isinstance(first, BaseExceptionGroup):
        return first_failure(first)
    return first
