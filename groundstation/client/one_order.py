"""Sends one order and disconnects when the order has ended, for ``covey order``."""

from __future__ import annotations

from collections.abc import Callable

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.orders.falling import below_words
from groundstation.orders.intents import Intent, Kill
from groundstation.orders.result import Results
from onboard.bus.control_token import OPEN_TO_ALL

CONNECT_S = 3.0  # longest wait until the vehicles are heard
# Longest wait before a kill for the telemetry of all others, which comes 5 to 10 times a second.
_OTHERS_S = 0.25


async def order_once(
    client: FleetClient, intent: Intent, timeout_s: float, say: Callable[[str], None]
) -> Results:
    """Connect, send an order, wait for its end, and disconnect.

    Args:
        client: fleet client that has not been started.
        intent: the order.
        timeout_s: longest wait for its end [s].
        say: function for a sentence about vehicles below the killed ones, called before a kill.

    Returns:
        vehicle -> its result.
    """

    def can_order(state: FleetState) -> bool:
        return _is_ready(client, state, intent)

    await client.start()
    try:
        await client.wait_for(can_order, CONNECT_S)
        if isinstance(intent, Kill):
            await client.wait_for(_are_all_heard, _OTHERS_S)
            below = below_words(intent.names, client.fleet, client.state, client.now_ns())
            if below:
                say(below)
        return await client.order(intent, timeout_s)
    finally:
        await client.stop()


def _are_all_heard(state: FleetState) -> bool:
    return all(view.telemetry is not None for view in state.vehicles.values())


def _is_ready(client: FleetClient, state: FleetState, intent: Intent) -> bool:
    """Whether the vehicles are heard, and the operator is known if the order depends on it."""
    for name in intent.names:
        if name in state.vehicles and state.vehicles[name].telemetry is None:
            return False

    if intent.verb in OPEN_TO_ALL or client.control.is_operator:
        return True
    return client.control.holder is not None or client.control.refusal(intent.verb) is not None
