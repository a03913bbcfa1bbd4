"""Datagrams to and from one MAVLink endpoint, recorded with the vehicle's own time.

Frames are cut by hand and decoded only when somebody looks into them: a fast vehicle sends
thousands a second.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Protocol

from pymavlink.dialects.v20 import common

IDS: dict[str, int] = {kind.msgname: number for number, kind in common.mavlink_map.items()}
# Not in pymavlink's dialect.
IDS |= {
    "LINK_NODE_STATUS": 8,
    "TIME_ESTIMATE_TO_TARGET": 380,
    "EVENT": 410,
    "CURRENT_EVENT_SEQUENCE": 411,
    "CURRENT_MODE": 436,
}
NAMES = {number: name for name, number in IDS.items()}
_EVENT = struct.Struct("<IIHBBB")
_ATTITUDE = IDS["ATTITUDE"]
_PACE_AFTER_S = 1.0  # between the first stamp and the first estimate of the pace
_MAGIC_V2 = 0xFD
_MAGIC_V1 = 0xFE
_SHORTEST_V2 = 12  # bytes of a frame without payload
_SHORTEST_V1 = 8
_SIGNATURE_BYTES = 13


class Port(Protocol):
    """A way to one vehicle."""

    def now_s(self) -> float:
        """Clock of the port."""

    def receive(self, timeout_s: float) -> list[bytes]:
        """Datagrams that have come, waiting for the first one up to `timeout_s`."""

    def send(self, datagram: bytes) -> None:
        """Send to the vehicle; dropped while nobody has been heard."""

    def another_sender(self) -> Port:
        """Another sender's way to the same vehicle, from an address of its own."""

    def close(self) -> None:
        """Give the port back."""


