"""A link to a vehicle's PX4 through its agent, over the bus. It carries PX4's own logs only.

PX4 is often connected to its companion computer by a serial cable, where only the agent reaches it.
While the vehicle is disarmed, the agent forwards requests that read logs
(:mod:`onboard.agent.log_relay`). The pieces have the lowest priority on the bus. Some are dropped,
and the transfer requests them again.

The node on the bus is a watcher, so that no vehicle takes it for its ground station. On a locked
bus it uses the key of the ground, because a viewer may not request anything.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from groundstation.client.ground_node import session
from groundstation.client.mavlink_port import (
    is_of_autopilot,
    message_codec,
    send_to_autopilot,
)
from groundstation.px4.log_transfer import ArmedInBetween
from onboard.bus.codec import Malformed
from onboard.bus.control_token import WATCHER
from onboard.bus.protocol import Bus, BusError
from onboard.bus.schema import LogPieces, LogRequest, Message, Telemetry
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.security.node_roles import NodeRole

_HEARD_S = 3.0  # longest wait for the telemetry of an agent
_LOOK_S = 0.05  # time between two looks
_MAX_PIECES = 2000  # most packets that wait to be decoded


class AgentLogLink:
    """The link to one vehicle.

    Args:
        vehicle: the vehicle in the fleet file.
        bus: bus of the fleet, which must be open.
    """

    def __init__(self, vehicle: Vehicle, bus: Bus) -> None:
        self.is_armed: bool | None = None  # None until telemetry of its agent has come
        self._vehicle = vehicle
        self._bus = bus
        self._codec = message_codec(self)
        self._pieces: queue.Queue[bytes] = queue.Queue(_MAX_PIECES)
        self._messages: deque[Any] = deque()  # decoded messages, the oldest first

        bus.subscribe(Topic.TELEMETRY, vehicle.name, self._received)
        bus.subscribe(Topic.LOG_PIECES, vehicle.name, self._received)

    def send(self, name: str, *values: object) -> None:
        """Send a message that is addressed to the autopilot.

        Args:
            name: name of the message, in small letters.
            values: values of its fields, without target system and component.
        """
        send_to_autopilot(self._codec, self._vehicle.system_id, name, values)

    def write(self, packet: bytes) -> None:
        """Publish an encoded packet. The codec calls this method as if the link were its port."""
        self._bus.publish(Topic.LOG_REQUEST, self._vehicle.name, LogRequest(packet=bytes(packet)))

    def next_message(self, names: Iterable[str], timeout_s: float) -> Any | None:
        """Return the autopilot's next message of these names; None if none comes in time.

        Raises:
            ArmedInBetween: the agent reports that the vehicle is armed.
        """
        wanted = tuple(names)
        end_s = time.monotonic() + timeout_s
        while True:
            if self.is_armed:
                raise ArmedInBetween
            while self._messages:
                message = self._messages.popleft()
                is_own = is_of_autopilot(message, self._vehicle.system_id)
                if is_own and message.get_type() in wanted:
                    return message

            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return None
            with contextlib.suppress(queue.Empty):
                packet = self._pieces.get(timeout=min(left_s, _LOOK_S))
                self._messages.extend(self._codec.parse_buffer(packet) or [])

    def _received(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        """Receive telemetry or log pieces; called on a thread of the bus."""
        if isinstance(message, Telemetry):
            self.is_armed = message.is_armed
        elif isinstance(message, LogPieces):
            for packet in message.packets:
                with contextlib.suppress(queue.Full):  # a dropped piece is requested again
                    self._pieces.put_nowait(packet)


@contextlib.contextmanager
def agent_log_links(
    fleet: FleetConfig, vehicles: Sequence[Vehicle]
) -> Iterator[dict[str, AgentLogLink]]:
    """Open links to vehicles through their agents, and close them at the end of the block.

    Args:
        fleet: the fleet file.
        vehicles: vehicles whose PX4 cannot be reached directly; if there are none, no bus is
            opened.

    Yields:
        The links by vehicle name, for those vehicles whose agent has sent telemetry.
    """
    if not vehicles:
        yield {}
        return

    bus = session(fleet, WATCHER, NodeRole.GROUND)
    try:
        bus.start()
    except BusError:
        yield {}
        return

    try:
        links = {vehicle.name: AgentLogLink(vehicle, bus) for vehicle in vehicles}
        end_s = time.monotonic() + _HEARD_S
        while time.monotonic() < end_s:
            if all(link.is_armed is not None for link in links.values()):
                break
            time.sleep(_LOOK_S)
        yield {name: link for name, link in links.items() if link.is_armed is not None}
    finally:
        bus.stop()
