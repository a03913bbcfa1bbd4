"""Signatures of MAVLink 2 packets: made, and checked as MAVLink's standard says. Pure; the caller
has the clock.
"""

from __future__ import annotations

import hmac
from enum import Enum
from hashlib import sha256

from onboard.px4.packets import SIGNATURE_BYTES, Packet

_DIGEST_BYTES = 6
_STAMP_BYTES = 6
_NEW_STREAM = 60 * 100_000  # a sender that was not heard before may be a minute behind
_OFF_STEPS = 60 * 100_000


class SignatureVerdict(Enum):
    """What a signature is worth."""

    FRESH = "fresh"
    UNSIGNED = "not signed"
    FORGED = "signed with another key"
    OLD = "signed, but older than what came before: a replay, or a sender whose clock went back"


class Signer:
    """Signs for one sender and checks what others signed with the same key.

    Its timestamps follow the clock but never go back: they are also above every one that PX4 has
    shown, so that a clock which is behind locks nobody out.

    Args:
        key: 32 bytes.
        link_id: tells senders with the same system and component apart.
    """

    def __init__(self, key: bytes, link_id: int) -> None:
        self._key, self._link_id = key, link_id
        self._newest = 0  # timestamp of this sender and of all that it has checked
        self._streams: dict[tuple[int, int, int], int] = {}
        self.behind = 0  # steps by which the clock was behind another sender's at last

    def sign(self, packet: bytes, clock: int) -> bytes:
        """Return a packet with its signature.

        Args:
            packet: with the flag of a signed one.
            clock: now [10 us since 2015].
        """
        self._newest = max(clock, self._newest + 1)
        data = packet + bytes((self._link_id,)) + self._newest.to_bytes(_STAMP_BYTES, "little")
        return data + self._digest(data)

    def check(self, packet: Packet, clock: int) -> SignatureVerdict:
        """Judge a packet, and remember its timestamp if it is fresh.

        Args:
            packet: as it came.
            clock: now [10 us since 2015].
        """
        if not packet.is_signed:
            return SignatureVerdict.UNSIGNED
        data = packet.data
        if not hmac.compare_digest(self._digest(data[:-_DIGEST_BYTES]), data[-_DIGEST_BYTES:]):
            return SignatureVerdict.FORGED
        signature = data[-SIGNATURE_BYTES:]
        stamp = int.from_bytes(signature[1 : 1 + _STAMP_BYTES], "little")
        stream = packet.system_id, packet.component_id, signature[0]
        last = self._streams.get(stream)
        oldest = max(clock, self._newest) - _NEW_STREAM if last is None else last + 1
        if stamp < oldest:
            return SignatureVerdict.OLD
        self._streams[stream] = stamp
        self._newest = max(self._newest, stamp)
        self.behind = stamp - clock
        return SignatureVerdict.FRESH

    @property
    def has_wrong_clock(self) -> bool:
        """Whether another sender's clock is a minute ahead of this computer's."""
        return self.behind > _OFF_STEPS

    def _digest(self, data: bytes) -> bytes:
        return sha256(self._key + data).digest()[:_DIGEST_BYTES]
