"""The kill key: it must be pressed twice within a second. Pure.

The console stops motors only at the second press. It gives a killed vehicle no orders until the
operator resets it. The same word makes it forget a silent vehicle that the fleet file lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from onboard.config.fleet import FleetConfig

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


def reset(
    names: str, latch: KillLatch, fleet: FleetConfig, forget_silent: Callable[[str], bool]
) -> str:
    """Allow orders to killed vehicles again, or forget a silent one that the fleet file lacks.

    Args:
        names: what the operator has written behind the word; empty: all killed vehicles.
        latch: the killed vehicles.
        fleet: the fleet file.
        forget_silent: forgets a silent vehicle by its name; returns whether there was one.

    Returns:
        What was done, in words.

    Raises:
        ConfigError: no vehicle has such a name.
    """
    if names and forget_silent(names):
        return f"{names} is forgotten until it is heard again."

    vehicles = latch.killed
    if names:
        vehicles = frozenset(fleet.select(names))
    released = ", ".join(sorted(latch.reset(vehicles)))
    if not released:
        return "No vehicle was killed from here."
    return f"{released} may be ordered again."
