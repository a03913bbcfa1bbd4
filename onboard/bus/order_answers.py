"""The event in which a vehicle tells its answer to an order: its sentence, written and read. Pure.

Only the sender receives the reply. By this event, records and other grounds know of the order too.
"""

from __future__ import annotations

from typing import NamedTuple

from onboard.bus.schema import Event, Order

ORDER_ANSWER = "order"  # code of the event

_LONGEST_ID = 60  # characters of an order's id that are told, because it may come from anybody


class OrderAnswer(NamedTuple):
    """A vehicle's answer to an order, as its event tells it."""

    order_id: str
    words: str  # kind, author and sender of the order, then the answer; for people

    @property
    def kind(self) -> str:
        """Kind of the order."""
        kind, _, _ = self.words.partition(" ")
        return kind

    @property
    def node(self) -> str:
        """Node of the ground that gave the order; the order's id begins with it."""
        node, _, _ = self.order_id.rpartition("-")
        return node


def order_answer_sentence(order: Order, answer: str) -> str:
    """Return the sentence of the event.

    Args:
        order: the order.
        answer: what the vehicle answers.
    """
    return f"{order.order_id[:_LONGEST_ID]} {order.text} {answer}"


def order_answer(event: Event) -> OrderAnswer | None:
    """Return the answer that an event tells; None if the event is not about an answer."""
    if event.code != ORDER_ANSWER:
        return None

    order_id, _, words = event.sentence.partition(" ")
    return OrderAnswer(order_id, words)
