"""Orders of a Crazyswarm script: collected between two sleeps, sent together, then waited for.

A command of Crazyswarm returns at once, and the script sleeps until it should have ended. So all
commands between two sleeps are one batch. Each order of a batch has a due time on the script's
clock. A sleep that ends later than the due time waits for the end of the order. The script's clock
stands still during such a wait: it is the fleet's time without the lateness of vehicles. The end of
the script is a sleep until all orders are due, because a Crazyflie carries out its last command
after the end of its script, too.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Coroutine, Iterable, Set
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

from msgspec import structs

from groundstation.missions.api import Fleet
from groundstation.missions.blocking import BlockingFleet
from groundstation.missions.ground import step_result
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Goto
from groundstation.orders.obstacle_crossings import path_refusals
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import OrderFailed, Results
from groundstation.paths.pieces import slowed
from onboard.config.fleet import ConfigError
from onboard.control.path import Path
from onboard.tuples import Xyz

_TIMESCALES = (1.25, 1.5, 2.0, 2.5, 3.0, 4.0)  # timescales that are tried for a refused trajectory
# longest waits for the end of orders
_TAKEOFF_S = 60.0
_LAND_S = 60.0
_MOVE_S = 40.0  # beyond the move's own duration
_SAME_TIME_S = 1e-6  # allowance for rounding errors of times
_SAME_GOAL_M = 0.01  # goals that are nearer to each other than this are one
_SMALL_YAW_DEG = 1.0  # a smaller heading counts as 0
_UNKNOWN: Xyz = (math.nan, math.nan, math.nan)

Kind = Literal["arm", "takeoff", "land", "path", "goto"]


class _Takeoff(NamedTuple):
    height_m: float
    duration_s: float


class _Move(NamedTuple):
    goal_enu_m: Xyz
    yaw_deg: float
    duration_s: float


@dataclass(slots=True)
class _Open:
    """An order that has been sent."""

    task: asyncio.Task[None]
    kind: Kind
    names: tuple[str, ...]
    due_s: float  # on the script's clock
    replaced: set[str]  # vehicles with a later order of the same script


@dataclass(slots=True)
class _Batch:
    """Orders since the last sleep; of each vehicle only the last one."""

    takeoffs: dict[str, _Takeoff] = field(default_factory=dict)
    moves: dict[str, _Move] = field(default_factory=dict)
    paths: dict[str, Path] = field(default_factory=dict)
    landings: dict[str, float] = field(default_factory=dict)  # duration [s]
    arms: list[str] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)

    def forget(self, name: str) -> None:
        """Drop the orders of a vehicle in this batch, because a new one replaces them."""
        self.takeoffs.pop(name, None)
        self.moves.pop(name, None)
        self.paths.pop(name, None)
        self.landings.pop(name, None)
        self.arms = [other for other in self.arms if other != name]
        self.stops = [other for other in self.stops if other != name]


class ScriptOrders:
    """The orders of one script.

    Args:
        blocking: fleet that is connected.
    """

    def __init__(self, blocking: BlockingFleet) -> None:
        self._blocking = blocking
        self.fleet: Fleet = blocking.run(_itself)
        self._batch = _Batch()
        self._open: list[_Open] = []
        # the newest one of each vehicle, until it gets a path or lands
        self._sent: dict[str, _Takeoff | _Move] = {}
        self._is_stopped = False  # whether emergency() has stopped the motors
        self._is_interrupted = False  # whether Ctrl-C or a signal has ended a sleep
        self._failure: BaseException | None = None
        self._has_failed = asyncio.Event()
        self._begin_ns = self.fleet.client.now_ns()
        self._late_s = 0.0  # total lateness of vehicles so far

    @property
    def time_s(self) -> float:
        """Time since the start [s], without the lateness of vehicles."""
        return (self.fleet.client.now_ns() - self._begin_ns) * 1e-9 - self._late_s

    # -- orders from the script --------------------------------------------------------------------

    def arm(self, name: str) -> None:
        """Have a vehicle arm on the ground."""
        self._check_not_stopped("arm")
        self._batch.stops = [other for other in self._batch.stops if other != name]
        self._batch.arms.append(name)

    def takeoff(self, name: str, height_m: float, duration_s: float) -> None:
        """Have a vehicle take off."""
        self._check_not_stopped("takeoff")
        self._batch.forget(name)
        self._batch.takeoffs[name] = _Takeoff(height_m, duration_s)

    def land(self, name: str, duration_s: float) -> None:
        """Have a vehicle land."""
        self._batch.forget(name)
        self._batch.landings[name] = duration_s

    def go_to(self, name: str, goal: Xyz, yaw_deg: float, duration_s: float) -> None:
        """Have a vehicle go to a goal."""
        self._check_not_stopped("goTo")
        self._batch.forget(name)
        self._batch.moves[name] = _Move(goal, yaw_deg, duration_s)

    def follow(self, name: str, path: Path) -> None:
        """Have a vehicle follow a path."""
        self._check_not_stopped("startTrajectory")
        self._batch.forget(name)
        self._batch.paths[name] = path

    def stop(self, name: str) -> None:
        """Have a vehicle disarm on the ground."""
        if self.fleet[name].is_flying and name not in self._batch.landings:
            raise OrderError(
                f"{name} flies, and without motors it would fall: land() it, or allcfs.emergency()."
            )
        landing_s = self._batch.landings.get(name)
        self._batch.forget(name)
        if landing_s is not None:  # it is disarmed once it has landed
            self._batch.landings[name] = landing_s
        self._batch.stops.append(name)

    def kill_all(self) -> None:
        """Stop all motors now; orders that are not sent yet are dropped."""
        self._batch = _Batch()
        self._is_stopped = True
        self._replace_open(self.fleet.names)
        self._blocking.run(lambda fleet: fleet.kill(fleet.names))

    def _check_not_stopped(self, command: str) -> None:
        """Refuse a command to arm or to fly after an emergency."""
        if self._is_stopped:
            raise OrderError(
                f"{command} is refused, because emergency() has stopped all motors: a Crazyflie has"
                " to be restarted after it. Look at the vehicles, then start the script again."
            )

    # -- what the script reads ---------------------------------------------------------------------

    def spot(self, name: str) -> tuple[Xyz, float]:
        """Return the point at which relative goals begin, and the heading there [deg].

        It is the goal of the move or take-off that the vehicle carries out for this script, which
        telemetry shows only later. Otherwise it is the goal that the vehicle reports in the air, or
        else its position. The heading is that of the move to this goal, or else the measured one:
        headings that are measured would add up their errors.
        """
        sent = self._batch.moves.get(name) or self._under_way(name)
        if isinstance(sent, _Move):
            return sent.goal_enu_m, sent.yaw_deg

        telemetry = self.fleet[name].telemetry
        if telemetry is None:
            raise OrderError(f"{name} does not report where it is.")

        yaw_deg = telemetry.yaw_deg
        if abs(yaw_deg) < _SMALL_YAW_DEG:
            yaw_deg = 0.0

        point_enu_m = telemetry.position_enu_m
        goal_enu_m = telemetry.goal_position_enu_m
        has_goal = telemetry.state in ("taking off", "flying", "holding")
        if has_goal and all(map(math.isfinite, goal_enu_m)):
            point_enu_m = goal_enu_m

        last = self._sent.get(name)
        if isinstance(last, _Move) and math.dist(last.goal_enu_m, point_enu_m) < _SAME_GOAL_M:
            yaw_deg = last.yaw_deg

        if isinstance(sent, _Takeoff):
            x, y, _ = point_enu_m
            return (x, y, sent.height_m), yaw_deg
        return point_enu_m, yaw_deg

    def _under_way(self, name: str) -> _Takeoff | _Move | None:
        """Return the take-off or move that a vehicle carries out for this script, if there is one.

        The newest order that was sent to it decides.
        """
        for order in reversed(self._open):
            if name in order.names:
                if order.kind in ("takeoff", "goto") and not order.task.done():
                    return self._sent[name]
                return None
        return None

    def position(self, name: str) -> Xyz:
        """Return the reported position [m], ENU; NaN if it is not known."""
        position_enu_m = self.fleet[name].position_enu_m
        if position_enu_m is None:
            return _UNKNOWN
        return position_enu_m

    # -- time passes -------------------------------------------------------------------------------

    def pass_time(self, duration_s: float, *, waits_for_moves: bool) -> None:
        """Send the orders since the last call, and let time pass.

        Args:
            duration_s: duration on the script's clock [s].
            waits_for_moves: whether to wait for moves that are due by then. Other orders are always
                waited for.

        Raises:
            OrderFailed: a vehicle did not do what was ordered.
        """
        batch = self._batch
        self._batch = _Batch()
        try:
            self._blocking.run(lambda _: self._pass(batch, duration_s, waits_for_moves))
        except (KeyboardInterrupt, SystemExit):
            self._is_interrupted = True
            raise

        failure = self._failure
        if failure is not None:
            self._failure = None
            self._has_failed.clear()
            raise failure

    def finish(self) -> None:
        """Send the orders after the last sleep, and wait until all orders should have ended.

        After Ctrl-C or a signal it does nothing, also if the script has caught the exception.

        Raises:
            OrderFailed: a vehicle did not do what was ordered.
        """
        if self._is_interrupted:
            return

        self.pass_time(0.0, waits_for_moves=False)
        end_s = max((order.due_s for order in self._open), default=0.0)
        self.pass_time(max(0.0, end_s - self.time_s), waits_for_moves=True)

    async def _pass(self, batch: _Batch, duration_s: float, waits_for_moves: bool) -> None:
        """Send a batch, let time pass unless an order fails, and wait for orders that are due."""
        await self._send(batch)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(duration_s):
                await self._has_failed.wait()

        due = []
        for order in self._open:
            is_waited_for = waits_for_moves or order.kind != "goto"
            if is_waited_for and order.due_s <= self.time_s + _SAME_TIME_S:
                due.append(order.task)
        await self._wait(due)
        self._open = [order for order in self._open if not order.task.done()]

    async def _wait(self, tasks: list[asyncio.Task[None]]) -> None:
        """Wait for tasks while the script's clock stands still."""
        running = [task for task in tasks if not task.done()]
        if not running:
            return

        begin_s = self.time_s
        await asyncio.wait(running)
        self._late_s += self.time_s - begin_s

    # -- sending orders ----------------------------------------------------------------------------

    async def _send(self, batch: _Batch) -> None:
        """Send the orders of a batch, with all orders of the same kind as one order."""
        # Orders that begin in the air wait until the take-offs of their vehicles have ended.
        in_air = {*batch.moves, *batch.paths, *batch.landings}
        await self._wait(self._open_tasks("takeoff", in_air))
        # A vehicle refuses a take-off while it still arms.
        await self._wait(self._open_tasks("arm", set(batch.takeoffs)))

        self._sent.update(batch.takeoffs)
        self._sent.update(batch.moves)
        for name in (*batch.paths, *batch.landings):
            self._sent.pop(name, None)
        arms = [name for name in batch.arms if name not in batch.takeoffs]
        if arms:
            self._begin("arm", dict.fromkeys(arms, 0.0), self.fleet.arm(arms))
        self._send_takeoffs(batch.takeoffs)
        if batch.moves:
            self._send_moves(batch.moves)
        if batch.paths:
            durations_s = {name: path.duration_s for name, path in batch.paths.items()}
            self._begin("path", durations_s, self._follow(batch.paths))
        if batch.landings:
            landing = self.fleet.land(list(batch.landings), timeout_s=_LAND_S)
            self._begin("land", batch.landings, landing)
        self._send_stops([name for name in batch.stops if name not in batch.landings])

        await asyncio.sleep(0.0)  # lets the tasks begin, which send the orders

    def _open_tasks(self, kind: Kind, names: set[str]) -> list[asyncio.Task[None]]:
        """Return the tasks of orders of a kind that have been sent to some of these vehicles."""
        tasks = []
        for order in self._open:
            has_vehicle = bool(names.intersection(order.names))
            if order.kind == kind and has_vehicle:
                tasks.append(order.task)
        return tasks

    def _send_takeoffs(self, takeoffs: dict[str, _Takeoff]) -> None:
        """Send one take-off for all vehicles with the same height."""
        for height_m in sorted({takeoff.height_m for takeoff in takeoffs.values()}):
            durations_s = {
                name: takeoff.duration_s
                for name, takeoff in takeoffs.items()
                if takeoff.height_m == height_m
            }
            order = self.fleet.takeoff(height_m, list(durations_s), timeout_s=_TAKEOFF_S)
            self._begin("takeoff", durations_s, order)

    def _send_moves(self, moves: dict[str, _Move]) -> None:
        """Send goals as one order; each vehicle has its own duration and heading."""
        intent = Goto(
            vehicles=tuple(moves),
            goals={name: move.goal_enu_m for name, move in moves.items()},
        )

        def with_own_values(planned: PlannedOrder) -> PlannedOrder:
            orders = {
                name: structs.replace(
                    order, duration_s=moves[name].duration_s, yaw_deg=moves[name].yaw_deg
                )
                for name, order in planned.orders.items()
            }
            return replace(planned, orders=orders)

        durations_s = {name: move.duration_s for name, move in moves.items()}
        timeout_s = max(durations_s.values()) + _MOVE_S
        order = self.fleet.ground.order(intent, timeout_s, change=with_own_values)
        self._begin("goto", durations_s, order)

    def _send_stops(self, names: list[str]) -> None:
        """Disarm vehicles on the ground, if one of them is armed."""
        on_ground = [name for name in names if not self.fleet[name].is_flying]
        if any(self.fleet[name].view.is_armed for name in on_ground):
            # a sleep waits for it as for a landing
            self._begin("land", dict.fromkeys(on_ground, 0.0), self.fleet.disarm(on_ground))

    async def _follow(self, paths: dict[str, Path]) -> None:
        """Follow paths; a refusal names a timescale that would be accepted."""
        try:
            await self.fleet.follow_path(paths)
        except ConfigError as error:
            for factor in _TIMESCALES:
                slower = {name: slowed(path, factor) for name, path in paths.items()}
                if not path_refusals(self.fleet.config, slower, "follow_path"):
                    raise ConfigError(
                        f"{error} A timescale that is {factor:g} times as long would do."
                    ) from None
            raise

    def _begin(
        self, kind: Kind, durations_s: dict[str, float], order: Coroutine[Any, Any, Any]
    ) -> None:
        """Begin an order in a separate task."""
        self._replace_open(durations_s)
        due_s = self.time_s + max(durations_s.values())
        replaced: set[str] = set()
        task = asyncio.create_task(self._until_its_end(order, replaced))
        task.add_done_callback(self._take_failure)
        self._open.append(
            _Open(task=task, kind=kind, names=tuple(durations_s), due_s=due_s, replaced=replaced)
        )

    def _replace_open(self, names: Iterable[str]) -> None:
        """Note that these vehicles get a later order than those that are open."""
        for order in self._open:
            order.replaced.update(names)

    async def _until_its_end(self, order: Coroutine[Any, Any, Results], replaced: Set[str]) -> None:
        """Wait for the end of an order.

        An order has not failed if a later order of the same script has superseded it. Cut off by
        anything else, as by the landing at the end, it has.

        Args:
            order: the order.
            replaced: vehicles to which the script has given a later order by the order's end.
        """
        try:
            await order
        except OrderFailed as error:
            for name, result in error.results.items():
                is_replaced = result.phase == "superseded" and name in replaced
                if not result.is_done and not is_replaced:
                    raise
            self._leave_out_step(error.results)

    def _leave_out_step(self, results: Results) -> None:
        """Leave the step of a superseded order out of the flight's steps, and so of its verdict."""
        step = step_result("", 0.0, results)
        self.fleet.steps[:] = [
            other
            for other in self.fleet.steps
            if other.vehicles != step.vehicles or other.sentences != step.sentences
        ]

    def _take_failure(self, task: asyncio.Task[None]) -> None:
        """Keep the first failure, and end the sleep that runs."""
        if task.cancelled():
            return
        error = task.exception()
        if error is None:
            return

        if self._failure is None:
            self._failure = error
        self._has_failed.set()


async def _itself(fleet: Fleet) -> Fleet:
    """Return the asynchronous fleet, when a blocking fleet runs this."""
    return fleet
