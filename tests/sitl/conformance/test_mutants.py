"""Deviations from PX4, made on purpose, are caught by the conformance suite; without them the same
facts agree.
"""

from __future__ import annotations

import pytest

from sitl.conformance.facts import FactReport, FactVerdict, facts_of, matching
from sitl.conformance.suite import FACTS, Terms, check
from tests.sitl.conformance.mutants import MUTANTS, Mutant
from tests.sitl.conformance.virtual import Wires


def verdict(fact: str, mutant: Mutant) -> tuple[FactVerdict, str]:
    """How one fact comes out, and what was measured."""
    wires = Wires(profile=mutant.profile, px4=mutant.px4)
    mutant.mutate(wires)
    report = FactReport(matching(facts_of(mutant.px4, FACTS).values(), [fact]))
    check(wires.companion(), None, report, Terms(may_turn_motors=True), lambda line: None)
    finding = report.results[fact]
    return finding.verdict, f"{finding.measured} {finding.reason}"


@pytest.mark.parametrize(
    "mutant",
    [pytest.param(m, id=m.name, marks=[pytest.mark.long] if m.flies else []) for m in MUTANTS],
)
def test_a_deviation_from_px4_is_caught_by_name(mutant: Mutant) -> None:
    found, measured = verdict(mutant.caught_by, mutant)
    assert found is FactVerdict.DIFFERS, f"{mutant.name}: {measured}"


def test_no_two_mutants_are_the_same() -> None:
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS) >= 20
