"""Orders the emulator to inject faults into a simulated flight."""

from __future__ import annotations

import asyncio

from groundstation.client.bus_feed import BusFeed
from onboard.bus.codec import Malformed
from onboard.bus.schema import FaultOrder, OrderReply

_TIMEOUT_S = 1.5


class FaultRefused(RuntimeError):
    """A fault was not injected; the text is a sentence with the reason."""


async def order_fault(feed: BusFeed, order: FaultOrder) -> str:
    """Order one fault and wait for the emulator's reply.

    Args:
        feed: the client's side of the bus.
        order: fault, vehicle, parameters and times.

    Returns:
        The emulator's sentence about the fault.

    Raises:
        FaultRefused: the fault is impossible, or no emulator answers.
    """
    has_ended = asyncio.Event()  # set by a reply, and also by the end of the wait without one
    replies: list[OrderReply | Malformed] = []

    def on_reply(reply: OrderReply | Malformed) -> None:
        replies.append(reply)
        feed.call(has_ended.set)

    feed.bus.fault(
        order, timeout_s=_TIMEOUT_S, on_reply=on_reply, on_end=lambda: feed.call(has_ended.set)
    )
    await has_ended.wait()

    reply = next((reply for reply in replies if isinstance(reply, OrderReply)), None)
    if reply is None:
        raise FaultRefused(
            f"{order.vehicle}: no emulator answers on the bus, so '{order.fault}' was not "
            "injected. Faults are for simulated flights only: fly with --sitl or in lockstep, or "
            "remove the fault from the mission."
        )
    if not reply.is_accepted:
        raise FaultRefused(f"{order.vehicle}: {reply.reason}")
    return reply.reason
