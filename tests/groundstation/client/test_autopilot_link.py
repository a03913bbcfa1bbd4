"""A link to PX4 over a serial cable, and lists of parameters that come with gaps."""

from __future__ import annotations

import contextlib
import os
import pty
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from groundstation.client.autopilot_link import AutopilotLink, LinkSilentError


class SerialPx4(threading.Thread):
    """An autopilot at the other end of a cable, with ten parameters of which four get lost in a
    list.
    """

    def __init__(self, descriptor: int, system_id: int) -> None:
        super().__init__(daemon=True)
        self._descriptor = descriptor
        self._mav = common.MAVLink(self, srcSystem=system_id, srcComponent=1)
        self.requested: list[int] = []

    def write(self, data: bytes) -> None:
        os.write(self._descriptor, data)

    def run(self) -> None:
        with contextlib.suppress(OSError):  # the cable is pulled
            while True:
                for message in self._mav.parse_buffer(os.read(self._descriptor, 4096)) or ():
                    self._answer(message)

    def beat(self) -> None:
        self._mav.heartbeat_send(2, 12, 29, 0, 3)

    def _answer(self, message: Any) -> None:
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                for index in (0, 1, 2, 5, 6, 9):
                    self._send(index)
            case "PARAM_REQUEST_READ":
                self.requested.append(message.param_index)
                self._send(message.param_index)
            case "HEARTBEAT":
                self.beat()

    def _send(self, index: int) -> None:
        value = struct.unpack("<f", struct.pack("<i", -index))[0] if index % 2 else 0.5 * index
        self._mav.param_value_send(f"P{index}".encode(), value, 6 if index % 2 else 9, 10, index)


@pytest.fixture
def cable() -> Iterator[tuple[int, str]]:
    master, slave = pty.openpty()
    yield master, os.ttyname(slave)
    os.close(
        slave
        # ends whoever reads at the other end, before somebody else's pipe gets the number of its
        # descriptor
    )
    for thread in threading.enumerate():
        if isinstance(thread, SerialPx4):
            thread.join(10.0)
            assert not thread.is_alive()
    os.close(master)


def test_a_vehicle_on_a_serial_cable_is_heard_and_another_one_is_named(
    cable: tuple[int, str],
) -> None:
    master, device = cable
    link = AutopilotLink(f"serial://{device}:921600", 5, is_own=True)
    SerialPx4(master, 6).beat()
    assert link.is_armed(0.2) is None
    assert link.other_system_id == 6
    SerialPx4(master, 5).beat()
    assert link.is_armed(5.0) is False
    link.stop()


def test_a_cable_that_is_pulled_is_a_silence_and_no_error() -> None:
    master, slave = pty.openpty()
    link = AutopilotLink(f"serial://{os.ttyname(slave)}:921600", 5, is_own=True)
    os.close(slave)
    os.close(master)

    assert link.is_armed(0.3) is None
    with pytest.raises(LinkSilentError):
        link.read_all()
    link.stop()


@pytest.mark.parametrize("endpoint", ["serial:///dev/null:57600", "serial:///dev/nowhere:57600"])
def test_what_is_no_serial_device_is_an_error_of_the_endpoint(endpoint: str) -> None:
    with pytest.raises(OSError, match=r"no serial device|No such file"):
        AutopilotLink(endpoint, 1, is_own=True)


@pytest.mark.parametrize("endpoint", ["serial:///dev/null", "serial:///dev/null:12345", "nowhere"])
def test_an_endpoint_that_is_written_wrongly_says_how(endpoint: str) -> None:
    with pytest.raises(ValueError, match="write it as"):
        AutopilotLink(endpoint, 1, is_own=True)


def test_parameters_that_get_lost_in_the_list_are_requested_one_by_one(
    cable: tuple[int, str],
) -> None:
    master, device = cable
    px4 = SerialPx4(master, 5)
    link = AutopilotLink(f"serial://{device}:921600", 5, is_own=True)
    px4.start()
    assert link.read_all() == {
        f"P{index}": -index if index % 2 else 0.5 * index for index in range(10)
    }
    assert set(px4.requested) == {3, 4, 7, 8}
    link.stop()


def test_first_message_of_a_process_is_mavlink_2() -> None:
    program = """
import socket
from groundstation.client.direct_mavlink import send_direct
px4 = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
px4.bind(("127.0.0.1", 0))
px4.setblocking(False)
send_direct(f"udpout://127.0.0.1:{px4.getsockname()[1]}", 1, "land", timeout_s=0.5)
begins = set()
try:
    while True:
        begins.add(px4.recv(300)[0])
except BlockingIOError:
    print(begins)
"""
    environment = {name: value for name, value in os.environ.items() if name != "MAVLINK20"}
    environment["PYTHONPATH"] = str(Path(__file__).parents[3])
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.stdout.strip() == str({0xFD}), done.stderr
