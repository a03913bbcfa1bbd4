"""One radio channel that a whole fleet shares, in simulated time. Seeded.

Stations take turns by the distributed coordination function of 802.11: each counts down a random
number of free slots, whoever is at zero first sends, two at once collide and draw from a window
twice as large. In its turn a station sends what waits for one receiver in one aggregate, as 802.11n
does, so that a channel that is nearly full carries more in each turn, later. An access point is a
station like the others, with a queue for each vehicle and a window that grows less, as 802.11e lets
it; what a vehicle sends to another goes to it first. Times: onboard/feasibility/airtime.py.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import islice
from typing import NamedTuple, cast

import numpy as np
from msgspec import Struct

from onboard.bus.codec import encode
from onboard.bus.schema import Message
from onboard.config.radio import RadioConfig
from onboard.feasibility.airtime import MOST_IN_TURN, OFDM, OVERHEAD_BYTES, message_packets, turn_s

_ACCESS_POINT = ""  # its name as a station
_SMALL_BYTES = 100  # of tokens, and of what is no message
_MOST_WAITING_NS = 300_000_000  # then the sender drops what only matters while it is new

FIRST_WINDOW = 16  # slots

# after so many collisions in a row a station's window grows no more
MOST_DOUBLED = 6
_MOST_DOUBLED_ACCESS_POINT = 2


class _Packet(NamedTuple):
    """One message on its way."""

    to: str  # the node that is to have it
    message_bytes: int
    sent_ns: int
    is_latest: bool  # dropped when it has waited for long
    deliver: Callable[[int], None]  # with the time of its arrival


class _Aggregate(NamedTuple):
    """What a station sends in its turn."""

    following: str  # the station that gets it
    packets: list[_Packet]
    turn_ns: int  # for so long the channel is busy with it


class Channel:
    """The channel.

    Args:
        radio: its quality.
        vehicles: nodes with a radio; all others are wired to the access point, or share a radio of
            their own.
        now_ns: the simulated time.
    """

    def __init__(
        self, radio: RadioConfig, vehicles: frozenset[str], now_ns: Callable[[], int], *, seed: int
    ) -> None:
        self._radio = radio
        self._vehicles = vehicles
        self._now_ns = now_ns
        self._rng = np.random.default_rng([seed, 13])

        # station -> next station -> what waits
        self._queues: dict[str, dict[str, deque[_Packet]]] = {}
        self._slots_left: dict[str, int] = {}  # station -> free slots until it may send
        self._in_a_row: dict[str, int] = {}  # station -> collisions of its turn
        self._free_ns = 0  # end of the turn that was begun last

        # the message whose size was measured last, and that size
        self._measured_message: object = None
        self._measured_bytes = 0

        # so far
        self.busy_ns = 0
        self.packets = 0
        self.dropped = 0
        self.collisions = 0

    def send(
        self,
        pair: tuple[str, str],
        args: tuple[object, ...],
        deliver: Callable[[int], None],
        is_latest: bool,
    ) -> None:
        """Take a message to the queue of its sender's station.

        Args:
            pair: names of sender and receiver.
            args: the last one is the message.
            deliver: called with the time at which the receiver has it.
            is_latest: whether it is dropped when it has waited for long.
        """
        sender, receiver = pair

        message_bytes = _SMALL_BYTES
        if args and isinstance(args[-1], Struct):
            message_bytes = self._size_of(args[-1])

        packet = _Packet(
            to=receiver,
            message_bytes=message_bytes,
            sent_ns=self._now_ns(),
            is_latest=is_latest,
            deliver=deliver,
        )

        station = _ACCESS_POINT
        if sender in self._vehicles:
            station = sender
        following = self._following(station, receiver)

        # both ends are wired
        if station == following:
            deliver(packet.sent_ns)
            return
        self._enqueue(station, following, packet)

    def _enqueue(self, station: str, following: str, packet: _Packet) -> None:
        queues = self._queues.setdefault(station, {})
        queues.setdefault(following, deque()).append(packet)

    def advance(self, now_ns: int) -> None:
        """Begin all turns that are due up to now."""
        while True:
            # station -> when the oldest of its packets was sent; none of those with nothing to send
            oldest_ns = {}
            for station, queues in self._queues.items():
                self._drop_old(queues)
                if queues:
                    oldest_ns[station] = min(queue[0].sent_ns for queue in queues.values())

            begin_ns = max(self._free_ns, min(oldest_ns.values(), default=now_ns + 1))
            if begin_ns > now_ns:
                return

            waiting = [station for station, sent_ns in oldest_ns.items() if sent_ns <= begin_ns]
            self._take_turn(waiting, begin_ns)

    def _take_turn(self, waiting: list[str], begin_ns: int) -> None:
        """Let the station with the fewest slots left send; several of them collide."""
        left = self._slots_left
        for station in waiting:
            if station not in left:
                left[station] = self._draw(station)

        slots = min(left[station] for station in waiting)
        first = [station for station in waiting if left[station] == slots]
        for station in waiting:
            left[station] -= slots

        # of those that collide the longest one holds the channel
        aggregates = [self._aggregate(station, slots) for station in first]
        turn_ns = max(aggregate.turn_ns for aggregate in aggregates)
        self.busy_ns += turn_ns
        self._free_ns = begin_ns + turn_ns

        is_collision = len(first) > 1
        for station in first:
            del left[station]
            if is_collision:
                self._in_a_row[station] = self._in_a_row.get(station, 0) + 1
            else:
                self._in_a_row[station] = 0

        if is_collision:
            self.collisions += 1
        else:
            self._pass_on(first[0], aggregates[0])

    def _pass_on(self, station: str, aggregate: _Aggregate) -> None:
        """Take an aggregate out of its station's queue to the receivers or to the next station."""
        following = aggregate.following
        queue = self._queues[station][following]
        for _ in aggregate.packets:
            queue.popleft()
        self.packets += sum(message_packets(packet.message_bytes) for packet in aggregate.packets)

        for packet in aggregate.packets:
            is_wired = following == _ACCESS_POINT and packet.to not in self._vehicles
            if packet.to == following or is_wired:
                packet.deliver(self._free_ns)
            else:
                self._enqueue(following, packet.to, packet)

    def _draw(self, station: str) -> int:
        """Return the free slots that a station waits for before it sends."""
        most_doubled = MOST_DOUBLED
        if station == _ACCESS_POINT:
            most_doubled = _MOST_DOUBLED_ACCESS_POINT

        doubled = min(self._in_a_row.get(station, 0), most_doubled)
        return int(self._rng.integers(FIRST_WINDOW << doubled))

    def _aggregate(self, station: str, slots: int) -> _Aggregate:
        """Return what a station sends in its turn: first to whom a packet has waited longest."""
        queues = self._queues[station]
        following = min(queues, key=lambda name: queues[name][0].sent_ns)
        packets = list(islice(queues[following], MOST_IN_TURN))

        count = sum(message_packets(packet.message_bytes) for packet in packets)
        size_bytes = sum(packet.message_bytes for packet in packets) + count * OVERHEAD_BYTES
        phy = OFDM._replace(backoff_slots=float(slots))
        busy_s = turn_s(count, size_bytes, self._radio.rate_mbit_s, phy)

        return _Aggregate(following, packets, round(busy_s * 1e9))

    def _following(self, station: str, receiver: str) -> str:
        """Return the station that gets a packet next."""
        is_direct = self._radio.link == "direct" or station == _ACCESS_POINT
        if is_direct and receiver in self._vehicles:
            return receiver
        return _ACCESS_POINT

    def _size_of(self, message: Struct) -> int:
        """Return the encoded size [byte] of a message."""
        # one message goes to many receivers, one after the other
        if message is not self._measured_message:
            self._measured_message = message
            self._measured_bytes = len(encode(cast(Message, message)))
        return self._measured_bytes

    def _drop_old(self, queues: dict[str, deque[_Packet]]) -> None:
        """Drop what has waited too long, and queues that are empty."""
        oldest_ns = self._now_ns() - _MOST_WAITING_NS
        for following in list(queues):
            queue = queues[following]
            while queue and queue[0].is_latest and queue[0].sent_ns < oldest_ns:
                queue.popleft()
                self.dropped += 1
            if not queue:
                del queues[following]
