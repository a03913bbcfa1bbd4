"""One radio channel that a whole fleet shares, in simulated time: queues, turns, aggregates,
collisions. Seeded.

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

_ACCESS_POINT = ""
_SMALL_BYTES = 100  # of tokens, and of what is no message
_MOST_WAITING_NS = 300_000_000  # then the sender drops what only matters while it is new
FIRST_WINDOW = 16  # slots
MOST_DOUBLED = 6
_MOST_DOUBLED_ACCESS_POINT = 2


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
        vehicles: nodes with a radio; all others are wired to the access point, or share a radio of
            their own.
        now_ns: the simulated time.
    """

    def __init__(
        self, radio: RadioConfig, vehicles: frozenset[str], now_ns: Callable[[], int], *, seed: int
    ) -> None:
        self._radio, self._vehicles, self._now_ns = radio, vehicles, now_ns
        self._rng = np.random.default_rng([seed, 13])
        # station -> next station -> what waits
        self._queues: dict[str, dict[str, deque[_Packet]]] = {}
        self._slots_left: dict[str, int] = {}  # station -> free slots until it may send
        self._in_a_row: dict[str, int] = {}  # station -> collisions of its turn
        self._free_ns = 0  # end of the turn that was begun last
        self._sized: tuple[object, int] = (None, 0)  # the message whose size was asked for last
        self.busy_ns = self.packets = self.dropped = self.collisions = 0

    def send(
        self,
        pair: tuple[str, str],
        args: tuple[object, ...],
        deliver: Callable[[int], None],
        is_latest: bool,
    ) -> None:
        """Take a message, the last of ``args``; ``deliver`` is called with the time at which its
        receiver has it.
        """
        sender, receiver = pair
        message_bytes = (
            self._size_of(args[-1]) if args and isinstance(args[-1], Struct) else _SMALL_BYTES
        )
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
            oldest_ns = {
                station: min(queue[0].sent_ns for queue in queues.values())
                for station, queues in self._queues.items()
                if self._drop_old(queues)
            }
            begin_ns = max(self._free_ns, min(oldest_ns.values(), default=now_ns + 1))
            if begin_ns > now_ns:
                return
            self._take_turn(
                [station for station, sent_ns in oldest_ns.items() if sent_ns <= begin_ns], begin_ns
            )

    def _take_turn(self, waiting: list[str], begin_ns: int) -> None:
        """Let whoever has fewest slots left of those that have something to send do so; several
        collide.
        """
        left = self._slots_left
        for station in waiting:
            if station not in left:
                left[station] = self._draw(station)
        slots = min(left[station] for station in waiting)
        first = [station for station in waiting if left[station] == slots]
        for station in waiting:
            left[station] -= slots
        turns = [self._aggregate(station, slots) for station in first]
        turn_ns = max(turn_ns for _, _, turn_ns in turns)
        self.busy_ns += turn_ns
        self._free_ns = begin_ns + turn_ns
        for station in first:
            del left[station]
            self._in_a_row[station] = self._in_a_row.get(station, 0) + 1 if len(first) > 1 else 0
        if len(first) > 1:
            self.collisions += 1
            return
        (following, packets, _), queue = turns[0], self._queues[first[0]][turns[0][0]]
        for _ in packets:
            queue.popleft()
        self.packets += sum(message_packets(packet.message_bytes) for packet in packets)
        for packet in packets:
            if packet.to == following or (
                following == _ACCESS_POINT and packet.to not in self._vehicles
            ):
                packet.deliver(self._free_ns)
            else:
                self._queues.setdefault(following, {}).setdefault(packet.to, deque()).append(packet)

    def _draw(self, station: str) -> int:
        """Return the free slots that a station waits for before it sends."""
        most = _MOST_DOUBLED_ACCESS_POINT if station == _ACCESS_POINT else MOST_DOUBLED
        return int(self._rng.integers(FIRST_WINDOW << min(self._in_a_row.get(station, 0), most)))

    def _aggregate(self, station: str, slots: int) -> tuple[str, list[_Packet], int]:
        """Return what a station sends in its turn, to whom, and for how long the channel is busy
        with it [ns].
        """
        queues = self._queues[station]
        following = min(queues, key=lambda name: queues[name][0].sent_ns)
        packets = list(islice(queues[following], MOST_IN_TURN))
        count = sum(message_packets(packet.message_bytes) for packet in packets)
        size_bytes = sum(packet.message_bytes for packet in packets) + count * OVERHEAD_BYTES
        phy = OFDM._replace(backoff_slots=float(slots))
        return (
            following,
            packets,
            round(turn_s(count, size_bytes, self._radio.rate_mbit_s, phy) * 1e9),
        )

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
