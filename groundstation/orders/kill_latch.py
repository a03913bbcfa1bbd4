"""The kill key: it must be pressed twice within a second. Pure.

The console stops motors only at the second press. It gives a killed vehicle no orders until the
operator resets it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

KILL_WINDOW_S = 1.0


class _Press(NamedTuple):
    """The first press of a kill key."""

    key: str
    vehicles: tuple[str, ...]
    time_s: float


class KillLatch:
    """Remembers the first press of a kill key, and the vehicles that were killed from here."""

    def __init__(self) -> None:
        self.killed: frozenset[str] = frozenset()
        self._first_press: _Press | None = None

    def armed(self, now_s: float) -> tuple[str, ...]:
        """Return the vehicles that the next press of the same key stops.

        The result is empty if that press would be a first one.
        """
        self._drop_old_press(now_s)
        return () if self._first_press is None else self._first_press.vehicles

    def press(self, key: str, vehicles: tuple[str, ...], now_s: float) -> bool:
        """Return whether this press is the second one of the same key for the same vehicles."""
        self._drop_old_press(now_s)
        first = self._first_press
        if first is not None and (first.key, first.vehicles) == (key, vehicles):
            self._first_press = None
            return True

        self._first_press = _Press(key, vehicles, now_s)
        return False

    def _drop_old_press(self, now_s: float) -> None:
        first = self._first_press
        if first is not None and now_s - first.time_s > KILL_WINDOW_S:
            self._first_press = None

    def add(self, vehicles: Iterable[str]) -> None:
        """Latch vehicles whose kill was sent."""
        self.killed |= frozenset(vehicles)

    def refusal(self, vehicles: Iterable[str]) -> str:
        """Return why an order to these vehicles is refused; empty if none of them is latched."""
        latched = sorted(self.killed.intersection(vehicles))
        if not latched:
            return ""
        names = ",".join(latched)
        pronoun = "it" if len(latched) == 1 else "them"
        return f"{names} was killed. Look at {pronoun}, then write: reset {names}"

    def reset(self, vehicles: Iterable[str]) -> frozenset[str]:
        """Release vehicles; return those that were latched."""
        released = self.killed.intersection(vehicles)
        self.killed -= released
        return released
