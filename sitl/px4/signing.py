"""MAVLink signing as PX4 v1.18 does it.

One key is for all links of a vehicle and survives restarts. The timestamps of what a vehicle sends
are counted by each link; those of what it receives are remembered for each sender, so that nobody
can send a recorded message again.
"""

from __future__ import annotations

from hashlib import sha256

SIGNATURE_BYTES = 13  # link id, timestamp and six bytes of the hash
KEY_BYTES = 32
# SETUP_SIGNING brings a timestamp of 64 bits; a frame carries the lower 48 of them.
_LOWEST_48_BITS = 2**48 - 1
_TIMESTAMP_BYTES = 6
_STREAMS = 16  # most senders that are remembered
_NEW_STREAM = 60 * 100_000  # a sender that was not heard before may be a minute behind [10 us]
# HEARTBEAT, RADIO_STATUS, ADSB_VEHICLE, COLLISION: taken whatever their signature is
_TAKEN_UNSIGNED = frozenset({0, 109, 246, 247})


class KeyStore:
    """The key on one vehicle's memory card, and the senders since its PX4 started.

    Attributes:
        key: empty without one.
        timestamp: of the time at which the key was set [10 us since 2015].
        changes: counts new keys and restarts, which all links follow.
        streams: newest timestamp of each system, component and link.
    """

    def __init__(self) -> None:
        self.key = b""
        self.timestamp = 0
        self.changes = 0
        self.streams: dict[tuple[int, int, int], int] = {}

    def put(self, key: bytes, timestamp: int) -> None:
        """Keep a key; a blank one with timestamp 0 removes it."""
        is_key = any(key) or timestamp != 0
        self.key = key if is_key else b""
        self.timestamp = timestamp if self.key else 0
        self.changes += 1

    def restart(self) -> None:
        """Forget the senders."""
        self.streams.clear()
        self.changes += 1


class LinkSigning:
    """Signatures of one link.

    Args:
        store: parameter store of the vehicle.
        link_id: number of the link.
    """

    def __init__(self, store: KeyStore, link_id: int) -> None:
        self.store = store
        self._link_id = link_id
        self._timestamp = store.timestamp
        self._changes = store.changes

    def sign(self, frame: bytes) -> bytes:
        """Return a frame, whose flags say that it is signed, with its signature."""
        self._follow()

        timestamp = self._timestamp & _LOWEST_48_BITS
        self._timestamp += 1

        signed = frame + bytes((self._link_id,)) + timestamp.to_bytes(_TIMESTAMP_BYTES, "little")
        return signed + sha256(self.store.key + signed).digest()[:6]

    def takes(
        self, frame: bytes, message_id: int, sender: tuple[int, int], *, is_signed: bool
    ) -> bool:
        """Whether PX4 listens to a frame; the timestamp of one that it checked is remembered."""
        self._follow()
        if is_signed and self._is_fresh(frame, sender):
            return True
        return message_id in _TAKEN_UNSIGNED

    def _is_fresh(self, frame: bytes, sender: tuple[int, int]) -> bool:
        """Whether a frame has the right signature and is newer than the last of its sender."""
        if sha256(self.store.key + frame[:-6]).digest()[:6] != frame[-6:]:
            return False

        timestamp = int.from_bytes(frame[-12:-6], "little")
        streams = self.store.streams
        stream = (*sender, frame[-SIGNATURE_BYTES])

        if stream in streams:
            if timestamp <= streams[stream]:
                return False
        elif len(streams) >= _STREAMS or timestamp + _NEW_STREAM < self._timestamp:
            return False

        streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return True

    def _follow(self) -> None:
        """Count from the store's timestamp again when the key or the PX4 is a new one."""
        if self._changes != self.store.changes:
            self._timestamp = self.store.timestamp
            self._changes = self.store.changes
