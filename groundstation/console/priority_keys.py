"""Emergency keys are heard on the thread that reads the terminal: their orders leave while the loop still draws."""

from __future__ import annotations

from typing import Protocol, cast

from textual import events
from textual.driver import Driver
from textual.message import Message


class Hearer(Protocol):
    """What is told of each key, on the thread that reads the terminal."""

    def hear_key(self, key: str) -> None:
        """Do what cannot wait for the key's turn."""


class _PromptDriver(Driver):
    def process_message(self, message: Message) -> None:
        """Tell the app of a key before it waits among all that the loop has to do."""
        if isinstance(message, events.Key):
            cast(Hearer, self._app).hear_key(message.key)
        super().process_message(message)


def prompt(driver: type[Driver]) -> type[Driver]:
    """The same terminal driver, but :class:`Hearer`'s app hears each key at once."""
    return type(f"Prompt{driver.__name__}", (_PromptDriver, driver), {})
