"""Pieces of a file, in any order, become the file."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.px4 import file_pieces
from groundstation.px4.file_pieces import Pieces

WHOLE = bytes(range(256)) * 4


@settings(max_examples=60, deadline=None)
@given(
    cuts=st.lists(st.tuples(st.integers(0, 1023), st.integers(1, 200)), max_size=40),
    count=st.integers(0, 1024),
)
def test_whatever_arrives_only_what_is_whole_from_the_begin_is_written(
    cuts: list[tuple[int, int]], count: int
) -> None:
    pieces = Pieces(len(WHOLE), count)
    written = WHOLE[:count]

    for offset, size in cuts:
        written += pieces.add(offset, WHOLE[offset : offset + size])
        assert written == WHOLE[: pieces.bytes_in_order]

        begin, end = pieces.gap
        assert begin == pieces.bytes_in_order
        assert begin <= end <= len(WHOLE)

    while not pieces.is_whole:
        begin, end = pieces.gap
        written += pieces.add(begin, WHOLE[begin:end])

    assert written == WHOLE


def test_bytes_beyond_the_end_do_not_count() -> None:
    pieces = Pieces(10)
    assert pieces.add(0, b"x" * 50) == b"x" * 10
    assert pieces.add(30, b"y") == b""
    assert pieces.is_whole


def test_what_waits_behind_a_hole_is_bounded() -> None:
    size = 10 * file_pieces._MAX_WAITING_BYTES
    pieces = Pieces(size)

    for offset in range(1, size, 1_000_000):
        pieces.add(offset, b"x" * 1_000_000)

    assert pieces.drops_more
    assert pieces._waiting_bytes <= file_pieces._MAX_WAITING_BYTES + 1_000_000
