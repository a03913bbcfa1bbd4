"""Orders about paths: the parts that a path is loaded in, and the common start. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from groundstation.orders.intents import PathVerb
from groundstation.orders.plan import ORDER_LIFE_S
from onboard.bus.schema import Order, PathOrder
from onboard.control.path import PART_BYTES, Path, path_id, to_bytes

OnLag = Literal["land", "hold"]


def path_orders(
    kind: PathVerb,
    paths: Mapping[str, PathOrder],
    new_id: Callable[[], str],
    author: str,
    node: str,
    now_ns: int,
) -> dict[str, Order]:
    """Return the messages that bring each vehicle its part of an order.

    Args:
        kind: whether they bring a part of a path, or start it.
        paths: the part, or the start, of each vehicle.
        new_id: makes the orders' ids.
        author: person or program that orders.
        node: the ground's name on the bus.
        now_ns: the ground's monotonic clock [ns].
    """
    deadline_ns = now_ns + int(ORDER_LIFE_S * 1e9)
    return {
        name: Order(
            order_id=new_id(),
            author=author,
            kind=kind,
            stamp_ns=now_ns,
            deadline_ns=deadline_ns,
            node=node,
            path=path,
        )
        for name, path in paths.items()
    }


def parts_of(path: Path) -> list[PathOrder]:
    """Return the parts of a path, in their order."""
    data = to_bytes(path)
    own_id = path_id(data)
    chunks = [data[begin : begin + PART_BYTES] for begin in range(0, len(data), PART_BYTES)]
    return [
        PathOrder(path_id=own_id, part=index, parts=len(chunks), data=chunk)
        for index, chunk in enumerate(chunks)
    ]


def starts_of(
    paths: Mapping[str, Path], show_id: str, start_ns: int, on_lag: OnLag
) -> dict[str, PathOrder]:
    """Return the start of each vehicle's path, all at one instant of the fleet's clock.

    Args:
        paths: paths of the vehicles.
        show_id: identifier of this flight: vehicles with the same id wait for each other.
        start_ns: time 0 of the paths, on this ground's monotonic clock.
        on_lag: reaction of a vehicle that falls behind for too long.
    """
    return {
        name: PathOrder(
            path_id=path_id(to_bytes(path)), show_id=show_id, start_ns=start_ns, on_lag=on_lag
        )
        for name, path in paths.items()
    }
