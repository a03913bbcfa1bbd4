"""docs/px4-facts.md: every fact with what the emulator does.

Written by ``python -m tests.sitl.conformance.facts_page``.
"""

from __future__ import annotations

from pathlib import Path

from sitl.conformance.facts import VERSIONS, FactReport, Verdict, facts_of, matching
from sitl.conformance.suite import FACTS, PHASES, Terms, check
from tests.sitl.conformance.exceptions import DIFFERENCES
from tests.sitl.conformance.virtual import Wires

PAGE = Path(__file__).parents[3] / "docs" / "px4-facts.md"
_HEAD = """# What PX4 does, and what the emulator does

Facts of PX4 v1.16, v1.17 and v1.18 (SITL with its built-in SIH quadrotor, default parameters), as `covey sitl-check`
demands them of any MAVLink endpoint, and what the emulator answered, which is a v1.16. `covey sitl-check
udpin://127.0.0.1:14540` asks yours, and judges it by the version that it reports (`--px4` says another); it turns the
motors only of a vehicle that knows its own ground truth, which only a simulated one does.

All were measured with the command, on v1.16.0, on the branch of release 1.17 of October 2025 (v1.17.0-alpha1) and on
that of release 1.18 of August 2026 (v1.18.0-rc1); nothing here was only read in PX4's source. An empty place under a
newer version: as in the version before. Bounds are wide enough for what a real PX4 itself scatters. The emulator in
simulated time, seed 1; written by `python -m tests.sitl.conformance.facts_page`.

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
    versions = [facts_of(version, FACTS) for version in VERSIONS]
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
            f"| name | fact | {' | '.join(f'v{version}' for version in VERSIONS)} | emulator | |",
            f"|---|---|{'---|' * len(VERSIONS)}---|---|",
        ]
        for fact in facts:
            finding = report.results[fact.name]
            mark = "" if finding.verdict is Verdict.AGREES else finding.verdict.value
            expected = [by_name[fact.name].expected for by_name in versions]
            shown = [now if now != then else "" for now, then in zip(expected, ["", *expected], strict=False)]
            cells = (f"`{fact.name}`", fact.says, *shown, finding.measured, mark)
            out.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(whole_check()), encoding="utf-8")
    print(f"wrote {PAGE}")
