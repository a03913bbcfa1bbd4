"""Forwards requests for PX4's own logs from the ground to PX4, and PX4's answers to the ground.

PX4 is often connected to its companion computer by a serial cable. Then only the agent can reach
it. The agent forwards requests while its vehicle is disarmed on the ground, and it forwards only
requests that read logs (:mod:`onboard.px4.log_requests`). It stores nothing on its own disk. The
program that fetches the log asks again for missing pieces.

Pieces of a log have the lowest priority of all messages on the bus. Each tick sends a bounded
number of pieces. If the queue is full, the oldest pieces are dropped.
"""

from __future__ import annotations

from collections import deque

from onboard.autopilot import AUTOPILOT_COMPONENT
from onboard.bus.codec import Malformed
from onboard.bus.protocol import Bus
from onboard.bus.schema import LogPieces, LogRequest, Message
from onboard.bus.topics import Topic
from onboard.px4.log_requests import is_allowed
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.packets import Packet, cut, packed

_MAX_REQUESTS = 16  # at most this many requests wait for a tick
_MAX_ANSWERS = 4000  # at most this many packets of PX4 wait for a tick, about one megabyte
_ANSWERS_A_TICK = 60  # at most this many packets are forwarded per tick, about 0.7 MB/s
_LISTENS_NS = 5_000_000_000  # time after a request for which answers are forwarded


class LogRelay:
    """The relay of one agent.

    Args:
        name: name of the vehicle.
        link: link to its PX4.
        bus: bus of the fleet.
    """

    def __init__(self, name: str, link: Px4Link, bus: Bus) -> None:
        self._name = name
        self._link = link
        self._bus = bus
        self._requests: deque[Packet] = deque(maxlen=_MAX_REQUESTS)
        self._answers: deque[bytes] = deque(maxlen=_MAX_ANSWERS)
        self._until_ns = 0  # time until which answers are forwarded
        self._is_listening = False

    def start(self) -> None:
        """Receive requests from now on; the bus must be open."""
        self._bus.collect(Topic.LOG_REQUEST, self._name, self._request_received, most=_MAX_REQUESTS)
        self._link.on_log_answer = self._answer_received

    def step(self, *, is_disarmed: bool, now_ns: int) -> None:
        """Forward the requests and answers that have come since the last tick.

        Args:
            is_disarmed: whether PX4 reports that it is disarmed, on the ground.
            now_ns: monotonic time [ns].
        """
        if not is_disarmed:
            self._is_listening = False
            self._requests.clear()
            self._answers.clear()
            return

        while self._requests:
            request = self._requests.popleft()
            self._until_ns = now_ns + _LISTENS_NS
            self._is_listening = True
            self._link.request_log(request.number, request.payload)
        if now_ns > self._until_ns:
            self._is_listening = False

        pieces: list[bytes] = []
        while self._answers and len(pieces) < _ANSWERS_A_TICK:
            pieces.append(self._answers.popleft())
        if pieces:
            message = LogPieces(packets=tuple(pieces))
            self._bus.publish(Topic.LOG_PIECES, self._name, message)

    def _request_received(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        if not isinstance(message, LogRequest):
            return
        # `cut` returns whole packets, and a number for the bytes that are left
        for packet in cut(message.packet):
            if isinstance(packet, Packet) and is_allowed(packet, self._link.system_id):
                self._requests.append(packet)

    def _answer_received(self, packet: Packet) -> None:
        """Store an answer of PX4; called on the thread of the link."""
        if self._is_listening:
            system_id = self._link.system_id
            # pack it again to remove the signature
            data = packed(
                packet.number,
                packet.payload,
                sequence=0,
                system_id=system_id,
                component_id=AUTOPILOT_COMPONENT,
            )
            self._answers.append(data)
