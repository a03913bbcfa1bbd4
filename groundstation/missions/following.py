"""Vehicles that follow another one at an offset: a new goal for each, twice a second, judged
together every time.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping, Sequence

from groundstation.client.client import FleetClient
from groundstation.missions.ground import MissionGround
from groundstation.orders.intents import Goto, Hold
from groundstation.orders.result import OrderFailed, Results
from groundstation.paths.checks import LOWEST_M
from onboard.bus.schema import Vec3
from onboard.config.fleet import ConfigError, FleetConfig

_PERIOD_S, _AHEAD_S = 0.5, 1.0  # a new leg takes about that long to get under way
_MOVED_M = 0.1
_REFUSED_S = 5.0
_INSIDE_M = 0.1


async def follow(
    ground: MissionGround, leader: str, offsets: Mapping[str, Vec3], duration_s: float
) -> Results:
    """Have vehicles follow another one for a time; then, and also when this is cancelled, they
    hold.

    Args:
        ground: of the flight.
        leader: the vehicle that is followed.
        offsets: of the followers from the leader [m], ENU.
        duration_s: for how long [s].

    Returns:
        One result per vehicle, of the order to hold.

    Raises:
        ConfigError: the leader does not report where it is.
        OrderFailed: the goals are refused for five seconds on end, or a follower does not hold.
    """
    client, last = ground.client, dict[str, Vec3]()
    client.fleet.select([leader])
    end_ns, good_ns = client.now_ns() + int(duration_s * 1e9), client.now_ns()
    ground.say(f"{', '.join(offsets)} follow {leader} for {duration_s:g} s")
    try:
        while client.now_ns() < end_ns:
            goals = _goals(client, leader, offsets)
            if not last or any(math.dist(goals[name], last[name]) > _MOVED_M for name in goals):
                order = await client.submit(Goto(vehicles=tuple(goals), goals=goals))
                if order.planned.refusals:
                    if client.now_ns() - good_ns > _REFUSED_S * 1e9:
                        raise OrderFailed(order.intent, dict(order.results))
                else:
                    last, good_ns = goals, client.now_ns()
            else:
                good_ns = client.now_ns()
            await asyncio.sleep(_PERIOD_S)
    finally:
        results = await ground.order(Hold(vehicles=tuple(offsets)), 15.0)
    return results


def present_offsets(client: FleetClient, leader: str, names: Sequence[str]) -> dict[str, Vec3]:
    """Return where vehicles are now, from a leader [m], ENU.

    Args:
        client: started.
        leader: the vehicle that is followed.
        names: of the vehicles; the leader itself is left out.

    Raises:
        ConfigError: somebody does not report where it is.
    """
    client.fleet.select([leader])
    spots = {
        name: client.state.vehicles[name].position_enu_m(client.now_ns())
        for name in (leader, *names)
    }
    unknown = [name for name, spot in spots.items() if spot is None]
    if unknown:
        raise ConfigError(
            f"{', '.join(unknown)} does not report where it is, so nobody can follow."
        )
    known = {name: spot for name, spot in spots.items() if spot is not None}
    x, y, z = known.pop(leader)
    return {name: (spot[0] - x, spot[1] - y, spot[2] - z) for name, spot in known.items()}


def _goals(client: FleetClient, leader: str, offsets: Mapping[str, Vec3]) -> dict[str, Vec3]:
    view = client.state.vehicles[leader]
    at = view.position_enu_m(client.now_ns())
    if at is None or view.telemetry is None:
        raise ConfigError(f"{leader} does not report where it is, so nobody can follow it.")
    v = view.telemetry.velocity_enu_m_s
    ahead = [value + _AHEAD_S * speed for value, speed in zip(at, v, strict=True)]
    return {
        name: _inside(client.fleet, (ahead[0] + x, ahead[1] + y, ahead[2] + z))
        for name, (x, y, z) in offsets.items()
    }


def _inside(fleet: FleetConfig, goal: Vec3) -> Vec3:
    """Return the nearest point inside the fence, a little above its floor."""
    fence = fleet.fleet.geofence_m
    x, y, z = fence.nearest_inside(goal, _INSIDE_M)
    return x, y, max(z, fence.z[0] + LOWEST_M)
