"""Text from outside, for terminals and text files: an escape sequence in it would command the
terminal.
"""

from __future__ import annotations

from typing import Any, TextIO, cast


def plain_line(text: str) -> str:
    """Return text from outside as one line without control characters.

    Args:
        text: of an event, a reply or a name.

    Returns:
        The text, a space for each run of white space or of characters that cannot be printed.
    """
    return " ".join(plain_lines(text).split())


def plain_lines(text: str) -> str:
    """Return text from outside without control characters, but with its lines and their
    indentation.

    Args:
        text: of several lines, as a trace.

    Returns:
        The text, a space for each character that cannot be printed.
    """
    lines = text.split("\n")
    if all(map(str.isprintable, lines)):
        return text
    return "\n".join(
        "".join(char if char.isprintable() else " " for char in line) for line in lines
    )


class PlainStream:
    """Output of a process whose lines may contain text from outside: no line can forget to clean
    it.

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
    """Return the stream below a :class:`PlainStream`, for what draws with escape sequences, as
    coloured tables.

    Args:
        stream: ``sys.stdout`` or ``sys.stderr``.
    """
    return cast(TextIO, getattr(stream, "stream", stream))
