"""Orders of a Crazyswarm script: collected between two sleeps, sent together, waited for when they
are due.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Coroutine
from dataclasses import dataclass, field, replace
from typing import Any

from msgspec import structs

from groundstation.missions.api import Fleet
from groundstation.missions.blocking import BlockingFleet
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Goto
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import OrderFailed
from groundstation.paths.checks import path_findings, refusals
from groundstation.paths.pieces import slowed
from onboard.bus.schema import Vec3
from onboard.config.fleet import ConfigError
from onboard.control.path import Path

_TIMESCALES = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0)
_TAKEOFF_S, _LAND_S, _MOVE_S = 60.0, 60.0, 40.0  # longest waits; of a move, beyond its own duration


@dataclass(slots=True)
class _Open:
    """An order that has been sent."""

    task: asyncio.Task[None]
    kind: str
    names: tuple[str, ...]
    due_s: float  # on the script's clock


@dataclass(slots=True)
class _Batch:
    """Orders since the last sleep; of one vehicle's the last counts."""

    # height [m], duration [s]
    takeoffs: dict[str, tuple[float, float]] = field(default_factory=dict)
    # goal, yaw [deg], duration [s]
    goals: dict[str, tuple[Vec3, float, float]] = field(default_factory=dict)
    paths: dict[str, Path] = field(default_factory=dict)
    landings: dict[str, float] = field(default_factory=dict)  # duration [s]
    stops: list[str] = field(default_factory=list)

    def forget(self, name: str) -> None:
        """Let a new order of a vehicle replace those of the same moment."""
        for orders in (self.takeoffs, self.goals, self.paths, self.landings):
            orders.pop(name, None)


