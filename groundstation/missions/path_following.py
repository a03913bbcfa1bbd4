"""Paths that are flown together: either all vehicles start, or none does.

1. Each vehicle gets its path in parts, and checks it on board.
2. One order sends all vehicles to the first points of their paths.
3. Whoever arrived early may have gone aside for the others since. So all are waited for until they
   are at these points together.
4. The start is ordered some seconds ahead, for one instant of the fleet's clock. If a vehicle does
   not accept it, or somebody takes the fleet, all are ordered to hold before that instant.

The instant may be a wall-clock time. Then the vehicles wait at the first points of their paths,
and an operator may stop the countdown until they start.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from contextlib import AbstractContextManager
from typing import Protocol

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.mission_files.wall_time import WallTime
from groundstation.missions.countdown import Countdown, CountdownEnded, count_down
from groundstation.missions.ground import step_result
from groundstation.missions.pause_watch import PauseWatch
from groundstation.missions.taken import FleetWatch
from groundstation.orders.intents import FollowPath, Goto, Hold, Intent
from groundstation.orders.path_orders import OnLag, parts_of, starts_of
from groundstation.orders.reachable_goals import longest_move_s
from groundstation.orders.result import OrderFailed, OrderResult, Results
from groundstation.paths.checks import paths_at_resting
from groundstation.paths.lights import Colour, TimedColour, colour_at
from groundstation.verdict.observations import StepResult
from onboard.bus.schema import Light as LightMessage
from onboard.bus.schema import Order
from onboard.bus.topics import Topic
from onboard.control.path import Path, point_at
from onboard.plain_text import listed
from onboard.tuples import Xyz

START_LEAD_S = 3.0  # time from the order to the start, in which all replies arrive
# Longest wait after the expected end of the ways to the first points, and after the paths' own end:
# vehicles that fall behind slow the clock of the paths.
_LATE_S = 60.0
_SLOWEST_RATE = 0.5  # rate of the paths while a failsafe slows all (onboard/flight/path_flight.py)
_SAY_S = 10.0  # time between two lines of progress
_LOAD_S = 10.0  # longest wait for the reply to one part of a path
_LOOK_S = 0.5  # time between two checks for a pause
_HOME_S = 120.0  # longest wait for vehicles that are brought home
_LIGHT_S = 0.2  # time between two checks for a new colour
_AT_FIRST_POINT_M = (
    0.4  # largest distance from the first point before the start; agents allow AT_START_M
)
_AT_FIRST_POINT_S = 20.0  # longest wait for all vehicles to be there at the same time
_NO_PATH = "No path is flown, because the mission goes on without these vehicles."
_SPARE_S = 0.3  # margin of the time that an order needs

Paths = Mapping[str, Path]  # by vehicle
Lights = Mapping[str, Sequence[TimedColour]]  # by vehicle


class PathGround(Protocol):
    """The part of a mission's ground that paths need."""

    client: FleetClient
    watch: FleetWatch
    steps: list[StepResult]
    say: Callable[[str], None]
    pause_line: str
    left_out: set[str]
    goes_on_without: bool
    is_ending: bool

    async def order(
        self, intent: Intent, timeout_s: float, *, may_be_left_out: bool = True
    ) -> Results:
        """Give an order and wait for its end."""

    async def end_of(self, order: OrderResult, timeout_s: float) -> Results:
        """Wait for the end of an order, and send it again when this ground's link was lost."""

    def leave_out_disabled(self) -> None:
        """Go on without vehicles that are out of service or swapped, if any vehicle is left."""

    async def check_open(self, intent: Intent) -> None:
        """Refuse an order of steps that have ended, or of a script whose end has begun."""

    def still_taking_part(self, names: Iterable[str], left_out_before: Set[str]) -> tuple[str, ...]:
        """Return vehicles without those that were left out since a time."""

    def counting(self, at: WallTime, names: Sequence[str]) -> AbstractContextManager[Countdown]:
        """Begin a countdown, which ends with the block."""

    def noting_cancellation(self, words: str, order: OrderResult) -> AbstractContextManager[None]:
        """Keep the results of an order that stays in force when the block is cancelled."""

    async def go_on_or_fail(self, intent: Intent, results: Results) -> None:
        """Leave out the vehicles that failed, or fail the order when no vehicle would be left."""

    def add_arrival(self, step: str, name: str, goal: Xyz) -> None:
        """Note how far a vehicle is from its goal now."""

    def note_done(self, words: str, name: str, message: Order, results: Results) -> None:
        """Note an order as the last one of a vehicle, if the vehicle has done it."""