class UdpPort:
    """A UDP socket: listens (`udpin`) and answers whom it hears, or speaks first (`udpout`)."""

    def __init__(self, bind: tuple[str, int] | None, peer: tuple[str, int] | None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        self._peer = peer
        self._is_peer_given = peer is not None
        try:
            self._socket.bind(bind or ("", 0))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def now_s(self) -> float:
        """Return the time of this computer's clock [s]."""
        return time.monotonic()

    def receive(self, timeout_s: float) -> list[bytes]:
        """Return the datagrams that are there, at the latest when the time is over."""
        select.select([self._socket], [], [], max(0.0, timeout_s))
        datagrams: list[bytes] = []
        while len(datagrams) < 256:
            try:
                datagram, sender = self._socket.recvfrom(4096)
            except (BlockingIOError, ConnectionRefusedError):
                break
            if not self._is_peer_given:
                self._peer = sender
            datagrams.append(datagram)
        return datagrams

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the peer; nothing is sent before the peer is known."""
        if self._peer is not None:
            try:
                self._socket.sendto(datagram, self._peer)
            except (BlockingIOError, ConnectionRefusedError):
                return  # nobody is there; silence says so later

    def another_sender(self) -> UdpPort:
        """Return a port of another address that sends to the same peer."""
        return UdpPort(None, self._peer)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def is_signed(frame: bytes) -> bool:
    """Whether a signature follows the checksum of a frame."""
    return frame[0] == _MAGIC_V2 and bool(frame[2] & 1)


@dataclass(slots=True)
class ReceivedPacket:
    """One frame: when it came (vehicle's time) and its bytes."""

    at_s: float
    message_id: int
    is_v1: bool
    frame: bytes
    _message: Any = None

    @property
    def system_id(self) -> int:
        """Sender's system."""
        if self.is_v1:
            return self.frame[3]
        return self.frame[5]

    @property
    def component_id(self) -> int:
        """Sender's component."""
        if self.is_v1:
            return self.frame[4]
        return self.frame[6]

    @property
    def message(self) -> Any:
        """Decoded by pymavlink, checksum included.

        Raises:
            common.MAVError: a broken frame.
        """
        if self._message is None:
            self._message = common.MAVLink(None).decode(bytearray(self.frame))
        return self._message

    def event_id(self) -> int:
        """Return the id of the event that an EVENT message reports."""
        payload = self.frame[10 : 10 + self.frame[1]].ljust(_EVENT.size, b"\0")
        return int(_EVENT.unpack_from(payload)[0])


@dataclass(slots=True)
class VehicleClock:
    """The vehicle's time: the stamps it sends (`time_boot_ms`), carried on at the measured pace."""

    pace: float = 1.0  # vehicle's time over the port's
    boot_s: float = 0.0  # newest stamp
    _port_s: float = 0.0  # port's time of it
    _first: tuple[float, float] | None = None  # port's time and stamp of the first
    _shown_s: float = 0.0  # newest time that somebody has read

    @property
    def is_known(self) -> bool:
        """Whether a stamp has come."""
        return self._first is not None

    def stamp(self, port_s: float, boot_s: float) -> None:
        """Take a stamp that arrived."""
        has_restarted = boot_s < self.boot_s - 0.5
        if self._first is None or has_restarted:
            self._first = (port_s, boot_s)
            self._shown_s = 0.0

        first_port_s, first_boot_s = self._first
        elapsed_s = port_s - first_port_s
        if elapsed_s > _PACE_AFTER_S:
            self.pace = min(50.0, max(0.05, (boot_s - first_boot_s) / elapsed_s))

        self.boot_s = boot_s
        self._port_s = port_s

    def now_s(self, port_s: float) -> float:
        """Return the vehicle's time, which never goes backwards."""
        if self._first is None:
            return 0.0
        self._shown_s = max(self._shown_s, self.boot_s + (port_s - self._port_s) * self.pace)
        return self._shown_s


@dataclass(slots=True)
class Recording:
    """Everything that came, by message."""

    packets: dict[int, list[ReceivedPacket]] = field(default_factory=lambda: defaultdict(list))
    datagrams: int = 0
    frames: int = 0
    v1_frames: int = 0
    octets: int = 0
    # came before the first stamp, and when
    _undated: list[tuple[ReceivedPacket, float]] = field(default_factory=list)

    def take(self, datagram: bytes, clock: VehicleClock, port_s: float) -> None:
        """File the frames of a datagram."""
        self.datagrams += 1
        self.octets += len(datagram)

        start = 0
        while start < len(datagram):
            frame = _frame(datagram, start)
            if frame is None:
                return
            self._file(frame, clock, port_s)
            start += len(frame)

        if clock.is_known and self._undated:
            for packet, came_s in self._undated:
                packet.at_s = max(0.0, clock.boot_s - (port_s - came_s))
            self._undated.clear()

    def _file(self, frame: bytes, clock: VehicleClock, port_s: float) -> None:
        is_v1 = frame[0] == _MAGIC_V1
        self.frames += 1
        if is_v1:
            self.v1_frames += 1
            message_id = frame[5]
            payload = frame[6:]
        else:
            message_id = int.from_bytes(frame[7:10], "little")
            payload = frame[10 : 10 + frame[1]]

        if message_id == _ATTITUDE:
            # Its first field is time_boot_ms; zeros at the end of a payload are not sent.
            clock.stamp(port_s, int.from_bytes(payload[:4], "little") * 1e-3)

        packet = ReceivedPacket(
            at_s=clock.now_s(port_s), message_id=message_id, is_v1=is_v1, frame=frame
        )
        self.packets[message_id].append(packet)
        if not clock.is_known:
            self._undated.append((packet, port_s))

    def of(
        self, name: str, since_s: float = 0.0, until_s: float = float("inf")
    ) -> list[ReceivedPacket]:
        """Return the packets of one message that came within a stretch of vehicle's time."""
        packets = self.packets.get(IDS[name], [])
        first = len(packets)
        while first and packets[first - 1].at_s >= since_s:
            first -= 1
        return [packet for packet in packets[first:] if packet.at_s < until_s]

    def newest(self, name: str) -> ReceivedPacket | None:
        """Return the newest packet of one message."""
        packets = self.packets.get(IDS[name])
        if not packets:
            return None
        return packets[-1]


def _frame(datagram: bytes, start: int) -> bytes | None:
    """Return the frame that starts here; None when there is none."""
    left = len(datagram) - start
    if datagram[start] == _MAGIC_V1 and left >= _SHORTEST_V1:
        length = datagram[start + 1] + _SHORTEST_V1
    elif datagram[start] == _MAGIC_V2 and left >= _SHORTEST_V2:
        length = datagram[start + 1] + _SHORTEST_V2
        if datagram[start + 2] & 1:
            length += _SIGNATURE_BYTES
    else:
        return None
    return datagram[start : start + length]
