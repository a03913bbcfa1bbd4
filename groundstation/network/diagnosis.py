"""The findings of ``covey check computer``, each with a grade and a remedy, as text and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import IntEnum
from json import dumps

_WIDTH = 118
_GRADE_WIDTH = 6  # including the space after it
_NAME_WIDTH = 22


class Grade(IntEnum):
    """Severity of a finding."""

    OK = 0
    WARN = 1  # it flies, less well or less safely
    FAIL = 2  # it does not fly, or must not


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The finding about one thing."""

    name: str
    grade: Grade
    sentence: str
    remedy: str = ""  # what to do; empty if there is nothing to do


def graded(
    name: str, is_good: bool, sentence: str, remedy: str, *, bad: Grade = Grade.WARN
) -> Diagnosis:
    """Return a finding with grade OK and no remedy, or with a bad grade and the remedy.

    Args:
        name: name of the thing.
        is_good: whether the grade is OK.
        sentence: the finding in words, which is shown in both cases.
        remedy: what to do in the bad case.
        bad: grade of the bad case.
    """
    if is_good:
        return Diagnosis(name, Grade.OK, sentence)
    return Diagnosis(name, bad, sentence, remedy)


def worst(diagnoses: Iterable[Diagnosis]) -> Grade:
    """Return the worst grade."""
    return max((diagnosis.grade for diagnosis in diagnoses), default=Grade.OK)


def as_text(diagnoses: Iterable[Diagnosis]) -> str:
    """Return the lines for people."""
    indent = " " * (_GRADE_WIDTH + _NAME_WIDTH)
    lines = []
    for diagnosis in diagnoses:
        head = f"{diagnosis.grade.name:5s} {diagnosis.name:{_NAME_WIDTH - 1}s} "
        text = f"{diagnosis.sentence} {diagnosis.remedy}".strip()
        lines.append(
            textwrap.fill(head + text, _WIDTH, subsequent_indent=indent, break_long_words=False)
        )
    return "\n".join(lines)


def as_json(diagnoses: Iterable[Diagnosis]) -> str:
    """Return a list with an object for each line."""
    rows = [{**asdict(diagnosis), "grade": diagnosis.grade.name} for diagnosis in diagnoses]
    return dumps(rows, indent=2)
