"""One radio channel that a whole fleet shares, in simulated time: queues, turns, aggregates, collisions. Seeded.

Stations take turns as the distributed coordination function of 802.11 lets them: whoever has something to send has
the same chance, an access point more, since it may wait for a shorter time (802.11e). In its turn a station sends what
waits for one receiver in one aggregate, as 802.11n does, so that a channel that is nearly full carries more packets in
each turn, later. An access point is a station like the others, with a queue for each vehicle; what a vehicle sends to
another goes to it first. Times: onboard/feasibility/airtime.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np
from msgspec import Struct

from onboard.bus.codec import encode
from onboard.bus.schema import Message
from onboard.config.radio import RadioConfig
from onboard.feasibility.airtime import MOST_IN_TURN, OVERHEAD_BYTES, message_packets, turn_s

_ACCESS_POINT = ""
_SMALL_BYTES = 100  # of tokens, and of what is no message
_MOST_WAITING_NS = 300_000_000  # then the sender drops what only matters while it is new
_SLOTS = 16  # of the first contention window; after each collision twice as many
_MOST_DOUBLED = 6
_ACCESS_POINT_FRAC = 0.25  # of the turns


class _Packet(NamedTuple):
    """One message on its way."""

    to: str  # the node that is to have it
    message_bytes: int
    sent_ns: int
    is_latest: bool  # dropped when it has waited for long
    deliver: Callable[[int], None]  # with the time of its arrival


class Channel:
    """The channel.

    Args:
        radio: its quality.
        vehicles: nodes with a radio; all others are wired to the access point, or share a radio of their own.
        now_ns: the simulated time.
    """

    def __init__(self, radio: RadioConfig, vehicles: frozenset[str], now_ns: Callable[[], int], *, seed: int) -> None:
        self._radio, self._vehicles, self._now_ns = radio, vehicles, now_ns
        self._rng = np.random.default_rng([seed, 13])
        self._queues: dict[str, dict[str, deque[_Packet]]] = {}  # station -> next station -> what waits
        self._in_a_row = 0  # collisions
        self._free_ns = 0  # end of the turn that was begun last
        self._sized: tuple[object, int] = (None, 0)  # the message whose size was asked for last
        self.busy_ns = self.packets = self.dropped = self.collisions = 0

    def send(
        self, pair: tuple[str, str], args: tuple[object, ...], deliver: Callable[[int], None], is_latest: bool
    ) -> None:
        """Take a message, the last of ``args``; ``deliver`` is called with the time at which its receiver has it."""
        sender, receiver = pair
        message_bytes = self._size_of(args[-1]) if args and isinstance(args[-1], Struct) else _SMALL_BYTES
        packet = _Packet(receiver, message_bytes, self._now_ns(), is_latest, deliver)
        station = sender if sender in self._vehicles else _ACCESS_POINT
        following = self._following(station, receiver)
        if station == following:  # both ends are wired
            deliver(packet.sent_ns)
            return
        self._queues.setdefault(station, {}).setdefault(following, deque()).append(packet)

    def advance(self, now_ns: int) -> None:
        """Begin all turns that are due up to now."""
        while True:
            waiting = [station for station, queues in self._queues.items() if self._drop_old(queues)]
            oldest_ns = [queue[0].sent_ns for station in waiting for queue in self._queues[station].values()]
            begin_ns = max(self._free_ns, min(oldest_ns, default=now_ns + 1))
            if begin_ns > now_ns:
                return
            self._take_turn(waiting, begin_ns)

    def _take_turn(self, waiting: list[str], begin_ns: int) -> None:
        """Let one of the stations that have something to send do so."""
        station = waiting[int(self._rng.integers(len(waiting)))]
        if _ACCESS_POINT in waiting and self._rng.random() < _ACCESS_POINT_FRAC:
            station = _ACCESS_POINT
        queues = self._queues[station]
        following = min(queues, key=lambda name: queues[name][0].sent_ns)
        queue = queues[following]
        packets = [queue.popleft() for _ in range(min(len(queue), MOST_IN_TURN))]
        count = sum(message_packets(packet.message_bytes) for packet in packets)
        size_bytes = sum(packet.message_bytes for packet in packets) + count * OVERHEAD_BYTES
        turn_ns = round(turn_s(count, size_bytes, self._radio.rate_mbit_s) * 1e9)
        self.busy_ns += turn_ns
        self._free_ns = begin_ns + turn_ns
        slots = _SLOTS << min(self._in_a_row, _MOST_DOUBLED)
        if self._rng.random() > (1.0 - 1.0 / slots) ** (len(waiting) - 1):
            self.collisions += 1
            self._in_a_row += 1
            queue.extendleft(reversed(packets))
            return
        self._in_a_row = 0
        self.packets += count
        for packet in packets:
            if packet.to == following or (following == _ACCESS_POINT and packet.to not in self._vehicles):
                packet.deliver(self._free_ns)
            else:
                self._queues.setdefault(following, {}).setdefault(packet.to, deque()).append(packet)

    def _following(self, station: str, receiver: str) -> str:
        """Return the station that gets a packet next."""
        is_direct = self._radio.link == "direct" or station == _ACCESS_POINT
        return receiver if is_direct and receiver in self._vehicles else _ACCESS_POINT

    def _size_of(self, message: Struct) -> int:
        if self._sized[0] is not message:  # one message goes to many receivers, one after the other
            self._sized = message, len(encode(cast(Message, message)))
        return self._sized[1]

    def _drop_old(self, queues: dict[str, deque[_Packet]]) -> bool:
        """Drop what has waited too long; whether anything is left."""
        oldest_ns = self._now_ns() - _MOST_WAITING_NS
        for following in list(queues):
            queue = queues[following]
            while queue and queue[0].is_latest and queue[0].sent_ns < oldest_ns:
                queue.popleft()
                self.dropped += 1
            if not queue:
                del queues[following]
        return bool(queues)
