"""A link to PX4, and the socket of a PX4 that sends to it what a test says."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.autopilot import Snapshot
from onboard.px4.mavsdk_link import Px4Link

_SYSTEM = 9


class Wire:
    """A started link, and the socket of the PX4 that it hears."""

    def __init__(self, link: Px4Link, port: int, px4: socket.socket) -> None:
        self.link = link
        self.mav = mavlink.MAVLink(None, _SYSTEM, 1)
        self._to = ("127.0.0.1", port)
        self._px4 = px4

    def send(self, message: mavlink.MAVLink_message) -> None:
        """Have PX4 send a message."""
        self._px4.sendto(message.pack(self.mav), self._to)

    def attitude(self, boot_ms: int) -> Snapshot:
        """Have PX4 send its attitude, and return the snapshot with it.

        The link has then received all messages that were sent before, too.
        """
        before_ns = self.link.snapshot().attitude_ns
        self.send(self.mav.attitude_quaternion_encode(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        return self.until(lambda snapshot: snapshot.attitude_ns > before_ns)

    def until(self, accept: Callable[[Snapshot], bool]) -> Snapshot:
        """Return the first snapshot that is accepted."""
        end_s = time.monotonic() + 10.0
        while not accept(self.link.snapshot()):
            assert time.monotonic() < end_s
            time.sleep(0.005)
        return self.link.snapshot()


@contextmanager
def wired() -> Iterator[Wire]:
    """Start a link at a free port, and stop it at the end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = Px4Link(f"udpin://127.0.0.1:{port}", _SYSTEM)
    link.start()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as px4:
            yield Wire(link, port, px4)
    finally:
        link.stop()
