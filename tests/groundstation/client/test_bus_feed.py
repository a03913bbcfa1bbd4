"""Messages of another computer, on their way to the record and into the fleet's state."""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.client.bus_feed import BusFeed
from groundstation.fleet.state import ReceivedMessage
from onboard.bus.schema import ClockMessage, Event, HeardClock, Message
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic

_MS = 1_000_000
_S = 1_000_000_000
_NOW_NS = 1000 * _S  # on the ground's clock


def _feed(folded: list[Message]) -> BusFeed:
    """A feed of events, which adds what it folds to a list."""

    def fold(batch: Sequence[ReceivedMessage]) -> None:
        folded.extend(message for message, _ in batch if isinstance(message, Message))

    return BusFeed(
        BusSession(namespace="covey/test", node="ground"),
        fold,
        folded=[Topic.EVENT],
        recorded=[],
        clock_ns=lambda: _NOW_NS,
        on_delivery=lambda: None,
    )


def test_sinks_get_stamps_on_the_grounds_clock_and_the_state_keeps_those_of_the_sender() -> None:
    ahead_ns = 300 * _S
    folded: list[Message] = []
    feed = _feed(folded)
    recorded: list[Event] = []

    def sink(_topic: Topic, _name: str, message: Message, received_ns: int) -> None:
        assert received_ns == _NOW_NS
        assert isinstance(message, Event)
        recorded.append(message)

    feed.add_sink(sink)
    clocks = feed.clocks
    assert clocks is not None
    # 1 ms in each direction
    heard = HeardClock("ground", clocks.host, _NOW_NS - _S, _NOW_NS - _S + ahead_ns + _MS)
    clock = ClockMessage(
        node="mav0", host=1, sequence=1, sent_ns=_NOW_NS + ahead_ns - _MS, heard=(heard,)
    )
    clocks.hear(clock, _NOW_NS)

    event = Event(
        vehicle="mav0",
        stamp_ns=_NOW_NS + ahead_ns - 50 * _MS,
        severity="info",
        code="x",
        sentence="x",
    )
    feed._receive(Topic.EVENT, "mav0", event)
    feed.read()
    assert folded == [event]
    (kept,) = recorded
    assert _NOW_NS - 55 * _MS < kept.stamp_ns <= _NOW_NS - 50 * _MS
    assert kept.sentence == event.sentence

    own = Event(vehicle="mav0", stamp_ns=_NOW_NS, severity="info", code="y", sentence="y")
    feed.tell_sinks(Topic.EVENT, "mav0", own)
    assert recorded[-1] is own, "a message of the ground itself has its clock"


def test_an_event_that_an_agent_repeats_for_another_ground_is_taken_once() -> None:
    folded: list[Message] = []
    feed = _feed(folded)
    recorded: list[Message] = []
    feed.add_sink(lambda _topic, _name, message, _received_ns: recorded.append(message))

    lands = Event(vehicle="mav0", stamp_ns=1, severity="critical", code="x", sentence="It lands.")
    again = Event(vehicle="mav0", stamp_ns=2, severity="critical", code="x", sentence="It lands.")
    others = [
        Event(vehicle="mav0", stamp_ns=3 + n, severity="info", code="x", sentence="It flies.")
        for n in range(3000)  # which no agent repeats
    ]
    for event in (lands, again, *others, lands):
        feed._receive(Topic.EVENT, "mav0", event)
    feed.read()

    assert folded == [lands, again, *others]
    assert len(recorded) == 2 + len(others)
