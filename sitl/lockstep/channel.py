"""One radio channel that a whole fleet shares, in simulated time and with seeded random numbers.

Stations take turns by the distributed coordination function of 802.11. Each station counts down a
random number of free slots, and the first one at zero sends. Stations that reach zero at once
collide, and draw again from a window twice as large. In its turn a station sends all packets that
wait for one receiver as one aggregate, as in 802.11n. A nearly full channel therefore carries more
packets in each turn, but later.

The access point is a station like the others. It has a queue for each vehicle, and its window grows
less, as 802.11e allows. Messages from vehicle to vehicle go through it, unless the radio's link is
``direct``. The durations come from onboard/feasibility/airtime.py.
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
from onboard.feasibility.airtime import MAX_IN_TURN, OFDM, OVERHEAD_BYTES, message_packets, turn_s
from sitl.physics.random_streams import Stream

_ACCESS_POINT = ""  # the station name of the access point; no node has this name
_SMALL_BYTES = 100  # size of a liveliness token, and of a call without a message
# A LATEST message is dropped after waiting this long.
_MAX_WAITING_NS = 300_000_000

FIRST_WINDOW = 16  # slots

# A station's window doubles with each consecutive collision, at most this many times.
MAX_DOUBLED = 6
_MAX_DOUBLED_ACCESS_POINT = 2


class _Packet(NamedTuple):
    """One message on its way."""

    to: str  # name of the receiving node
    message_bytes: int
    sent_ns: int
    is_latest: bool  # whether only the newest message matters: then it is dropped if it waits long
    deliver: Callable[[int], None]  # called with the time of arrival [ns]


class _Aggregate(NamedTuple):
    """The packets that a station sends in its turn."""

    next_station: str  # the station that receives them
    packets: list[_Packet]
    turn_ns: int  # how long they keep the channel busy


class Channel:
    """The channel.

    Args:
        radio: its bit rate, and whether vehicles send directly or over the access point.
        vehicles: names of the nodes with a radio; all other nodes are wired to the access point.
        now_ns: returns the simulated time.
        seed: the seed of all random numbers.
    """

    def __init__(
        self, radio: RadioConfig, vehicles: frozenset[str], now_ns: Callable[[], int], *, seed: int
    ) -> None:
        self._radio = radio
        self._vehicles = vehicles
        self._now_ns = now_ns
        self._rng = np.random.default_rng([seed, Stream.RADIO])

        # station -> next station -> waiting packets
        self._queues: dict[str, dict[str, deque[_Packet]]] = {}
        self._slots_left: dict[str, int] = {}  # station -> free slots until it may send
        # station -> number of its collisions since its last turn without one
        self._collisions_in_a_row: dict[str, int] = {}
        self._free_ns = 0  # end of the most recent turn

        # the message measured last, and its size
        self._measured_message: object = None
        self._measured_bytes = 0

        # totals since the start
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
        """Put a message into the queue of its sender's station.

        Args:
            pair: names of sender and receiver.
            args: arguments of the receiver's callback; if there is a message, it is the last one.
            deliver: called with the time [ns] at which the message arrives.
            is_latest: whether only the newest message matters: then it is dropped if it waits long.
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
        next_station = self._next_station(station, receiver)

        # both ends are wired
        if station == next_station:
            deliver(packet.sent_ns)
            return
        self._enqueue(station, next_station, packet)

    def _enqueue(self, station: str, next_station: str, packet: _Packet) -> None:
        queues = self._queues.setdefault(station, {})
        queues.setdefault(next_station, deque()).append(packet)

    def advance(self, now_ns: int) -> None:
        """Begin all turns that are due up to now."""
        while True:
            # station with waiting packets -> when the oldest of them was sent
            oldest_ns = {}
            for station, queues in self._queues.items():
                self._drop_old(queues)
                if queues:
                    oldest_ns[station] = min(queue[0].sent_ns for queue in queues.values())

            # without a waiting packet the next turn begins later
            first_sent_ns = min(oldest_ns.values(), default=now_ns + 1)
            begin_ns = max(self._free_ns, first_sent_ns)
            if begin_ns > now_ns:
                return

            waiting = [station for station, sent_ns in oldest_ns.items() if sent_ns <= begin_ns]
            self._take_turn(waiting, begin_ns)

    def _take_turn(self, waiting: list[str], begin_ns: int) -> None:
        """Let the station with the fewest slots left send; if several are level, they collide."""
        slots_left = self._slots_left
        for station in waiting:
            if station not in slots_left:
                slots_left[station] = self._draw(station)

        fewest_slots = min(slots_left[station] for station in waiting)
        senders = [station for station in waiting if slots_left[station] == fewest_slots]
        for station in waiting:
            slots_left[station] -= fewest_slots

        # when several collide, the longest aggregate keeps the channel busy
        aggregates = [self._aggregate(station, fewest_slots) for station in senders]
        turn_ns = max(aggregate.turn_ns for aggregate in aggregates)
        self.busy_ns += turn_ns
        self._free_ns = begin_ns + turn_ns

        is_collision = len(senders) > 1
        for station in senders:
            del slots_left[station]
            if is_collision:
                self._collisions_in_a_row[station] = self._collisions_in_a_row.get(station, 0) + 1
            else:
                self._collisions_in_a_row[station] = 0

        if is_collision:
            self.collisions += 1
        else:
            self._pass_on(senders[0], aggregates[0])

    def _pass_on(self, station: str, aggregate: _Aggregate) -> None:
        """Move an aggregate from its station's queue to the receivers or to the next station."""
        next_station = aggregate.next_station
        queue = self._queues[station][next_station]
        for _ in aggregate.packets:
            queue.popleft()
        self.packets += sum(message_packets(packet.message_bytes) for packet in aggregate.packets)

        for packet in aggregate.packets:
            is_wired = next_station == _ACCESS_POINT and packet.to not in self._vehicles
            if packet.to == next_station or is_wired:
                packet.deliver(self._free_ns)
            else:
                self._enqueue(next_station, packet.to, packet)

    def _draw(self, station: str) -> int:
        """Return the free slots that a station waits for before it sends."""
        most_doubled = MAX_DOUBLED
        if station == _ACCESS_POINT:
            most_doubled = _MAX_DOUBLED_ACCESS_POINT

        doubled = min(self._collisions_in_a_row.get(station, 0), most_doubled)
        return int(self._rng.integers(FIRST_WINDOW * 2**doubled))

    def _aggregate(self, station: str, slots: int) -> _Aggregate:
        """Return the packets that a station sends in its turn.

        They all go to the receiver of the packet that has waited longest.
        """
        queues = self._queues[station]
        next_station = min(queues, key=lambda name: queues[name][0].sent_ns)
        packets = list(islice(queues[next_station], MAX_IN_TURN))

        count = sum(message_packets(packet.message_bytes) for packet in packets)
        size_bytes = sum(packet.message_bytes for packet in packets) + count * OVERHEAD_BYTES
        phy = OFDM._replace(backoff_slots=float(slots))
        busy_s = turn_s(count, size_bytes, self._radio.rate_mbit_s, phy)

        return _Aggregate(next_station, packets, round(busy_s * 1e9))

    def _next_station(self, station: str, receiver: str) -> str:
        """Return the station to which this station sends a packet for a receiver."""
        is_direct = self._radio.link == "direct" or station == _ACCESS_POINT
        if is_direct and receiver in self._vehicles:
            return receiver
        return _ACCESS_POINT

    def _size_of(self, message: Struct) -> int:
        """Return the encoded size [byte] of a message."""
        # the same message is sent to many receivers in a row, so its size is kept
        if message is not self._measured_message:
            self._measured_message = message
            self._measured_bytes = len(encode(cast(Message, message)))
        return self._measured_bytes

    def _drop_old(self, queues: dict[str, deque[_Packet]]) -> None:
        """Drop packets that have waited too long, and then queues that are empty."""
        oldest_ns = self._now_ns() - _MAX_WAITING_NS
        for next_station in list(queues):
            queue = queues[next_station]
            while queue and queue[0].is_latest and queue[0].sent_ns < oldest_ns:
                queue.popleft()
                self.dropped += 1
            if not queue:
                del queues[next_station]
