"""Passes requests for PX4's own logs from the ground to PX4, and its answers back to the ground.

PX4 often hangs on a cable of its companion computer, where only the agent reaches it. The agent
passes on while its vehicle stands disarmed on the ground, and only what reads logs
(:mod:`onboard.px4.log_requests`). It keeps nothing on its own disk: whoever fetches asks once more
for the pieces that are missing.

Pieces give way to everything else: a tick sends a bounded number of them, on a topic that all
others overtake, and of more than fit into the queue the oldest are lost.
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

_MOST_REQUESTS = 16  # that wait for a tick
_MOST_ANSWERS = 4000  # packets that wait; about a megabyte
_ANSWERS_A_TICK = 60  # about 0.7 MB/s
_LISTENS_NS = 5_000_000_000  # after a request, for which answers are passed on


class LogRelay:
    """One agent's.

    Args:
        name: of the vehicle.
        link: to its PX4.
        bus: of the fleet.
    """

    def __init__(self, name: str, link: Px4Link, bus: Bus) -> None:
        self._name = name
        self._link = link
        self._bus = bus
        self._requests: deque[Packet] = deque(maxlen=_MOST_REQUESTS)
        self._answers: deque[bytes] = deque(maxlen=_MOST_ANSWERS)
        self._until_ns = 0  # answers are passed on until then
        self._is_listening = False

    def start(self) -> None:
        """Take requests from now on; the bus is open."""
        self._bus.collect(
            Topic.LOG_REQUEST, self._name, self._request_received, most=_MOST_REQUESTS
        )
        self._link.on_log_answer = self._answer_received

    def step(self, *, is_disarmed: bool, now_ns: int) -> None:
        """Pass on what has come since the last tick.

        Args:
            is_disarmed: whether PX4 says so, and the vehicle stands on the ground.
            now_ns: monotonic time.
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
        for packet in cut(message.packet):
            if isinstance(packet, Packet) and is_allowed(packet, self._link.system_id):
                self._requests.append(packet)

    def _answer_received(self, packet: Packet) -> None:
        """Keep an answer of PX4, on the thread of its link."""
        if self._is_listening:
            system_id = self._link.system_id
            data = packed(packet.number, packet.payload, 0, system_id, AUTOPILOT_COMPONENT)
            self._answers.append(data)  # without the signature that a vehicle with a key sends
