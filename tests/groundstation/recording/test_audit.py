"""Who ordered what, when, and what came of it, from a record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from groundstation.cli import main
from groundstation.recording.writer import RecordFiles
from onboard.bus.schema import Event, Message, Order, OrderReply
from onboard.bus.topics import Topic
from tests.groundstation.recorded import SECOND, record


def _event(at_s: int, code: str, sentence: str, **fields: Any) -> Event:
    return Event(
        vehicle="mav1",
        stamp_ns=at_s * SECOND,
        severity="debug",
        code=code,
        sentence=sentence,
        **fields,
    )


def test_the_trail_of_a_flight_lists_every_order(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = record(tmp_path / "flight", 1.0)
    land = Order(
        order_id="g-1",
        author="ann",
        kind="land",
        stamp_ns=6 * SECOND,
        deadline_ns=8 * SECOND,
        node="g",
    )
    messages: list[tuple[int, Topic, Message]] = [
        (6, Topic.ORDER, land),
        (6, Topic.ORDER, OrderReply(order_id="g-1", vehicle="mav1", is_accepted=True, reason="")),
        (6, Topic.EVENT, _event(6, "order", "g-1 land of ann (from g) accepted.")),
        (7, Topic.EVENT, _event(7, "order", "h-4 hold of bob (from h) accepted.")),
        (8, Topic.EVENT, _event(8, "order-refused", "Order kill of eve (from g) is not signed.")),
        (9, Topic.EVENT, _event(9, "landed", "Down.", order_id="g-1", order_outcome="done")),
    ]
    files = RecordFiles(
        folder, (folder / "flight.mcap").open("wb"), begin_ns=5 * SECOND, begin="a test"
    )
    for at_s, topic, message in messages:
        files.write(topic, "mav1", message, at_s * SECOND)
    files.finish()
    files.close()
    assert main(["replay", str(folder), "--orders"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("s  mav1", 1)[1].strip() for line in lines] == [
        "land of ann (from g) - accepted; done at 3.0 s: Down.",
        "hold of bob (from h) accepted. - as mav1 tells; id h-4",
        "Order kill of eve (from g) is not signed. - not believed",
    ]


def test_a_record_without_orders_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(record(tmp_path / "flight", 1.0)), "--orders"]) == 0
    assert capsys.readouterr().out == "No orders are in this record.\n"
