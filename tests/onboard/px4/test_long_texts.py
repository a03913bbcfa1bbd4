"""PX4's texts of more than 50 characters, which come in several messages."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.px4.mavsdk_link import Px4Link

_SYSTEM = 9
_WARNING = 4
_DENIED = "Arming denied: Resolve system health failures first\t"


def _pieces(text: str) -> list[str]:
    return [text[begin : begin + 50] for begin in range(0, len(text), 50)]


@pytest.fixture
def told() -> Iterator[Callable[..., str]]:
    """Have PX4 send pieces of texts, each with id and number, and return the link's text."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    link = Px4Link(f"udpin://127.0.0.1:{port}", _SYSTEM)
    mav = mavlink.MAVLink(None, _SYSTEM, 1)
    boot_ms = iter(range(1000, 10_000_000, 20))

    link.start()
    px4 = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(*pieces: tuple[int, int, str]) -> str:
        last_ns = link.snapshot().attitude_ns
        for text_id, number, piece in pieces:
            message = mav.statustext_encode(_WARNING, piece.encode(), text_id, number)
            px4.sendto(message.pack(mav), ("127.0.0.1", port))

        # an attitude after them shows that the link has received all pieces
        attitude = mav.attitude_quaternion_encode(next(boot_ms), 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        px4.sendto(attitude.pack(mav), ("127.0.0.1", port))
        end_s = time.monotonic() + 10.0
        while link.snapshot().attitude_ns == last_ns:
            assert time.monotonic() < end_s
            time.sleep(0.005)
        return link.snapshot().status_text

    try:
        with closing(px4):
            yield send
    finally:
        link.stop()


def test_a_text_of_two_pieces_is_told_as_a_whole(told: Callable[..., str]) -> None:
    first, second = _pieces(_DENIED)

    assert told((0, 0, first), (0, 1, second)) == _DENIED.strip()
    assert told((1, 0, "Ready")) == "Ready"
    assert told((2, 0, first)) == first
    assert told((2, 1, second)) == _DENIED.strip()


def test_the_rest_of_another_text_is_not_appended(told: Callable[..., str]) -> None:
    first, second = _pieces(_DENIED)

    assert told((0, 0, first), (1, 1, second)) == second.strip()


def test_a_text_without_an_end_does_not_grow_forever(told: Callable[..., str]) -> None:
    assert len(told(*((0, number, 50 * "a") for number in range(255)))) <= 200
