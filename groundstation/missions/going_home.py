"""Vehicles fly home at the end of a mission or of a script, and land at their take-off spots.

How long that is waited for depends on the way: a slow vehicle far away needs minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from groundstation.client.client import FleetClient
from groundstation.missions.taken import FleetWatch, flown_by_hand
from groundstation.orders.intents import Home
from groundstation.orders.obstruction import explained
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.reachable_goals import longest_move_s
from groundstation.orders.result import Results

_LATE_S = 90.0  # longest wait after the expected end of the ways: for the landing, and for detours


def flying_by_agent(client: FleetClient, names: Sequence[str]) -> tuple[str, ...]:
    """Return those of these vehicles that are in the air and that no pilot flies by hand."""
    vehicles = client.state.vehicles
    by_hand = flown_by_hand(client)
    return tuple(name for name in names if vehicles[name].is_airborne and name not in by_hand)


async def fly_home_unless_taken(
    client: FleetClient, names: Sequence[str], watch: FleetWatch, *, say: Callable[[str], None]
) -> Collection[str] | None:
    """Let those of these vehicles fly home that their agents fly, and land there.

    Args:
        client: fleet client that has been started.
        names: names of the vehicles.
        watch: watch of the mission's fleet.
        say: function that receives each line of progress.

    Returns:
        The vehicles that a person here has ordered elsewhere meanwhile; None if somebody has taken
        the fleet, whose order stays.
    """
    flying = flying_by_agent(client, names)
    if not flying:
        return ()
    results = await fly_home(client, flying, say=say)
    if await watch.after_failure(results) is not None:
        return None
    return watch.ordered_by_person(results)


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
