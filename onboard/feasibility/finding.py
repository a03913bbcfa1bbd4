"""Findings of feasibility checks: a quantity, its bound, a status, a sentence and a remedy. Pure.

A check computes one quantity of a fleet, and passes the quantity and its bound to :func:`at_least`
or :func:`at_most`. These functions decide the status and write the numbers into the sentence.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "note", "warning", "refused"]
Relation = Literal["at least", "at most"]

# The statuses, the worst first. A note says that something is not known. The owner of a fleet
# cannot fix it.
ORDER: tuple[Status, ...] = ("refused", "warning", "note", "ok")

# Because of rounding, a value counts as within its bound if it exceeds it by no more than this, and
# as a rounded number.
_ROUNDING = 1e-9
_DIGITS = 3  # of a number in a sentence
_MAX_DIGITS = 6


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of the check of one quantity: ``value`` must be ``relation`` ``bound``."""

    name: str
    status: Status
    value: float
    bound: float
    unit: str  # unit of value and bound
    relation: Relation
    sentence: str  # contains value and bound; ends with the remedy unless the status is ok
    remedy: str
    where: str = ""  # what the finding is about, such as a step of the mission; empty: the fleet
    never_refuses_flights: bool = False  # a flight begins even if the status is "refused"

    @property
    def title(self) -> str:
        """The name, and what the finding is about."""
        return f"{self.name}, {self.where}" if self.where else self.name


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort findings.

    Args:
        findings: any findings.
    Returns:
        The refusals, then the warnings, then the others; equal statuses keep their order.
    """
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.status)))


def worst(findings: Iterable[Finding]) -> Finding:
    """Return the worst of several findings of one kind.

    Args:
        findings: at least one finding.
    Returns:
        The finding with the worst status. Among several, the finding with its value nearest to the
        bound, or farthest beyond it.
    """
    return min(findings, key=_severity)


def at_least(
    name: str,
    value: float,
    bound: float,
    unit: str,
    sentence: str,
    remedy: str,
    *,
    where: str = "",
    never_refuses_flights: bool = False,
    refuse_below: float | None = None,
    warn_below: float | None = None,
) -> Finding:
    """Return the finding about a value that must not be less than its bound.

    Args:
        name: name of the finding.
        value: value of the quantity.
        bound: bound of the quantity.
        unit: unit of value and bound.
        sentence: template without a full stop. ``<value>``, ``<bound>`` and ``<difference>`` stand
            for the numbers with their unit, ``<relation>`` for "at least". The difference is
            rounded up, so that it is enough.
        remedy: template of the same kind, with a full stop.
        where: what the finding is about; empty: the fleet.
        never_refuses_flights: whether a flight begins even if the value is refused.
        refuse_below: a smaller value is refused; None: the bound; -inf: no value is refused.
        warn_below: a smaller value is a warning; None: the bound.
    """
    if refuse_below is None:
        refuse_below = bound
    if warn_below is None:
        warn_below = bound

    status: Status = "ok"
    if value < refuse_below - _ROUNDING:
        status = "refused"
    elif value < warn_below - _ROUNDING:
        status = "warning"

    return _finding(
        name=name,
        status=status,
        value=value,
        bound=bound,
        unit=unit,
        relation="at least",
        sentence=sentence,
        remedy=remedy,
        where=where,
        never_refuses_flights=never_refuses_flights,
    )


def at_most(
    name: str,
    value: float,
    bound: float,
    unit: str,
    sentence: str,
    remedy: str,
    *,
    where: str = "",
    never_refuses_flights: bool = False,
    refuse_above: float | None = None,
    warn_above: float | None = None,
) -> Finding:
    """Return the finding about a value that must not be greater than its bound.

    Args:
        name: name of the finding.
        value: value of the quantity.
        bound: bound of the quantity.
        unit: unit of value and bound.
        sentence: template as in :func:`at_least`.
        remedy: template as in :func:`at_least`.
        where: what the finding is about; empty: the fleet.
        never_refuses_flights: whether a flight begins even if the value is refused.
        refuse_above: a greater value is refused; None: the bound; inf: no value is refused.
        warn_above: a greater value is a warning; None: the bound.
    """
    if refuse_above is None:
        refuse_above = bound
    if warn_above is None:
        warn_above = bound

    status: Status = "ok"
    if value > refuse_above + _ROUNDING:
        status = "refused"
    elif value > warn_above + _ROUNDING:
        status = "warning"

    return _finding(
        name=name,
        status=status,
        value=value,
        bound=bound,
        unit=unit,
        relation="at most",
        sentence=sentence,
        remedy=remedy,
        where=where,
        never_refuses_flights=never_refuses_flights,
    )


def warning_of(name: str, sentence: str, remedy: str) -> Finding:
    """Return the warning about something in a fleet file that has no measured value.

    Args:
        name: name of the finding.
        sentence: sentence with its remedy; no template.
        remedy: remedy, which the sentence contains.
    """
    return Finding(
        name=name,
        status="warning",
        value=1.0,
        bound=0.0,
        unit="",
        relation="at most",
        sentence=sentence,
        remedy=remedy,
    )


def rounded_up(value: float, decimals: int) -> float:
    """Return the smallest number of so many decimals that is not less than a value.

    Args:
        value: a value.
        decimals: number of digits after the point.
    """
    scale = 10.0**decimals
    return math.ceil(scale * value - _ROUNDING) / scale


def rounded_down(value: float, decimals: int) -> float:
    """Return the largest number of so many decimals that is not greater than a value.

    Args:
        value: a value.
        decimals: number of digits after the point.
    """
    scale = 10.0**decimals
    return math.floor(scale * value + _ROUNDING) / scale


def _finding(
    *,
    name: str,
    status: Status,
    value: float,
    bound: float,
    unit: str,
    relation: Relation,
    sentence: str,
    remedy: str,
    where: str,
    never_refuses_flights: bool,
) -> Finding:
    """Return a finding whose templates are filled in."""
    digits = _DIGITS
    if status != "ok":
        digits = _digits_that_differ(value, bound)

    words = {
        "<value>": f"{value:.{digits}g} {unit}".strip(),
        "<bound>": f"{bound:.{digits}g} {unit}".strip(),
        "<relation>": relation,
        "<difference>": f"{rounded_up(abs(bound - value), 2):.2f} {unit}".strip(),
    }
    full_sentence = f"{sentence}."
    full_remedy = remedy
    for mark, word in words.items():
        full_sentence = full_sentence.replace(mark, word)
        full_remedy = full_remedy.replace(mark, word)

    if status == "ok":
        full_remedy = "Nothing to do."
    else:
        full_sentence = f"{full_sentence} {full_remedy}"

    return Finding(
        name=name,
        status=status,
        value=round(value, 4),
        bound=round(bound, 4),
        unit=unit,
        relation=relation,
        sentence=full_sentence,
        remedy=full_remedy,
        where=where,
        never_refuses_flights=never_refuses_flights,
    )


def _digits_that_differ(value: float, bound: float) -> int:
    """Return the number of digits with which two numbers look different in a sentence."""
    for digits in range(_DIGITS, _MAX_DIGITS):
        if f"{value:.{digits}g}" != f"{bound:.{digits}g}":
            return digits
    return _MAX_DIGITS


def _severity(finding: Finding) -> tuple[int, float]:
    """Return a sort key. It is smaller for a worse finding.

    Returns:
        The rank of the status, and how far within its bound the value is (negative: beyond it).
    """
    margin = finding.value - finding.bound
    if finding.relation == "at most":
        margin = -margin
    return ORDER.index(finding.status), margin
