"""Killing needs the same key twice within a second; a killed vehicle takes no orders until it is
reset. Pure.
"""

from __future__ import annotations

from collections.abc import Iterable

KILL_WINDOW_S = 1.0


class KillLatch:
    """Remembers the first press of a kill key, and the vehicles that were killed from this console."""

    def __init__(self) -> None:
        self.killed: frozenset[str] = frozenset()
        # key, vehicles, time in s
        self._first_press: tuple[str, tuple[str, ...], float] | None = None

    def armed(self, now_s: float) -> tuple[str, ...]:
        """Return the vehicles that the next press of the same key stops; none when that press would
        only arm.
        """
        if self._first_press is not None and now_s - self._first_press[2] > KILL_WINDOW_S:
            self._first_press = None
        return () if self._first_press is None else self._first_press[1]

    def press(self, key: str, vehicles: tuple[str, ...], now_s: float) -> bool:
        """Return whether this press is the second one of the same key for the same vehicles."""
        self.armed(now_s)  # drops a first press that is too old
        first, self._first_press = self._first_press, (key, vehicles, now_s)
        is_second = first is not None and first[:2] == (key, vehicles)
        if is_second:
            self._first_press = None
        return is_second

    def add(self, vehicles: Iterable[str]) -> None:
        """Latch vehicles whose kill was sent."""
        self.killed |= frozenset(vehicles)

    def reset(self, vehicles: Iterable[str]) -> frozenset[str]:
        """Release vehicles; return those that were latched."""
        freed = self.killed.intersection(vehicles)
        self.killed -= freed
        return freed
