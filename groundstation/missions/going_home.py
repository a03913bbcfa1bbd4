"""Vehicles fly home at the end of a mission or of a script, and land at their take-off spots.

How long that is waited for depends on the way: a slow vehicle far away needs minutes.
"""

from __future__ import annotations

from collections.abc import Callable

from groundstation.client.client import FleetClient
from groundstation.orders.intents import Home
from groundstation.orders.obstruction import explained
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.reachable_goals import longest_move_s
from groundstation.orders.result import Results

_LATE_S = 90.0  # longest wait after the expected end of the ways: for the landing, and for detours


async def fly_home(
    client: FleetClient, names: tuple[str, ...], *, say: Callable[[str], None]
) -> Results:
    """Let vehicles fly home and land there, and say which of them did not.

    Args:
        client: fleet client that has been started.
        names: vehicles in the air.
        say: function that receives each line of progress.

    Returns:
        One result per vehicle.
    """
    planned = client.plan(Home(vehicles=names))
    timeout_s = way_home_s(client, planned) + _LATE_S
    ended = await client.send(planned, is_by_mission=True).wait(timeout_s)

    results = explained(ended, planned, client.fleet, client.state, client.now_ns())
    for name, result in results.items():
        if not result.is_done:
            say(f"  {name} did not get home; {result.phase}: {result.reason}")
    return results


def way_home_s(client: FleetClient, planned: PlannedOrder) -> float:
    """Return the time [s] after which the last vehicle is above its spot if each flies alone.

    Args:
        client: fleet client that has been started.
        planned: order to fly home, which is not sent yet.
    """
    spots = {
        name: order.position_enu_m
        for name, order in planned.orders.items()
        if order.position_enu_m is not None
    }
    return longest_move_s(client.fleet, client.state, spots)
