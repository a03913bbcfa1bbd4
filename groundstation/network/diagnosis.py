"""What a doctor says: one line for each thing that was looked at, with what to do about it."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import IntEnum
from json import dumps

_WIDTH, _NAME_WIDTH = 118, 22


class Grade(IntEnum):
    """How bad it is."""

    OK = 0
    WARN = 1  # it flies, less well or less safely
    FAIL = 2  # it does not fly, or must not


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One thing that was looked at."""

    name: str
    grade: Grade
    sentence: str
    remedy: str = ""  # what to do; empty where nothing is to be done


def graded(
    name: str, is_good: bool, sentence: str, remedy: str, *, bad: Grade = Grade.WARN
) -> Diagnosis:
    """Return OK without the remedy, or what is bad with it."""
    return Diagnosis(name, Grade.OK if is_good else bad, sentence, "" if is_good else remedy)


def worst(found: Iterable[Diagnosis]) -> Grade:
    """Return the worst grade."""
    return max((one.grade for one in found), default=Grade.OK)


def as_text(found: Iterable[Diagnosis]) -> str:
    """Return the lines for people."""
    indent = " " * (6 + _NAME_WIDTH)
    lines = []
    for one in found:
        text = f"{one.sentence} {one.remedy}".strip()
        head = f"{one.grade.name:5s} {one.name:{_NAME_WIDTH - 1}s} "
        lines.append(
            textwrap.fill(head + text, _WIDTH, subsequent_indent=indent, break_long_words=False)
        )
    return "\n".join(lines)


def as_json(found: Iterable[Diagnosis]) -> str:
    """Return a list with an object for each line."""
    return dumps([{**asdict(one), "grade": one.grade.name} for one in found], indent=2)
