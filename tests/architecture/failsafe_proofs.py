"""Which tests prove which row of the failsafe table, for docs/failsafe-proofs.md.

Three sources are put together:

* markers of tests, ``@pytest.mark.failsafe("own position lost", step="flying")``, which are read
  from the source, so that nothing has to be imported or run;
* the fault suite's injections, each of which names the conditions that somebody has to notice;
* the flights of the fault suite that have been flown last (`make bench-faults`), with which
  conditions were seen in them, in which air and at which height, and how near two came.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from onboard.safety.failsafe_table import TABLE, WORDS, Action, Condition, Situation
from onboard.supervision import condition_table
from sitl.lockstep.campaign.injections import INJECTIONS

TESTS = Path(__file__).parents[1]
FLOWN = TESTS / "sitl" / "lockstep" / "flown.json"
_MARKER = "failsafe"
_WHOLE_BENCH = 12  # flights of each fault by `make bench-faults`


@dataclass(frozen=True, slots=True)
class Proof:
    """One marker of one test."""

    condition: str
    step: str
    test: str  # file and name

    @property
    def wrong(self) -> str:
        """What is wrong with the marker, as a sentence; empty when nothing is."""
        if self.condition not in {condition.value for condition in Condition}:
            return f"{self.test} proves '{self.condition}', which is no condition."
        if self.step not in {situation.value for situation in Situation}:
            return f"{self.test} proves a row while '{self.step}', which is no situation."
        return ""


@cache
def proofs() -> tuple[Proof, ...]:
    """Return all markers of all tests."""
    found: list[Proof] = []
    for path in sorted(TESTS.rglob("test_*.py")):
        text = path.read_text(encoding="utf-8")
        if f"mark.{_MARKER}(" in text:
            found += _proofs_of(path, ast.parse(text))
    return tuple(found)


def _proofs_of(path: Path, tree: ast.Module) -> Iterator[Proof]:
    """Yield the markers of the tests of one file."""
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        for decorator in node.decorator_list:
            if _is_marker(decorator):
                assert isinstance(decorator, ast.Call)
                yield Proof(
                    condition=_constant(decorator.args[0]),
                    step=_constant(decorator.keywords[0].value),
                    test=f"{path.relative_to(TESTS).as_posix()}::{node.name}",
                )


def _is_marker(decorator: ast.expr) -> bool:
    return (
        isinstance(decorator, ast.Call)
        and isinstance(decorator.func, ast.Attribute)
        and decorator.func.attr == _MARKER
    )


def _constant(node: ast.expr) -> str:
    assert isinstance(node, ast.Constant), "a marker names its row by words"
    return str(node.value)


def tests_file() -> str:
    """Return the tests of each condition as TOML: what ``covey evidence`` names."""
    lines = [
        "# Tests by the condition that they show; printed from their markers by",
        "# `.venv/bin/python -m tests.architecture.documents --write`.",
        "[tests]",
    ]
    for condition in Condition:
        names = [f"{proof.test}" for proof in proofs() if proof.condition == condition.value]
        if names:
            quoted = ",\n".join(f'  "{name}"' for name in dict.fromkeys(names))
            lines.append(f'"{condition.value}" = [\n{quoted},\n]')
    return "\n".join(lines) + "\n"


def injections_of(condition: Condition) -> list[str]:
    """Return the faults of the suite of which somebody has to notice this condition, or others."""
    return [one.name for one in INJECTIONS if condition in one.own | one.others]


@cache
def flown() -> dict[str, Any]:
    """Return the results of the fault suite, by injection; empty before it has been flown."""
    if not FLOWN.exists():
        return {}
    results: dict[str, Any] = json.loads(FLOWN.read_text(encoding="utf-8"))
    return results


def without_proof() -> list[str]:
    """Return the conditions that no test proves.

    A fault of the suite proves a row only where its flights have brought the condition about, or as
    long as it has been flown less often than a whole bench flies it.
    """
    marked = {proof.condition for proof in proofs()}
    return [
        condition.value
        for condition in Condition
        if condition.value not in marked and not any(_proves(condition))
    ]


def _proves(condition: Condition) -> Iterator[bool]:
    """Yield for each fault that has to bring a condition about whether it may have done so."""
    for name in injections_of(condition):
        result = flown().get(name)
        if result is None or result.get("flights", _WHOLE_BENCH) < _WHOLE_BENCH:
            yield True
        else:
            yield condition.value in result["seen"]


def matrix() -> str:
    """Return the table of rows and their proofs."""
    lines = [
        line(
            "condition",
            "actions",
            "noticed by",
            "tests",
            "faults of the suite",
            "flights",
            "smallest distance m",
        ),
        "|---" * 7 + "|",
    ]
    for condition in Condition:
        tests = [
            f"`{proof.test.partition('::')[2]}` ({proof.step})"
            for proof in proofs()
            if proof.condition == condition.value
        ]
        faults = [f"{name}{_flown_words(name, condition)}" for name in _seen_in(condition)]
        lines.append(
            line(
                condition.value,
                ", ".join(_actions(condition)),
                _noticed(condition),
                "; ".join(tests) or "-",
                "; ".join(faults) or "-",
                *_flown_cells(condition),
            )
        )
    return "\n".join(lines)


def _flown_cells(condition: Condition) -> tuple[str, str]:
    """Return in how many flights a condition was seen, and how near two came in all of them.

    The distance is that of pairs which the law flies, in all flights of these faults.
    """
    results = [flown()[name] for name in _seen_in(condition) if name in flown()]
    count = sum(result["seen"].get(condition.value, 0) for result in results)
    if not count:
        return "-", "-"
    distances_m = [
        result["smallest_m"]
        for result in results
        if condition.value in result["seen"] and result["smallest_m"] is not None
    ]
    return str(count), _distance(min(distances_m, default=None))


def _actions(condition: Condition) -> list[str]:
    """Return the actions of a row in words, from the mildest, each once."""
    actions = {TABLE[situation, condition] for situation in Situation} - {Action.GO_ON}
    return [WORDS[action] for action in sorted(actions)] or [WORDS[Action.GO_ON]]


def _noticed(condition: Condition) -> str:
    """Return how long a condition has to last, in the words of docs/failsafe.md."""
    row = next(row for row in condition_table.ROWS if row.condition is condition)
    words = []
    for cause in row.causes:
        pace = "slow" if cause.is_slow else "every"
        words.append(f"{cause.checks} × {pace} tick{_longer(cause.over_s)}")
    return " or ".join(words)


def _longer(over_s: float | str | None) -> str:
    if over_s is None:
        return ""
    if isinstance(over_s, str):
        return f", over `{over_s}`"
    return f", over {over_s:g} s"


def _seen_in(condition: Condition) -> list[str]:
    """Return the faults that have to bring a condition about, and those that have done so."""
    seen = [name for name, result in flown().items() if condition.value in result.get("seen", {})]
    return list(dict.fromkeys([*injections_of(condition), *seen]))


def _flown_words(name: str, condition: Condition) -> str:
    result = flown().get(name)
    if result is None:
        return ""
    count = result["seen"].get(condition.value, 0)
    return f" (in {count} of {result['flights']})"


def flown_table() -> str:
    """Return the table of the faults that have been flown, for docs/failsafe.md."""
    lines = [
        line(
            "fault",
            "flights",
            "wrong",
            "missions",
            "vehicles",
            "heights m",
            "wind m/s",
            "smallest distance m",
            "to a vehicle that stops avoiding m",
        ),
        "|---" * 9 + "|",
    ]
    for name, result in flown().items():
        lines.append(
            line(
                name,
                str(result["flights"]),
                str(result["wrong"]),
                ", ".join(result["missions"]),
                _numbers(result["counts"]),
                _numbers(result["heights_m"]),
                _numbers(result["winds_m_s"]),
                _distance(result["smallest_m"]),
                _distance(result["smallest_silenced_m"]),
            )
        )

    flights = sum(result["flights"] for result in flown().values())
    wrong = sum(result["wrong"] for result in flown().values())
    return "\n".join([*lines, "", f"{flights} flights, {wrong} of them judged wrong."])


def line(*cells: str) -> str:
    """Return a row of a table."""
    return "| " + " | ".join(cells) + " |"


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def _distance(distance_m: float | None) -> str:
    return "-" if distance_m is None else f"{distance_m:.2f}"
