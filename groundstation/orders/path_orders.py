"""Messages about paths: the parts in which a path is sent, and the common start. Pure.

A path is longer than one message may be, so it is cut into parts of PART_BYTES bytes.
"""

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
    """Return the message to each vehicle.

    Args:
        kind: "load_path" for messages with a part of a path, "follow_path" for the start.
        paths: the part or the start for each vehicle.
        new_id: function that returns a new order id.
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
    id_of_path = path_id(data)
    chunks = [data[begin : begin + PART_BYTES] for begin in range(0, len(data), PART_BYTES)]
    return [
        PathOrder(path_id=id_of_path, part=index, parts=len(chunks), data=chunk)
        for index, chunk in enumerate(chunks)
    ]


def starts_of(
    paths: Mapping[str, Path], show_id: str, start_ns: int, on_lag: OnLag
) -> dict[str, PathOrder]:
    """Return the start of each vehicle's path, all at one instant of the fleet's clock.

    Args:
        paths: paths of the vehicles.
        show_id: identifier of this flight: vehicles with the same id wait for each other.
        start_ns: time 0 of the paths, on this ground's monotonic clock [ns].
        on_lag: reaction of a vehicle that falls behind for too long.
    """
    return {
        name: PathOrder(
            path_id=path_id(to_bytes(path)), show_id=show_id, start_ns=start_ns, on_lag=on_lag
        )
        for name, path in paths.items()
    }
