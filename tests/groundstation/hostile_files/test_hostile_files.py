"""Files of others are refused in words: in little memory, without waiting, without a traceback."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

from groundstation.cli import main
from onboard.exit_status import EXIT_WRONG_INPUT
from tests.groundstation.hostile_files.corpus import CORPUS
from tests.groundstation.hostile_files.reading import outcome_in_process, warm_up

MAX_MB = 700.0  # that one file may take; 25 million pixels or 6 million values take 400

SLOW_TO_MAKE = [name for name, hostile in CORPUS.items() if hostile.is_slow_to_make]
FAST_TO_MAKE = [name for name in CORPUS if name not in SLOW_TO_MAKE]


@pytest.fixture(scope="module", autouse=True)
def _imports() -> None:
    warm_up()


@pytest.mark.parametrize("name", FAST_TO_MAKE)
def test_a_hostile_file_is_refused_in_words(name: str, tmp_path: Path) -> None:
    refuse(name, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("name", SLOW_TO_MAKE)
def test_a_large_hostile_file_is_refused_in_words(name: str, tmp_path: Path) -> None:
    refuse(name, tmp_path)


def test_numbers_that_overflow_cause_a_sentence_and_no_warnings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"{second},{second % 2}e308,0,1\n" for second in range(9))
    (tmp_path / "drone1.csv").write_text("t,x,y,z\n" + rows, encoding="utf-8")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        status = main(["import", str(tmp_path), "--out", str(tmp_path / "out")])
    assert status == EXIT_WRONG_INPUT
    assert capsys.readouterr().err.startswith(f"covey: {tmp_path}/drone1.csv: ")
    assert [str(one.message) for one in caught] == []


def refuse(name: str, folder: Path) -> None:
    """Open a file of the corpus; it must be refused, or be harmless."""
    hostile = CORPUS[name]
    outcome = outcome_in_process(hostile.door, hostile.make(folder))
    assert outcome.kind == hostile.outcome, outcome
    assert outcome.memory_mb < MAX_MB, outcome
    if outcome.kind == "refused":
        # a sentence about one file that says what to do, and not the content of the file
        assert outcome.sentence.endswith("."), outcome
        assert len(outcome.sentence) < 700, outcome
