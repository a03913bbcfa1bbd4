"""Text from outside, for terminals and text files. Pure."""

from __future__ import annotations


def plain_line(text: str) -> str:
    """Return text from outside as one line without control characters: an escape sequence would command the terminal.

    Args:
        text: of an event, a reply or a name.

    Returns:
        The text, a space for each run of white space or of characters that cannot be printed.
    """
    return " ".join("".join(char if char.isprintable() else " " for char in text).split())


def plain_lines(text: str) -> str:
    """Return text from outside without control characters, but with its lines and their indentation.

    Args:
        text: of several lines, as a trace.

    Returns:
        The text, a space for each character that cannot be printed.
    """
    return "\n".join("".join(char if char.isprintable() else " " for char in line) for line in text.split("\n"))
