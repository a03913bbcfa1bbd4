"""Relays MAVLink packets between an agent and its PX4.

The relay signs the packets that it sends, and accepts only packets from this PX4. A thread of the
agent's process receives packets. A packet is sent in the call that makes it. The relay has no queue
and never repeats packets.
"""

from __future__ import annotations

import errno
import logging
import socket
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from msgspec.structs import replace

from onboard.autopilot import AUTOPILOT_COMPONENT, EndpointAbsentError, LinkError, Refused
from onboard.px4.packets import Packet, Remainder, cut, cut_stream, is_read, packed
from onboard.px4.signing import SignatureVerdict, Signer
from onboard.px4.transport import Address, Transport, open_transport
from onboard.security.mavlink_key import signing_time

_HEARTBEAT = 0
_ANOTHER_NS = 3_000_000_000  # after this silence, PX4 may send from another address
_GREET_NS = 900_000_000  # shortest time between two greetings
# a greeting is a HEARTBEAT of an onboard controller (type 18); this is its payload
_GREETING = bytes((0, 0, 0, 0, 18, 8, 0, 4, 3))

# errors of an endpoint that is not there yet: a device, the right to open it (udev gives it some
# time after the device has come), or a network interface
_ABSENT = frozenset(
    (
        errno.ENOENT,
        errno.ENODEV,
        errno.ENXIO,
        errno.EIO,
        errno.EACCES,
        errno.EADDRNOTAVAIL,
        errno.ENETUNREACH,
        errno.ENETDOWN,
        errno.EHOSTUNREACH,
    )
)

# verdict about a wrong signature -> field of ``Refused`` that counts it
_BY_VERDICT = {
    SignatureVerdict.UNSIGNED: "unsigned",
    SignatureVerdict.FORGED: "forged",
    SignatureVerdict.OLD: "old",
}

log = logging.getLogger("covey.agent")


class Ids(NamedTuple):
    """MAVLink's ids of an agent."""

    system: int  # system id of the vehicle, which agent and PX4 share
    component: int  # component id of the agent


