"""How far the monotonic clocks of other hosts are from ours, measured over the bus. Pure: times are passed in.

Every node tells its clock twice a second, and when it heard the clocks of the others. A message that was sent at t1 by
their clock and arrived at t2 by ours says that their clock is ahead by at least t1 - t2, since nothing arrives before
it is sent; what they tell of ours says that it is ahead by at most so much. Both are true whatever the delays are,
however different on the way there and back; the quickest messages of each way make the bounds narrow. A bound gets
wider while it ages, for clocks drift apart. Nothing is averaged, and no wall clock is asked: one that jumps changes
nothing.

Nodes that share a clock (one kernel, one boot, one time namespace) know that from each other's host id.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from onboard.bus.schema import ClockMessage, HeardClock

# Crystals are within 100 ppm; a host whose wall clock is being disciplined slews its monotonic clock too, by up to 500.
DRIFT = 1e-3
_UNKNOWN_DELAY_NS = 20_000_000  # assumed while nothing is measured
_SAME_CLOCK_NS = 500_000_000
_FORGET_NS = 60_000_000_000
_MOST_NODES = 64


@dataclass(frozen=True, slots=True)
class Peer:
    """One other node: their clock minus ours lies between ``low_ns`` and ``high_ns``, each true at its own time.

    sent_ns, received_ns: of its newest message, by its clock and by ours.
    """

    host: int
    sent_ns: int
    received_ns: int
    low_ns: int
    low_at_ns: int
    high_ns: int | None = None
    high_at_ns: int = 0

    def bounds_ns(self, now_ns: int) -> tuple[int, int | None]:
        """Both bounds now, wider for their age."""
        low = self.low_ns - _drift_ns(now_ns - self.low_at_ns)
        return low, None if self.high_ns is None else self.high_ns + _drift_ns(now_ns - self.high_at_ns)


@dataclass(slots=True)
class Clocks:
    """The clocks of all nodes that were heard.

    Args:
        node: our own name on the bus. host: our own host id.
    """

    node: str
    host: int
    restarts: int = 0
    _peers: dict[str, Peer] = field(default_factory=dict)
    _sequence: int = 0

    def message(self, now_ns: int) -> ClockMessage:
        """What to tell the others now."""
        self._sequence += 1
        heard = tuple(
            HeardClock(name, peer.host, peer.sent_ns, peer.received_ns)
            for name, peer in tuple(self._peers.items())
            if peer.host != self.host and now_ns - peer.received_ns < _FORGET_NS
        )
        return ClockMessage(node=self.node, host=self.host, sequence=self._sequence, sent_ns=now_ns, heard=heard)

    def hear(self, message: ClockMessage, received_ns: int) -> None:
        """Take a message of another node."""
        if message.node == self.node or (message.node not in self._peers and not self._has_room(received_ns)):
            return
        low = message.sent_ns - received_ns
        peer = self._peers.get(message.node)
        if peer is None or peer.host != message.host or message.host == self.host:
            # another boot is another clock, and of our own there is nothing to measure
            peer = Peer(message.host, message.sent_ns, received_ns, low, received_ns)
        elif low >= peer.bounds_ns(received_ns)[0]:
            peer = replace(peer, low_ns=low, low_at_ns=received_ns)
        if message.sent_ns > peer.sent_ns:
            peer = replace(peer, sent_ns=message.sent_ns, received_ns=received_ns)
        for heard in message.heard:
            if heard.node == self.node and heard.host == self.host and heard.sent_ns <= received_ns:
                high = heard.received_ns - heard.sent_ns
                known = peer.bounds_ns(heard.sent_ns)[1]
                if known is None or high <= known:
                    peer = replace(peer, high_ns=high, high_at_ns=heard.sent_ns)
        low_now, high_now = peer.bounds_ns(received_ns)
        if high_now is not None and low_now > high_now:
            # No two true bounds exclude each other: a clock stood still (a suspended host) or somebody lies. Anew.
            self.restarts += 1
            peer = Peer(message.host, message.sent_ns, received_ns, low, received_ns)
        self._peers[message.node] = peer

    def _has_room(self, now_ns: int) -> bool:
        """Whether one more node can be remembered; who has been silent for a minute makes room."""
        if len(self._peers) >= _MOST_NODES:
            oldest, peer = min(tuple(self._peers.items()), key=lambda item: item[1].received_ns)
            if now_ns - peer.received_ns < _FORGET_NS:
                return False
            self._peers.pop(oldest, None)  # another thread may have been as quick
        return True

    def own_ns(self, node: str, stamp_ns: int, received_ns: int) -> int:
        """A stamp of ``node`` on our clock: the earliest moment that it can mean, and never after its arrival.

        While nothing is known of the node, a stamp shortly before its arrival counts as one of our own clock, and of
        any other the arrival counts, less a usual delay.
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
        """Whether stamps of ``node`` can be told on our clock."""
        peer = self._peers.get(node)
        return peer is not None and (peer.host == self.host or peer.high_ns is not None)

    def offset_s(self, node: str, now_ns: int) -> tuple[float, float] | None:
        """How far their clock is ahead of ours, and how wrong that may be; None while it is not measured."""
        peer = self._peers.get(node)
        if peer is None:
            return None
        if peer.host == self.host:
            return 0.0, 0.0
        low, high = peer.bounds_ns(now_ns)
        return None if high is None else ((low + high) * 0.5e-9, (high - low) * 0.5e-9)

    def bounds_s(self, now_ns: int) -> dict[str, float]:
        """How wrong each other host's clock may be known: half the gap of its bounds, infinite while not measured."""
        found = {}
        for name, peer in tuple(self._peers.items()):
            if peer.host != self.host and now_ns - peer.received_ns < _FORGET_NS:
                offset = self.offset_s(name, now_ns)
                found[name] = float("inf") if offset is None else offset[1]
        return found

    def shares(self, node: str) -> bool:
        """Whether ``node`` is known to run on our clock."""
        peer = self._peers.get(node)
        return peer is not None and peer.host == self.host


def _drift_ns(age_ns: int) -> int:
    return int(DRIFT * max(0, age_ns))