async def follow_paths(
    ground: PathGround,
    paths: Paths,
    *,
    lights: Lights,
    on_lag: OnLag,
    at: WallTime | None = None,
    timeout_s: float | None,
) -> Results:
    """Let each vehicle follow its path; all start at the same instant.

    Args:
        ground: gives the mission's orders and keeps their results.
        paths: paths of the vehicles.
        lights: colours of the vehicles, which are shown and recorded.
        on_lag: reaction of a vehicle that falls behind for too long; the others go on.
        at: wall-clock time at which they start; None: at once.
        timeout_s: longest flight along the paths [s]; None: twice their own duration, because all
            may be slowed, plus a minute.

    Returns:
        One result per vehicle that has started. A vehicle that has left its path has failed; the
        others go on. A vehicle that is left out before the start does not start, nor does one that
        is left out already and does not fly.

    Raises:
        OrderFailed: a vehicle does not accept its path or its start, so no vehicle starts; all were
            brought home in a pause; or no vehicle has followed its path to the end, or one still
            follows it after the timeout, and the mission does not go on without them. Vehicles
            that the mission itself has ordered elsewhere meanwhile do not count, here or in the
            mission's steps.
        CountdownEnded: the countdown ended before the start, so no vehicle starts.
    """
    ground.leave_out_disabled()
    grounded = _grounded(ground, paths)
    if grounded:
        ground.say(f"  the mission goes on without {listed(grounded)}: no path for them")
        paths = {name: path for name, path in paths.items() if name not in grounded}
    if not paths:
        ground.say(_NO_PATH)
        return {}

    client = ground.client
    resting_enu_m = client.state.resting_enu_m(client.now_ns(), without=paths)
    for sentence in paths_at_resting(client.fleet, paths, resting_enu_m):
        ground.say(f"  {sentence}")

    def taking_part() -> dict[str, Path]:
        return {name: paths[name] for name in ground.still_taking_part(paths, left_out_before)}

    left_out_before = frozenset(ground.left_out)
    await ground.check_open(FollowPath(vehicles=tuple(paths)))
    await _load(ground, paths)

    await _bring_to_first_points(ground, taking_part)

    if at is None:
        start_ns = ground.client.now_ns() + int(START_LEAD_S * 1e9)
        order = await _start(ground, taking_part(), on_lag, start_ns)
        begin_words = f"from {START_LEAD_S:g} s from now on"
    else:
        order = await _start_at(ground, taking_part, on_lag, at)
        begin_words = f"from {at.words} on"
    names = tuple(order.results)
    if not names:
        ground.say(_NO_PATH)
        return {}
    longest_s = max(paths[name].duration_s for name in names)
    ground.say(f"follow_path {listed(names)}: {longest_s:.0f} s, {begin_words}")

    if not timeout_s:
        timeout_s = START_LEAD_S + longest_s / _SLOWEST_RATE + _LATE_S

    begin_ns = ground.client.now_ns()
    results = await _flown(ground, order, lights, longest_s, timeout_s)
    duration_s = (ground.client.now_ns() - begin_ns) * 1e-9
    judged = _without_replaced(ground, results)

    ends = {name: point_at(paths[name], longest_s).position_enu_m for name in names}
    _note_results(ground, order, results, judged, ends, duration_s)
    await _judge_end(ground, order.intent, judged)
    return results


def _grounded(ground: PathGround, names: Iterable[str]) -> list[str]:
    """Return the vehicles without which the mission goes on and that do not fly."""
    vehicles = ground.client.state.vehicles
    return [name for name in names if name in ground.left_out and not vehicles[name].is_airborne]


async def _bring_to_first_points(ground: PathGround, taking_part: Callable[[], Paths]) -> None:
    """Order the vehicles to the first points of their paths, and wait until all are there together.

    Args:
        ground: gives the mission's orders.
        taking_part: function that returns the paths of the vehicles that still take part.
    """
    first_points: dict[str, Xyz] = {}
    for name, path in taking_part().items():
        first_points[name] = point_at(path, 0.0).position_enu_m

    client = ground.client
    move_s = longest_move_s(client.fleet, client.state, first_points)
    to_first_points = Goto(vehicles=tuple(first_points), goals=first_points)
    await ground.order(to_first_points, move_s + _LATE_S, may_be_left_out=False)
    await _wait_at_first_points(ground, {name: first_points[name] for name in taking_part()})


