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
_PACE_AFTER_S = 1.0
_MAGIC_V2, _MAGIC_V1 = 0xFD, 0xFE


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
        return time.monotonic()

    def receive(self, timeout_s: float) -> list[bytes]:
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
        if self._peer is not None:
            try:
                self._socket.sendto(datagram, self._peer)
            except (BlockingIOError, ConnectionRefusedError):
                return  # nobody is there; silence says so later

    def another_sender(self) -> UdpPort:
        return UdpPort(None, self._peer)

    def close(self) -> None:
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
        return self.frame[3 if self.is_v1 else 5]

    @property
    def component_id(self) -> int:
        """Sender's component."""
        return self.frame[4 if self.is_v1 else 6]

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
    """The vehicle's time between the stamps it sends: `time_boot_ms`, carried on at the measured
    pace.
    """

    pace: float = 1.0
    boot_s: float = 0.0
    _port_s: float = 0.0
    _first: tuple[float, float] | None = None
    _shown_s: float = 0.0

    @property
    def is_known(self) -> bool:
        """Whether a stamp has come."""
        return self._first is not None

    def stamp(self, port_s: float, boot_s: float) -> None:
        """A stamp arrived."""
        if self._first is None or boot_s < self.boot_s - 0.5:
            self._first, self._shown_s = (port_s, boot_s), 0.0
        elapsed = port_s - self._first[0]
        if elapsed > _PACE_AFTER_S:
            self.pace = min(50.0, max(0.05, (boot_s - self._first[1]) / elapsed))
        self.boot_s, self._port_s = boot_s, port_s

    def now_s(self, port_s: float) -> float:
        """Vehicle's time, never backwards."""
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
            is_v1 = datagram[start] == _MAGIC_V1
            left = len(datagram) - start
            if (not is_v1 and datagram[start] != _MAGIC_V2) or left < (8 if is_v1 else 12):
                return
            length = datagram[start + 1] + (8 if is_v1 else 12 + 13 * (datagram[start + 2] & 1))
            frame = datagram[start : start + length]
            message_id = frame[5] if is_v1 else int.from_bytes(frame[7:10], "little")
            if message_id == _ATTITUDE:
                stamp = frame[6:10] if is_v1 else frame[10 : min(14, 10 + frame[1])]
                clock.stamp(port_s, int.from_bytes(stamp, "little") * 1e-3)
            self.frames += 1
            self.v1_frames += is_v1
            packet = ReceivedPacket(clock.now_s(port_s), message_id, is_v1, frame)
            self.packets[message_id].append(packet)
            if not clock.is_known:
                self._undated.append((packet, port_s))
            start += length
        if clock.is_known and self._undated:
            for packet, came_s in self._undated:
                packet.at_s = max(0.0, clock.boot_s - (port_s - came_s))
            self._undated.clear()

    def of(
        self, name: str, since_s: float = 0.0, until_s: float = float("inf")
    ) -> list[ReceivedPacket]:
        """Packets of one message that came within a stretch of vehicle's time."""
        packets = self.packets.get(IDS[name], [])
        first = len(packets)
        while first and packets[first - 1].at_s >= since_s:
            first -= 1
        return [packet for packet in packets[first:] if packet.at_s < until_s]

    def newest(self, name: str) -> ReceivedPacket | None:
        """Last packet of one message."""
        packets = self.packets.get(IDS[name])
        return packets[-1] if packets else None
