"""Vehicles that follow another vehicle at an offset.

Each follower gets a new goal twice a second: the position that the leader will have in a second,
plus the follower's offset. The goals of all followers are one order, which is checked as a whole.
During a pause no goals are sent. The duration includes neither pauses nor the time in which this
ground hears no vehicle.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Mapping, Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.missions.follow_pause import FollowPause
from groundstation.missions.ground import MissionGround
from groundstation.missions.taken import FleetTaken
from groundstation.orders.intents import Goto, Hold
from groundstation.orders.result import OrderFailed, OrderResult, Results
from groundstation.paths.checks import LOWEST_M
from onboard.config.fleet import ConfigError, FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.ground import floor_m, least_height_m
from onboard.tuples import Xyz

_PERIOD_S = 0.5
# A goal is where the leader will be after this time, because a vehicle needs about that long to set
# out for a new goal.
_AHEAD_S = 1.0
_MOVED_M = 0.1  # a goal that has moved less is not ordered again
_REFUSED_S = 5.0  # longest time for which all goals may be refused
_HEARD_S = 1.0  # longest wait for the leader's telemetry after this ground's link is back
_INSIDE_M = 0.1  # smallest distance of goals from the fence
_HOLD_S = 15.0  # longest wait for the hold at the end


async def follow(
    ground: MissionGround, leader: str, offsets: Mapping[str, Xyz], duration_s: float
) -> Results:
    """Have vehicles follow another one for a time; then they hold, even when this is cancelled.

    Args:
        ground: gives the mission's orders and keeps their results.
        leader: the vehicle that is followed.
        offsets: offsets of the followers from the leader [m], ENU.
        duration_s: duration [s].

    Returns:
        The result of the order to hold for each vehicle, except those that the mission has landed.

    Raises:
        ConfigError: the leader does not report where it is.
        OrderFailed: all goals of the last five seconds were refused, a follower does not hold, or
            all were brought home in a pause.
    """
    client = ground.client
    client.fleet.select([leader])
    ground.say(f"{', '.join(offsets)} follow {leader} for {duration_s:g} s")

    end_ns = client.now_ns() + int(duration_s * 1e9)
    accepted_goals: dict[str, Xyz] = {}  # the last goals that were accepted
    # last time at which goals were accepted, or had not moved enough to be ordered
    accepted_ns = client.now_ns()
    holding = tuple(offsets)  # vehicles that hold in the end
    left_out_before = frozenset(ground.left_out)
    pause = FollowPause(ground, holding)
    ground.follow_pauses.append(pause)
    try:
        while client.now_ns() < end_ns:
            look_ns = client.now_ns()
            was_lost = await ground.link.wait_while_lost()
            if was_lost:
                await client.wait_for(lambda state: _is_heard(client, state, leader), _HEARD_S)
                end_ns += client.now_ns() - look_ns
                accepted_goals = {}  # the vehicles may not have received the last goals
                accepted_ns = client.now_ns()

            pause.update()
            if pause.is_paused:
                end_ns += await pause.wait()
                accepted_goals = {}  # so that goals are ordered also if the leader has not moved
                accepted_ns = client.now_ns()

            skipped = pause.skipped()
            is_taken = ground.watch.takeover() is not None  # an operator has given other orders
            if skipped and not is_taken:
                ground.say(f"  {', '.join(skipped)} skips the rest of following {leader}")
                offsets = {name: offsets[name] for name in offsets if name not in skipped}
                pause.leave_out(skipped)

            landed = _landed_by_mission(client, offsets)
            if landed:
                ground.say(f"  {', '.join(landed)} lands and follows {leader} no longer")
                offsets = {name: offsets[name] for name in offsets if name not in landed}
                pause.leave_out(landed)
                holding = tuple(name for name in holding if name not in landed)

            remaining = ground.still_taking_part(offsets, left_out_before)
            pause.leave_out(tuple(name for name in offsets if name not in remaining))
            offsets = {name: offsets[name] for name in remaining}

            if not offsets:
                break

            goals = _goals(client, leader, offsets)
            if _have_moved(goals, accepted_goals):
                order = await _order_goals(ground, leader, goals)
                if not order.planned.refusals:
                    accepted_goals = goals
                    accepted_ns = client.now_ns()
                elif client.now_ns() - accepted_ns > _REFUSED_S * 1e9:
                    raise OrderFailed(order.intent, dict(order.results))
            else:
                accepted_ns = client.now_ns()

            await asyncio.sleep(_PERIOD_S)
    finally:
        ground.follow_pauses.remove(pause)
        results: Results = {}
        is_taken = ground.watch.takeover() is not None
        have_other_order = is_taken or pause.has_brought_home
        if holding and not have_other_order:
            results = await ground.order(Hold(vehicles=holding), _HOLD_S)
    return results


def _is_heard(client: FleetClient, state: FleetState, leader: str) -> bool:
    return state.vehicles[leader].is_fresh(client.now_ns())


def _landed_by_mission(client: FleetClient, names: Iterable[str]) -> tuple[str, ...]:
    """Return the vehicles whose newest order is to land, and was given by this mission."""
    landed = []
    for name in names:
        telemetry = client.state.vehicles[name].telemetry
        if telemetry is None or telemetry.order_kind != "land":
            continue
        if client.is_of_mission(telemetry.order_id):
            landed.append(name)
    return tuple(landed)


async def _order_goals(ground: MissionGround, leader: str, goals: dict[str, Xyz]) -> OrderResult:
    """Send the followers to their goals, without waiting for this order to end.

    Raises:
        FleetTaken: an operator has taken the fleet.
    """
    taken = ground.watch.takeover()
    if taken is not None:
        raise FleetTaken(taken)

    goto = Goto(vehicles=tuple(goals), goals=goals, follows=leader)
    return await ground.client.submit(goto, is_by_mission=True)


def present_offsets(client: FleetClient, leader: str, names: Sequence[str]) -> dict[str, Xyz]:
    """Return the present offsets of vehicles from a leader [m], ENU.

    Args:
        client: fleet client that has been started.
        leader: the vehicle that is followed.
        names: names of the vehicles; the leader itself is left out.

    Raises:
        ConfigError: a vehicle does not report its position.
    """
    client.fleet.select([leader])

    positions: dict[str, Xyz] = {}
    unknown = []
    for name in dict.fromkeys((leader, *names)):
        position_enu_m = client.state.vehicles[name].position_enu_m(client.now_ns())
        if position_enu_m is None:
            unknown.append(name)
        else:
            positions[name] = position_enu_m
    if unknown:
        raise ConfigError(
            f"{', '.join(unknown)} does not report where it is, so nobody can follow."
        )

    x, y, z = positions.pop(leader)
    return {
        name: (position[0] - x, position[1] - y, position[2] - z)
        for name, position in positions.items()
    }


def _have_moved(goals: Mapping[str, Xyz], last_goals: Mapping[str, Xyz]) -> bool:
    """Whether goals have moved enough to be ordered; the first goals always are."""
    if not last_goals:
        return True
    return any(math.dist(goals[name], last_goals[name]) > _MOVED_M for name in goals)


def _goals(client: FleetClient, leader: str, offsets: Mapping[str, Xyz]) -> dict[str, Xyz]:
    """Return the followers' goals, ahead of the leader's present position and inside the fence."""
    view = client.state.vehicles[leader]
    position_enu_m = view.position_enu_m(client.now_ns())
    if position_enu_m is None or view.telemetry is None:
        raise ConfigError(f"{leader} does not report where it is, so nobody can follow it.")

    velocity_enu_m_s = view.telemetry.velocity_enu_m_s
    ahead_enu_m = [
        coordinate_m + _AHEAD_S * speed_m_s
        for coordinate_m, speed_m_s in zip(position_enu_m, velocity_enu_m_s, strict=True)
    ]

    goals = {}
    for name, (x, y, z) in offsets.items():
        goal = (ahead_enu_m[0] + x, ahead_enu_m[1] + y, ahead_enu_m[2] + z)
        goals[name] = _inside(client.fleet, client.fleet.vehicles[name], goal)
    return goals


def _inside(fleet: FleetConfig, follower: Vehicle, goal: Xyz) -> Xyz:
    """Return the point nearest to the goal that is inside the fence and not too low."""
    x, y, z = flight_space_of(fleet).nearest_inside(goal, _INSIDE_M)
    least_m = max(LOWEST_M, least_height_m(follower))
    return (x, y, max(z, floor_m(fleet) + least_m))
