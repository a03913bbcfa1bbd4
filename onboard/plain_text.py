"""Text from outside, for terminals and text files.

An escape sequence in it would command the terminal. So every character that cannot be printed
becomes a space.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TextIO, cast


def plain_line(text: str) -> str:
    """Return text from outside as one line without control characters.

    Args:
        text: of an event, a reply or a name.

    Returns:
        The text, a space for each run of white space or of characters that cannot be printed.
    """
    return " ".join(plain_lines(text).split())


def listed(names: Sequence[str], most: int) -> str:
    """Return names in one line, with the number of those that find no room.

    Args:
        names: one or more.
        most: so many are written out.
    """
    shown = ", ".join(names[:most])
    hidden = len(names) - most
    if hidden > 0:
        return f"{shown} and {hidden} more"
    return shown


def plain_lines(text: str) -> str:
    """Return text from outside without control characters; its lines and indentation stay.

    Args:
        text: of several lines, as a trace.

    Returns:
        The text, a space for each character that cannot be printed.
    """
    lines = text.split("\n")
    if all(map(str.isprintable, lines)):
        return text
    return "\n".join(map(_printable, lines))


def _printable(line: str) -> str:
    return "".join(char if char.isprintable() else " " for char in line)


class PlainStream:
    """Output of a process whose lines may contain text from outside.

    It cleans every text, so that no caller can forget to.

    Args:
        stream: where the lines go, as ``sys.stdout``.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text, without its control characters.

        Returns:
            the number of characters taken.
        """
        self.stream.write(plain_lines(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Return everything else as the stream has it."""
        return getattr(self.stream, name)


def drawing(stream: TextIO) -> TextIO:
    """Return the stream below a :class:`PlainStream`, for what draws with escape sequences.

    Args:
        stream: ``sys.stdout`` or ``sys.stderr``.
    """
    return cast(TextIO, getattr(stream, "stream", stream))
