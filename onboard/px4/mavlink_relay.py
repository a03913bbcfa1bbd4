"""The relay between an agent and its PX4.

It signs the packets that leave, and lets in only packets that this PX4 has sent. A thread receives
them; it belongs to the agent's process and ends with it. No packet is kept to be sent later or once
more: it leaves in the call that made it, or never.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from msgspec.structs import replace

from onboard.autopilot import AUTOPILOT_COMPONENT, LinkError, Refused
from onboard.px4.packets import Packet, cut, is_read, packed
from onboard.px4.signing import SignatureVerdict, Signer
from onboard.px4.transport import Address, Transport, open_transport
from onboard.security.mavlink_key import signing_time

_HEARTBEAT = 0
_ANOTHER_NS = 3_000_000_000  # of silence, after which PX4 may send from another address
_GREET_NS = 900_000_000  # from one greeting to the next, at least
_GREETING = bytes((0, 0, 0, 0, 18, 8, 0, 4, 3))  # HEARTBEAT of an onboard controller

# what is counted for a signature that is not right: a field of ``Refused``
_BY_VERDICT = {
    SignatureVerdict.UNSIGNED: "unsigned",
    SignatureVerdict.FORGED: "forged",
    SignatureVerdict.OLD: "old",
}

log = logging.getLogger("covey.agent")


class Ids(NamedTuple):
    """MAVLink's ids of both ends."""

    system: int  # of the vehicle
    component: int  # of this end; the other one is the autopilot


class MavlinkRelay:
    """One autopilot's packets.

    Args:
        endpoint: of the fleet file.
        ids: of this vehicle.
        signer: where packets are signed; None for a vehicle that does not sign.
        on_packet: takes what was let in, on the relay's thread.
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
        self._sending = threading.Lock()  # several threads send
        self._sequence = 0  # of the packets sent

        self._rest = b""  # of a serial device: the begin of a packet
        self._peer: Address | None = None  # where PX4 sends from
        self._peer_ns = 0  # when it last did
        self._greeted_ns = 0

        self.other_system_id: int | None = None  # of another autopilot that is heard here
        self.refused = Refused()  # what was not let in
        self.is_signed = False  # whether the newest packet that was let in had a signature
        self.has_wrong_clock = False  # PX4's timestamps are far ahead of this computer's clock

    def start(self) -> None:
        """Open the endpoint, and receive from now on.

        Raises:
            LinkError: it cannot be opened.
        """
        try:
            self._transport = open_transport(self._endpoint)
        except (OSError, ValueError) as error:
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
        """Send one message now; while PX4's address is not known, nothing is sent.

        Args:
            number: kind of the message.
            payload: its bytes.
        """
        self._send(number, payload, self._peer)

    def _send(self, number: int, payload: bytes, address: Address | None) -> None:
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

    # -- what comes in, on the relay's thread ------------------------------------------------------

    def _run(self, transport: Transport) -> None:
        while self._transport is transport:
            data, address = transport.receive()
            if data:
                self._take(data, address)
            else:  # PX4 may wait for somebody to speak
                self._greet(self._peer)

    def _take(self, data: bytes, address: Address | None) -> None:
        """Take a datagram, or what came over a cable, where packets may be cut anywhere."""
        is_cable = address is None
        whole = self._rest + data
        self._rest = b""

        while whole:
            left_bytes = 0  # at the end, as :func:`cut` counts them
            for packet in cut(whole):
                if isinstance(packet, Packet):
                    self._judge(packet, address)
                else:
                    left_bytes = packet
            begins_a_packet = left_bytes > 0
            is_junk = left_bytes < 0

            # the rest of a packet comes over a cable later, in a datagram never
            if begins_a_packet and is_cable:
                self._rest = whole[-left_bytes:]
            elif begins_a_packet or is_junk:
                self._refuse("malformed", address)

            # behind junk on a cable more packets may follow
            if is_junk and is_cable:
                whole = _from_next_magic(whole[left_bytes:])
            else:
                whole = b""

    def _judge(self, packet: Packet, address: Address | None) -> None:
        """Let a packet in, or count it."""
        if not is_read(packet.number):
            return

        # of another vehicle, or of another component of this one
        if packet.component_id != AUTOPILOT_COMPONENT or packet.system_id != self._ids.system:
            if packet.number == _HEARTBEAT and packet.component_id == AUTOPILOT_COMPONENT:
                self.other_system_id = packet.system_id
            self.refused = replace(self.refused, others=self.refused.others + 1)
            return

        now_ns = time.monotonic_ns()
        is_peer = address == self._peer or now_ns - self._peer_ns > _ANOTHER_NS
        if not packet.is_right:
            self._refuse("malformed", address)
        elif not is_peer:
            self._refuse("other_address", address)
        elif self._is_fresh(packet, address):
            if address != self._peer:
                log.info("PX4 sends from %s", _words(address) or self._endpoint)
            self._peer = address
            self._peer_ns = now_ns
            self.is_signed = packet.is_signed
            self._on_packet(packet)

    def _is_fresh(self, packet: Packet, address: Address | None) -> bool:
        """Whether a packet may be taken: where packets are signed, whether its signature is right.

        A wrong one is counted.
        """
        if self._signer is None:
            return True

        with self._sending:
            verdict = self._signer.check(packet, signing_time(time.time_ns()))
            self.has_wrong_clock = self._signer.has_wrong_clock
        if verdict is SignatureVerdict.FRESH:
            return True

        self._refuse(_BY_VERDICT[verdict], address)
        # After a start PX4's timestamps are old until it has heard those of another system.
        if verdict is SignatureVerdict.OLD:
            self._greet(address)
        return False

    def _greet(self, address: Address | None) -> None:
        """Send a heartbeat, unless one was sent lately."""
        now_ns = time.monotonic_ns()
        if now_ns - self._greeted_ns > _GREET_NS:
            self._greeted_ns = now_ns
            self._send(_HEARTBEAT, _GREETING, address)

    def _refuse(self, reason: str, address: Address | None) -> None:
        refused = self.refused
        self.refused = replace(
            refused,
            **{reason: getattr(refused, reason) + 1},
            newest=reason,
            source=_words(address),
            newest_ns=time.monotonic_ns(),
        )


def _from_next_magic(data: bytes) -> bytes:
    """Return the bytes from the next one at which a packet may begin; empty where there is none."""
    indices = (data.find(b"\xfd", 1), data.find(b"\xfe", 1))
    begins = [index for index in indices if index > 0]
    if not begins:
        return b""
    return data[min(begins) :]


def _words(address: Address | None) -> str:
    if address is None:
        return ""
    return f"{address[0]} port {address[1]}"