async def _flown(
    ground: PathGround, order: OrderResult, lights: Lights, longest_s: float, timeout_s: float
) -> Results:
    """Wait for the end of all paths; meanwhile say how far they are flown, and play the lights.

    Args:
        ground: gives the mission's orders.
        order: the order that has started the paths.
        lights: colours of the vehicles.
        longest_s: duration of the longest path [s].
        timeout_s: longest wait [s].
    """
    names = tuple(order.results)
    tasks = [
        asyncio.create_task(_say_progress(ground, names, longest_s)),
        asyncio.create_task(_play_lights(ground, lights)),
    ]
    try:
        with _waiting_for(ground, order):
            return await _end_of(ground, order, timeout_s)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _note_results(
    ground: PathGround,
    order: OrderResult,
    results: Results,
    judged: Results,
    ends: Mapping[str, Xyz],
    duration_s: float,
) -> None:
    """Note how the vehicles have followed their paths, and say what was wrong.

    Args:
        ground: keeps the mission's results.
        order: the order that has started the paths.
        results: its results.
        judged: results without vehicles that the mission itself has ordered elsewhere.
        ends: last points of the paths [m], ENU.
        duration_s: time from the order to its end [s].
    """
    if judged:
        ground.steps.append(step_result(f"follow_path {','.join(judged)}", duration_s, judged))
    for name, result in results.items():
        if result.is_done:
            ground.add_arrival("follow_path", name, ends[name])
            ground.note_done("follow_path", name, order.planned.orders[name], results)
        else:
            ground.say(f"  {result.words}")
    is_followed = any(result.is_done for result in results.values())
    if is_followed and duration_s > START_LEAD_S:
        ground.say(f"  followed in {duration_s - START_LEAD_S:.1f} s")


def _without_replaced(ground: PathGround, results: Results) -> Results:
    """Return the results without vehicles that a later order of this mission took from their paths.

    The landing at the end of a script is no such order.
    """
    if ground.is_ending:
        return results

    kept = {}
    for name, result in results.items():
        is_newest = ground.client.is_newest_of_mission(name, result.order_id)
        if result.phase != "superseded" or is_newest:
            kept[name] = result
    return kept


async def _judge_end(ground: PathGround, intent: Intent, judged: Results) -> None:
    """Fail the step if no vehicle has followed its path to the end, or one still follows it.

    Args:
        ground: leaves out vehicles, or fails the step.
        intent: the order to follow the paths.
        judged: results without vehicles that the mission itself has ordered elsewhere.

    Raises:
        OrderFailed: the step has failed, and the mission does not go on without these vehicles.
        FleetTaken: somebody has taken the fleet, and that is why.
    """
    is_followed = any(result.is_done for result in judged.values())
    is_in_time = all(result.phase != "unfinished" for result in judged.values())
    if ground.goes_on_without or not is_followed or not is_in_time:
        await ground.go_on_or_fail(intent, judged)


async def _end_of(ground: PathGround, order: OrderResult, timeout_s: float) -> Results:
    """Wait for the end of all paths; the time of a pause does not count.

    During a pause, all are brought home when the weakest battery can wait no longer.

    Raises:
        OrderFailed: all were brought home.
    """
    watch = PauseWatch(ground)
    try:
        return await _watched_end_of(ground, order, timeout_s, watch)
    finally:
        watch.hide()


