"""Makes and checks signatures of MAVLink 2 packets. Pure: the caller passes the time.

https://mavlink.io/en/guide/message_signing.html is the standard. A signature is a link id, a
timestamp [10 us since 2015], and the first bytes of a SHA-256.
"""

from __future__ import annotations

import hmac
from enum import Enum
from hashlib import sha256

from onboard.px4.packets import SIGNATURE_BYTES, Packet

_DIGEST_BYTES = 6
_STAMP_BYTES = 6
_MINUTE_STEPS = 60 * 100_000  # a minute in steps of 10 us
_NEW_STREAM_STEPS = _MINUTE_STEPS  # a new sender's first timestamp may be this far behind
_WRONG_CLOCK_STEPS = _MINUTE_STEPS  # our clock is wrong if another sender is further ahead


class SignatureVerdict(Enum):
    """Result of the check of a signature."""

    FRESH = "fresh"
    UNSIGNED = "not signed"
    FORGED = "signed with another key"
    OLD = "signed, but older than what came before: a replay, or a sender whose clock went back"


class Signer:
    """Signs packets of one sender, and checks packets that others signed with the same key.

    Every timestamp that it writes is greater than all earlier ones, and than every timestamp that
    it has checked. So PX4 accepts its packets even if this computer's clock is behind.

    Args:
        key: key of 32 bytes.
        link_id: distinguishes senders with the same system and component.
    """

    def __init__(self, key: bytes, link_id: int) -> None:
        self._key = key
        self._link_id = link_id
        self._newest = 0  # newest timestamp that this sender has used or checked

        # (system, component, link id) of a sender -> its newest timestamp
        self._streams: dict[tuple[int, int, int], int] = {}
        self.behind = 0  # how many steps our clock was behind that of the last checked sender

    def sign(self, packet: bytes, clock: int) -> bytes:
        """Return a packet with its signature.

        Args:
            packet: packet with the flag of a signed packet.
            clock: present time [10 us since 2015].
        """
        self._newest = max(clock, self._newest + 1)
        data = packet + bytes((self._link_id,)) + self._newest.to_bytes(_STAMP_BYTES, "little")
        return data + self._digest(data)

    def check(self, packet: Packet, clock: int) -> SignatureVerdict:
        """Check a packet's signature, and remember its timestamp if it is fresh.

        Args:
            packet: received packet.
            clock: present time [10 us since 2015].
        """
        if not packet.is_signed:
            return SignatureVerdict.UNSIGNED

        signed = packet.data[:-_DIGEST_BYTES]
        digest = packet.data[-_DIGEST_BYTES:]
        if not hmac.compare_digest(self._digest(signed), digest):
            return SignatureVerdict.FORGED

        signature = packet.data[-SIGNATURE_BYTES:]
        link_id, *stamp_and_digest = signature
        stamp = int.from_bytes(stamp_and_digest[:_STAMP_BYTES], "little")

        stream = (packet.system_id, packet.component_id, link_id)
        last_stamp = self._streams.get(stream)
        if last_stamp is None:
            oldest_stamp = max(clock, self._newest) - _NEW_STREAM_STEPS
        else:
            oldest_stamp = last_stamp + 1
        if stamp < oldest_stamp:
            return SignatureVerdict.OLD

        self._streams[stream] = stamp
        self._newest = max(self._newest, stamp)
        self.behind = stamp - clock
        return SignatureVerdict.FRESH

    @property
    def has_wrong_clock(self) -> bool:
        """Whether another sender's clock is a minute ahead of this computer's."""
        return self.behind > _WRONG_CLOCK_STEPS

    def _digest(self, data: bytes) -> bytes:
        return sha256(self._key + data).digest()[:_DIGEST_BYTES]