class MavlinkRelay:
    """One autopilot's packets.

    Args:
        endpoint: endpoint of the fleet file.
        ids: ids of this agent.
        signer: signs and checks packets; None for a vehicle that does not sign.
        on_packet: called with each accepted packet, on the relay's thread.
    """

    def __init__(
        self, endpoint: str, ids: Ids, signer: Signer | None, on_packet: Callable[[Packet], None]
    ) -> None:
        self._endpoint = endpoint
        self._ids = ids
        self._signer = signer
        self._on_packet = on_packet

        self._transport: Transport | None = None  # while it is open
        self._thread: threading.Thread | None = None
        # protects sequence, transport and signer, because several threads send
        self._sending = threading.Lock()
        self._sequence = 0  # sequence of the next packet to send

        # the first bytes of a packet that a serial device has not delivered completely
        self._begun = b""
        self._peer: Address | None = None  # address from which PX4 sends
        self._peer_ns = 0  # time of PX4's newest packet
        self._greeted_ns = 0  # time of the last greeting

        self.other_system_id: int | None = None  # system id of another autopilot that was heard
        self.refused = Refused()  # counts of refused packets
        self.is_signed = False  # whether the newest accepted packet had a signature
        self.has_wrong_clock = False  # whether PX4's timestamps are far ahead of our clock

    def start(self) -> None:
        """Open the endpoint, and start receiving.

        Raises:
            EndpointAbsentError: The endpoint cannot be opened, but may be there later.
            LinkError: The endpoint cannot be opened.
        """
        try:
            self._transport = open_transport(self._endpoint)
        except (OSError, ValueError) as error:
            if _may_come(error):
                raise EndpointAbsentError(
                    f"{self._endpoint} cannot be opened ({error}). Connect it, allow this user to "
                    "open it, or correct 'autopilot' of this vehicle in the fleet file."
                ) from None
            raise LinkError(
                f"{self._endpoint} cannot be opened ({error}). Correct 'autopilot' of this vehicle "
                "in the fleet file."
            ) from None

        self._thread = threading.Thread(
            target=self._run, args=(self._transport,), name="link", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Close the endpoint; a second call does nothing."""
        transport = self._transport
        self._transport = None
        if transport is not None and self._thread is not None:
            transport.stop()
            self._thread.join()

    def send(self, number: int, payload: bytes) -> None:
        """Send one message now; nothing is sent while PX4's address is not known.

        Args:
            number: id of the message's kind.
            payload: bytes of its payload.
        """
        self._send(number, payload, self._peer)

    def _send(self, number: int, payload: bytes, address: Address | None) -> None:
        """Sign a message and send it to an address."""
        with self._sending:
            transport = self._transport
            if transport is None:
                return

            signer = self._signer
            data = packed(number, payload, self._sequence, *self._ids, is_signed=signer is not None)
            if signer is not None:
                data = signer.sign(data, signing_time(time.time_ns()))

            self._sequence = (self._sequence + 1) & 0xFF
            transport.send(data, address)

    # -- receiving, on the relay's thread ----------------------------------------------------------

    def _run(self, transport: Transport) -> None:
        while self._transport is transport:
            data, address = transport.receive()
            if data:
                self._take(data, address)
            else:  # PX4 may send nothing before it has received a packet
                self._greet(self._peer)

    def _take(self, data: bytes, address: Address | None) -> None:
        """Take a datagram, or bytes from a serial device, which may end within a packet."""
        if address is not None:
            for piece in cut(data):
                self._take_piece(piece, address)
            return

        pending = self._begun + data
        self._begun = b""
        for piece in cut_stream(pending):
            # a serial device delivers the rest of a packet later; a datagram is always complete
            if isinstance(piece, Remainder) and not piece.is_junk:
                self._begun = piece.data
            else:
                self._take_piece(piece, address)

    def _take_piece(self, piece: Packet | Remainder, address: Address | None) -> None:
        if isinstance(piece, Packet):
            self._judge(piece, address)
        else:
            self._refuse("malformed", address)

    def _judge(self, packet: Packet, address: Address | None) -> None:
        """Accept a packet, or count it as refused."""
        if not is_read(packet.number):
            return

        # packets of another vehicle, or of another component of this one
        if packet.component_id != AUTOPILOT_COMPONENT or packet.system_id != self._ids.system:
            is_autopilot = packet.component_id == AUTOPILOT_COMPONENT
            if packet.number == _HEARTBEAT and is_autopilot and packet.has_right_checksum:
                self.other_system_id = packet.system_id
            self.refused = replace(self.refused, others=self.refused.others + 1)
            return

        now_ns = time.monotonic_ns()
        is_peer = address == self._peer or now_ns - self._peer_ns > _ANOTHER_NS
        if not packet.has_right_checksum:
            self._refuse("malformed", address)
        elif not is_peer:
            self._refuse("other_address", address)
        elif self._is_fresh(packet, address):
            if address != self._peer:
                source = self._endpoint if address is None else _in_words(address)
                log.info("PX4 sends from %s", source)
            self._peer = address
            self._peer_ns = now_ns
            self.is_signed = packet.is_signed
            self._on_packet(packet)

    def _is_fresh(self, packet: Packet, address: Address | None) -> bool:
        """Return whether a packet's signature is valid and new; True for a vehicle without a key.

        A packet with a wrong signature is counted.
        """
        if self._signer is None:
            return True

        with self._sending:
            verdict = self._signer.check(packet, signing_time(time.time_ns()))
            self.has_wrong_clock = self._signer.has_wrong_clock
        if verdict is SignatureVerdict.FRESH:
            return True

        self._refuse(_BY_VERDICT[verdict], address)
        # After its start, PX4's timestamps are old until it has received another system's
        # timestamps.
        if verdict is SignatureVerdict.OLD:
            self._greet(address)
        return False

    def _greet(self, address: Address | None) -> None:
        """Send a heartbeat, unless one was sent less than _GREET_NS ago."""
        now_ns = time.monotonic_ns()
        if now_ns - self._greeted_ns > _GREET_NS:
            self._greeted_ns = now_ns
            self._send(_HEARTBEAT, _GREETING, address)

    def _refuse(self, reason: str, address: Address | None) -> None:
        """Count a refused packet; ``reason`` is a field of ``Refused``."""
        refused = self.refused
        self.refused = replace(
            refused,
            **{reason: getattr(refused, reason) + 1},
            newest=reason,
            source=_in_words(address),
            newest_ns=time.monotonic_ns(),
        )


def _in_words(address: Address | None) -> str:
    """Return an address for people; empty for a serial device, which has none."""
    if address is None:
        return ""
    host, port = address
    return f"{host} port {port}"


def _may_come(error: Exception) -> bool:
    """Return whether an endpoint that could not be opened may be there later, by itself."""
    if isinstance(error, socket.gaierror):  # a name that cannot be resolved without a network
        return True
    return isinstance(error, OSError) and error.errno in _ABSENT
