"""What a feasibility check says: one quantity, its bound, a status, a sentence and a remedy. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

Status = Literal["ok", "warning", "refused"]
Relation = Literal["at least", "at most"]
ORDER: tuple[Status, ...] = ("refused", "warning", "ok")


@dataclass(frozen=True, slots=True)
class Finding:
    """One judged quantity: ``value`` must be ``relation`` ``bound``; the sentence says both, the remedy what to do."""

    name: str
    status: Status
    value: float
    bound: float
    unit: str
    relation: Relation
    sentence: str
    remedy: str


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Refusals, then warnings, then the rest, each in the order found."""
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.status)))


def worst(findings: Iterable[Finding]) -> Finding:
    """The finding that is nearest to its bound or farthest beyond it."""

    def room(finding: Finding) -> tuple[int, float]:
        sign = 1.0 if finding.relation == "at least" else -1.0
        return ORDER.index(finding.status), sign * (finding.value - finding.bound)

    return min(findings, key=room)


def least(
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
    """A finding whose value must not lie below the bound.

    ``{value}``, ``{bound}``, ``{relation}`` and ``{lack}`` stand for the numbers with their unit in both texts.
    """
    refuse, warn = bound if refuse_below is None else refuse_below, bound if warn_below is None else warn_below
    status = _judged(lambda limit: value < limit - 1e-9, refuse, warn)
    return _finding(name, status, (value, bound), unit, "at least", sentence, remedy)


def most(
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
    """A finding whose value must not lie above the bound; see :func:`least`."""
    refuse, warn = bound if refuse_above is None else refuse_above, bound if warn_above is None else warn_above
    status = _judged(lambda limit: value > limit + 1e-9, refuse, warn)
    return _finding(name, status, (value, bound), unit, "at most", sentence, remedy)


def _judged(is_beyond: Callable[[float], bool], refuse: float, warn: float) -> Status:
    return "refused" if is_beyond(refuse) else "warning" if is_beyond(warn) else "ok"


def _finding(
    name: str,
    status: Status,
    numbers: tuple[float, float],
    unit: str,
    relation: Relation,
    sentence: str,
    remedy: str,
) -> Finding:
    value, bound = numbers
    words = {
        "value": f"{value:.3g} {unit}".strip(),
        "bound": f"{bound:.3g} {unit}".strip(),
        "relation": relation,
        "lack": f"{abs(bound - value):.2f} {unit}".strip(),
    }
    said = sentence.format(**words) + "."
    if status == "ok":
        remedy = "Nothing to do."
    else:
        remedy = remedy.format(**words)
        said = f"{said} {remedy}"
    return Finding(name, status, round(value, 4), round(bound, 4), unit, relation, said, remedy)
