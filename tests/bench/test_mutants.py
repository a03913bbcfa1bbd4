"""The benchmark of mutants: what it changes, and that it tells noticed mutants from survivors."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.bench.mutant_figures import kept
from tests.bench.mutant_reasons import ACCEPTED, code_of
from tests.bench.mutant_runs import ROOT, RoomFails, verdicts
from tests.bench.mutants import mutants_of

GEOFENCE = Path("onboard/safety/geofence.py")

# A room whose test notices one half of its mistakes.
ROOM = """
LIMIT = 3
NOBODY_ASKS = 5

def is_above(value):
    return value > LIMIT

def is_far_above(value):
    if value > 2 * LIMIT:
        return True
    return False

def never_tried(value):
    return value == 0
"""
TESTS = """
from a_room import is_above, is_far_above

def test_the_limit_itself_is_not_above():
    assert not is_above(3)
    assert is_above(4)

def test_far_above():
    assert is_far_above(100)
"""


def test_each_mutant_differs_from_the_file_and_from_all_others() -> None:
    texts = [ast.unparse(mutant.make_tree()) for mutant in mutants_of(GEOFENCE)]
    assert len(texts) > 5
    assert len(set(texts)) == len(texts)
    for text in texts:
        compile(text, "mutant", "exec")


def test_the_statement_around_a_change_and_when_it_is_executed_are_known(tmp_path: Path) -> None:
    (tmp_path / "a_room.py").write_text(ROOM, encoding="utf-8")
    found = {
        (mutant.line, mutant.change): (mutant.first_line, mutant.last_line, mutant.is_in_function)
        for mutant in mutants_of(Path("a_room.py"), tmp_path)
    }
    assert found[2, "3 becomes larger"] == (2, 2, False)
    assert found[6, "Gt becomes GtE"] == (6, 6, True)
    assert found[9, "2 becomes larger"] == (9, 10, True)


def test_each_accepted_mutant_is_one_of_its_file() -> None:
    for accepted in ACCEPTED:
        file = Path("onboard") / accepted.file
        lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
        there = {(code_of(lines[mutant.line - 1]), mutant.change) for mutant in mutants_of(file)}
        for mutant in accepted.mutants:
            assert mutant in there, (accepted.file, mutant)


def test_the_figures_are_of_modules_that_there_are() -> None:
    for file, measured in kept().items():
        there = sum(1 for _ in mutants_of(Path("onboard") / file))
        assert measured.mutants == measured.noticed + measured.accepted + len(measured.survivors)
        assert measured.mutants > 0
        assert there > 0, file


@pytest.mark.long
def test_mutants_are_noticed_or_survive_as_the_tests_of_their_room_say(tmp_path: Path) -> None:
    (tmp_path / "a_room.py").write_text(ROOM, encoding="utf-8")
    (tmp_path / "test_a_room.py").write_text(TESTS, encoding="utf-8")
    mutants = list(mutants_of(Path("a_room.py"), tmp_path))

    found = {
        (mutant.line, mutant.change): is_noticed
        for mutant, is_noticed in verdicts(["test_a_room.py"], mutants, tmp_path)
    }
    assert found == {
        (2, "3 becomes larger"): True,  # a constant
        (3, "5 becomes larger"): False,
        (6, "Gt becomes GtE"): True,  # inside a function
        (9, "Gt becomes GtE"): False,
        (9, "2 becomes larger"): False,
        (14, "Eq becomes NotEq"): False,
        (14, "0 becomes larger"): False,
    }
    assert (tmp_path / "a_room.py").read_text(encoding="utf-8") == ROOM


@pytest.mark.long
def test_a_room_whose_tests_fail_without_a_change_proves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a_room.py").write_text(ROOM, encoding="utf-8")
    wrong = TESTS.replace("assert is_above(4)", "assert is_above(1)")
    (tmp_path / "test_a_room.py").write_text(wrong, encoding="utf-8")
    mutants = list(mutants_of(Path("a_room.py"), tmp_path))
    with pytest.raises(RoomFails, match="the_limit_itself"):
        next(verdicts(["test_a_room.py"], mutants, tmp_path))
