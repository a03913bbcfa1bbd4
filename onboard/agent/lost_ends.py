"""Ends of orders that a ground missed while it was cut off: told again when it is back. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from onboard.agent_commands import Command, Publish
from onboard.bus.schema import Event

_NOTICED_NS = 1_500_000_000  # a ground that is cut off counts as there for so long
_WAIT_NS = 1_000_000_000  # until a ground that is back hears events, too
_MOST_ENDS, _MOST_GROUNDS = 8, 16


class LostEnds:
    """Memory of the newest ends of orders, and of the grounds that were lost."""

    def __init__(self) -> None:
        self._ends: deque[tuple[int, Publish]] = deque(maxlen=_MOST_ENDS)
        self._lost_ns: dict[str, int] = {}  # ground -> when it was lost
        self._from_ns = 0  # ends from then on are told again
        self._tell_ns = 0  # when; 0: nobody is back

    def see(self, ground: str, is_alive: bool, now_ns: int) -> None:
        """Take a ground's appearance or end."""
        if not is_alive:
            if len(self._lost_ns) >= _MOST_GROUNDS:
                self._lost_ns.pop(next(iter(self._lost_ns)))
            # lost again before anything was told: what it missed before is still to be told
            self._lost_ns[ground] = (
                min(now_ns, self._from_ns + _NOTICED_NS) if self._tell_ns else now_ns
            )
        elif ground in self._lost_ns:
            lost_ns = self._lost_ns.pop(ground) - _NOTICED_NS
            self._from_ns = min(self._from_ns, lost_ns) if self._tell_ns else lost_ns
            self._tell_ns = now_ns + _WAIT_NS

    def pass_on(self, commands: Iterable[Command], now_ns: int) -> list[Command]:
        """Return commands of a tick, with the ends that are to be told again."""
        out = list(commands)
        if self._tell_ns and now_ns >= self._tell_ns:
            self._tell_ns = 0
            out += [command for stamp_ns, command in self._ends if stamp_ns >= self._from_ns]
        for command in out:
            if not isinstance(command, Publish) or not isinstance(command.message, Event):
                continue
            message = command.message
            end = message.stamp_ns, command
            if message.order_outcome and message.severity != "debug" and end not in self._ends:
                self._ends.append(end)
        return out
