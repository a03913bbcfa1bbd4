"""Two nodes on real endpoints: samples, orders, liveliness, and fleets side by side."""

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from onboard.bus.codec import Malformed
from onboard.bus.protocol import BusError, UntrustedOrder
from onboard.bus.schema import Event, FaultOrder, Order, OrderReply
from onboard.bus.session import BusSession, _Collector
from onboard.bus.topics import Topic
from tests.onboard.bus.sessions import until


class Flood:
    """A subscriber whose sender is faster than any reader."""

    def try_recv(self) -> bytes:
        return b"one more"


def test_a_flood_does_not_hold_up_who_reads_the_bus() -> None:
    session = BusSession(namespace="covey/t", node="mav0", listen=[])
    received: list[bytes] = []
    session._collectors = (_Collector(Flood(), received.append, 7),)
    session.deliver()
    assert len(received) == 7


EVENT = Event(vehicle="mav0", stamp_ns=5, severity="info", code="armed", sentence="Armed.")


def free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def agent(endpoint: str) -> Iterator[BusSession]:
    session = BusSession(namespace="covey/t", node="mav0", listen=[endpoint])
    session.start()
    yield session
    session.stop()


@pytest.fixture
def ground(agent: BusSession, endpoint: str) -> Iterator[BusSession]:
    session = BusSession(namespace="covey/t", node="ground", connect=[endpoint])
    session.start()
    alive: set[str] = set()
    session.watch_alive(lambda node, is_alive: alive.add(node) if is_alive else alive.discard(node))
    assert until(lambda: "mav0" in alive)
    session.alive = alive  # type: ignore[attr-defined]
    yield session
    session.stop()


def order(order_id: str = "1") -> Order:
    return Order(order_id=order_id, author="me", kind="arm", stamp_ns=0, deadline_ns=0)


def ask(ground: BusSession, vehicle: str) -> list[OrderReply | Malformed]:
    replies: list[OrderReply | Malformed] = []
    ended = threading.Event()
    ground.order(vehicle, order(), timeout_s=2.0, on_reply=replies.append, on_end=ended.set)
    assert ended.wait(5.0)
    return replies


def test_a_sample_arrives_with_topic_and_name(agent: BusSession, ground: BusSession) -> None:
    got: list[Any] = []
    ground.subscribe(Topic.EVENT, "*", lambda *sample: got.append(sample))

    def published() -> bool:
        agent.publish(Topic.EVENT, "mav0", EVENT)
        return bool(got)

    assert until(published)
    assert got[0] == (Topic.EVENT, "mav0", EVENT)


def test_an_order_is_answered_and_an_absent_vehicle_is_silence_at_once(
    agent: BusSession, ground: BusSession
) -> None:
    def answer(
        received: Order | Malformed | UntrustedOrder, reply: Callable[[OrderReply], None]
    ) -> None:
        assert isinstance(received, Order)
        message = OrderReply(
            order_id=received.order_id, vehicle="mav0", is_accepted=False, reason="not ready"
        )
        threading.Thread(target=reply, args=(message,)).start()

    agent.serve_orders("mav0", answer)
    assert until(lambda: ask(ground, "mav0"))
    assert ask(ground, "mav0") == [
        OrderReply(order_id="1", vehicle="mav0", is_accepted=False, reason="not ready")
    ]
    assert ask(ground, "mav7") == []


def test_a_fault_is_asked_of_the_emulator_and_answered(
    agent: BusSession, ground: BusSession
) -> None:
    heard: list[Any] = []

    def answer(received: FaultOrder | Malformed, reply: Callable[[OrderReply], None]) -> None:
        heard.append(received)
        taken = OrderReply(
            order_id="7", vehicle="mav0", is_accepted=True, reason="mav0: motor 2 stops"
        )
        threading.Thread(target=reply, args=(taken,)).start()

    fault = FaultOrder(
        order_id="7",
        author="me",
        stamp_ns=1,
        vehicle="mav0",
        fault="motor_dead",
        parameters={"motor": 2.0, "x": "y"},
    )
    replies: list[Any] = []

    def asked() -> bool:
        ended = threading.Event()
        ground.fault(fault, timeout_s=1.0, on_reply=replies.append, on_end=ended.set)
        assert ended.wait(5.0)
        return bool(replies)

    assert not asked()  # nobody emulates yet
    agent.serve_faults(answer)
    assert until(asked)
    assert heard[0] == fault
    assert replies[0].reason == "mav0: motor 2 stops"


