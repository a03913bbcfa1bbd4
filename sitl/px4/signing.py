"""MAVLink signing as PX4 v1.18 does it.

All links of a vehicle use one key, which a restart keeps. Each link counts the timestamps of the
frames that it sends. The timestamps of received frames are stored for each sender, so that a
recorded frame cannot be sent again.
"""

from __future__ import annotations

from hashlib import sha256

SIGNATURE_BYTES = 13  # link id, timestamp and six bytes of the hash
KEY_BYTES = 32
# SETUP_SIGNING has a timestamp of 64 bits. A frame has the lower 48 of them.
_LOWEST_48_BITS = 2**48 - 1
_TIMESTAMP_BYTES = 6
_HASH_BYTES = 6
_MAX_STREAMS = 16  # largest number of stored senders
_NEW_STREAM_LAG = 60 * 100_000  # largest lag of the first timestamp of a sender [10 us]
# HEARTBEAT, RADIO_STATUS, ADSB_VEHICLE and COLLISION are accepted with any or no signature.
_ACCEPTED_UNSIGNED = frozenset({0, 109, 246, 247})


class KeyStore:
    """The key on the memory card of one vehicle, and the senders since the start of its PX4.

    Attributes:
        key: the key; empty if there is none.
        timestamp: time at which the key was set [10 us since 2015].
        changes: number of new keys and restarts, after which each link restarts its timestamps.
        streams: newest timestamp of each system, component and link.
    """

    def __init__(self) -> None:
        self.key = b""
        self.timestamp = 0
        self.changes = 0
        self.streams: dict[tuple[int, int, int], int] = {}

    def put(self, key: bytes, timestamp: int) -> None:
        """Store a key; a key of zeros with timestamp 0 removes it."""
        is_removal = not any(key) and timestamp == 0
        if is_removal:
            key = b""
        if not key:
            timestamp = 0
        self.key = key
        self.timestamp = timestamp
        self.changes += 1

    def restart(self) -> None:
        """Remove all senders, as a restart of PX4 does."""
        self.streams.clear()
        self.changes += 1


class LinkSigning:
    """Signatures of one link.

    Args:
        store: key store of the vehicle.
        link_id: number of the link.
    """

    def __init__(self, store: KeyStore, link_id: int) -> None:
        self.store = store
        self._link_id = link_id
        self._timestamp = store.timestamp
        self._changes = store.changes

    def sign(self, frame: bytes) -> bytes:
        """Return a frame with its signature; the flags of the frame have to announce it."""
        self._restart_after_change()

        timestamp = self._timestamp & _LOWEST_48_BITS
        self._timestamp += 1

        signed = frame + bytes((self._link_id,)) + timestamp.to_bytes(_TIMESTAMP_BYTES, "little")
        return signed + sha256(self.store.key + signed).digest()[:_HASH_BYTES]

    def takes(
        self, frame: bytes, message_id: int, sender: tuple[int, int], *, is_signed: bool
    ) -> bool:
        """Return whether PX4 accepts a frame; if the signature is right, store its timestamp."""
        self._restart_after_change()
        if is_signed and self._is_fresh(frame, sender):
            return True
        return message_id in _ACCEPTED_UNSIGNED

    def _is_fresh(self, frame: bytes, sender: tuple[int, int]) -> bool:
        """Return whether a frame has the right signature and is the newest from its sender."""
        signed = frame[:-_HASH_BYTES]
        if sha256(self.store.key + signed).digest()[:_HASH_BYTES] != frame[-_HASH_BYTES:]:
            return False

        timestamp = int.from_bytes(signed[-_TIMESTAMP_BYTES:], "little")
        streams = self.store.streams
        stream = (*sender, frame[-SIGNATURE_BYTES])

        if stream in streams:
            if timestamp <= streams[stream]:
                return False
        elif len(streams) >= _MAX_STREAMS or timestamp + _NEW_STREAM_LAG < self._timestamp:
            return False

        streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return True

    def _restart_after_change(self) -> None:
        """Restart from the stored timestamp after a new key or a restart of PX4."""
        if self._changes != self.store.changes:
            self._timestamp = self.store.timestamp
            self._changes = self.store.changes