class ScriptOrders:
    """The orders of one script.

    Args:
        blocking: connected.
    """

    def __init__(self, blocking: BlockingFleet) -> None:
        self._blocking = blocking
        self.fleet: Fleet = blocking.run(_itself)
        self._batch = _Batch()
        self._open: list[_Open] = []
        self._failure: BaseException | None = None
        self._has_failed = asyncio.Event()
        self._begin_ns = self.fleet.client.now_ns()
        self._late_s = 0.0

    @property
    def time_s(self) -> float:
        """Time since the begin, without what vehicles were late."""
        return (self.fleet.client.now_ns() - self._begin_ns) * 1e-9 - self._late_s

    def takeoff(self, name: str, height_m: float, duration_s: float) -> None:
        """Have a vehicle take off."""
        self._batch.forget(name)
        self._batch.takeoffs[name] = height_m, duration_s

    def land(self, name: str, duration_s: float) -> None:
        """Have a vehicle land."""
        self._batch.forget(name)
        self._batch.landings[name] = duration_s

    def go_to(self, name: str, goal: Vec3, yaw_deg: float, duration_s: float) -> None:
        """Have a vehicle go to a goal."""
        self._batch.forget(name)
        self._batch.goals[name] = goal, yaw_deg, duration_s

    def follow(self, name: str, path: Path) -> None:
        """Have a vehicle follow a path."""
        self._batch.forget(name)
        self._batch.paths[name] = path

    def stop(self, name: str) -> None:
        """Have a vehicle disarm on the ground."""
        if self.fleet[name].is_flying and name not in self._batch.landings:
            raise OrderError(
                f"{name} flies, and without motors it would fall: land() it, or allcfs.emergency()."
            )
        self._batch.stops.append(name)

    def kill_all(self) -> None:
        """Stop all motors now."""
        self._blocking.run(lambda fleet: fleet.kill(fleet.names))

    def spot(self, name: str) -> tuple[Vec3, float]:
        """Return where a vehicle is going to, with its heading [deg]: what relative goals count
        from.
        """
        if name in self._batch.goals:
            goal, yaw_deg, _ = self._batch.goals[name]
            return goal, yaw_deg
        telemetry = self.fleet[name].telemetry
        if telemetry is None:
            raise OrderError(f"{name} does not report where it is.")
        goal, is_flying = telemetry.goal_position_enu_m, telemetry.state in ("flying", "holding")
        yaw_deg = 0.0 if abs(telemetry.yaw_deg) < 1.0 else telemetry.yaw_deg
        return (
            goal if is_flying and all(map(math.isfinite, goal)) else telemetry.position_enu_m
        ), yaw_deg

    def position(self, name: str) -> Vec3:
        """Return the reported position; not a number where it is not known."""
        return self.fleet[name].position_enu_m or (math.nan, math.nan, math.nan)

    def pass_time(self, duration_s: float, *, waits_for_moves: bool) -> None:
        """Send what was ordered since the last call, and let time pass.

        Args:
            duration_s: on the script's clock.
            waits_for_moves: whether moves that should have ended by then are waited for; all else
                always is.

        Raises:
            OrderFailed: a vehicle did not do what was ordered.
        """
        batch, self._batch = self._batch, _Batch()
        self._blocking.run(lambda _: self._pass(batch, duration_s, waits_for_moves))
        if self._failure is not None:
            failure, self._failure = self._failure, None
            self._has_failed.clear()
            raise failure

    async def _pass(self, batch: _Batch, duration_s: float, waits_for_moves: bool) -> None:
        await self._send(batch)
        try:
            async with asyncio.timeout(duration_s):
                await self._has_failed.wait()
        except TimeoutError:
            pass
        kinds = (
            ("takeoff", "land", "path", "goto") if waits_for_moves else ("takeoff", "land", "path")
        )
        late = [
            one.task for one in self._open if one.kind in kinds and one.due_s <= self.time_s + 1e-6
        ]
        await self._wait(late)
        self._open = [one for one in self._open if not one.task.done()]

    async def _wait(self, tasks: list[asyncio.Task[None]]) -> None:
        """Wait for tasks while the script's clock stands."""
        left = [task for task in tasks if not task.done()]
        if left:
            begin_s = self.time_s
            await asyncio.wait(left)
            self._late_s += self.time_s - begin_s

    async def _send(self, batch: _Batch) -> None:
        starting = {*batch.goals, *batch.paths, *batch.landings}
        await self._wait(
            [
                one.task
                for one in self._open
                if one.kind == "takeoff" and starting.intersection(one.names)
            ]
        )
        ground, fleet = self.fleet.ground, self.fleet
        for height_m in sorted({height_m for height_m, _ in batch.takeoffs.values()}):
            own = {name: one[1] for name, one in batch.takeoffs.items() if one[0] == height_m}
            self._begin("takeoff", own, fleet.takeoff(height_m, list(own), timeout_s=_TAKEOFF_S))
        if batch.goals:
            durations_s = {name: duration_s for name, (_, _, duration_s) in batch.goals.items()}
            intent = Goto(
                vehicles=tuple(batch.goals),
                goals={name: goal for name, (goal, _, _) in batch.goals.items()},
            )

            def with_own(planned: PlannedOrder) -> PlannedOrder:
                orders = {
                    name: structs.replace(
                        order, duration_s=durations_s[name], yaw_deg=batch.goals[name][1]
                    )
                    for name, order in planned.orders.items()
                }
                return replace(planned, orders=orders)

            timeout_s = max(durations_s.values()) + _MOVE_S
            self._begin("goto", durations_s, ground.order(intent, timeout_s, change=with_own))
        if batch.paths:
            durations_s = {name: path.duration_s for name, path in batch.paths.items()}
            self._begin("path", durations_s, self._follow(batch.paths))
        if batch.landings:
            self._begin("land", batch.landings, fleet.land(list(batch.landings), timeout_s=_LAND_S))
        stopped = [
            name for name in batch.stops if name not in batch.landings and not fleet[name].is_flying
        ]
        if any(fleet[name].view.is_armed for name in stopped):
            self._begin("land", dict.fromkeys(stopped, 0.0), fleet.disarm(stopped))
        await asyncio.sleep(0.0)  # lets the orders leave

    async def _follow(self, paths: dict[str, Path]) -> None:
        try:
            await self.fleet.follow_path(paths)
        except ConfigError as error:
            config = self.fleet.config
            for factor in _TIMESCALES:
                slower = {name: slowed(path, factor) for name, path in paths.items()}
                if not refusals(path_findings(config, slower, "follow_path")):
                    raise ConfigError(
                        f"{error} A timescale that is {factor:g} times as long would do."
                    ) from None
            raise

    def _take_failure(self, task: asyncio.Task[None]) -> None:
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._failure = self._failure or error
            self._has_failed.set()

    def _begin(
        self, kind: str, durations_s: dict[str, float], order: Coroutine[Any, Any, Any]
    ) -> None:
        async def follow() -> None:
            try:
                await order
            except OrderFailed as error:
                if any(
                    not one.is_done and one.phase != "superseded" for one in error.results.values()
                ):
                    raise
                # the script itself has ordered something else, which is no failure
                steps = self.fleet.steps
                steps[:] = [step for step in steps if "superseded" not in step.vehicles.values()]

        due_s = self.time_s + max(durations_s.values())
        task = asyncio.create_task(follow())
        task.add_done_callback(self._take_failure)
        self._open.append(_Open(task, kind, tuple(durations_s), due_s))


async def _itself(fleet: Fleet) -> Fleet:
    return fleet
