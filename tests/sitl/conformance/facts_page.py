"""docs/px4-facts.md: every fact with what the emulator does.

Written by ``python -m tests.sitl.conformance.facts_page``.
"""

from __future__ import annotations

from pathlib import Path

from sitl.conformance.facts import FactReport, Verdict, matching
from sitl.conformance.suite import FACTS, PHASES, Terms, check
from tests.sitl.conformance.exceptions import DIFFERENCES
from tests.sitl.conformance.virtual import Wires

PAGE = Path(__file__).parents[3] / "docs" / "px4-facts.md"
_HEAD = """# What PX4 does, and what the emulator does

Facts measured on PX4 v1.16.0 (SITL with its built-in SIH quadrotor, default parameters), as `covey sitl-check` demands
them of any MAVLink endpoint, and what the emulator answered. `covey sitl-check udpin://127.0.0.1:14540` asks yours; it
turns the motors only of a vehicle that knows its own ground truth, which only a simulated one does.

Bounds are wide enough for what a real PX4 itself scatters. In simulated time, seed 1; written by
`python -m tests.sitl.conformance.facts_page`.

{agree} of {all} facts agree.{differ}
"""


def whole_check(seed: int = 1) -> FactReport:
    """Every fact, asked of the emulator in simulated time; those about the first sender in a run of their own."""
    report = FactReport(matching(FACTS, []))
    wires = Wires(seed=seed)
    check(wires.companion(), wires.ground_station(), report, Terms(), lambda line: None)
    sender = FactReport(matching(FACTS, ["link"]))
    check(Wires(seed=seed).companion(), None, sender, Terms(from_elsewhere=True), lambda line: None)
    for name, finding in sender.results.items():
        if report.results[name].verdict is Verdict.SKIPPED:
            report.results[name] = finding
    return report


def page(report: FactReport) -> str:
    """The page as text."""
    differing = [name for name, finding in report.results.items() if finding.verdict is not Verdict.AGREES]
    agree = len(report.results) - len(differing)
    differ = "\n\nNot emulated, or not quite:\n\n" if DIFFERENCES or differing else ""
    named = dict.fromkeys((*DIFFERENCES, *differing))
    lines = [f"- `{name}`: {DIFFERENCES.get(name, 'unexplained')}" for name in named]
    numbers = {"agree": agree, "all": len(report.results)}
    out = [_HEAD.format(**numbers, differ=differ + "\n".join(lines)).rstrip()]
    done: set[str] = set()
    for phase in (*PHASES, None):
        facts = [f for f in (FACTS if phase is None else phase.facts) if f.name not in done]
        done |= {fact.name for fact in facts}
        if not facts:
            continue
        title = "the ground station's link" if phase is None else phase.name
        out += [
            "",
            f"## {title[0].upper()}{title[1:]}",
            "",
            "| name | fact | PX4 | emulator | |",
            "|---|---|---|---|---|",
        ]
        for fact in facts:
            finding = report.results[fact.name]
            mark = "" if finding.verdict is Verdict.AGREES else finding.verdict.value
            cells = (f"`{fact.name}`", fact.says, fact.expected, finding.measured, mark)
            out.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(whole_check()), encoding="utf-8")
    print(f"wrote {PAGE}")
