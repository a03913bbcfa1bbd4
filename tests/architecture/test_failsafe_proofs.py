"""Every row of the failsafe table has a test, and every marker of a test has its row."""

from __future__ import annotations

import pytest

from groundstation.evidence import proofs
from onboard.safety.failsafe_table import Condition
from sitl.lockstep.campaign.injections import INJECTIONS
from tests.architecture import failsafe_proofs
from tests.architecture.documents import TESTS_FILE
from tests.architecture.failsafe_proofs import Proof


def test_every_row_of_the_failsafe_table_is_proved_by_a_test() -> None:
    assert failsafe_proofs.without_proof() == []


def test_a_row_without_a_test_and_without_a_fault_that_has_shown_it_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(failsafe_proofs, "proofs", tuple)
    monkeypatch.setattr(failsafe_proofs, "flown", dict)
    without = failsafe_proofs.without_proof()
    assert Condition.DISK_FULL.value in without
    assert Condition.POSITION_STALE.value not in without

    unseen: dict[str, dict[str, dict[str, int]]] = {
        injection.name: {"seen": {}} for injection in INJECTIONS
    }
    monkeypatch.setattr(failsafe_proofs, "flown", lambda: unseen)
    assert set(failsafe_proofs.without_proof()) == {condition.value for condition in Condition}


def test_every_marker_names_a_row_and_a_situation() -> None:
    assert [proof.wrong for proof in failsafe_proofs.proofs() if proof.wrong] == []
    assert len(failsafe_proofs.proofs()) > 40


def test_a_marker_that_names_no_row_is_found() -> None:
    fine = Proof(Condition.POSITION_LOST.value, "flying", "test_x.py::test_y")
    assert fine.wrong == ""
    assert "is no condition" in Proof("own position gone", "flying", "a test").wrong
    assert "is no situation" in Proof(Condition.POSITION_LOST.value, "up", "a test").wrong


def test_what_was_flown_names_faults_and_conditions_that_there_are() -> None:
    words = {condition.value for condition in Condition}
    faults = {injection.name for injection in INJECTIONS}
    for name, result in failsafe_proofs.flown().items():
        assert name in faults
        assert set(result["seen"]) <= words


def test_the_file_of_tests_that_evidence_names_is_printed_from_the_markers() -> None:
    assert TESTS_FILE.read_text(encoding="utf-8") == failsafe_proofs.tests_file()
    named = {name for names in proofs.tests_by_condition().values() for name in names}
    assert named == {proof.test for proof in failsafe_proofs.proofs()}
