"""The key of MAVLink signing at one link: signing and checking of messages, SETUP_SIGNING."""

from __future__ import annotations

from sitl.mavlink.codec import Decoder, Encoder, MavlinkMessage
from sitl.px4.commander import EmulatedPx4
from sitl.px4.signing import KeyStore, LinkSigning

_FLAGS_BYTE = 2  # index of incompat_flags in a frame of MAVLink 2
_FLAG_SIGNED = 0x01  # MAVLINK_IFLAG_SIGNED


class LinkKey:
    """Signing of one link.

    Args:
        store: key of the vehicle, common to all of its links.
        link_id: number of the link.
        encoder: encoder of the link, whose frames announce a signature while there is a key.
        decoder: decoder of the link, which checks signatures while there is a key.
    """

    def __init__(self, store: KeyStore, link_id: int, encoder: Encoder, decoder: Decoder) -> None:
        self._store = store
        self._signing = LinkSigning(store, link_id)
        self._encoder = encoder
        self._decoder = decoder
        self.follow()

    def follow(self) -> None:
        """Start signing and checking if there is a key, and stop both if there is none."""
        if self._store.key:
            self._encoder.is_signed = True
            self._decoder.takes = self._takes
        else:
            self._encoder.is_signed = False
            self._decoder.takes = None

    def signed(self, frames: list[bytes]) -> list[bytes]:
        """Return frames with their signatures, if there is a key."""
        if not self._store.key:
            return frames

        signed_frames: list[bytes] = []
        for frame in frames:
            # A frame that was encoded before there was a key has no flag and stays unsigned.
            needs_signature = bool(frame[_FLAGS_BYTE] & _FLAG_SIGNED)
            if needs_signature:
                signed_frames.append(self._signing.sign(frame))
            else:
                signed_frames.append(frame)
        return signed_frames

    def set_up(self, px4: EmulatedPx4, now_s: float, message: MavlinkMessage) -> None:
        """Store the key of a SETUP_SIGNING; a key of zeros with timestamp 0 removes it."""
        if not px4.version.knows_signing:
            return
        if px4.is_armed:
            px4.journal.say(now_s, "signing refused")
            return

        self._store.put(bytes(message.fields["secret_key"]), message.fields["initial_timestamp"])
        if self._store.key:
            px4.journal.say(now_s, "signing accepted")
        else:
            px4.journal.say(now_s, "signing disabled")
        self.follow()

    def _takes(self, message: MavlinkMessage, frame: bytes, is_signed: bool) -> bool:
        sender = message.system_id, message.component_id
        return self._signing.takes(frame, message.message_id, sender, is_signed=is_signed)
