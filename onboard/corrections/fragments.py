"""An RTCM frame as fragments for MAVLink's GPS_RTCM_DATA. Pure.

A fragment has up to 180 bytes and one byte of flags: the lowest bit says that the frame is cut into
several fragments, two bits are the fragment's number, and five bits count the frames.

A program that reassembles a cut frame recognises the last fragment because it is the fourth or is
not full. So a shorter frame with a full last fragment gets one more fragment, which is empty.

PX4 does not reassemble frames. It passes every fragment on to its receiver, which checks the
frame's checksum.

The format: https://mavlink.io/en/messages/common.html#GPS_RTCM_DATA
"""

from __future__ import annotations

from msgspec import Struct

FRAGMENT_BYTES = 180
MAX_FRAGMENTS = 4
MAX_BYTES = FRAGMENT_BYTES * MAX_FRAGMENTS  # length of the longest frame that can be sent
SEQUENCES = 32  # frames are counted from 0 to 31

_IS_CUT = 1
_NUMBER_SHIFT = 1
_SEQUENCE_SHIFT = 3


class Fragment(Struct, frozen=True):
    """Content of one message GPS_RTCM_DATA."""

    flags: int
    data: bytes


def fragments_of(frame: bytes, sequence: int) -> tuple[Fragment, ...]:
    """Cut a frame into fragments.

    Args:
        frame: whole frame, at most :data:`MAX_BYTES` long.
        sequence: 0 to 31; it must differ from that of the previous frame.
    Returns:
        its fragments, in the order in which they are sent.
    """
    assert len(frame) <= MAX_BYTES
    sequence_flags = (sequence % SEQUENCES) << _SEQUENCE_SHIFT
    if len(frame) <= FRAGMENT_BYTES:
        return (Fragment(flags=sequence_flags, data=frame),)

    pieces = [
        frame[begin : begin + FRAGMENT_BYTES] for begin in range(0, len(frame), FRAGMENT_BYTES)
    ]
    if len(pieces[-1]) == FRAGMENT_BYTES and len(pieces) < MAX_FRAGMENTS:
        pieces.append(b"")

    fragments = []
    for number, piece in enumerate(pieces):
        flags = sequence_flags | (number << _NUMBER_SHIFT) | _IS_CUT
        fragments.append(Fragment(flags=flags, data=piece))
    return tuple(fragments)
