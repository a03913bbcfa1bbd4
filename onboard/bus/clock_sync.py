"""The clocks of the fleet for one process: tells its own, hears the others', and knows which host this is."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import time
from pathlib import Path

from msgspec.structs import replace

from onboard.bus.clock_offsets import Clocks
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import ClockMessage, Message, MocapPose, Order, StateMessage
from onboard.bus.topics import Topic

BEAT_S = 0.5
_PATIENCE_NS = 5_000_000_000

log = logging.getLogger("covey.clock")


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

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.clocks = Clocks(bus.node, host_id())
        self._waiting_ns: dict[str, int] = {}
        self._named: set[str] = set()

    def start(self) -> None:
        """Listen to the others; the bus must be open."""
        self._bus.subscribe(Topic.CLOCK, "*", self._receive)

    def state(self, node: str, message: StateMessage, received_ns: int) -> StateMessage:
        """A neighbour's state with its stamp on our clock; the very same where the clock is shared."""
        stamp_ns = self.clocks.own_ns(node, message.stamp_ns, received_ns)
        return message if stamp_ns == message.stamp_ns else replace(message, stamp_ns=stamp_ns)

    def pose(self, pose: MocapPose, received_ns: int) -> MocapPose | None:
        """A mocap's pose with its stamp on our clock; None while the clock of its source is not measured."""
        if not pose.source:
            return pose
        if not self.clocks.is_measured(pose.source):
            self._wait_for(pose.source, received_ns)
            return None
        stamp_ns = self.clocks.own_ns(pose.source, pose.stamp_ns, received_ns)
        return pose if stamp_ns == pose.stamp_ns else replace(pose, stamp_ns=stamp_ns)

    def _wait_for(self, source: str, now_ns: int) -> None:
        since_ns = self._waiting_ns.setdefault(source, now_ns)
        if source not in self._named and now_ns - since_ns > _PATIENCE_NS:
            self._named.add(source)
            log.warning(
                "Poses of node '%s' are not used: its clock is not known. Let it tell its clock (onboard/bus/"
                "clock_node.py), or leave 'source' empty if it runs on this computer.",
                source,
            )

    def order(self, order: Order, received_ns: int) -> Order:
        """An order with its stamp and its deadline on our clock."""
        stamp_ns = self.clocks.own_ns(order.node, order.stamp_ns, received_ns)
        if stamp_ns == order.stamp_ns:
            return order
        deadline_ns = order.deadline_ns and order.deadline_ns - order.stamp_ns + stamp_ns
        return replace(order, stamp_ns=stamp_ns, deadline_ns=deadline_ns)

    def beat(self) -> None:
        """Tell our clock; never blocks."""
        self._bus.publish(Topic.CLOCK, self._bus.node, self.clocks.message(time.monotonic_ns()))

    async def keep(self) -> None:
        """Start and beat until cancelled, for who has an event loop."""
        self.start()
        while True:
            self.beat()
            await asyncio.sleep(BEAT_S)

    def _receive(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        # the key says who speaks: nobody can tell a clock in another node's name by mistake
        if isinstance(message, ClockMessage) and message.node == name:
            self.clocks.hear(message, time.monotonic_ns())
