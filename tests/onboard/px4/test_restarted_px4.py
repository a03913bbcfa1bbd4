"""A PX4 that has restarted: the link counts it, and from its first message on knows no origin."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.autopilot import Snapshot
from onboard.px4.mavsdk_link import Px4Link

_SYSTEM = 9
_ORIGIN = (473977060, 85455408, 489400)  # 1e-7 degrees and mm
_OTHER = (473976790, 85455408, 489400)  # 3 m further south


class _Wire:
    """A link, and the socket of the PX4 that it hears."""

    def __init__(self, link: Px4Link, port: int, px4: socket.socket) -> None:
        self.link = link
        self._to = ("127.0.0.1", port)
        self._px4 = px4
        self._mav = mavlink.MAVLink(None, _SYSTEM, 1)

    def position(self, boot_ms: int) -> Snapshot:
        """Have PX4 send its local position, and return the snapshot with it."""
        before_ns = self.link.snapshot().local_position_ns
        message = self._mav.local_position_ned_encode(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._send(message)
        return self._until(lambda snapshot: snapshot.local_position_ns > before_ns)

    def attitude(self, boot_ms: int) -> Snapshot:
        """Have PX4 send its attitude, and return the snapshot with it."""
        before_ns = self.link.snapshot().attitude_ns
        message = self._mav.attitude_quaternion_encode(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._send(message)
        return self._until(lambda snapshot: snapshot.attitude_ns > before_ns)

    def origin(self, place: tuple[int, int, int]) -> None:
        """Have PX4 send its global origin, and wait until the link knows it."""
        self._send(self._mav.gps_global_origin_encode(*place))
        latitude_deg = place[0] * 1e-7
        self._until(
            lambda snapshot: (
                snapshot.global_origin is not None
                and snapshot.global_origin[0] == pytest.approx(latitude_deg, abs=1e-9)
            )
        )

    def _send(self, message: mavlink.MAVLink_message) -> None:
        self._px4.sendto(message.pack(self._mav), self._to)

    def _until(self, accept: Callable[[Snapshot], bool]) -> Snapshot:
        end_s = time.monotonic() + 10.0
        while not accept(self.link.snapshot()):
            assert time.monotonic() < end_s
            time.sleep(0.005)
        return self.link.snapshot()


@pytest.fixture
def wire() -> Iterator[_Wire]:
    """A link that knows the origin of a PX4 that has run for ten minutes."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = Px4Link(f"udpin://127.0.0.1:{port}", _SYSTEM)
    link.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as px4:
            found = _Wire(link, port, px4)
            found.attitude(600_000)
            found.origin(_ORIGIN)
            yield found
    finally:
        link.stop()


def test_its_first_local_position_is_not_counted_from_the_origin_of_before(wire: _Wire) -> None:
    """PX4 sends local positions a second before its first attitude and its new origin."""
    assert wire.position(600_020).global_origin is not None
    assert wire.position(400).global_origin is None


def test_the_origin_that_it_tells_after_the_restart_stays(wire: _Wire) -> None:
    wire.position(400)
    wire.origin(_OTHER)
    assert wire.attitude(2_400).global_origin is not None
    assert wire.position(2_420).global_origin is not None


def test_messages_that_overtake_each_other_are_no_restart(wire: _Wire) -> None:
    snapshot = wire.position(599_600)
    assert snapshot.global_origin is not None
    assert snapshot.restarts == 0


def test_a_restart_is_counted_although_its_clock_has_caught_up_since(wire: _Wire) -> None:
    assert wire.attitude(600_020).restarts == 0
    assert wire.position(400).restarts == 1
    assert wire.attitude(700_000).restarts == 1
    assert wire.position(300).restarts == 2
