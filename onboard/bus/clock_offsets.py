"""Offsets of other hosts' monotonic clocks from ours, measured over the bus. Pure: times are passed
in.

Twice a second every node publishes its clock, and the arrival times of the others' clock messages.
A message sent at t1 by their clock that arrives at t2 by ours shows that their clock is ahead by at
least t1 - t2, since nothing arrives before it is sent. The arrival times that they publish of our
messages bound it from above in the same way. Both bounds are true whatever the delays are, however
different in the two directions; the quickest messages of each direction make them narrow. A bound
widens as it ages, because clocks drift apart. Nothing is averaged, and no wall clock takes part, so
a wall clock that jumps changes nothing.

Each node also tells what time it is in the world, by its own computer. That is only compared, for
starts at a time of day; no stamp is converted by it.

Nodes that share a clock (one kernel, one boot, one time namespace) know that from each other's host
id.

A message that contradicts what is known of its sender may be false. What is known stays, and is
used, while messages agree with it; when none has for a while, and several in a row agree on
something else, that is believed instead.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from onboard.bus.schema import ClockMessage, HeardClock

# Crystals are within 100 ppm; a host whose wall clock is being disciplined slews its monotonic
# clock too, by up to 500.
DRIFT = 1e-3
_UNKNOWN_DELAY_NS = 20_000_000  # assumed while nothing is measured
_SAME_CLOCK_NS = 500_000_000
_FORGET_NS = 60_000_000_000
_MAX_NODES = 64
_SILENT_NS = 1_800_000_000  # without a message that agrees: three are missing
_CONFIRMATIONS = 3  # messages in a row that agree on something new


@dataclass(frozen=True, slots=True)
class Peer:
    """One other node: their clock minus ours lies between ``low_ns`` and ``high_ns``, each true at
    its own time.
    """

    host: int
    sent_ns: int  # of its newest message, by its clock
    received_ns: int  # of its newest message, by ours
    low_ns: int
    low_at_ns: int
    high_ns: int | None = None  # None while they have not published an arrival time of ours
    high_at_ns: int = 0
    # the world's clock, as its computer has it, minus its monotonic clock; None: not told
    world_offset_ns: int | None = None

    def bounds_ns(self, now_ns: int) -> tuple[int, int | None]:
        """Return both bounds, widened for their age.

        Args:
            now_ns: our clock.
        Returns:
            lower and upper bound [ns] of their clock minus ours; the upper one is None while it is
            not measured.
        """
        low = self.low_ns - _drift_ns(now_ns - self.low_at_ns)
        return low, None if self.high_ns is None else self.high_ns + _drift_ns(
            now_ns - self.high_at_ns
        )

    def raised_low(self, low_ns: int, now_ns: int) -> Peer:
        """Return the peer with a new lower bound, where that is the narrower one.

        Args:
            low_ns: what a message that arrives now shows.
            now_ns: our clock.
        Returns:
            the same peer or a changed copy.
        """
        return (
            replace(self, low_ns=low_ns, low_at_ns=now_ns)
            if low_ns >= self.bounds_ns(now_ns)[0]
            else self
        )

    def lowered_high(self, high_ns: int, at_ns: int) -> Peer:
        """Return the peer with a new upper bound, where that is the narrower one.

        Args:
            high_ns: what their arrival time of our message shows.
            at_ns: when we sent that message, by our clock.
        Returns:
            the same peer or a changed copy.
        """
        known = self.bounds_ns(at_ns)[1]
        return (
            self
            if known is not None and high_ns > known
            else replace(self, high_ns=high_ns, high_at_ns=at_ns)
        )

    def is_contradictory(self, now_ns: int) -> bool:
        """Whether both bounds exclude each other: a clock stood still (a suspended host), or a
        message is false.

        Args:
            now_ns: our clock.
        Returns:
            True if no offset fulfils both.
        """
        low, high = self.bounds_ns(now_ns)
        return high is not None and low > high


@dataclass(slots=True)
class Clocks:
    """The clocks of all nodes that were heard."""

    node: str  # our own name on the bus
    host: int  # our own host id
    restarts: int = 0  # nodes of which something else was believed, after a contradiction
    _peers: dict[str, Peer] = field(default_factory=dict)
    # what contradicts, and how many agree on it
    _doubtful: dict[str, tuple[Peer, int]] = field(default_factory=dict)
    _sequence: int = 0

    def message(self, now_ns: int, world_ns: int = 0) -> ClockMessage:
        """Make the next clock message of this node.

        Args:
            now_ns: our clock.
            world_ns: the world's clock at the same time, since 1970; 0: not told.
        Returns:
            the message to publish at once.
        """
        self._sequence += 1
        heard = tuple(
            HeardClock(name, peer.host, peer.sent_ns, peer.received_ns)
            for name, peer in tuple(self._peers.items())
            if peer.host != self.host and now_ns - peer.received_ns < _FORGET_NS
        )
        return ClockMessage(
            node=self.node,
            host=self.host,
            sequence=self._sequence,
            sent_ns=now_ns,
            heard=heard,
            world_ns=world_ns,
        )

    def hear(self, message: ClockMessage, received_ns: int) -> None:
        """Take a clock message of another node.

        Args:
            message: as received; our own is ignored.
            received_ns: its arrival, by our clock.
        """
        node = message.node
        if node == self.node or (node not in self._peers and not self._has_room(received_ns)):
            return
        if message.host == self.host and not 0 <= received_ns - message.sent_ns < _SAME_CLOCK_NS:
            return  # not by our clock
        peer = self._peers.get(node)
        merged = self._merged(peer, message, received_ns)
        if merged is not None:
            self._peers[node] = merged
            self._doubtful.pop(node, None)
            return
        doubtful, count = self._doubtful.get(node, (None, 0))
        further = self._merged(doubtful, message, received_ns)
        if further is None:
            further, count = self._merged(None, message, received_ns), 0
        if further is None:
            return  # contradicts itself
        self._doubtful[node] = further, count + 1
        if count + 1 >= _CONFIRMATIONS and (
            peer is None or received_ns - peer.received_ns > _SILENT_NS
        ):
            self.restarts += 1
            self._peers[node] = further
            del self._doubtful[node]

    def _merged(self, peer: Peer | None, message: ClockMessage, received_ns: int) -> Peer | None:
        """Return what is known with one more message of the node; None if that contradicts what was
        known.
        """
        low_ns = message.sent_ns - received_ns
        if peer is not None and peer.host != message.host:
            return None  # another boot is another clock
        if peer is None or message.host == self.host:
            peer = Peer(
                host=message.host,
                sent_ns=message.sent_ns,
                received_ns=received_ns,
                low_ns=low_ns,
                low_at_ns=received_ns,
            )
        else:
            peer = peer.raised_low(low_ns, received_ns)
        if message.sent_ns >= peer.sent_ns:
            world_offset_ns = message.world_ns - message.sent_ns if message.world_ns else None
            peer = replace(
                peer,
                sent_ns=message.sent_ns,
                received_ns=received_ns,
                world_offset_ns=world_offset_ns,
            )
        for heard in message.heard:
            if heard.node == self.node and heard.host == self.host and heard.sent_ns <= received_ns:
                peer = peer.lowered_high(heard.received_ns - heard.sent_ns, heard.sent_ns)
        return None if peer.is_contradictory(received_ns) else peer

    def _has_room(self, now_ns: int) -> bool:
        """Whether one more node can be remembered; one that was silent for a minute makes room."""
        if len(self._peers) >= _MAX_NODES:
            oldest, peer = min(tuple(self._peers.items()), key=lambda item: item[1].received_ns)
            if now_ns - peer.received_ns < _FORGET_NS:
                return False
            self._peers.pop(oldest, None)  # another thread may have been as quick
        return True

    def own_ns(self, node: str, stamp_ns: int, received_ns: int) -> int:
        """Convert a stamp of another node to our clock.

        While nothing is known of the node, a stamp shortly before its arrival counts as one of our
        own clock; any other is replaced by its arrival, less a usual delay.

        Args:
            node: whose clock made the stamp.
            stamp_ns: by that clock.
            received_ns: arrival of the message, by our clock.
        Returns:
            the earliest time [ns] by our clock that the stamp can mean, and never after its
            arrival.
        """
        peer = self._peers.get(node)
        if peer is None:
            is_near = 0 <= received_ns - stamp_ns < _SAME_CLOCK_NS
            return stamp_ns if is_near else received_ns - _UNKNOWN_DELAY_NS
        if peer.host == self.host:
            return min(stamp_ns, received_ns)
        if peer.high_ns is None:
            return received_ns - _UNKNOWN_DELAY_NS
        return min(stamp_ns - peer.high_ns - _drift_ns(received_ns - peer.high_at_ns), received_ns)

    def is_measured(self, node: str) -> bool:
        """Whether stamps of a node can be converted to our clock.

        Args:
            node: its name on the bus.
        Returns:
            True if it shares our clock or its offset is bounded on both sides.
        """
        peer = self._peers.get(node)
        return peer is not None and (peer.host == self.host or peer.high_ns is not None)

    def offset_s(self, node: str, now_ns: int) -> tuple[float, float] | None:
        """Return the offset of a node's clock.

        Args:
            node: its name on the bus.
            now_ns: our clock.
        Returns:
            by how much [s] their clock is ahead of ours, and the largest error [s] of that; None
            while not measured.
        """
        peer = self._peers.get(node)
        if peer is None:
            return None
        if peer.host == self.host:
            return 0.0, 0.0
        low, high = peer.bounds_ns(now_ns)
        return None if high is None else ((low + high) * 0.5e-9, (high - low) * 0.5e-9)

    def world_ahead_s(
        self, node: str, now_ns: int, world_offset_ns: int
    ) -> tuple[float, float] | None:
        """Compare the world's clock of a node's computer with that of ours.

        Args:
            node: its name on the bus.
            now_ns: our clock.
            world_offset_ns: the world's clock, as our computer has it, minus our clock.
        Returns:
            by how much [s] theirs is ahead of ours, and the largest error [s] of that; None while
            it is not measured, and for a node that does not tell it.
        """
        peer = self._peers.get(node)
        offset = self.offset_s(node, now_ns)
        if peer is None or peer.world_offset_ns is None or offset is None:
            return None
        ahead_s, error_s = offset
        return ahead_s + (peer.world_offset_ns - world_offset_ns) * 1e-9, error_s

    def bounds_s(self, now_ns: int) -> dict[str, float]:
        """Return the largest error of each other host's offset.

        Args:
            now_ns: our clock.
        Returns:
            node -> half the distance [s] of its bounds; infinite while not measured.
        """
        errors = {}
        for name, peer in tuple(self._peers.items()):
            if peer.host != self.host and now_ns - peer.received_ns < _FORGET_NS:
                offset = self.offset_s(name, now_ns)
                errors[name] = float("inf") if offset is None else offset[1]
        return errors


def _drift_ns(age_ns: int) -> int:
    return int(DRIFT * max(0, age_ns))
