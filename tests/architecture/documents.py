"""Parts of docs/ that are printed from the code: ``python -m tests.architecture.documents
--write``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from tests.architecture import api_reference, commands, failsafe_proofs, reference, tables
from tests.bench import mutant_figures
from tests.onboard.flight import explorer

DOCS = Path(__file__).parents[2] / "docs"
# no document, but printed as they are: which tests show which row of the failsafe table
TESTS_FILE = Path(__file__).parents[2] / "groundstation" / "evidence" / "proofs.toml"

PRINTED: dict[str, tuple[str, Callable[[], str]]] = {
    "commands": ("commands.md", commands.commands),
    "failsafe": ("failsafe.md", tables.failsafes),
    "conditions": ("failsafe.md", tables.conditions),
    "flown": ("failsafe.md", failsafe_proofs.flown_table),
    "proofs": ("failsafe-proofs.md", failsafe_proofs.matrix),
    "steps": ("flight.md", tables.steps),
    "flight": ("flight.md", tables.flight),
    "explored": ("flight.md", lambda: explorer.explore().in_words()),
    "mutants": ("mutants.md", mutant_figures.table),
    "accepted-mutants": ("mutants.md", mutant_figures.accepted_list),
    "alarms": ("alarms.md", tables.alarms),
    "preflight": ("preflight.md", tables.preflight),
    "parameters": ("deployment.md", tables.parameters),
    "camera-parameters": ("deployment.md", tables.camera_parameters),
    "own-failsafes": ("px4.md", tables.own_failsafe_table),
    "emulated": ("emulator.md", tables.emulated),
    "roles": ("keys.md", tables.roles),
    "fleet-file": ("fleet-file.md", reference.fleet_file),
    "gallery": ("gallery.md", reference.gallery),
    "mission-file": ("mission-file.md", reference.mission_file),
    "scenes": ("open-benchmark.md", reference.scenes),
    "open-laws": ("open-benchmark.md", reference.open_laws),
    "scene-file": ("open-benchmark.md", reference.scene_file),
    "python-api": ("python-api.md", api_reference.python_api),
}


def _marks(name: str) -> tuple[str, str]:
    return f"<!-- {name}: begin -->", f"<!-- {name}: end -->"


def written(name: str) -> str:
    """The part as the document holds it now."""
    begin, end = _marks(name)
    return (
        (DOCS / PRINTED[name][0]).read_text(encoding="utf-8").split(begin)[1].split(end)[0].strip()
    )


def write(name: str) -> None:
    """Replace the part by what the code says."""
    (begin, end) = _marks(name)
    (file, text) = PRINTED[name]
    before, _, rest = (DOCS / file).read_text(encoding="utf-8").partition(begin)
    (DOCS / file).write_text(
        f"{before}{begin}\n{text()}\n{end}{rest.partition(end)[2]}", encoding="utf-8"
    )


if __name__ == "__main__":
    if "--write" in sys.argv:
        TESTS_FILE.write_text(failsafe_proofs.tests_file(), encoding="utf-8")
    for part in PRINTED:
        if "--write" in sys.argv:
            write(part)
        else:
            print(PRINTED[part][1]())
