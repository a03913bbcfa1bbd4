"""Datagrams to and from one MAVLink endpoint, recorded with the time of the vehicle.

A vehicle that is simulated faster than real time sends thousands of frames a second, so pymavlink
decodes only frames whose message is read.
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
# Messages that are missing in pymavlink's dialect.
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
_PACE_AFTER_S = 1.0  # time between the first stamp and the first estimate of the pace
_MIN_PACE = 0.05
_MAX_PACE = 50.0
_RESTART_S = 0.5  # a stamp that goes back by more than this means that the vehicle has restarted
_RECEIVE_BUFFER_BYTES = 1 << 21
_MAX_DATAGRAMS = 256  # datagrams read in one batch
_LARGEST_DATAGRAM = 4096
_ANY_ADDRESS = ("", 0)

# A frame of MAVLink 2: magic, payload length, flags, compatible flags, sequence, system, component,
# message id (3 bytes), payload. A frame of MAVLink 1: magic, payload length, sequence, system,
# component, message id (1 byte), payload.
_MAGIC_V2 = 0xFD
_MAGIC_V1 = 0xFE
_SIGNED_FLAG = 1
_SHORTEST_V2 = 12  # bytes of a frame without payload
_SHORTEST_V1 = 8
_SIGNATURE_BYTES = 13


class Port(Protocol):
    """A connection with one vehicle."""

    def now_s(self) -> float:
        """Return the time of the port's clock."""

    def receive(self, timeout_s: float) -> list[bytes]:
        """Return the datagrams that have arrived; wait for the first up to `timeout_s`."""

    def send(self, datagram: bytes) -> None:
        """Send to the vehicle; the datagram is dropped before the vehicle's address is known."""

    def another_sender(self) -> Port:
        """Return a port to the same vehicle from another address."""

    def close(self) -> None:
        """Close the port."""


