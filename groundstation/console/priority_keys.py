"""A terminal driver that passes each key on at once.

It writes nothing once the terminal is gone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from textual import events
from textual.driver import Driver
from textual.message import Message


@dataclass(slots=True)
class TerminalHooks:
    """Hooks of the console in Textual's driver."""

    # Called with each key, on the thread that reads the terminal.
    on_key: Callable[[str], None]
    # The terminal is gone: what is written is dropped, so that nobody waits for it.
    is_closed: bool = False


class _HookedDriver(Driver):
    hooks: ClassVar[TerminalHooks]

    def process_message(self, message: Message) -> None:
        """Pass a key on before it waits among all that the event loop has to do."""
        if isinstance(message, events.Key):
            self.hooks.on_key(message.key)
        super().process_message(message)

    def write(self, data: str) -> None:
        """Write to the terminal while there is one.

        Textual's writing thread may have died of a closed terminal; its full queue would stop the
        event loop.
        """
        if not self.hooks.is_closed:
            # of the driver that this class is mixed into
            super().write(data)  # type: ignore[safe-super]


def with_hooks(driver: type[Driver], hooks: TerminalHooks) -> type[Driver]:
    """Return the same terminal driver with these hooks."""
    return type(f"Hooked{driver.__name__}", (_HookedDriver, driver), {"hooks": hooks})
