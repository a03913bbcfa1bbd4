"""The clocks of the fleet for one process: tells its own, hears the others', and knows which host this is."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path

from onboard.bus.clocks import Clocks
from onboard.bus.codec import Malformed
from onboard.bus.schema import ClockMessage, Message
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic


def host_id() -> int:
    """A number that all processes share that see the same monotonic clock: one kernel, one boot, one time namespace."""
    boot = Path("/proc/sys/kernel/random/boot_id").read_text()
    try:
        space = os.stat("/proc/self/ns/time").st_ino
    except OSError:  # a kernel without time namespaces has one time
        space = 0
    return int.from_bytes(hashlib.sha256(f"{boot}{space}".encode()).digest()[:6], "little")


class ClockNode:
    """Keeps ``clocks`` fed; :meth:`beat` twice a second, from any thread. Callbacks come on a bus thread."""

    def __init__(self, bus: BusSession) -> None:
        self._bus = bus
        self.clocks = Clocks(bus.node, host_id())

    def start(self) -> None:
        """Listen to the others; the bus must be open."""
        self._bus.subscribe(Topic.CLOCK, "*", self._receive)

    def beat(self) -> None:
        """Tell our clock; never blocks."""
        self._bus.publish(Topic.CLOCK, self._bus.node, self.clocks.message(time.monotonic_ns()))

    def _receive(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        # the key says who speaks: nobody can tell a clock in another node's name by mistake
        if isinstance(message, ClockMessage) and message.node == name:
            self.clocks.hear(message, time.monotonic_ns())
