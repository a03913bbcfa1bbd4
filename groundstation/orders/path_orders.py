"""Orders about paths: the parts that a path is loaded in, and the start at a common instant. Pure."""

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
    """Return the messages that bring each vehicle its part of an order."""
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
    chunks = [data[at : at + PART_BYTES] for at in range(0, len(data), PART_BYTES)]
    own_id = path_id(data)
    return [
        PathOrder(path_id=own_id, part=k, parts=len(chunks), data=chunk)
        for k, chunk in enumerate(chunks)
    ]


def starts_of(
    paths: Mapping[str, Path], show_id: str, start_ns: int, on_lag: OnLag
) -> dict[str, PathOrder]:
    """Return the start of each vehicle's path, all at one instant of the fleet's clock.

    Args:
        paths: of the vehicles.
        show_id: of this flight: whoever has the same id waits for each other.
        start_ns: time 0 of the paths, on this ground's monotonic clock.
        on_lag: what a vehicle does that falls behind for too long.
    """
    return {
        name: PathOrder(
            path_id=path_id(to_bytes(path)), show_id=show_id, start_ns=start_ns, on_lag=on_lag
        )
        for name, path in paths.items()
    }