def test_leaving_shows_in_the_liveliness(agent: BusSession, ground: BusSession) -> None:
    agent.stop()
    agent.stop()
    assert until(lambda: "mav0" not in ground.alive)  # type: ignore[attr-defined]


def test_a_second_node_of_a_name_does_not_take_the_first_along_when_it_leaves(
    agent: BusSession, ground: BusSession, endpoint: str
) -> None:
    def joins(node: str) -> BusSession:
        session = BusSession(namespace="covey/t", node=node, connect=[endpoint])
        session.start()
        return session

    second = joins("mav0")
    third = joins("mav9")
    seen: list[tuple[str, bool]] = []
    agent.watch_alive(lambda *change: seen.append(change))  # connected to all of them
    assert until(lambda: {("mav0", True), ("mav9", True)} <= set(seen))
    second.stop()
    third.stop()
    assert until(lambda: ("mav9", False) in seen)
    assert ("mav0", False) not in seen


def test_another_fleet_on_the_same_endpoint_hears_nothing(
    agent: BusSession, ground: BusSession, endpoint: str
) -> None:
    other = BusSession(namespace="covey/other", node="ground", connect=[endpoint])
    other.start()
    try:
        heard: list[Any] = []
        here: list[Any] = []
        other.subscribe(Topic.EVENT, "*", lambda *sample: heard.append(sample))
        ground.subscribe(Topic.EVENT, "*", lambda *sample: here.append(sample))

        def published() -> bool:
            agent.publish(Topic.EVENT, "mav0", EVENT)
            return len(here) > 5

        assert until(published)
        assert heard == []
    finally:
        other.stop()


def test_a_taken_endpoint_is_refused_in_words(agent: BusSession, endpoint: str) -> None:
    second = BusSession(namespace="covey/t", node="mav0", listen=[endpoint])
    with pytest.raises(BusError, match="address is in use"):
        second.start()


def test_a_closed_session_says_so() -> None:
    with pytest.raises(BusError, match="not open"):
        BusSession(namespace="covey/t", node="x").publish(Topic.EVENT, "x", EVENT)


def test_a_thread_of_the_bus_keeps_what_python_knows_of_it_from_one_message_to_the_next(
    agent: BusSession, ground: BusSession
) -> None:
    """Made anew for every message it would cost more than the message."""
    known = threading.local()
    counts = []

    def receive(*_: object) -> None:
        known.count = getattr(known, "count", 0) + 1
        counts.append(known.count)

    ground.subscribe(Topic.EVENT, "*", receive)

    def published() -> bool:
        agent.publish(Topic.EVENT, "mav0", EVENT)
        return len(counts) >= 5

    assert until(published)
    assert counts[:5] == [1, 2, 3, 4, 5]


def test_a_process_whose_bus_has_called_it_back_ends_as_it_should() -> None:
    program = f"""
import time
from onboard.bus.schema import Event
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
endpoint, got = {free_endpoint()!r}, []
with_ends = [BusSession(namespace="covey/t", node="a", listen=[endpoint]),
             BusSession(namespace="covey/t", node="b", connect=[endpoint])]
for session in with_ends:
    session.start()
with_ends[0].subscribe(Topic.EVENT, "*", lambda *sample: got.append(sample))
event = Event(vehicle="a", stamp_ns=5, severity="info", code="armed", sentence="Armed.")
for _ in range(500):
    with_ends[1].publish(Topic.EVENT, "b", event)
    time.sleep(0.01)
    if len(got) > 5:
        break
for session in with_ends:
    session.stop()
print(len(got) > 5)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=30.0, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "True\n", "")
