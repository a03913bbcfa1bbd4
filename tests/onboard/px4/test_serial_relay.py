"""The relay over a serial device, here a pseudo terminal: a stream of bytes in which packets begin
anywhere.
"""

from __future__ import annotations

import os
import select
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.px4.mavlink_relay import Ids, MavlinkRelay
from onboard.px4.packets import SENT, Packet
from onboard.px4.signing import Signer
from onboard.security.mavlink_key import AGENT_LINK_ID
from tests.onboard.px4.test_mavlink_relay import SYSTEM, now, until
from tests.onboard.px4.test_packets_and_signing import KEY


class Line:
    """A relay at one end of a serial line, and PX4's end of it."""

    def __init__(self, key: bytes | None, folder: Path) -> None:
        self.name = folder / "ttyACM0"
        self.plug_in()
        self.let_in: list[Packet] = []
        signer = None if key is None else Signer(key, AGENT_LINK_ID)
        self.relay = MavlinkRelay(
            f"serial://{self.name}:921600", Ids(SYSTEM, 191), signer, self.let_in.append
        )
        self.end = mavlink.MAVLink(None, SYSTEM, 1)
        if key is not None:
            self.end.signing.secret_key = key
            self.end.signing.sign_outgoing = True
            self.end.signing.timestamp = now()
            self.end.signing.link_id = 1
        self.relay.start()

    def beat(self) -> bytes:
        return bytes(mavlink.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3).pack(self.end))

    def command(self) -> None:
        self.relay.send(76, SENT["COMMAND_LONG"].layout.pack(*(0.0,) * 7, 400, SYSTEM, 1, 0))

    def receive(self) -> mavlink.MAVLink_message:
        """The next message that is no greeting."""
        while True:
            assert select.select([self.px4], [], [], 5.0)[0]
            for message in self.end.parse_buffer(bytearray(os.read(self.px4, 2048))) or ():
                if message.get_type() != "HEARTBEAT":
                    return message

    def plug_in(self) -> None:
        self.px4, self.device = os.openpty()
        tty.setraw(self.device)  # no echo of what PX4 sends before the relay opens it
        self.name.symlink_to(os.ttyname(self.device))

    def unplug(self) -> None:
        self.name.unlink()
        os.close(self.px4)

    def close(self) -> None:
        self.relay.stop()
        os.close(self.device)


@pytest.fixture(params=[None, KEY], ids=["unsigned", "signed"])
def line(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Line]:
    line = Line(request.param, tmp_path)
    yield line
    line.close()


def test_packets_are_found_in_a_stream_of_pieces_and_junk_and_answers_leave(line: Line) -> None:
    for junk in (b"", b"\xfd", b"\xfd\x09noise\xfe\x03", bytes(range(256))):
        wanted = len(line.let_in) + 10
        packet = line.beat()
        os.write(line.px4, junk + packet[:7])
        os.write(line.px4, packet[7:])
        # what looks like the start of a packet may wait for as many bytes as it says, and what has
        # waited too long on a busy machine is dropped
        until(lambda: len(line.let_in) >= wanted or not os.write(line.px4, line.beat()))  # noqa: B023  within this round
        until(lambda: not select.select([line.device], [], [], 0.0)[0])
    assert all(packet.is_signed == line.relay.is_signed for packet in line.let_in)
    line.command()
    assert line.receive().command == 400
    line.unplug()


def test_a_device_that_is_unplugged_or_takes_no_bytes_blocks_nobody(line: Line) -> None:
    os.write(line.px4, line.beat() + line.beat())
    until(lambda: len(line.let_in) == 2)
    for _ in range(2000):  # nobody reads: what does not fit is lost
        line.command()
    line.unplug()
    for _ in range(10):
        line.command()
    line.relay.stop()
    line.relay.stop()


def test_an_unplugged_device_costs_no_computing_time(line: Line) -> None:
    line.unplug()
    computed_s = time.process_time()
    time.sleep(1.0)
    assert time.process_time() - computed_s < 0.3


def test_a_device_that_is_plugged_in_again_is_opened_again(line: Line) -> None:
    os.write(line.px4, line.beat())
    until(lambda: len(line.let_in) == 1)

    line.unplug()
    os.close(line.device)
    time.sleep(0.5)
    line.plug_in()

    # what arrives before the device is open is lost
    until(lambda: len(line.let_in) >= 2 or not os.write(line.px4, line.beat()))
    line.command()
    assert line.receive().command == 400
