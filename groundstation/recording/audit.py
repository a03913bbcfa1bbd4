"""The orders of a recorded flight: author, time, the vehicle's reply, and how each order ended."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from groundstation.recording.timeline import RecordedMessage, Timeline
from onboard.bus.order_answers import order_answer
from onboard.bus.schema import Event, Order, OrderReply
from onboard.plain_text import plain_line

TOPICS = frozenset(("order", "reply", "event"))
_NOT_BELIEVED = "order-refused"  # code of the event about an order that a vehicle holds for forged


@dataclass(slots=True)
class OrderTrace:
    """One order to one vehicle."""

    at_s: float  # time since the start of the record
    vehicle: str
    text: str  # kind, author and ground
    answer: str = "no answer"
    end: str = ""  # outcome, time and reason; empty if no end was reported
    end_s: float = math.nan  # time at which the end was reported


class _Trail:
    """Collects the orders of a record, message by message."""

    def __init__(self) -> None:
        self.traces: list[OrderTrace] = []
        # (vehicle, order id) -> order of the ground that recorded
        self._own: dict[tuple[str, str], OrderTrace] = {}

    def add(self, at_s: float, vehicle: str, message: object) -> None:
        """Add one message about a vehicle."""
        if isinstance(message, Order):
            trace = OrderTrace(at_s, vehicle, message.text)
            self._own[vehicle, message.order_id] = trace
            self.traces.append(trace)
        elif isinstance(message, OrderReply):
            answered = self._own.get((vehicle, message.order_id))
            if answered is not None:
                answer = "accepted" if message.is_accepted else f"refused: {message.reason}"
                answered.answer = answer
        elif isinstance(message, Event):
            self._add_event(at_s, vehicle, message)

    def _add_event(self, at_s: float, vehicle: str, event: Event) -> None:
        order = self._own.get((vehicle, event.order_id))
        answered = order_answer(event)
        # After a break of the link the vehicle reports an end again; only the first report counts.
        if order is not None and event.order_outcome and not order.end:
            order.end_s = at_s
            order.end = f"{event.order_outcome} at {at_s:.1f} s: {event.sentence}"
        elif event.code == _NOT_BELIEVED:
            self.traces.append(OrderTrace(at_s, vehicle, event.sentence, "not believed"))
        elif answered is not None and (vehicle, answered.order_id) not in self._own:
            answer = f"as {vehicle} tells; id {answered.order_id}"
            self.traces.append(OrderTrace(at_s, vehicle, answered.words, answer))


def trail(timeline: Timeline) -> list[OrderTrace]:
    """List the orders of a record in the order in which they were given.

    Args:
        timeline: timeline of the record.

    Returns:
        Orders of the ground that recorded, with reply and end; and orders of other grounds as the
        vehicles have reported them.
    """
    # one nanosecond early, because a reading yields only messages after this time
    messages = timeline.read(timeline.begin_ns - 1, TOPICS).until(timeline.end_ns)
    return trail_of(messages, timeline.begin_ns)


def trail_of(messages: Iterable[RecordedMessage], begin_ns: int) -> list[OrderTrace]:
    """List the orders among messages, as :func:`trail`.

    Args:
        messages: messages of ``TOPICS``, in the order of their stamps.
        begin_ns: stamp [ns] from which the seconds count.
    """
    collected = _Trail()
    for recorded in messages:
        at_s = (recorded.stamp_ns - begin_ns) * 1e-9
        collected.add(at_s, recorded.name, recorded.message)
    return collected.traces


def trail_lines(traces: list[OrderTrace]) -> list[str]:
    """Return the orders as lines of text."""
    if not traces:
        return ["No orders are in this record."]

    lines = []
    for trace in traces:
        result = "; ".join(part for part in (trace.answer, trace.end) if part)
        text = plain_line(f"{trace.text} - {result}")
        lines.append(f"{trace.at_s:8.1f} s  {trace.vehicle:10s} {text}")
    return lines
