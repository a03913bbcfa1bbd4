"""A terminal driver of Textual that passes on each key at once, so that emergency keys do not wait.

It also drops all output after the terminal has been closed.
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

    # called with each key, on the thread that reads the terminal
    on_key: Callable[[str], None]
    # whether the terminal is closed, so that all output is dropped
    is_closed: bool = False


class _HookedDriver(Driver):
    hooks: ClassVar[TerminalHooks]

    def process_message(self, message: Message) -> None:
        """Pass on a key before it is queued for the event loop."""
        if isinstance(message, events.Key):
            self.hooks.on_key(message.key)
        super().process_message(message)

    def write(self, data: str) -> None:
        """Write to the terminal, unless it is closed.

        Textual's writing thread may have ended because of a closed terminal. Then its queue would
        fill up and stop the event loop.
        """
        if not self.hooks.is_closed:
            # the method of the driver with which this class is combined
            super().write(data)  # type: ignore[safe-super]


def with_hooks(driver: type[Driver], hooks: TerminalHooks) -> type[Driver]:
    """Return a subclass of a terminal driver that calls these hooks."""
    return type(f"Hooked{driver.__name__}", (_HookedDriver, driver), {"hooks": hooks})
