"""Clock synchronisation of one process with the others on the bus.

The process publishes its monotonic clock and its computer's wall clock. It receives the clocks of
the others, and ``clock_offsets.py`` compares them. It converts the stamps of messages to its own
clock. Processes that share its clock publish the same host id.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import time
from pathlib import Path
from typing import TypeVar

from msgspec.structs import replace

from onboard.bus.clock_offsets import Clocks
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import (
    ClockMessage,
    Corrections,
    Event,
    Message,
    MocapPose,
    Order,
    PreflightReport,
    StateMessage,
    Telemetry,
    TickBatch,
)
from onboard.bus.topics import Topic

BEAT_S = 0.5  # from one clock message to the next
# stamps of a clock that is not measured count as ours in a record if they are this near the arrival
_NEAR_NS = 5_000_000_000
_WARN_AFTER_NS = 5_000_000_000  # time from the first unusable pose to the warning

log = logging.getLogger("covey.clock")
StampedMessage = StateMessage | Telemetry | PreflightReport | Event | MocapPose | Corrections
Stamped = TypeVar("Stamped", bound=StampedMessage)
FromNeighbour = TypeVar("FromNeighbour", bound=StateMessage | Telemetry)


def host_id() -> int:
    """Return the id of this host: equal for all processes that read the same monotonic clock.

    Returns:
        48 bits of a hash of the kernel's boot id and the time namespace.
    """
    boot = Path("/proc/sys/kernel/random/boot_id").read_text()
    try:
        namespace = os.stat("/proc/self/ns/time").st_ino
    except OSError:  # on a kernel without time namespaces all processes share one clock
        namespace = 0
    digest = hashlib.sha256(f"{boot}{namespace}".encode()).digest()
    return int.from_bytes(digest[:6], "little")


class ClockNode:
    """Keeps :attr:`clocks` up to date; call :meth:`beat` twice a second, from any thread.

    Args:
        bus: an open node; its messages arrive on a thread of the bus.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self.clocks = Clocks(bus.node, host_id())

        # source with an unknown clock and so unusable poses -> arrival of its first pose
        self._unknown_since_ns: dict[str, int] = {}
        self._warned: set[str] = set()  # sources with an unknown clock that a warning has named

    def start(self) -> None:
        """Subscribe to the others' clocks; the bus must be open."""
        self._bus.subscribe(Topic.CLOCK, "*", self._receive)

    def from_neighbour(self, node: str, message: FromNeighbour, received_ns: int) -> FromNeighbour:
        """Return a neighbour's state or telemetry with its stamp on our clock.

        Args:
            node: the neighbour.
            message: the message as received.
            received_ns: its arrival, by our clock.
        Returns:
            the same object if the clock is shared, otherwise a changed copy.
        """
        return self._on_own_clock(message, node, received_ns)

    def pose(self, pose: MocapPose, received_ns: int) -> MocapPose | None:
        """Return a mocap pose with its stamp on our clock.

        Args:
            pose: the pose as received.
            received_ns: its arrival, by our clock.
        Returns:
            the pose; None until the clock of its source is measured.
        """
        if not pose.source:  # the source shares our clock
            return pose
        if not self.clocks.is_measured(pose.source):
            self._warn_of_unknown_clock(pose.source, received_ns)
            return None

        return self._on_own_clock(pose, pose.source, received_ns)

    def corrections(self, message: Corrections, received_ns: int) -> Corrections:
        """Return corrections with their stamp on our clock.

        Args:
            message: the message as received.
            received_ns: its arrival, by our clock.
        Returns:
            the same object if the clock is shared, otherwise a changed copy.
        """
        return self._on_own_clock(message, message.source, received_ns)

    def any_message(self, name: str, message: Message, received_ns: int) -> Message:
        """Return any message with its stamps on our clock, as a record needs it.

        Until the clock of its sender is measured, a stamp within 5 s of the arrival counts as one
        of our own clock, and a message with any other stamp as 20 ms old.

        Args:
            name: vehicle, body or node that the message's topic names.
            message: the message as received.
            received_ns: its arrival, by our clock.
        Returns:
            the same object if it has no stamp or the clock is shared, otherwise a changed copy.
        """
        if isinstance(message, TickBatch):
            if not message.ticks:
                return message
            newest_ns = message.ticks[-1].stamp_ns
            offset_ns = self._record_ns(name, newest_ns, received_ns) - newest_ns
            if offset_ns == 0:
                return message
            ticks = [replace(tick, stamp_ns=tick.stamp_ns + offset_ns) for tick in message.ticks]
            return replace(message, ticks=tuple(ticks))

        # Neither ground truth nor a pose without a source names the node that stamps it.
        if not isinstance(message, StampedMessage):
            return message
        node = name
        if isinstance(message, MocapPose):
            node = message.source
        if not node:
            return message

        return _with_stamp(message, self._record_ns(node, message.stamp_ns, received_ns))

    def _record_ns(self, node: str, stamp_ns: int, received_ns: int) -> int:
        """Return a stamp of another node on our clock, see :meth:`any_message`."""
        if not self.clocks.is_measured(node) and abs(received_ns - stamp_ns) < _NEAR_NS:
            return stamp_ns
        return self.clocks.own_ns(node, stamp_ns, received_ns)

    def _on_own_clock(self, message: Stamped, node: str, received_ns: int) -> Stamped:
        return _with_stamp(message, self.clocks.own_ns(node, message.stamp_ns, received_ns))

    def _warn_of_unknown_clock(self, source: str, now_ns: int) -> None:
        """Log a warning once if the clock of a source has been unknown for a while."""
        since_ns = self._unknown_since_ns.setdefault(source, now_ns)
        if source in self._warned or now_ns - since_ns <= _WARN_AFTER_NS:
            return
        self._warned.add(source)
        log.warning(
            "Poses of node '%s' are not used, because it does not publish its clock. Let it "
            "publish its clock (onboard/bus/clock_sync.py), or leave 'source' empty if it runs on "
            "this computer.",
            source,
        )

    def order(self, order: Order, received_ns: int) -> Order:
        """Return an order with its stamp and its times on our clock.

        Args:
            order: the order as received.
            received_ns: its arrival, by our clock.
        Returns:
            the same object if the clock is shared, otherwise a changed copy.
        """
        stamp_ns = self.clocks.own_ns(order.node, order.stamp_ns, received_ns)
        if stamp_ns == order.stamp_ns:
            return order
        offset_ns = stamp_ns - order.stamp_ns

        deadline_ns = order.deadline_ns
        if deadline_ns != 0:  # 0: no deadline
            deadline_ns += offset_ns

        path = order.path
        if path is not None:
            path = replace(path, start_ns=path.start_ns + offset_ns)

        return replace(order, stamp_ns=stamp_ns, deadline_ns=deadline_ns, path=path)

    def beat(self) -> None:
        """Publish our clock; never blocks."""
        message = self.clocks.message(time.monotonic_ns(), time.time_ns())
        self._bus.publish(Topic.CLOCK, self._bus.node, message)

    async def keep(self) -> None:
        """Start, then publish the clock twice a second until cancelled. This runs on an event
        loop.
        """
        self.start()
        while True:
            self.beat()
            await asyncio.sleep(BEAT_S)

    def _receive(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        # the key names the sender; a message that claims to be from another node is not used
        if isinstance(message, ClockMessage) and message.node == name:
            self.clocks.hear(message, time.monotonic_ns())


def _with_stamp(message: Stamped, stamp_ns: int) -> Stamped:
    """Return a message with this stamp: the same object if it has it already."""
    if stamp_ns == message.stamp_ns:
        return message
    return replace(message, stamp_ns=stamp_ns)
