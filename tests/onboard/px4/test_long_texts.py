"""PX4's texts of more than 50 characters, which come in several messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from tests.onboard.px4.wire import wired

_WARNING = 4
_DENIED = "Arming denied: Resolve system health failures first\t"


def _pieces(text: str) -> list[str]:
    return [text[begin : begin + 50] for begin in range(0, len(text), 50)]


@pytest.fixture
def told() -> Iterator[Callable[..., str]]:
    """Have PX4 send pieces of texts, each with id and number, and return the link's text."""
    boot_ms = iter(range(1000, 10_000_000, 20))
    with wired() as wire:

        def send(*pieces: tuple[int, int, str]) -> str:
            for text_id, number, piece in pieces:
                wire.send(wire.mav.statustext_encode(_WARNING, piece.encode(), text_id, number))
            return wire.attitude(next(boot_ms)).status_text

        yield send


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
