"""docs/px4-facts.md: every fact with what the emulator does.

Written by ``python -m tests.sitl.conformance.facts_page``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from sitl.conformance.facts import (
    VERSIONS,
    Fact,
    FactReport,
    FactResult,
    FactVerdict,
    facts_of,
    matching,
)
from sitl.conformance.suite import FACT_GROUPS, FACTS, LINKS, Terms, check
from tests.sitl.conformance.exceptions import DIFFERENCES
from tests.sitl.conformance.virtual import Wires

PAGE = Path(__file__).parents[3] / "docs" / "px4-facts.md"
_HEAD = """# What PX4 does, and what the emulator does

Facts of PX4 v1.16, v1.17 and v1.18 (SITL with its built-in SIH quadrotor, default parameters), as
`covey check endpoint` demands them of any MAVLink endpoint, and what the emulator answered as each of
them (`covey sitl --px4 1.18`). `covey check endpoint udpin://127.0.0.1:14540` asks yours, and
judges it by the version that it reports (`--px4` says another); it
turns the motors only of a vehicle that knows its own ground truth, which only a simulated one does.

All were measured with the command, on v1.16.0, on the branch of release 1.17 of October 2025 (v1.17.0-alpha1) and on
that of release 1.18 of August 2026 (v1.18.0-rc1); nothing here was only read in PX4's source. The facts of arming by
hand, of commands in hold and of a velocity in BODY_NED were measured on v1.16.0 and v1.18.0-rc1 alone. An empty place
under a newer version: as in the version before. Bounds are wide enough for what a real PX4 itself scatters. The
emulator flew PX4's own quadrotor in simulated time, seed 1; a vehicle of a fleet file steps and lasts as its type. A
second value is that of the first newer version of which other things are expected, a third that of the next. Written by `python -m tests.sitl.conformance.facts_page`.

{agree} of {all} facts agree, counted once for each version.{differ}
"""  # noqa: E501  lines of a page


def whole_check(px4: str = VERSIONS[0], seed: int = 1) -> FactReport:
    """Every fact, asked of the emulator in simulated time; those about the first sender in a run of
    their own.
    """
    facts = tuple(facts_of(px4, FACTS).values())
    report = FactReport(matching(facts, []))
    wires = Wires(seed=seed, px4=px4)
    check(
        wires.companion(),
        wires.ground_station(),
        report,
        Terms(),
        lambda line: None,
        wires.viewer(),
    )
    # what the whole check leaves out: it would lock the link, or a broken attitude control stands
    # in its way
    for names, terms in (
        (["link"], Terms(from_elsewhere=True)),
        (["setpoint.nan-quaternion*"], Terms()),
    ):
        if any(
            report.results[name].verdict is FactVerdict.SKIPPED for name in matching(facts, names)
        ):
            alone = FactReport(matching(facts, names))
            check(Wires(seed=seed, px4=px4).companion(), None, alone, terms, lambda line: None)
            skipped = [
                name
                for name, result in report.results.items()
                if result.verdict is FactVerdict.SKIPPED
            ]
            report.results |= {
                name: result for name, result in alone.results.items() if name in skipped
            }
    return report


def page(reports: Mapping[str, FactReport]) -> str:
    """The page as text, from one whole check of the emulator as each version."""
    results = [result for report in reports.values() for result in report.results.values()]
    differing = [result.fact.name for result in results if result.verdict is not FactVerdict.AGREES]
    differ = "\n\nNot emulated, or not quite:\n\n" if DIFFERENCES or differing else ""
    lines = [
        f"- `{name}`: {DIFFERENCES.get(name, 'unexplained')}"
        for name in dict.fromkeys((*DIFFERENCES, *differing))
    ]
    numbers = {"agree": len(results) - len(differing), "all": len(results)}
    out = [_HEAD.format(**numbers, differ=differ + "\n".join(lines)).rstrip()]
    done: set[str] = set()
    for phase in (*FACT_GROUPS, *(phase for phase, _ in LINKS)):
        facts = [f for f in phase.facts if f.name not in done]
        done |= {fact.name for fact in facts}
        if not facts:
            continue
        title = phase.name
        out += [
            "",
            f"## {title[0].upper()}{title[1:]}",
            "",
            f"| name | fact | {' | '.join(f'v{version}' for version in VERSIONS)} | emulator | |",
            f"|---|---|{'---|' * len(VERSIONS)}---|---|",
        ]
        out += [
            _row(fact, [reports[version].results[fact.name] for version in VERSIONS])
            for fact in facts
        ]
    return "\n".join(out) + "\n"


def _row(fact: Fact, results: Sequence[FactResult]) -> str:
    """One fact: what each version is expected to do where that differs, and what the emulator did
    as that version.
    """
    expected = [result.fact.expected for result in results]
    is_new = [now != then for now, then in zip(expected, ["", *expected], strict=False)]
    shown = [words if new else "" for words, new in zip(expected, is_new, strict=True)]
    measured = "; ".join(
        result.measured for result, new in zip(results, is_new, strict=True) if new
    )
    marks = {result.verdict.value for result in results if result.verdict is not FactVerdict.AGREES}
    cells = (f"`{fact.name}`", fact.says, *shown, measured, " ".join(sorted(marks)))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


if __name__ == "__main__":
    PAGE.write_text(page({version: whole_check(version) for version in VERSIONS}), encoding="utf-8")
    print(f"wrote {PAGE}")
