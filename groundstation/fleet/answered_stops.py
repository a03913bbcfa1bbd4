"""Orders to stop that vehicles on the ground refuse: only the answers tell of them. Pure."""

from __future__ import annotations

from collections.abc import Callable, Collection

from groundstation.fleet.state import FleetState
from onboard.bus.control_token import EMERGENCY
from onboard.bus.order_answers import order_answer


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
        vehicle = logged.event.vehicle
        answer = order_answer(logged.event)
        if answer is None or vehicle not in names or logged.received_ns < since_ns:
            continue
        if answer.kind in EMERGENCY and not is_own(answer.order_id):
            return f"{answer.node} has ordered {vehicle} to {answer.kind}"
    return ""
