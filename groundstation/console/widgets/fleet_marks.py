"""The marked vehicles of the fleet table. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

ALL_MARKED_S = 5.0  # time after which marks on all vehicles end by themselves


class FleetMarks:
    """Marks belong to vehicles and not to rows; marks on all vehicles end after five seconds."""

    def __init__(self) -> None:
        self.names: frozenset[str] = frozenset()
        self._until_s = math.inf  # time at which the marks end by themselves

    def set(self, names: Iterable[str], known: Collection[str], now_s: float) -> None:
        """Mark these vehicles and no others; unknown names are left out."""
        self.names = frozenset(names).intersection(known)
        is_all = len(self.names) > 1 and len(self.names) == len(known)
        self._until_s = math.inf
        if is_all:
            self._until_s = now_s + ALL_MARKED_S

    def update(self, known: Collection[str], now_s: float) -> None:
        """Drop marks that have ended, and those of vehicles that have vanished."""
        if now_s >= self._until_s:
            self.names = frozenset()
            self._until_s = math.inf
        self.names = self.names.intersection(known)

    def keep(self, now_s: float) -> None:
        """Let the five seconds begin again, because the operator uses the marks."""
        if math.isfinite(self._until_s):
            self._until_s = now_s + ALL_MARKED_S

    def text(self, count: int, shown: Collection[str], now_s: float) -> str:
        """Return a few words for the border; ``count`` is the number of vehicles in the fleet."""
        if not self.names:
            return ""

        marked = len(self.names)
        is_all = marked >= count and marked >= 2
        words = "ALL marked" if is_all else f"{marked} marked"

        hidden = len(self.names.difference(shown))
        if hidden:
            words += f", {hidden} hidden by the filter"

        left_s = self._until_s - now_s
        if math.isfinite(left_s):
            words += f", {math.ceil(max(0.0, left_s))} s"
        return words