async def _watched_end_of(
    ground: PathGround, order: OrderResult, timeout_s: float, watch: PauseWatch
) -> Results:
    """Wait for the end of all paths, and check for a pause twice a second."""
    client = ground.client
    names = tuple(order.results)
    remaining_s = timeout_s
    was_paused = False

    while True:
        wait_begin_ns = client.now_ns()
        await order.wait(min(_LOOK_S, remaining_s))
        if order.is_final:
            return dict(order.results)
        _call_off_if_taken(ground, order)

        following = [name for name in names if _is_following(client.state, name)]
        is_paused = any(_is_paused(client.state, name) for name in following)
        reserve = watch.weakest_battery(following)

        if is_paused and not was_paused and reserve is not None:
            ground.say(f"  paused; {reserve}")
        was_paused = is_paused

        if is_paused:
            watch.show(reserve)
            if reserve is not None and reserve.is_used_up:
                await watch.bring_home(following, reserve, _HOME_S)
                raise OrderFailed(FollowPath(vehicles=names), dict(order.results))
        else:
            watch.hide()
            remaining_s -= (client.now_ns() - wait_begin_ns) * 1e-9
        if remaining_s <= 0.0:
            return order.unfinished_after(timeout_s)


def _is_following(state: FleetState, name: str) -> bool:
    """Whether a vehicle follows a path; only then does its telemetry have a `show_id`."""
    telemetry = state.vehicles[name].telemetry
    return telemetry is not None and bool(telemetry.show_id)


def _is_paused(state: FleetState, name: str) -> bool:
    telemetry = state.vehicles[name].telemetry
    return telemetry is not None and telemetry.is_path_paused


async def _load(ground: PathGround, paths: Paths) -> None:
    """Send every path to its vehicle in parts; after the last part, the vehicle checks the path."""
    parts = {name: parts_of(path) for name, path in paths.items()}
    most_parts = max(len(own_parts) for own_parts in parts.values())

    for index in range(most_parts):
        orders = {
            name: own_parts[index] for name, own_parts in parts.items() if index < len(own_parts)
        }
        order = ground.client.order_paths("load_path", orders)
        results = await ground.end_of(order, _LOAD_S)
        _require_done(ground, results, "load_path")


async def _wait_at_first_points(ground: PathGround, first_points: Mapping[str, Xyz]) -> None:
    """Wait until all vehicles are at the first points of their paths together, but not for long.

    A vehicle may have gone aside for others that arrived later. The agent of one that is still
    elsewhere after the wait refuses the start.
    """
    client = ground.client

    def are_there(state: FleetState) -> bool:
        return not _away_from(state, first_points)

    away = _away_from(client.state, first_points)
    if not away:
        return
    ground.say(f"  waits until {listed(away)} is back at the first point of its path")
    await client.wait_for(are_there, _AT_FIRST_POINT_S)


def _away_from(state: FleetState, first_points: Mapping[str, Xyz]) -> list[str]:
    """Return the vehicles whose newest telemetry is not near the first points of their paths."""
    away = []
    for name, point in first_points.items():
        telemetry = state.vehicles[name].telemetry
        if telemetry is None or math.dist(telemetry.position_enu_m, point) > _AT_FIRST_POINT_M:
            away.append(name)
    return away


async def _start_at(
    ground: PathGround, taking_part: Callable[[], Paths], on_lag: OnLag, at: WallTime
) -> OrderResult:
    """Order the start for a wall-clock time; an operator may stop it until then.

    Args:
        ground: gives the mission's orders.
        taking_part: function that returns the paths of the vehicles that still take part.
        on_lag: reaction of a vehicle that falls behind for too long.
        at: the time.
    """
    with ground.counting(at, tuple(taking_part())) as countdown:
        if countdown.left_s < START_LEAD_S:
            raise CountdownEnded(
                f"{at.words} comes in {countdown.left_s:.1f} s, and a start is ordered "
                f"{START_LEAD_S:g} s ahead: the vehicles came too late to the first points of "
                "their paths."
            )
        await count_down(countdown, ground.say, until_s=START_LEAD_S + _SPARE_S)

        order = await _start(ground, taking_part(), on_lag, countdown.start_ns)
        try:
            with _waiting_for(ground, order):
                await count_down(countdown, ground.say, until_s=_SPARE_S)
        except CountdownEnded:
            await _hold(ground, tuple(order.results))
            raise
    return order


async def _start(ground: PathGround, paths: Paths, on_lag: OnLag, start_ns: int) -> OrderResult:
    """Order the start; if a vehicle does not accept it, order all to hold before that instant."""
    client = ground.client
    await ground.check_open(FollowPath(vehicles=tuple(paths)))
    starts = starts_of(paths, client.new_order_id(), start_ns, on_lag)
    order = client.order_paths("follow_path", starts)

    def have_replied(_: object) -> bool:
        return all(result.phase != "sent" for result in order.results.values())

    with _waiting_for(ground, order):
        await client.wait_for(have_replied, START_LEAD_S)
    if any(result.phase != "accepted" for result in order.results.values()):
        results = dict(order.results)
        # This includes vehicles that may have accepted the start, and whose reply was lost.
        await _hold(ground, tuple(paths))
        _require_done(ground, results, "follow_path")
    return order


