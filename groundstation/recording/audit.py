"""The orders of a recorded flight: who gave which, when, what the vehicle answered, and how it
ended.
"""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.recording.timeline import Timeline
from onboard.bus.schema import Event, Order, OrderReply
from onboard.plain_text import plain_line

_TOPICS = frozenset(("order", "reply", "event"))
# of events in which a vehicle says itself what it was ordered: also by grounds other than the one
# that recorded
_ANSWERED, _NOT_BELIEVED = "order", "order-refused"


@dataclass(slots=True)
class OrderTrace:
    """One order to one vehicle."""

    at_s: float  # since the record's begin
    vehicle: str
    text: str  # kind, author and ground
    answer: str = "no answer"
    end: str = ""


def trail(timeline: Timeline) -> list[OrderTrace]:
    """List the orders of a record in the order in which they were given.

    Args:
        timeline: of the record.

    Returns:
        Orders of the ground that recorded, with answer and end; and those of others as their
        vehicles tell of them.
    """
    traces: list[OrderTrace] = []
    own: dict[tuple[str, str], OrderTrace] = {}  # (vehicle, order id) of the ground that recorded
    for one in timeline.read(timeline.begin_ns - 1, _TOPICS).until(timeline.end_ns):
        at_s, message = (one.stamp_ns - timeline.begin_ns) * 1e-9, one.message
        if isinstance(message, Order):
            trace = own[one.name, message.order_id] = OrderTrace(at_s, one.name, message.text)
            traces.append(trace)
        elif isinstance(message, OrderReply):
            known = own.get((one.name, message.order_id))
            if known is not None:
                known.answer = "accepted" if message.is_accepted else f"refused: {message.reason}"
        elif isinstance(message, Event):
            known = own.get((one.name, message.order_id))
            # ends are told again after a cut
            if known is not None and message.order_outcome and not known.end:
                known.end = f"{message.order_outcome} at {at_s:.1f} s: {message.sentence}"
            elif message.code == _NOT_BELIEVED:
                traces.append(OrderTrace(at_s, one.name, message.sentence, "not believed"))
            elif (
                message.code == _ANSWERED
                and (one.name, message.sentence.partition(" ")[0]) not in own
            ):
                order_id, _, sentence = message.sentence.partition(" ")
                traces.append(
                    OrderTrace(at_s, one.name, sentence, f"as {one.name} tells; id {order_id}")
                )
    return traces


def trail_lines(traces: list[OrderTrace]) -> list[str]:
    """Return the orders as lines of text."""
    lines = []
    for one in traces:
        result = "; ".join(filter(None, (one.answer, one.end)))
        lines.append(f"{one.at_s:8.1f} s  {one.vehicle:10s} {plain_line(f'{one.text} - {result}')}")
    return lines or ["No orders are in this record."]
