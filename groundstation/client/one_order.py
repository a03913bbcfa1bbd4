"""Sends one order and disconnects when the order has ended, for ``covey order``."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from msgspec import structs

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.orders.falling import below_words
from groundstation.orders.intents import Intent, Kill, Land
from groundstation.orders.result import Results
from onboard.bus.control_token import OPEN_TO_ALL
from onboard.config.fleet import FleetConfig

CONNECT_S = 3.0  # longest wait until the vehicles are heard, or until a router answers
# Longest wait of a land or kill for silent vehicles. Such an order does not need their telemetry,
# and goes straight to PX4 if their agents do not answer.
_SILENT_S = 0.5
# Longest wait after a kill for the telemetry of all others, which comes 5 to 10 times a second.
_OTHERS_S = 0.25


async def order_once(
    client: FleetClient, intent: Intent, timeout_s: float, say: Callable[[str], None]
) -> Results:
    """Connect, send an order, wait for its end, and disconnect.

    Args:
        client: fleet client that has not been started.
        intent: the order.
        timeout_s: longest wait for its end [s].
        say: function for a sentence about vehicles below the killed ones; it is called after the
            kill was sent.

    Returns:
        vehicle -> its result.
    """
    longest_s = longest_start_s(client.fleet, intent)
    await client.start(longest_s)
    try:
        if client.is_without_bus:
            say(_without_bus_words(client, longest_s))
        await _wait_until_heard(client, intent)
        state_before = client.state
        ordered = asyncio.create_task(client.order(intent, timeout_s))
        if isinstance(intent, Kill):
            await asyncio.sleep(0.0)  # lets the task send the kill
            await client.wait_for(_are_all_heard, _OTHERS_S)
            below = _below_killed(client, intent, state_before)
            if below:
                say(below)
        return await ordered
    finally:
        await client.stop()


def longest_start_s(fleet: FleetConfig, intent: Intent) -> float | None:
    """Return how long an order waits for a router of the fleet [s]; None: until one answers.

    A land or kill needs no router where it can go straight to PX4. A land waits longer, because
    vehicles that PX4 lands do not avoid each other.

    Args:
        fleet: the fleet file.
        intent: the order.
    """
    if not isinstance(intent, Land | Kill) or not fleet.fleet.routers:
        return None

    has_direct = [fleet.vehicles[name].direct is not None for name in intent.names]
    if not any(has_direct):
        return None
    if isinstance(intent, Kill) and all(has_direct):
        return _SILENT_S
    return CONNECT_S


def _without_bus_words(client: FleetClient, waited_s: float | None) -> str:
    """Return why this ground is not on the bus, and where the order goes meanwhile."""
    if client.bus_problem:
        return client.bus_problem
    return (
        f"No router of this fleet has answered within {waited_s:g} s: the order goes straight to "
        "PX4, and over the bus as soon as a router answers."
    )


async def _wait_until_heard(client: FleetClient, intent: Intent) -> None:
    """Wait until the vehicles of an order are heard; a land or kill waits only briefly."""

    def can_order(state: FleetState) -> bool:
        return _is_ready(client, state, intent)

    if not isinstance(intent, Land | Kill):
        await client.wait_for(can_order, CONNECT_S)
        return

    if client.is_without_bus:
        return

    # While nobody is heard, this ground may not be connected yet, and an order over the bus would
    # reach nobody. It waits for that if there is no other way to a vehicle.
    vehicles = [client.fleet.vehicles[name] for name in intent.names]
    if any(vehicle.direct is None for vehicle in vehicles):
        await client.wait_for(lambda state: state.is_anybody_heard, CONNECT_S)
    await client.wait_for(can_order, _SILENT_S)


def _below_killed(client: FleetClient, intent: Kill, state_before: FleetState) -> str:
    """Return which vehicles are below the killed ones, by the positions before the kill."""
    vehicles = dict(client.state.vehicles)
    for name in intent.names:
        if name in state_before.vehicles:
            vehicles[name] = state_before.vehicles[name]
    state = structs.replace(client.state, vehicles=vehicles)
    return below_words(intent.names, client.fleet, state, client.now_ns())


def _are_all_heard(state: FleetState) -> bool:
    return all(view.telemetry is not None for view in state.vehicles.values())


def _is_ready(client: FleetClient, state: FleetState, intent: Intent) -> bool:
    """Whether the vehicles are heard, and the operator is known if the order depends on it."""
    for name in intent.names:
        if name not in client.fleet.enabled_names and not intent.brings_down:
            continue  # the order to a disabled vehicle is refused; nothing to wait for
        view = state.vehicles.get(name)  # None: a disabled vehicle that was not heard yet
        if view is None or view.telemetry is None:
            return False

    if intent.verb in OPEN_TO_ALL or client.control.is_operator:
        return True
    has_other_operator = client.control.holder is not None
    return has_other_operator or client.control.refusal(intent.verb) is not None
