"""What a vehicle writes about its answer to an order, others read."""

from __future__ import annotations

from onboard.bus.order_answers import ORDER_ANSWER, order_answer, order_answer_sentence
from onboard.bus.schema import Event, Order


def test_an_answer_is_read_as_it_was_written() -> None:
    order = Order(
        order_id="ground-77-a1b2-5",
        author="ada",
        kind="land",
        stamp_ns=1,
        deadline_ns=0,
        node="ground-77-a1b2",
    )
    event = Event(
        vehicle="mav0",
        stamp_ns=2,
        severity="debug",
        code=ORDER_ANSWER,
        sentence=order_answer_sentence(order, "refused: mav0 is on the ground."),
    )
    answer = order_answer(event)
    assert answer is not None
    assert (answer.order_id, answer.kind, answer.node) == (order.order_id, "land", order.node)
    assert answer.words == "land of ada (from ground-77-a1b2) refused: mav0 is on the ground."

    other = Event(vehicle="mav0", stamp_ns=2, severity="info", code="landed", sentence="a b")
    assert order_answer(other) is None
