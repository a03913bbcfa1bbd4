"""Interest on the bus: what nobody follows does not travel; a node that hangs holds nobody up."""

from __future__ import annotations

import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from onboard.bus.schema import Event, TickBatch
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from tests.onboard.bus.sessions import until

_SENTENCE_BYTES = 2000
BATCH = TickBatch(vehicle="x" * 50_000, boot_id=1, sequence=1, ticks=())


class Relay:
    """A TCP relay between two nodes that counts what flows from the one that listens to the one
    that connects.
    """

    def __init__(self, target: int) -> None:
        self.bytes_to_client = 0
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"
        self._is_open = True
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._is_open = False
        self._thread.join(5.0)
        self._listener.close()

    def _serve(self) -> None:
        other_end: dict[socket.socket, socket.socket] = {}
        servers: set[socket.socket] = set()
        while self._is_open:
            for ready in select.select([self._listener, *other_end], [], [], 0.1)[0]:
                if ready is self._listener:
                    client = ready.accept()[0]
                    server = socket.create_connection(("127.0.0.1", self._target))
                    other_end |= {client: server, server: client}
                    servers.add(server)
                    continue
                data = ready.recv(65536)
                if not data:
                    for end in (other_end.pop(ready), ready):
                        other_end.pop(end, None)
                        end.close()
                    continue
                if ready in servers:
                    self.bytes_to_client += len(data)
                other_end[ready].sendall(data)
        for end in other_end:
            end.close()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def talker() -> Iterator[tuple[BusSession, int]]:
    port = free_port()
    session = BusSession(namespace="covey/i", node="talker", listen=[f"tcp/127.0.0.1:{port}"])
    session.start()
    yield session, port
    session.stop()


def say(talker: BusSession, name: str) -> None:
    text = "x" * _SENTENCE_BYTES
    talker.publish(
        Topic.EVENT, name, Event(vehicle=name, stamp_ns=1, severity="info", code="c", sentence=text)
    )


def test_a_topic_that_is_not_followed_is_not_sent(talker: tuple[BusSession, int]) -> None:
    session, port = talker
    relay = Relay(port)
    listener = BusSession(namespace="covey/i", node="listener", connect=[relay.endpoint])
    listener.start()
    try:
        heard: list[str] = []

        def hears(name: str) -> Callable[[], bool]:
            def asked() -> bool:
                say(session, name)
                listener.deliver()
                return name in heard

            return asked

        def hear(_topic: Topic, name: str, _message: Any) -> None:
            heard.append(name)

        listener.follow(Topic.EVENT, {"near"}, hear)
        assert until(hears("near"))
        before = relay.bytes_to_client
        for _ in range(50):
            say(session, "far")
        time.sleep(0.3)
        listener.deliver()
        assert relay.bytes_to_client - before < 5 * _SENTENCE_BYTES
        assert "far" not in heard

        listener.follow(Topic.EVENT, {"far"}, hear)  # the one goes, the other comes
        assert until(hears("far"))
        time.sleep(0.2)
        listener.deliver()
        heard.clear()
        before = relay.bytes_to_client
        for _ in range(50):
            say(session, "near")
        time.sleep(0.3)
        listener.deliver()
        assert relay.bytes_to_client - before < 5 * _SENTENCE_BYTES
        assert "near" not in heard
        listener.follow(Topic.EVENT, (), hear)
        listener.follow(Topic.EVENT, (), hear)
        listener.deliver()
    finally:
        listener.stop()
        relay.close()


def test_what_is_collected_waits_and_of_too_much_the_newest_is_kept(
    talker: tuple[BusSession, int],
) -> None:
    session, port = talker
    listener = BusSession(namespace="covey/i", node="listener", connect=[f"tcp/127.0.0.1:{port}"])
    listener.start()
    try:
        heard: list[int] = []

        def hear(_topic: Topic, _name: str, message: Any) -> None:
            assert threading.current_thread() is threading.main_thread()
            heard.append(message.stamp_ns)

        def tell(number: int) -> None:
            event = Event(vehicle="mav0", stamp_ns=number, severity="info", code="c", sentence="")
            session.publish(Topic.EVENT, "mav0", event)

        listener.collect(Topic.EVENT, "*", hear)

        def hears() -> bool:
            tell(-1)
            listener.deliver()
            return bool(heard)

        assert until(hears)
        for number in range(5000):
            tell(number)
        time.sleep(0.5)
        heard.clear()
        listener.deliver()
        assert heard == sorted(heard)
        assert heard[-1] == 4999
        assert 500 < len(heard) <= 1000
        heard.clear()
        listener.deliver()
        assert heard == []
    finally:
        listener.stop()
        listener.deliver()


_HANGING = """
import sys, time
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
session = BusSession(namespace="covey/i", node="hanging", connect=[sys.argv[1]])
session.start()
session.subscribe(Topic.EVENT, "*", lambda *sample: None)
session.subscribe(Topic.TICK, "*", lambda *sample: print("heard", flush=True))
time.sleep(120)
"""


@pytest.fixture
def hanging(talker: tuple[BusSession, int]) -> Iterator[subprocess.Popen[str]]:
    """A node in a process of its own that has heard the talker and then was stopped.

    It asks for events first: whoever hears its ticks has heard of both subscriptions.
    """
    session, port = talker
    command = [sys.executable, "-c", _HANGING, f"tcp/127.0.0.1:{port}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            heard = threading.Event()
            assert process.stdout is not None
            line = process.stdout.readline

            def hear() -> None:
                if line():
                    heard.set()

            threading.Thread(target=hear, daemon=True).start()

            def listens() -> bool:
                session.publish(Topic.TICK, "talker", BATCH)
                return heard.is_set()

            assert until(listens, 30.0)
            process.send_signal(signal.SIGSTOP)
            yield process
        finally:
            process.kill()


def publish_many(session: BusSession) -> float:
    """The longest that one of many batches took, in seconds."""
    longest_s = 0.0
    for _ in range(200):  # 10 MB, more than all buffers on the way hold
        before = time.monotonic()
        session.publish(Topic.TICK, "talker", BATCH)
        longest_s = max(longest_s, time.monotonic() - before)
    return longest_s


def test_a_node_that_hangs_does_not_hold_up_the_publisher(
    talker: tuple[BusSession, int], hanging: subprocess.Popen[str]
) -> None:
    assert publish_many(talker[0]) < 0.5  # one message that waits for its place costs a second


def test_an_event_that_waits_for_a_hanging_node_holds_up_no_other_message(
    talker: tuple[BusSession, int], hanging: subprocess.Popen[str]
) -> None:
    session, _ = talker
    waited_s: list[float] = []

    def insist() -> None:
        for _ in range(30_000):
            before = time.monotonic()
            say(session, "talker")
            waited_s.append(time.monotonic() - before)
            if waited_s[-1] > 0.5:
                return

    worker = threading.Thread(target=insist, daemon=True)
    worker.start()
    longest_s = 0.0
    small = TickBatch(vehicle="x" * 4000, boot_id=1, sequence=1, ticks=())
    while worker.is_alive():
        before = time.monotonic()
        session.publish(Topic.TICK, "talker", small)
        longest_s = max(longest_s, time.monotonic() - before)
        time.sleep(0.002)
    assert max(waited_s) > 0.5, "the events never had to wait, so nothing was tested"
    assert longest_s < 0.5
