"""The relay over real sockets: who is heard, and what leaves."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.px4.mavlink_relay import Ids, MavlinkRelay
from onboard.px4.packets import SENT, Packet
from onboard.px4.signing import Signer
from onboard.security.mavlink_key import AGENT_LINK_ID, signing_time
from tests.onboard.px4.test_packets_and_signing import KEY, OTHER_KEY

SYSTEM = 3


def now() -> int:
    return signing_time(time.time_ns())


class Sender:
    """Somebody with a UDP port and ids."""

    def __init__(
        self, to: int, system_id: int = SYSTEM, component_id: int = 1, key: bytes | None = None
    ) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(3.0)
        self._to = ("127.0.0.1", to)
        self.end = mavlink.MAVLink(None, system_id, component_id)
        if key is not None:
            self.end.signing.secret_key = key
            self.end.signing.sign_outgoing = True
            self.end.signing.timestamp = now()
            self.end.signing.link_id = 1

    def beat(self) -> bytes:
        return self.send(
            bytes(mavlink.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3).pack(self.end))
        )

    def send(self, data: bytes) -> bytes:
        self.socket.sendto(data, self._to)
        return data

    def receive(self) -> mavlink.MAVLink_message:
        (message,) = self.end.parse_buffer(bytearray(self.socket.recv(2048)))
        return message


class Bench:
    """A relay and what it has let in."""

    def __init__(self, key: bytes | None = None) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        self.let_in: list[Packet] = []
        signer = None if key is None else Signer(key, AGENT_LINK_ID)
        self.relay = MavlinkRelay(
            f"udpin://127.0.0.1:{self.port}", Ids(SYSTEM, 191), signer, self.let_in.append
        )
        self.senders: list[Sender] = []

    def sender(self, **ids: int | bytes) -> Sender:
        self.senders.append(Sender(self.port, **ids))  # type: ignore[arg-type]
        return self.senders[-1]

    def command(self) -> None:
        self.relay.send(76, SENT["COMMAND_LONG"].layout.pack(*(0.0,) * 7, 400, SYSTEM, 1, 0))


def until(holds: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.005)


@pytest.fixture
def start() -> Iterator[Callable[..., Bench]]:
    benches: list[Bench] = []

    def started(key: bytes | None = None) -> Bench:
        benches.append(Bench(key))
        benches[-1].relay.start()
        return benches[-1]

    yield started
    for bench in benches:
        bench.relay.stop()
        bench.relay.stop()
        for sender in bench.senders:
            sender.socket.close()


def test_only_the_first_autopilot_with_the_right_ids_is_heard_and_all_else_is_counted(
    start,
) -> None:
    bench = start()
    relay = bench.relay
    px4 = bench.sender()
    outsider = bench.sender()
    other = bench.sender(system_id=9)
    ground = bench.sender(system_id=255, component_id=190)
    bench.command()  # nobody to send to yet
    other.beat()
    ground.beat()
    outsider.send(b"\xfd\x09junk")
    until(lambda: relay.refused.malformed == 1 and relay.refused.others == 2)
    assert (relay.other_system_id, relay.refused.count) == (9, 1)
    px4.beat()
    until(lambda: len(bench.let_in) == 1)
    for _ in range(3):
        outsider.beat()  # the same ids, from another port of this computer
    good = bytearray(outsider.beat())
    good[12] ^= 1
    px4.send(bytes(good))
    until(lambda: relay.refused.other_address == 4 and relay.refused.malformed == 2)
    assert relay.refused.newest == "malformed"
    px4.beat()
    until(lambda: len(bench.let_in) == 2)
    bench.command()
    assert px4.receive().command == 400
    outsider.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        outsider.socket.recv(100)


def test_a_damaged_heartbeat_names_no_other_autopilot(start) -> None:
    bench = start()
    relay = bench.relay
    px4 = bench.sender()
    damaged = bytearray(px4.beat())
    until(lambda: len(bench.let_in) == 1)

    damaged[5] = 73  # its system id
    px4.send(bytes(damaged))
    until(lambda: relay.refused.others + relay.refused.malformed == 1)
    assert relay.other_system_id is None


def test_a_relay_with_a_key_hears_what_is_freshly_signed_and_signs_what_it_sends(start) -> None:
    bench = start(KEY)
    px4 = bench.sender(key=KEY)
    relay = bench.relay
    bench.sender().beat()
    bench.sender(key=OTHER_KEY).beat()
    until(lambda: (relay.refused.unsigned, relay.refused.forged) == (1, 1))
    first = px4.beat()
    until(lambda: len(bench.let_in) == 1 and relay.is_signed)
    px4.send(first)
    until(lambda: relay.refused.old == 1)
    bench.command()
    message = px4.receive()
    while message.get_type() == "HEARTBEAT":
        message = px4.receive()
    assert message.get_signed()
    assert (message.command, message.get_link_id()) == (400, AGENT_LINK_ID)


def test_a_px4_that_has_just_started_is_greeted_so_that_its_time_catches_up(start) -> None:
    bench = start(KEY)
    px4 = bench.sender(key=KEY)
    # since its key was set it has heard nobody
    px4.end.signing.timestamp = now() - 90 * 24 * 3600 * 100_000
    px4.beat()
    greeting = px4.receive()
    assert (greeting.get_type(), greeting.get_signed(), greeting.get_srcComponent()) == (
        "HEARTBEAT",
        True,
        191,
    )
    assert not bench.let_in
    px4.beat()
    until(lambda: len(bench.let_in) == 1)
