"""How many mutants of each module were noticed: kept beside the benchmark, printed into docs."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tests.bench.mutant_reasons import ACCEPTED

KEPT = Path(__file__).parent / "mutants_measured.json"
ROOMS = ("safety", "flight", "avoidance", "supervision")
_ONBOARD = Path(__file__).parents[2] / "onboard"


class Measured(NamedTuple):
    """What was found about one module."""

    mutants: int
    noticed: int
    accepted: int  # survive for a reason
    survivors: tuple[str, ...]  # the others: their line and their change


def kept() -> dict[str, Measured]:
    """Return what was measured last, by the file below onboard."""
    found = json.loads(KEPT.read_text(encoding="utf-8"))
    return {
        file: Measured(**one | {"survivors": tuple(one["survivors"])})
        for file, one in found.items()
    }


def keep(measured: dict[str, Measured]) -> None:
    """Replace what is known of some modules."""
    merged = kept() | measured if KEPT.exists() else measured
    values = {file: merged[file]._asdict() for file in sorted(merged)}
    KEPT.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")


def table() -> str:
    """Return the figures of each module and of each room, as a table for docs."""
    lines = [
        "| room | module | mutants | noticed | accepted | not noticed |",
        "|---|---|---|---|---|---|",
    ]
    measured = kept()
    unmeasured = []
    for room in ROOMS:
        modules = {file: one for file, one in measured.items() if _room(file) == room}
        for file, one in modules.items():
            lines.append(f"| {room} | `{Path(file).stem}` | {_cells([one])} |")
        if modules:
            lines.append(f"| **{room}** | **all of these** | {_cells(modules.values())} |")
        unmeasured += [file for file in _files(room) if file not in measured]

    if unmeasured:
        names = ", ".join(f"`{file}`" for file in unmeasured)
        lines += ["", f"Not measured yet, as whole modules: {names}."]
    return "\n".join(lines)


def accepted_list() -> str:
    """Return the mutants that survive for a reason, as a list for docs."""
    lines = []
    for one in ACCEPTED:
        lines.append(f"* `{one.file}`: {one.reason}.")
        lines += [f"    * `{code}`: {change}" for code, change in one.mutants]
    return "\n".join(lines)


def _files(room: str) -> list[str]:
    """Return the modules of a room, below onboard."""
    paths = sorted((_ONBOARD / room).glob("*.py"))
    return [f"{room}/{path.name}" for path in paths if path.name != "__init__.py"]


def _room(file: str) -> str:
    return Path(file).parts[0]


def _cells(modules: Iterable[Measured]) -> str:
    rows = list(modules)
    figures = (
        sum(one.mutants for one in rows),
        sum(one.noticed for one in rows),
        sum(one.accepted for one in rows),
        sum(len(one.survivors) for one in rows),
    )
    return " | ".join(str(figure) for figure in figures)
