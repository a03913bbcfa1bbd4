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

A message that contradicts what is known of its sender may be false. So what is known stays in use
while messages agree with it. Beside it stands what the contradicting messages say. Once no message
has agreed with what is known for a while, and several in a row have agreed on something else, that
takes its place: the sender has probably started anew.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from onboard.bus.schema import ClockMessage, HeardClock

# Crystals are within 100 ppm; a host whose wall clock is being disciplined slews its monotonic
# clock too, by up to 500.
DRIFT = 1e-3
_UNKNOWN_DELAY_NS = 20_000_000  # assumed while nothing is measured
_SAME_CLOCK_NS = 500_000_000  # a stamp this far before its arrival may be of our own clock
_FORGET_NS = 60_000_000_000  # without a message, after which a node makes room for another one
_MAX_NODES = 64
_SILENT_NS = 1_800_000_000  # without a message that agrees: three are missing
_CONFIRMATIONS = 3  # messages in a row that agree on something new


@dataclass(frozen=True, slots=True)
class Peer:
    """One other node, and the bounds of its clock minus ours."""

    host: int
    sent_ns: int  # of its newest message, by its clock
    received_ns: int  # of its newest message, by ours
    low_ns: int  # lower bound of its clock minus ours
    low_at_ns: int  # when that bound was true, by ours
    high_ns: int | None = None  # upper bound; None while it has published no arrival of ours
    high_at_ns: int = 0  # when that bound was true, by ours
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
        low_ns = self.low_ns - _drift_ns(now_ns - self.low_at_ns)
        if self.high_ns is None:
            return low_ns, None

        high_ns = self.high_ns + _drift_ns(now_ns - self.high_at_ns)
        return low_ns, high_ns

    def raised_low(self, low_ns: int, now_ns: int) -> Peer:
        """Return the peer with a new lower bound, where that is the narrower one.

        Args:
            low_ns: what a message that arrives now shows.
            now_ns: our clock.
        Returns:
            the same peer or a changed copy.
        """
        known_low_ns, _ = self.bounds_ns(now_ns)
        if low_ns < known_low_ns:
            return self
        return replace(self, low_ns=low_ns, low_at_ns=now_ns)

    def lowered_high(self, high_ns: int, at_ns: int) -> Peer:
        """Return the peer with a new upper bound, where that is the narrower one.

        Args:
            high_ns: what their arrival time of our message shows.
            at_ns: when we sent that message, by our clock.
        Returns:
            the same peer or a changed copy.
        """
        _, known_high_ns = self.bounds_ns(at_ns)
        if known_high_ns is not None and high_ns > known_high_ns:
            return self
        return replace(self, high_ns=high_ns, high_at_ns=at_ns)

    def is_contradictory(self, now_ns: int) -> bool:
        """Whether no offset fulfils both bounds.

        A clock stood still (a suspended host), or a message is false.

        Args:
            now_ns: our clock.
        """
        low_ns, high_ns = self.bounds_ns(now_ns)
        return high_ns is not None and low_ns > high_ns


@dataclass(slots=True)
class Clocks:
    """The clocks of all nodes that were heard."""

    node: str  # our own name on the bus
    host: int  # our own host id
    restarts: int = 0  # nodes of which something else was believed, after a contradiction
    _peers: dict[str, Peer] = field(default_factory=dict)
    # what messages say that contradict what is known of a node, and how many in a row agree on it
    _contradictions: dict[str, tuple[Peer, int]] = field(default_factory=dict)
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
        if node == self.node:
            return
        if node not in self._peers and not self._has_room(received_ns):
            return

        # who says that it shares our clock has to be right about the time
        age_ns = received_ns - message.sent_ns
        if message.host == self.host and not 0 <= age_ns < _SAME_CLOCK_NS:
            return

        known = self._peers.get(node)
        merged = self._merged(known, message, received_ns)
        if merged is not None:
            self._peers[node] = merged
            self._contradictions.pop(node, None)
            return

        contradiction = self._contradiction(message, received_ns)
        if contradiction is None:
            return
        _, agreeing = contradiction
        self._contradictions[node] = contradiction

        is_known_silent = known is None or received_ns - known.received_ns > _SILENT_NS
        if agreeing >= _CONFIRMATIONS and is_known_silent:
            self.restarts += 1
            self._peers[node], _ = self._contradictions.pop(node)

    def _contradiction(self, message: ClockMessage, received_ns: int) -> tuple[Peer, int] | None:
        """Return what a message says that contradicts what is known, and how many agree on that.

        It agrees with the contradicting messages before it, or is the first of a new row. None for
        a message that contradicts itself.
        """
        earlier, count = self._contradictions.get(message.node, (None, 0))
        peer = self._merged(earlier, message, received_ns)
        if peer is None:
            count = 0
            peer = self._merged(None, message, received_ns)
        if peer is None:
            return None
        return peer, count + 1

    def _merged(self, peer: Peer | None, message: ClockMessage, received_ns: int) -> Peer | None:
        """Return what is known of a node with one more message of it.

        None if the message contradicts what was known.
        """
        # another boot is another clock
        if peer is not None and peer.host != message.host:
            return None

        low_ns = message.sent_ns - received_ns
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
            world_offset_ns = None
            if message.world_ns:
                world_offset_ns = message.world_ns - message.sent_ns
            peer = replace(
                peer,
                sent_ns=message.sent_ns,
                received_ns=received_ns,
                world_offset_ns=world_offset_ns,
            )

        for heard in message.heard:
            is_of_ours = heard.node == self.node and heard.host == self.host
            if is_of_ours and heard.sent_ns <= received_ns:
                peer = peer.lowered_high(heard.received_ns - heard.sent_ns, heard.sent_ns)

        if peer.is_contradictory(received_ns):
            return None
        return peer

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
            may_be_ours = 0 <= received_ns - stamp_ns < _SAME_CLOCK_NS
            if may_be_ours:
                return stamp_ns
            return received_ns - _UNKNOWN_DELAY_NS

        if peer.host == self.host:
            return min(stamp_ns, received_ns)
        if peer.high_ns is None:
            return received_ns - _UNKNOWN_DELAY_NS

        largest_offset_ns = peer.high_ns + _drift_ns(received_ns - peer.high_at_ns)
        return min(stamp_ns - largest_offset_ns, received_ns)

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

        low_ns, high_ns = peer.bounds_ns(now_ns)
        if high_ns is None:
            return None
        return (low_ns + high_ns) * 0.5e-9, (high_ns - low_ns) * 0.5e-9

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
