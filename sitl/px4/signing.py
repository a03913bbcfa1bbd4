"""MAVLink signing as PX4 v1.18 does it: one key for all links, kept over restarts; timestamps
counted by each link.
"""

from __future__ import annotations

from hashlib import sha256

SIGNATURE_BYTES = 13
KEY_BYTES = 32
_STREAMS = 16
_NEW_STREAM = 60 * 100_000  # a sender that was not heard before may be a minute behind
# HEARTBEAT, RADIO_STATUS, ADSB_VEHICLE, COLLISION: taken whatever their signature is
_TAKEN_UNSIGNED = frozenset({0, 109, 246, 247})


class KeyStore:
    """The key on one vehicle's memory card, and who has spoken since its PX4 started.

    Attributes:
        key: empty without one.
        timestamp: of the day it was set.
        changes: counts new keys and restarts, which all links follow.
    """

    def __init__(self) -> None:
        self.key = b""
        self.timestamp = self.changes = 0
        self.streams: dict[tuple[int, int, int], int] = {}

    def put(self, key: bytes, timestamp: int) -> None:
        """Keep a key; a blank one with timestamp 0 is none."""
        self.key = key if any(key) or timestamp else b""
        self.timestamp = timestamp if self.key else 0
        self.changes += 1

    def restart(self) -> None:
        """Forget who has spoken."""
        self.streams.clear()
        self.changes += 1


class LinkSigning:
    """Signatures of one link.

    Args:
        store: of the vehicle.
        link_id: number of the link.
    """

    def __init__(self, store: KeyStore, link_id: int) -> None:
        self.store, self._link_id = store, link_id
        self._timestamp, self._changes = store.timestamp, store.changes

    def sign(self, frame: bytes) -> bytes:
        """Return a frame, whose flags say that it is signed, with its signature."""
        self._follow()
        data = frame + bytes((self._link_id,)) + self._timestamp.to_bytes(6, "little")
        self._timestamp += 1
        return data + sha256(self.store.key + data).digest()[:6]

    def takes(
        self, frame: bytes, message_id: int, sender: tuple[int, int], *, is_signed: bool
    ) -> bool:
        """Whether PX4 listens to a frame; the timestamp of one that it checked is remembered."""
        self._follow()
        return (is_signed and self._is_fresh(frame, sender)) or message_id in _TAKEN_UNSIGNED

    def _is_fresh(self, frame: bytes, sender: tuple[int, int]) -> bool:
        if sha256(self.store.key + frame[:-6]).digest()[:6] != frame[-6:]:
            return False
        timestamp = int.from_bytes(frame[-12:-6], "little")
        streams, stream = self.store.streams, (*sender, frame[-SIGNATURE_BYTES])
        if stream in streams:
            if timestamp <= streams[stream]:
                return False
        elif len(streams) >= _STREAMS or timestamp + _NEW_STREAM < self._timestamp:
            return False
        streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return True

    def _follow(self) -> None:
        if self._changes != self.store.changes:
            self._timestamp, self._changes = self.store.timestamp, self.store.changes
