"""Publishes ends of orders again to a ground that was cut off when they happened. Pure.

Each order finishes with an event, which is called the end of the order. If the link of a ground
breaks, the ground misses this event and would wait for it forever. So the newest ends are kept, and
published again when the ground is back.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from onboard.agent_commands import Command, Publish
from onboard.bus.schema import Event

_NOTICED_NS = 1_500_000_000  # the loss of a ground is noticed within this time
_WAIT_NS = 1_000_000_000  # time after which a ground that is back receives events
_MAX_ENDS = 8
_MAX_GROUNDS = 16


class LostEnds:
    """Memory of the newest ends of orders, and of the grounds that were lost."""

    def __init__(self) -> None:
        self._ends: deque[tuple[int, Publish]] = deque(maxlen=_MAX_ENDS)  # stamp [ns], event
        # lost ground -> time from which it may have missed ends
        self._missed_from_ns: dict[str, int] = {}
        # One repeat serves all grounds that are back.
        self._repeat_at_ns = 0  # time of the next repeat; 0: no repeat is pending
        self._repeat_from_ns = 0  # ends since this time are then published again

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
        """Return the commands of a tick, followed by the ends that must be published again.

        Ends among the commands of the tick are kept.
        """
        repeated: list[Publish] = []
        if self._repeat_at_ns and now_ns >= self._repeat_at_ns:
            self._repeat_at_ns = 0
            for stamp_ns, end in self._ends:
                if stamp_ns >= self._repeat_from_ns:
                    repeated.append(end)

        new = list(commands)
        for command in new:
            if isinstance(command, Publish) and isinstance(command.message, Event):
                self._keep(command, command.message)
        return [*new, *repeated]

    def _keep(self, command: Publish, event: Event) -> None:
        """Keep the event if it ends an order that a ground may wait for."""
        is_end = event.order_outcome != "" and event.severity != "debug"
        if is_end:
            self._ends.append((event.stamp_ns, command))
