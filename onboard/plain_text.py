"""Cleans text from outside before it is written to terminals and text files.

An escape sequence in such a text would control the terminal. Therefore every character that cannot
be printed becomes a space.
"""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Sequence
from typing import Any, TextIO, cast

MAX_NAMES = 12  # more names in a line are counted, not read


def plain_line(text: str) -> str:
    """Return text from outside as one line without control characters.

    Args:
        text: Text of an event, a reply or a name.

    Returns:
        The text, with each run of white space or unprintable characters replaced by one space.
    """
    return " ".join(plain_lines(text).split())


def listed(names: Sequence[str], most: int = MAX_NAMES) -> str:
    """Return names in one line: the first names, and how many more there are.

    Args:
        names: One or more names.
        most: The largest number of names in the line.
    """
    shown = ", ".join(names[:most])
    hidden = len(names) - most
    if hidden > 0:
        return f"{shown} and {hidden} more"
    return shown


def numbered(count: int, noun: str) -> str:
    """Return a count with its noun, as "1 vehicle" or "2 vehicles"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def capitalised(words: str) -> str:
    """Return words with a capital letter, for the start of a sentence."""
    return words[0].upper() + words[1:]


def natural_sort_key(text: str) -> list[tuple[int, str]]:
    """Return a sort key that sorts mav10 after mav9."""
    key = []
    for part in re.split(r"(\d+)", text):
        if part.isdecimal():
            key.append((int(part), ""))
        else:
            key.append((-1, part))
    return key


def meant_words(word: str, names: Sequence[str]) -> str:
    """Return a question, with a space before it, that offers the name nearest to a wrong word.

    Args:
        word: The word that is none of the names.
        names: The names that are known.

    Returns:
        The question; empty if no name is near.
    """
    import difflib  # takes time, and is needed only for a wrong word

    nearest = difflib.get_close_matches(word, names, n=1, cutoff=0.7)
    if not nearest:
        return ""
    return f" Did you mean '{nearest[0]}'?"


def plain_lines(text: str) -> str:
    """Return text from outside without control characters, but with its lines and indentation.

    Args:
        text: Text of several lines, for instance a traceback.

    Returns:
        The text, with each unprintable character replaced by a space.
    """
    lines = text.split("\n")
    if all(map(str.isprintable, lines)):  # the usual case, quickly
        return text
    return "\n".join(map(_printable, lines))


def _printable(line: str) -> str:
    return "".join(char if char.isprintable() else " " for char in line)


def fitted(text: str, stream: TextIO) -> str:
    """Return a text of which no line is longer than a line of the terminal.

    Words longer than a line stay whole, so that paths can be copied. Further lines have the
    indentation of their first one.

    Args:
        text: One or more lines.
        stream: The stream to which the text is written. Unless it is a terminal of known width, the
            text stays as it is.
    """
    if not stream.isatty():
        return text
    width = os.get_terminal_size(stream.fileno()).columns
    if width < 1:
        return text
    return "\n".join(_wrapped(line, width) for line in text.split("\n"))


def _wrapped(line: str, width: int) -> str:
    if len(line) <= width:
        return line
    indentation = line[: len(line) - len(line.lstrip())]
    return textwrap.fill(
        line,
        width,
        subsequent_indent=indentation,
        break_long_words=False,
        break_on_hyphens=False,
    )


class PlainStream:
    """An output stream that cleans every text, because it may contain text from outside.

    Args:
        stream: The stream that gets the cleaned texts, for instance ``sys.stdout``.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text, without its control characters.

        Returns:
            The number of characters of ``text``.
        """
        self.stream.write(plain_lines(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the stream."""
        return getattr(self.stream, name)


def drawing(stream: TextIO) -> TextIO:
    """Return the stream below a :class:`PlainStream`, for output that needs escape sequences.

    Args:
        stream: ``sys.stdout`` or ``sys.stderr``.
    """
    return cast(TextIO, getattr(stream, "stream", stream))
