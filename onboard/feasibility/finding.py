"""Findings of feasibility checks: one quantity, its bound, a status, a sentence and a remedy. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warning", "refused"]
Relation = Literal["at least", "at most"]
ORDER: tuple[Status, ...] = ("refused", "warning", "ok")


@dataclass(frozen=True, slots=True)
class Finding:
    """One judged quantity: ``value`` must be ``relation`` ``bound``."""

    name: str
    status: Status
    value: float
    bound: float
    unit: str
    relation: Relation
    sentence: str  # with value and bound; ends with the remedy unless the status is ok
    remedy: str


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort findings.

    Args:
        findings: any.
    Returns:
        refusals, then warnings, then the rest, each in their former order.
    """
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.status)))


def worst(findings: Iterable[Finding]) -> Finding:
    """Return the worst of several findings of one kind.

    Args:
        findings: at least one.
    Returns:
        the one nearest to its bound or farthest beyond it.
    """

    return min(findings, key=_margin)


def at_least(
    name: str,
    value: float,
    bound: float,
    unit: str,
    sentence: str,
    remedy: str,
    *,
    refuse_below: float | None = None,
    warn_below: float | None = None,
) -> Finding:
    """Judge a value that must not lie below its bound.

    Args:
        name: of the finding.
        value: of the quantity.
        bound: to compare with.
        unit: of both.
        sentence: template without a full stop; ``{value}``, ``{bound}`` and ``{difference}`` stand
            for the numbers with their unit, ``{relation}`` for "at least".
        remedy: template of the same kind, with a full stop.
        refuse_below: the flight is refused below it; the bound by default.
        warn_below: there is a warning below it; the bound by default.
    Returns:
        the finding.
    """
    refuse, warn = (
        bound if refuse_below is None else refuse_below,
        bound if warn_below is None else warn_below,
    )
    status: Status = (
        "refused" if value < refuse - 1e-9 else "warning" if value < warn - 1e-9 else "ok"
    )
    return _finding(name, status, (value, bound), unit, "at least", (sentence, remedy))


def at_most(
    name: str,
    value: float,
    bound: float,
    unit: str,
    sentence: str,
    remedy: str,
    *,
    refuse_above: float | None = None,
    warn_above: float | None = None,
) -> Finding:
    """Judge a value that must not lie above its bound.

    Args:
        name: of the finding.
        value: of the quantity.
        bound: to compare with.
        unit: of both.
        sentence: template as in :func:`at_least`.
        remedy: template as in :func:`at_least`.
        refuse_above: the flight is refused above it; the bound by default.
        warn_above: there is a warning above it; the bound by default.
    Returns:
        the finding.
    """
    refuse, warn = (
        bound if refuse_above is None else refuse_above,
        bound if warn_above is None else warn_above,
    )
    status: Status = (
        "refused" if value > refuse + 1e-9 else "warning" if value > warn + 1e-9 else "ok"
    )
    return _finding(name, status, (value, bound), unit, "at most", (sentence, remedy))


def _finding(
    name: str,
    status: Status,
    numbers: tuple[float, float],
    unit: str,
    relation: Relation,
    texts: tuple[str, str],
) -> Finding:
    value, bound = numbers
    words = {
        "value": f"{value:.3g} {unit}".strip(),
        "bound": f"{bound:.3g} {unit}".strip(),
        "relation": relation,
        "difference": f"{abs(bound - value):.2f} {unit}".strip(),
    }
    sentence, remedy = (text.format(**words) for text in texts)
    sentence = f"{sentence}."
    if status == "ok":
        remedy = "Nothing to do."
    else:
        sentence = f"{sentence} {remedy}"
    return Finding(name, status, round(value, 4), round(bound, 4), unit, relation, sentence, remedy)


def _margin(finding: Finding) -> tuple[int, float]:
    sign = 1.0 if finding.relation == "at least" else -1.0
    return ORDER.index(finding.status), sign * (finding.value - finding.bound)
