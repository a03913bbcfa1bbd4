"""Orders to stop that vehicles on the ground refuse: only the answers tell of them. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection

from groundstation.fleet.state import FleetState
from onboard.bus.control_token import EMERGENCY


def answered_stop(
    state: FleetState, names: Collection[str], since_ns: int, is_own: Callable[[str], bool]
) -> str:
    """Return which other ground has ordered a vehicle to land or to hold; empty if none.

    A vehicle on the ground refuses that, so its telemetry does not tell of it.

    Args:
        state: the fleet as known now.
        names: names of vehicles.
        since_ns: time since which such an order counts, on the ground's clock [ns].
        is_own: whether this ground has given an order with this identifier.
    """
    for logged in state.events:
        event = logged.event
        is_answer = event.code == "order" and event.vehicle in names
        if logged.received_ns < since_ns or not is_answer:
            continue

        order_id, _, words = event.sentence.partition(" ")
        verb = words.partition(" ")[0]
        if verb in EMERGENCY and not is_own(order_id):
            node = order_id.rpartition("-")[0]
            return f"{node} has ordered {event.vehicle} to {verb}"
    return ""