class UdpPort:
    """A UDP socket.

    Args:
        bind: address to bind; None: any.
        peer: address of the vehicle (`udpout`); None: the sender of the newest datagram (`udpin`).
    """

    def __init__(self, bind: tuple[str, int] | None, peer: tuple[str, int] | None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        self._peer = peer
        self._is_peer_given = peer is not None
        try:
            self._socket.bind(_ANY_ADDRESS if bind is None else bind)
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def now_s(self) -> float:
        """Return the time of this computer's clock [s]."""
        return time.monotonic()

    def receive(self, timeout_s: float) -> list[bytes]:
        """Return the datagrams that have arrived; wait for the first up to `timeout_s`."""
        select.select([self._socket], [], [], max(0.0, timeout_s))
        datagrams: list[bytes] = []
        while len(datagrams) < _MAX_DATAGRAMS:
            try:
                datagram, sender = self._socket.recvfrom(_LARGEST_DATAGRAM)
            except OSError:
                break  # no datagram is left, or the peer does not exist
            if not self._is_peer_given:
                self._peer = sender
            datagrams.append(datagram)
        return datagrams

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the peer; nothing is sent before the peer is known."""
        if self._peer is not None:
            try:
                self._socket.sendto(datagram, self._peer)
            except OSError:
                return  # the peer cannot be reached; its silence will show this later

    def another_sender(self) -> UdpPort:
        """Return a port of another address that sends to the same peer."""
        return UdpPort(None, self._peer)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def is_signed(frame: bytes) -> bool:
    """Return whether a signature follows the checksum of a frame."""
    return frame[0] == _MAGIC_V2 and bool(frame[2] & _SIGNED_FLAG)


@dataclass(slots=True)
class ReceivedPacket:
    """One received frame."""

    at_s: float  # time of arrival, in the time of the vehicle
    message_id: int
    is_v1: bool
    frame: bytes
    _message: Any = None

    @property
    def system_id(self) -> int:
        """System of the sender."""
        if self.is_v1:
            return self.frame[3]
        return self.frame[5]

    @property
    def component_id(self) -> int:
        """Component of the sender."""
        if self.is_v1:
            return self.frame[4]
        return self.frame[6]

    @property
    def message(self) -> Any:
        """The message, decoded by pymavlink with a check of its checksum.

        Raises:
            common.MAVError: the frame is malformed.
        """
        if self._message is None:
            self._message = common.MAVLink(None).decode(bytearray(self.frame))
        return self._message

    def event_id(self) -> int:
        """Return the id of the event that an EVENT message reports."""
        payload = self.frame[10 : 10 + self.frame[1]].ljust(_EVENT.size, b"\0")
        event_id, *_ = _EVENT.unpack_from(payload)
        return int(event_id)


@dataclass(slots=True)
class VehicleClock:
    """The time of the vehicle: its stamps (`time_boot_ms`), extrapolated at the measured pace."""

    pace: float = 1.0  # time of the vehicle over time of the port
    boot_s: float = 0.0  # newest stamp
    _port_s: float = 0.0  # time of the port at the newest stamp
    _first: tuple[float, float] | None = None  # time of the port at the first stamp, and that stamp
    _shown_s: float = 0.0  # newest time that was returned

    @property
    def is_known(self) -> bool:
        """Whether a stamp has arrived."""
        return self._first is not None

    def stamp(self, port_s: float, boot_s: float) -> None:
        """Update the clock with a stamp that has arrived."""
        has_restarted = boot_s < self.boot_s - _RESTART_S
        if self._first is None or has_restarted:
            self._first = (port_s, boot_s)
            self._shown_s = 0.0

        first_port_s, first_boot_s = self._first
        elapsed_s = port_s - first_port_s
        if elapsed_s > _PACE_AFTER_S:
            pace = (boot_s - first_boot_s) / elapsed_s
            self.pace = min(_MAX_PACE, max(_MIN_PACE, pace))

        self.boot_s = boot_s
        self._port_s = port_s

    def now_s(self, port_s: float) -> float:
        """Return the time of the vehicle, which never decreases without a restart."""
        if self._first is None:
            return 0.0
        self._shown_s = max(self._shown_s, self.boot_s + (port_s - self._port_s) * self.pace)
        return self._shown_s


@dataclass(slots=True)
class Recording:
    """All received frames, by message."""

    packets: dict[int, list[ReceivedPacket]] = field(default_factory=lambda: defaultdict(list))
    datagrams: int = 0
    frames: int = 0
    v1_frames: int = 0
    octets: int = 0
    # Packets that arrived before the first stamp, with the time of the port at their arrival.
    _undated: list[tuple[ReceivedPacket, float]] = field(default_factory=list)

    def take(self, datagram: bytes, clock: VehicleClock, port_s: float) -> None:
        """Record the frames of a datagram."""
        self.datagrams += 1
        self.octets += len(datagram)

        start = 0
        while start < len(datagram):
            frame = _frame(datagram, start)
            if frame is None:
                return
            self._record_frame(frame, clock, port_s)
            start += len(frame)

        # The first stamp dates the earlier packets, as if the vehicle ran in real time.
        if clock.is_known and self._undated:
            for packet, arrival_s in self._undated:
                packet.at_s = max(0.0, clock.boot_s - (port_s - arrival_s))
            self._undated.clear()

    def _record_frame(self, frame: bytes, clock: VehicleClock, port_s: float) -> None:
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
            # The first field is time_boot_ms. Zeros at the end of a payload are not sent.
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
        """Return the packets of one message within an interval of the vehicle's time."""
        packets = self.packets.get(IDS[name], [])
        # search from the newest packet, because most callers ask for the last seconds
        first = len(packets)
        while first > 0 and packets[first - 1].at_s >= since_s:
            first -= 1
        return [packet for packet in packets[first:] if packet.at_s < until_s]

    def newest(self, name: str) -> ReceivedPacket | None:
        """Return the newest packet of one message."""
        packets = self.packets.get(IDS[name])
        if not packets:
            return None
        return packets[-1]


def _frame(datagram: bytes, start: int) -> bytes | None:
    """Return the frame that starts at an index; None when there is none."""
    left_bytes = len(datagram) - start
    if datagram[start] == _MAGIC_V1 and left_bytes >= _SHORTEST_V1:
        length = datagram[start + 1] + _SHORTEST_V1
    elif datagram[start] == _MAGIC_V2 and left_bytes >= _SHORTEST_V2:
        length = datagram[start + 1] + _SHORTEST_V2
        if datagram[start + 2] & _SIGNED_FLAG:
            length += _SIGNATURE_BYTES
    else:
        return None
    return datagram[start : start + length]
