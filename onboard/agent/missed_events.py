"""Publishes events again to a ground that was cut off when they happened. Pure.

Each order finishes with an event, which is called the end of the order. If the link of a ground
breaks, the ground misses this event and would wait for it forever. Nor would it ever learn why a
vehicle landed, which a critical event says. So the newest of both are kept, and published again
when the ground is back. A ground that has heard one of them drops the repeat.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from onboard.agent_commands import Command, Publish
from onboard.bus.schema import Event

# The loss of a ground is noticed within this time, also by a busy computer. Too much does no harm.
_NOTICED_NS = 3_000_000_000
_WAIT_NS = 1_000_000_000  # time after which a ground that is back receives events
_MAX_ENDS = 8
_MAX_CRITICAL = 16
_MAX_GROUNDS = 16


class _Kept(NamedTuple):
    """An event that may be published again."""

    number: int  # events are numbered in the order in which they were published
    stamp_ns: int
    command: Publish


class MissedEvents:
    """Memory of the newest ends of orders and critical events, and of the grounds that were
    lost.
    """

    def __init__(self) -> None:
        # in memories of their own, so that no critical event pushes out an end that is waited for
        self._ends: deque[_Kept] = deque(maxlen=_MAX_ENDS)
        self._critical: deque[_Kept] = deque(maxlen=_MAX_CRITICAL)
        self._count = 0  # of all events that were kept
        # lost ground -> time from which it may have missed events
        self._missed_from_ns: dict[str, int] = {}
        # One repeat serves all grounds that are back.
        self._repeat_at_ns = 0  # time of the next repeat; 0: no repeat is pending
        self._repeat_from_ns = 0  # events since this time are then published again

    def see(self, ground: str, is_alive: bool, now_ns: int) -> None:
        """Note that a ground has appeared or was lost."""
        is_repeat_pending = self._repeat_at_ns != 0

        if not is_alive:
            if len(self._missed_from_ns) >= _MAX_GROUNDS:
                oldest = next(iter(self._missed_from_ns))
                self._missed_from_ns.pop(oldest)

            from_ns = now_ns - _NOTICED_NS
            if is_repeat_pending:
                # This ground may be one that waits for the repeat, and now misses it.
                from_ns = min(from_ns, self._repeat_from_ns)
            self._missed_from_ns[ground] = from_ns

        elif ground in self._missed_from_ns:
            from_ns = self._missed_from_ns.pop(ground)
            if is_repeat_pending:
                from_ns = min(from_ns, self._repeat_from_ns)
            self._repeat_from_ns = from_ns
            self._repeat_at_ns = now_ns + _WAIT_NS

    def pass_on(self, commands: Iterable[Command], now_ns: int) -> list[Command]:
        """Return the commands of a tick, followed by the events that must be published again.

        Events among the commands of the tick are kept.
        """
        repeated: list[Publish] = []
        if self._repeat_at_ns and now_ns >= self._repeat_at_ns:
            self._repeat_at_ns = 0
            for kept in sorted((*self._ends, *self._critical)):
                if kept.stamp_ns >= self._repeat_from_ns:
                    repeated.append(kept.command)

        new = list(commands)
        for command in new:
            if isinstance(command, Publish) and isinstance(command.message, Event):
                self._keep(command, command.message)
        return [*new, *repeated]

    def _keep(self, command: Publish, event: Event) -> None:
        """Keep the event if it ends an order that a ground may wait for, or is critical."""
        kept = _Kept(self._count, event.stamp_ns, command)
        self._count += 1

        is_end = event.order_outcome != "" and event.severity != "debug"
        if is_end:
            self._ends.append(kept)
        elif event.severity == "critical":
            self._critical.append(kept)
