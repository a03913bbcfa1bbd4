"""Signatures of MAVLink 2 packets: made, and checked as MAVLink's standard says. Pure.

The caller has the clock. The standard: https://mavlink.io/en/guide/message_signing.html. A
signature is a link id, a timestamp [10 us since 2015], and the first bytes of a SHA-256.
"""

from __future__ import annotations

import hmac
from enum import Enum
from hashlib import sha256

from onboard.px4.packets import SIGNATURE_BYTES, Packet

_DIGEST_BYTES = 6
_STAMP_BYTES = 6
_MINUTE_STEPS = 60 * 100_000  # in steps of 10 us
_NEW_STREAM_STEPS = _MINUTE_STEPS  # a sender that was not heard before may be so far behind
_WRONG_CLOCK_STEPS = _MINUTE_STEPS


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
        self._key = key
        self._link_id = link_id
        self._newest = 0  # timestamp of this sender and of all that it has checked

        # newest timestamp of each sender: system, component, link id
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

        signed = packet.data[:-_DIGEST_BYTES]
        digest = packet.data[-_DIGEST_BYTES:]
        if not hmac.compare_digest(self._digest(signed), digest):
            return SignatureVerdict.FORGED

        signature = packet.data[-SIGNATURE_BYTES:]
        link_id = signature[0]
        stamp = int.from_bytes(signature[1 : 1 + _STAMP_BYTES], "little")

        stream = (packet.system_id, packet.component_id, link_id)
        last = self._streams.get(stream)
        if last is None:
            oldest = max(clock, self._newest) - _NEW_STREAM_STEPS
        else:
            oldest = last + 1
        if stamp < oldest:
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
