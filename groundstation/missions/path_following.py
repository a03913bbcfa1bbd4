"""Paths flown together: loaded and checked on board, everybody at its begin, then one start for
all, or for none.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from groundstation.client.client import FleetClient
from groundstation.orders.intents import FollowPath, Goto, Hold, Intent
from groundstation.orders.path_orders import OnLag, parts_of, starts_of
from groundstation.orders.result import OrderFailed, OrderResult, Results
from groundstation.paths.lights import Colour, Light, colour_at
from groundstation.verdict.verdict import StepResult
from onboard.bus.schema import Light as LightMessage
from onboard.bus.topics import Topic
from onboard.config.fleet import Vec3
from onboard.control.path import Path, point_at

AHEAD_S = 3.0  # of the start, for all replies to come before it
_LATE_S = 60.0  # after the paths' own end: half the clock's rate for ten seconds, and some
_SAY_S = 10.0
_LOAD_S = 10.0
_LIGHT_S = 0.2  # between two looks at the colours


Paths = Mapping[str, Path]  # by vehicle
Lights = Mapping[str, Sequence[Light]]


class Fleet(Protocol):
    """The part of a mission's fleet that paths need."""

    client: FleetClient
    steps: list[StepResult]
    say: Callable[[str], None]

    async def order(self, intent: Intent, timeout_s: float) -> Results:
        """Give an order and wait for its end."""

    def add_arrival(self, step: str, name: str, goal: Vec3) -> None:
        """Note how far a vehicle is from its goal now."""


async def follow_paths(
    fleet: Fleet,
    paths: Paths,
    *,
    lights: Lights,
    on_lag: OnLag,
    timeout_s: float | None,
) -> Results:
    """Have each vehicle follow its path, from one instant on.

    Args:
        fleet: that flies.
        paths: of the vehicles.
        lights: colours of vehicles, shown and recorded.
        on_lag: what a vehicle does that falls behind for too long; the others go on.
        timeout_s: longest flight along the paths [s]; None: their own duration, and a minute.

    Returns:
        One result per vehicle; one that has left the others has failed, which ends nothing else.

    Raises:
        OrderFailed: a vehicle does not take its path, or does not start: then nobody does.
    """
    await _load(fleet, paths)
    begins = {name: point_at(path, 0.0).position_enu_m for name, path in paths.items()}
    await fleet.order(Goto(vehicles=tuple(paths), goals=begins), _LATE_S)
    longest_s = max(path.duration_s for path in paths.values())
    order = await _start(fleet, paths, on_lag)
    fleet.say(f"follow_path {','.join(paths)}: {longest_s:.0f} s, from {AHEAD_S:g} s from now on")
    begin_ns = fleet.client.now_ns()
    beside = [
        asyncio.create_task(_say_progress(fleet, tuple(paths), longest_s)),
        asyncio.create_task(_play_lights(fleet, lights)),
    ]
    try:
        results = await order.wait(timeout_s or AHEAD_S + longest_s + _LATE_S)
    finally:
        for task in beside:
            task.cancel()
        await asyncio.gather(*beside, return_exceptions=True)
    duration_s = (fleet.client.now_ns() - begin_ns) * 1e-9
    fleet.steps.append(_step_result("follow_path", duration_s, results))
    for name, result in results.items():
        if result.is_done:
            fleet.add_arrival("follow_path", name, point_at(paths[name], longest_s).position_enu_m)
        else:
            fleet.say(f"  {name} {result.phase}: {result.sentence}")
    fleet.say(f"  followed in {duration_s - AHEAD_S:.1f} s")
    return results


async def _load(fleet: Fleet, paths: Paths) -> None:
    """Bring every path to its vehicle, in parts; the last one has it checked there."""
    parts = {name: parts_of(path) for name, path in paths.items()}
    for k in range(max(map(len, parts.values()))):
        orders = {name: one[k] for name, one in parts.items() if k < len(one)}
        _require(
            fleet, await fleet.client.order_paths("load_path", orders).wait(_LOAD_S), "load_path"
        )


async def _start(fleet: Fleet, paths: Paths, on_lag: OnLag) -> OrderResult:
    """Order the start; if anybody does not accept it, all are ordered to hold before it comes."""
    client = fleet.client
    start_ns = client.now_ns() + int(AHEAD_S * 1e9)
    order = client.order_paths(
        "follow_path", starts_of(paths, client.new_order_id(), start_ns, on_lag)
    )

    def has_replied(_: object) -> bool:
        return all(result.phase != "sent" for result in order.results.values())

    await client.wait_for(has_replied, AHEAD_S)
    if any(result.phase != "accepted" for result in order.results.values()):
        results = dict(order.results)
        # also those whose reply may have been lost
        await client.order(Hold(vehicles=tuple(paths)), AHEAD_S)
        _require(fleet, results, "follow_path")
    return order


def _require(fleet: Fleet, results: Results, verb: str) -> None:
    if all(result.is_done for result in results.values()):
        return
    fleet.steps.append(_step_result(verb, 0.0, results))
    raise OrderFailed(FollowPath(vehicles=tuple(results)), dict(results))


def _step_result(verb: str, duration_s: float, results: Results) -> StepResult:
    return StepResult(
        step=f"{verb} {','.join(results)}",
        duration_s=round(duration_s, 2),
        vehicles={name: result.phase for name, result in results.items()},
        sentences={name: result.sentence for name, result in results.items()},
    )


async def _say_progress(fleet: Fleet, names: tuple[str, ...], longest_s: float) -> None:
    await asyncio.sleep(AHEAD_S)
    while True:
        await asyncio.sleep(_SAY_S)
        views = (fleet.client.state.vehicles[name].telemetry for name in names)
        flying = [one for one in views if one is not None and one.show_id]
        if flying:
            last = max(flying, key=lambda one: one.path_lag_m)
            mean_m = sum(one.path_lag_m for one in flying) / len(flying)
            fleet.say(
                f"  {min(one.path_time_s for one in flying):.0f} of {longest_s:.0f} s; behind their paths by "
                f"{mean_m:.2f} m, {last.vehicle} by {last.path_lag_m:.2f} m"
            )


async def _play_lights(fleet: Fleet, lights: Lights) -> None:
    """Show and record the colour of each vehicle at its own time of the show, when it has changed."""
    shown: dict[str, Colour] = {}
    while lights:
        await asyncio.sleep(_LIGHT_S)
        for name, own in lights.items():
            telemetry = fleet.client.state.vehicles[name].telemetry
            if telemetry is None or not telemetry.show_id or not own:
                continue
            colour = colour_at(own, telemetry.path_time_s)
            if shown.get(name) != colour:
                shown[name] = colour
                message = LightMessage(vehicle=name, stamp_ns=fleet.client.now_ns(), colour=colour)
                fleet.client.tell(Topic.LIGHT, name, message)