@contextlib.contextmanager
def _waiting_for(ground: PathGround, order: OrderResult) -> Iterator[None]:
    """Keep the results of a start when the block is cancelled.

    If somebody who takes the fleet before the start is the cause, nobody starts.

    Args:
        ground: keeps the mission's results.
        order: the order to start the paths.
    """
    try:
        with ground.noting_cancellation(f"follow_path {','.join(order.results)}", order):
            yield
    finally:
        _call_off_if_taken(ground, order)


def _call_off_if_taken(ground: PathGround, order: OrderResult) -> None:
    """Order all to hold if somebody has taken the fleet before the start of their paths.

    Else the others would begin to fly around a vehicle that somebody has just stopped. Vehicles
    that have taken an order of somebody else keep it, and so do those that the mission has ordered
    since: each is held once only.

    Args:
        ground: gives the mission's orders.
        order: the order to start the paths.
    """
    client = ground.client
    starts = [message.path.start_ns for message in order.planned.orders.values() if message.path]
    is_before_start = client.now_ns() < min(starts, default=0)
    if not is_before_start or ground.watch.takeover() is None:
        return

    names = []
    for name, result in order.results.items():
        if not client.is_newest_of_mission(name, result.order_id):
            continue
        telemetry = client.state.vehicles[name].telemetry
        if telemetry is None or client.is_of_mission(telemetry.taken_order_id):
            names.append(name)
    if names:
        ground.say(f"  {listed(names)} hold, and nobody starts.")
        client.submit_now(Hold(vehicles=tuple(names)), is_by_mission=True)


async def _hold(ground: PathGround, names: tuple[str, ...]) -> None:
    """Order vehicles whose paths do not start to hold, unless the end of the script orders them."""
    if not ground.is_ending:
        await ground.client.order(Hold(vehicles=names), START_LEAD_S, is_by_mission=True)


def _require_done(ground: PathGround, results: Results, verb: str) -> None:
    """Fail the step unless every vehicle has done its part."""
    if all(result.is_done for result in results.values()):
        return

    ground.steps.append(step_result(f"{verb} {','.join(results)}", 0.0, results))
    raise OrderFailed(FollowPath(vehicles=tuple(results)), dict(results))


async def _say_progress(ground: PathGround, names: tuple[str, ...], longest_s: float) -> None:
    """Say every ten seconds how far the paths are flown, and how far vehicles are behind."""
    await asyncio.sleep(START_LEAD_S)
    while True:
        await asyncio.sleep(_SAY_S)

        following = []
        for name in names:
            telemetry = ground.client.state.vehicles[name].telemetry
            if telemetry is not None and telemetry.show_id:
                following.append(telemetry)
        if not following:
            continue

        time_s = min(telemetry.path_time_s for telemetry in following)
        mean_lag_m = sum(telemetry.path_lag_m for telemetry in following) / len(following)
        farthest = max(following, key=lambda telemetry: telemetry.path_lag_m)
        ground.say(
            f"  {time_s:.0f} of {longest_s:.0f} s; behind their paths by {mean_lag_m:.2f} m, "
            f"{farthest.vehicle} by {farthest.path_lag_m:.2f} m"
        )


async def _play_lights(ground: PathGround, lights: Lights) -> None:
    """Show and record each change of a vehicle's colour, at the vehicle's own time of the show."""
    client = ground.client
    shown: dict[str, Colour] = {}
    while lights:
        await asyncio.sleep(_LIGHT_S)
        for name, own_lights in lights.items():
            telemetry = client.state.vehicles[name].telemetry
            if telemetry is None or not telemetry.show_id or not own_lights:
                continue

            colour = colour_at(own_lights, telemetry.path_time_s)
            if shown.get(name) != colour:
                shown[name] = colour
                message = LightMessage(vehicle=name, stamp_ns=client.now_ns(), colour=colour)
                client.tell(Topic.LIGHT, name, message)
