"""Offsets of other hosts' monotonic clocks from ours, measured over the bus. Pure.

Twice a second every node publishes a clock message: its present time, and the times at which it
received the last clock message of every other node. All times are by its own clock. Suppose another
node sends a message at t1 by its clock, and the message arrives at t2 by our clock. Nothing arrives
before it is sent, so the other clock is ahead of ours by at least t1 - t2. In the same way, the
arrival times of our messages, which the other node publishes, bound this offset from above. Both
bounds hold for any delays, even if the two directions differ. A bound widens as it ages, because
clocks drift apart.

Each node also publishes its computer's wall clock. It is compared with ours for flights that start
at a time of day, and is never used to convert stamps.

Nodes that share a clock (one kernel, one boot, one time namespace) have equal host ids.

A message that contradicts the known bounds of its sender may be false. So the known bounds stay in
use while messages agree with them, and the contradicting messages form a second set of bounds. If
no message agrees with the known bounds for a while, and several in a row agree with the second set,
the second set replaces the known bounds. In this case, the sender has probably restarted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from onboard.bus.schema import ClockMessage, HeardClock

# Crystals are within 100 ppm. While NTP corrects a host's wall clock, it slews the monotonic clock
# as well, by up to 500 ppm.
DRIFT = 1e-3  # largest change of the difference of two clocks, per elapsed time
_UNKNOWN_DELAY_NS = 20_000_000  # assumed delay of a message until a delay is measured
# a stamp at most this long before its arrival may come from our own clock
_SAME_CLOCK_NS = 500_000_000
_FORGET_NS = 60_000_000_000  # a node that is silent for this time may be forgotten
_MAX_NODES = 300  # 256 vehicles, as many as a record may have, and grounds, relays and viewers
# After this time without a message that agrees with them, the known bounds may be replaced. By then
# three messages are missing.
_SILENT_NS = 1_800_000_000
_CONFIRMATIONS = 3  # contradicting messages in a row that must agree with each other


@dataclass(frozen=True, slots=True)
class Peer:
    """One other node, and the bounds of its clock minus ours."""

    host: int  # host id: equal for nodes that share a clock
    sent_ns: int  # when it sent its newest message, by its own clock
    received_ns: int  # when that message arrived, by our clock
    low_ns: int  # lower bound of its clock minus ours
    low_at_ns: int  # when that bound was measured, by our clock
    # upper bound; None while the node has published no arrival of one of our messages
    high_ns: int | None = None
    high_at_ns: int = 0  # when that bound was measured, by our clock
    # its computer's wall clock minus its monotonic clock; None: not published
    world_offset_ns: int | None = None

    def bounds_ns(self, now_ns: int) -> tuple[int, int | None]:
        """Return both bounds, widened for their age.

        Args:
            now_ns: our clock.
        Returns:
            lower and upper bound [ns] of their clock minus ours; the upper bound is None until it
            is measured.
        """
        low_ns = self.low_ns - _drift_ns(now_ns - self.low_at_ns)
        if self.high_ns is None:
            return low_ns, None

        high_ns = self.high_ns + _drift_ns(now_ns - self.high_at_ns)
        return low_ns, high_ns

    def raised_low(self, low_ns: int, now_ns: int) -> Peer:
        """Return the peer with a new lower bound if this bound is higher than the known one.

        Args:
            low_ns: bound given by a message that arrives now.
            now_ns: our clock.
        Returns:
            the same peer or a changed copy.
        """
        known_low_ns, _ = self.bounds_ns(now_ns)
        if low_ns < known_low_ns:
            return self
        return replace(self, low_ns=low_ns, low_at_ns=now_ns)

    def lowered_high(self, high_ns: int, at_ns: int) -> Peer:
        """Return the peer with a new upper bound if this bound is lower than the known one.

        Args:
            high_ns: bound given by the time at which one of our messages reached it.
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

        If so, a clock stood still (a suspended host), or a message is false.

        Args:
            now_ns: our clock.
        """
        low_ns, high_ns = self.bounds_ns(now_ns)
        return high_ns is not None and low_ns > high_ns


@dataclass(slots=True)
class Clocks:
    """The clocks of all nodes that we have heard."""

    node: str  # our own name on the bus
    host: int  # our own host id
    restarts: int = 0  # how often the bounds of a node were replaced after a contradiction
    _peers: dict[str, Peer] = field(default_factory=dict)
    # node -> the peer according to messages that contradict the known bounds, and how many of these
    # messages in a row agree with each other
    _contradictions: dict[str, tuple[Peer, int]] = field(default_factory=dict)
    _sequence: int = 0

    def message(self, now_ns: int, world_ns: int = 0) -> ClockMessage:
        """Make the next clock message of this node.

        Args:
            now_ns: our clock.
            world_ns: our computer's wall clock at the same time, since 1970; 0: not published.
        Returns:
            the message to publish at once.
        """
        self._sequence += 1
        heard = []
        for name, peer in tuple(self._peers.items()):
            is_recent = now_ns - peer.received_ns < _FORGET_NS
            if is_recent and peer.host != self.host:
                heard.append(HeardClock(name, peer.host, peer.sent_ns, peer.received_ns))
        return ClockMessage(
            node=self.node,
            host=self.host,
            sequence=self._sequence,
            sent_ns=now_ns,
            heard=tuple(heard),
            world_ns=world_ns,
        )

    def hear(self, message: ClockMessage, received_ns: int) -> None:
        """Take a clock message of another node.

        Args:
            message: the message as received; our own is ignored.
            received_ns: its arrival, by our clock.
        """
        node = message.node
        if node == self.node:
            return
        if node not in self._peers and not self._make_room(received_ns):
            return

        # if a node claims to share our clock, its sending time must be plausible by our clock
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
        peer, agreeing = contradiction
        self._contradictions[node] = contradiction

        is_known_silent = known is None or received_ns - known.received_ns > _SILENT_NS
        if agreeing >= _CONFIRMATIONS and is_known_silent:
            self.restarts += 1
            self._peers[node] = peer
            self._contradictions.pop(node)

    def _contradiction(self, message: ClockMessage, received_ns: int) -> tuple[Peer, int] | None:
        """Return the peer according to a contradicting message, and how many messages agree on it.

        The message either agrees with the earlier contradicting messages, or is the first of a new
        series. Return None for a message that contradicts itself.
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
        """Return a peer with one more of its messages taken into account.

        Return None if the message contradicts the peer.
        """
        # another boot means another clock
        if peer is not None and peer.host != message.host:
            return None

        # for a shared clock, earlier bounds are not needed
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
            is_our_message = heard.node == self.node and heard.host == self.host
            if is_our_message and heard.sent_ns <= received_ns:
                peer = peer.lowered_high(heard.received_ns - heard.sent_ns, heard.sent_ns)

        if peer.is_contradictory(received_ns):
            return None
        return peer

    def _make_room(self, now_ns: int) -> bool:
        """Return whether one more node can be remembered.

        If the table is full, a node that was silent for a minute is forgotten.
        """
        if len(self._peers) >= _MAX_NODES:
            peers = dict(self._peers)
            oldest = min(peers, key=lambda name: peers[name].received_ns)
            if now_ns - peers[oldest].received_ns < _FORGET_NS:
                return False
            self._peers.pop(oldest, None)  # another thread may have removed it already
        return True

    def own_ns(self, node: str, stamp_ns: int, received_ns: int) -> int:
        """Convert a stamp of another node to our clock.

        While nothing is known about the node, a stamp shortly before the message's arrival counts
        as a stamp of our own clock. Any other stamp is replaced by the arrival time, less an
        assumed delay.

        Args:
            node: name of the node whose clock made the stamp.
            stamp_ns: time by that clock.
            received_ns: arrival of the message, by our clock.
        Returns:
            the earliest time [ns] by our clock that the stamp can mean. It is never later than the
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
            True if the node shares our clock, or its offset is bounded on both sides.
        """
        peer = self._peers.get(node)
        return peer is not None and (peer.host == self.host or peer.high_ns is not None)

    def offset_s(self, node: str, now_ns: int) -> tuple[float, float] | None:
        """Return the offset of a node's clock.

        Args:
            node: its name on the bus.
            now_ns: our clock.
        Returns:
            by how much [s] their clock is ahead of ours, and the largest error [s] of this value;
            None until measured.
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
        """Compare the wall clock of a node's computer with that of ours.

        Args:
            node: its name on the bus.
            now_ns: our clock.
            world_offset_ns: our computer's wall clock minus our monotonic clock.
        Returns:
            by how much [s] their wall clock is ahead of ours, and the largest error [s] of this
            value. None until it is measured, and for a node that does not publish its wall clock.
        """
        peer = self._peers.get(node)
        offset = self.offset_s(node, now_ns)
        if peer is None or peer.world_offset_ns is None or offset is None:
            return None
        ahead_s, error_s = offset
        return ahead_s + (peer.world_offset_ns - world_offset_ns) * 1e-9, error_s

    def largest_errors_s(self, now_ns: int) -> dict[str, float]:
        """Return the largest error of each other host's offset.

        Args:
            now_ns: our clock.
        Returns:
            node -> half the distance [s] between its bounds; infinite until measured.
        """
        errors = {}
        for name, peer in tuple(self._peers.items()):
            if peer.host != self.host and now_ns - peer.received_ns < _FORGET_NS:
                error_s = math.inf
                offset = self.offset_s(name, now_ns)
                if offset is not None:
                    _, error_s = offset
                errors[name] = error_s
        return errors


def _drift_ns(age_ns: int) -> int:
    """Return by how much two clocks may have drifted apart since a bound was measured."""
    return int(DRIFT * max(0, age_ns))
