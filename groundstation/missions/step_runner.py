"""The steps of a mission file, done one after the other, side by side, again, or until a condition
holds.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

from groundstation.mission_files.expected_course import (
    Stage,
    formation_paths,
    intent_of,
    with_speed,
)
from groundstation.mission_files.loading import Mission
from groundstation.mission_files.steps import (
    ExpectStep,
    FaultStep,
    FlyFormationStep,
    FollowPathStep,
    GoalStep,
    MissionStep,
    OrderStep,
    ParallelStep,
    ReactStep,
    RepeatStep,
    Until,
    WaitStep,
)
from groundstation.missions import conditions
from groundstation.missions.api import Fleet
from groundstation.missions.conditions import WaitCondition
from groundstation.orders.grammar import Intent
from groundstation.verdict.verdict import check, is_landed, smallest
from onboard.config.fleet import FleetConfig, Vec3


class MissionFailed(RuntimeError):
    """An expectation in the middle of a mission was not met."""


class StepRunner:
    """Does the steps of one mission.

    Args:
        mission: loaded and checked.
        fleet: that flies it.
    """

    def __init__(self, mission: Mission, fleet: Fleet) -> None:
        self._mission = mission
        self._fleet = fleet

    async def run(self) -> None:
        """Do all steps, and say before each of several which one it is and how long the rest takes."""
        steps = self._mission.steps
        stages = list(self._mission.course())
        for index, step in enumerate(steps):
            left_s = sum(one.times * one.expected_s for one in stages if _index(one) >= index)
            self._fleet.say(f"[{index + 1}/{len(steps)}] {step.do}; about {left_s:.0f} s left")
            await self._do(step, f"step[{index}]")

    async def rehearse_faults(self, steps: Sequence[MissionStep] | None = None) -> None:
        """Check every fault before the take-off.

        Raises:
            FaultRefused: one will be impossible.
        """
        for step in self._mission.steps if steps is None else steps:
            if isinstance(step, FaultStep):
                await self._fault(step, is_rehearsal=True)
            for inner in _blocks(step):
                await self.rehearse_faults(inner)

    async def _all(self, steps: Sequence[MissionStep], key: str) -> None:
        for index, step in enumerate(steps):
            await self._do(step, f"{key}[{index}]")

    async def _do(self, step: MissionStep, key: str) -> None:
        fleet = self._fleet
        if isinstance(step, OrderStep):
            await self._order(step)
        elif isinstance(step, WaitStep):
            await fleet.wait(step.duration_s)
            if step.until is not None:
                await fleet.until(condition(step.until, fleet.config), step.timeout_s)
        elif isinstance(step, FaultStep):
            await self._fault(step)
        elif isinstance(step, ExpectStep):
            self._expect_now(key, step)
        elif isinstance(step, FollowPathStep):
            paths, lights = self._mission.paths_of(step), self._mission.lights_of(step)
            await fleet.follow_path(
                paths, lights=lights, on_lag=step.on_lag, timeout_s=step.timeout_s
            )
        elif isinstance(step, FlyFormationStep):
            paths = formation_paths(step, fleet.config, self._spots())
            await fleet.follow_path(paths, on_lag=step.on_lag, timeout_s=step.timeout_s)
        elif isinstance(step, RepeatStep):
            for _ in range(step.times):
                await self._all(step.steps, f"{key}.steps")
        elif isinstance(step, ParallelStep):
            await self._side_by_side(step, key)
        else:
            await self._react(step, key)

    async def _order(self, step: OrderStep) -> None:
        fleet = self._fleet
        intent = intent_of(step, fleet.config)
        intent = _without(intent, fleet.ground.left_out)
        if not intent.vehicles:
            return
        if isinstance(step, GoalStep) and step.speed_m_s is not None:
            orders = fleet.client.plan(intent).orders
            goals = {
                name: one.position_enu_m
                for name, one in orders.items()
                if one.position_enu_m is not None
            }
            intent = with_speed(intent, step.speed_m_s, goals, self._spots())
        await fleet.order(intent, step.timeout_s)

    async def _side_by_side(self, step: ParallelStep, key: str) -> None:
        try:
            async with asyncio.TaskGroup() as group:
                for index, branch in enumerate(step.branches):
                    group.create_task(self._all(branch, f"{key}.branches[{index}]"))
        except BaseExceptionGroup as failures:
            raise _first(failures) from None

    async def _react(self, step: ReactStep, key: str) -> None:
        async def then() -> None:
            await self._all(step.then, f"{key}.then")

        try:
            async with self._fleet.reacting(
                condition(step.when, self._fleet.config), then, ends=True
            ):
                await self._all(step.steps, f"{key}.steps")
        except BaseExceptionGroup as failures:
            raise _first(failures) from None

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
        state = self._fleet.state
        landed = {name: is_landed(state, name) for name in self._fleet.names}
        for one in check(step, self._mission.fleet, smallest(state), self._fleet.arrivals, landed):
            self._fleet.say(f"  {one.sentence}")
            if not one.has_come_true:
                raise MissionFailed(f"{key} expected: {one.sentence}")

    def _spots(self) -> dict[str, Vec3]:
        now_ns, views = self._fleet.client.now_ns(), self._fleet.state.vehicles
        spots = {name: views[name].position_enu_m(now_ns) for name in self._fleet.names}
        return {name: spot for name, spot in spots.items() if spot is not None}


def condition(until: Until, fleet: FleetConfig) -> WaitCondition:
    """Return the condition that a step waits for.

    Args:
        until: the keys of the file; at least one.
        fleet: the fleet file.

    Raises:
        ConfigError: a vehicle is unknown.
    """

    def names(vehicles: str | list[str] | None) -> tuple[str, ...] | None:
        return None if vehicles is None else fleet.select(vehicles)

    about = names(until.vehicles)
    all_ = []
    if until.reached:
        goals = dict(zip(fleet.select(list(until.reached)), until.reached.values(), strict=True))
        all_.append(conditions.reached(goals, until.within_m))
    if until.separation_above_m is not None:
        all_.append(conditions.separation_above(until.separation_above_m))
    if until.separation_below_m is not None:
        all_.append(conditions.separation_below(until.separation_below_m))
    if until.battery_below_pct is not None:
        all_.append(conditions.battery_below(until.battery_below_pct, about))
    if until.landed is not None:
        all_.append(conditions.landed(names(until.landed)))
    if until.flying is not None:
        all_.append(conditions.flying(names(until.flying)))
    if until.fails:
        all_.append(conditions.fails(about))
    if until.event is not None:
        all_.append(conditions.event(until.event, about))
    return all_[0] if len(all_) == 1 else conditions.all_of(*all_)


def _without(intent: Intent, left_out: set[str]) -> Intent:
    names = tuple(name for name in intent.vehicles if name not in left_out)
    goals = None if intent.goals is None else {name: intent.goals[name] for name in names}
    return replace(intent, vehicles=names, goals=goals)


def _blocks(step: MissionStep) -> tuple[Sequence[MissionStep], ...]:
    if isinstance(step, ParallelStep):
        return step.branches
    return (
        (step.steps, getattr(step, "then", ())) if isinstance(step, RepeatStep | ReactStep) else ()
    )


def _index(stage: Stage) -> int:
    return int(stage.key.removeprefix("step[").partition("]")[0])


def _first(failures: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the first exception of a group, which the others followed."""
    first = failures.exceptions[0]
    return _first(first) if isinstance(first, BaseExceptionGroup) else first
