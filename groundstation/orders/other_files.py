"""Refuses orders to fly to vehicles that have another fleet file than this ground. Pure."""

from __future__ import annotations

from dataclasses import replace

from groundstation.fleet.fleet_files import other_file_words, with_other_file
from groundstation.fleet.state import FleetState
from groundstation.orders.plan import PlannedOrder, refuse_jointly
from onboard.bus.schema import OrderKind
from onboard.config.fleet import FleetConfig

# kinds of orders that start or move a vehicle, or let it go on along its path
_FLYING: tuple[OrderKind, ...] = (
    "arm",
    "takeoff",
    "move",
    "load_path",
    "follow_path",
    "resume",
    "skip",
)


def without_other_files(
    planned: PlannedOrder, fleet: FleetConfig, state: FleetState, now_ns: int
) -> PlannedOrder:
    """Return a planned order, refused to vehicles that would fly with another fleet file.

    Orders that end a flight, and those that start none, go to every vehicle.

    Args:
        planned: the order, with its goals checked.
        fleet: this ground's fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].
    """
    flying = [name for name, order in planned.orders.items() if order.kind in _FLYING]
    others = with_other_file(state, flying, fleet, now_ns)
    if not others:
        return planned

    refusals = {name: other_file_words([name], fleet) for name in others}
    if planned.intent.is_joint:
        refusals = refuse_jointly(refusals, planned.orders)
    orders = {name: order for name, order in planned.orders.items() if name not in refusals}
    return replace(planned, orders=orders, refusals={**planned.refusals, **refusals})
