"""A link to a vehicle's PX4 through its agent, over the bus, for PX4's own logs alone.

Where PX4 hangs on a cable of its companion computer, nothing but the agent reaches it. The agent
passes on what reads logs while the vehicle is disarmed (:mod:`onboard.agent.log_relay`). Pieces
give way to everything else on the bus, and some are lost: the transfer asks for them once more.

The node that fetches is a watcher: no vehicle takes it for its ground station. On a locked bus it
uses the ground's key, since a viewer may request nothing.
"""

from __future__ import annotations

import contextlib
import queue
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from groundstation.client.ground_node import session
from groundstation.client.mavlink_port import (
    is_of_autopilot,
    message_codec,
    send_to_autopilot,
)
from onboard.bus.codec import Malformed
from onboard.bus.control_token import WATCHER
from onboard.bus.protocol import Bus, BusError
from onboard.bus.schema import LogPieces, LogRequest, Message, Telemetry
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.security.node_roles import NodeRole

_HEARD_S = 3.0  # within which an agent is heard
_LOOK_S = 0.05
_MOST_PIECES = 2000  # messages that wait


class _Armed:
    """Says in place of a heartbeat that the vehicle is armed."""

    def get_type(self) -> str:
        """Return the name of the message that this stands for."""
        return "HEARTBEAT"


class AgentLogLink:
    """One vehicle's.

    Args:
        vehicle: of the fleet file.
        bus: of the fleet, open.
    """

    def __init__(self, vehicle: Vehicle, bus: Bus) -> None:
        self.is_armed: bool | None = None  # None: its agent was not heard yet
        self._vehicle = vehicle
        self._bus = bus
        self._codec = message_codec(self)
        self._pieces: queue.Queue[bytes] = queue.Queue(_MOST_PIECES)
        self._messages: list[Any] = []  # decoded, not yet taken; the oldest last

        bus.subscribe(Topic.TELEMETRY, vehicle.name, self._received)
        bus.subscribe(Topic.LOG_PIECES, vehicle.name, self._received)

    def send(self, name: str, *values: object) -> None:
        """Send a message that is addressed to the autopilot.

        Args:
            name: of the message, in small letters.
            values: of its fields, without target system and component.
        """
        send_to_autopilot(self._codec, self._vehicle.system_id, name, values)

    def write(self, packet: bytes) -> None:
        """Take a packet of the codec, as a port would."""
        self._bus.publish(Topic.LOG_REQUEST, self._vehicle.name, LogRequest(packet=bytes(packet)))

    def next_message(self, names: Iterable[str], timeout_s: float) -> Any | None:
        """Return the autopilot's next message of these names; None when none comes in time."""
        wanted = tuple(names)
        end_s = time.monotonic() + timeout_s
        while True:
            if self.is_armed and "HEARTBEAT" in wanted:
                return _Armed()
            while self._messages:
                message = self._messages.pop()
                is_own = is_of_autopilot(message, self._vehicle.system_id)
                if is_own and message.get_type() in wanted:
                    return message

            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return None
            with contextlib.suppress(queue.Empty):
                packet = self._pieces.get(timeout=min(left_s, _LOOK_S))
                self._messages = list(reversed(self._codec.parse_buffer(packet) or []))

    def says_armed(self, _heartbeat: Any) -> bool:
        """Return whether the vehicle is armed, as its agent says."""
        return bool(self.is_armed)

    def _received(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        """Take telemetry or pieces, on a thread of the bus."""
        if isinstance(message, Telemetry):
            self.is_armed = message.is_armed
        elif isinstance(message, LogPieces):
            for packet in message.packets:
                with contextlib.suppress(queue.Full):  # a piece that is lost is asked for again
                    self._pieces.put_nowait(packet)


@contextlib.contextmanager
def agent_log_links(
    fleet: FleetConfig, vehicles: Sequence[Vehicle]
) -> Iterator[dict[str, AgentLogLink]]:
    """Open links through the agents of vehicles, closed with the block.

    Args:
        fleet: the fleet file.
        vehicles: whose PX4s cannot be reached otherwise; without any, no bus is opened.
    Yields:
        A link for each vehicle whose agent is heard.
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
