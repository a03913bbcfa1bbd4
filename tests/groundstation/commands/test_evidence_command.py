"""``covey evidence``: what is wrong with the command line, before anything is flown."""

from __future__ import annotations

import pytest

from groundstation.cli import main
from onboard.exit_status import EXIT_WRONG_INPUT


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--wind", "12"], "may fly in 8.1 m/s at most"),
        (["--wind", "3", "--quick", "--rounds", "2"], "Give --quick or --rounds"),
        (["--wind", "3", "--rounds", "0"], "--rounds is 0"),
        (["--wind", "3", "--jobs", "0"], "--jobs is 0"),
        (["--wind", "3", "--beside", "nowhere"], "evidence.json: there is no such file"),
        (["--wind", "3", "--beside", "folder"], "the folder of this evidence itself"),
        (["--wind", "3", "--only", "no such fault"], "--only is 'no such fault'"),
        ([], "--wind"),
    ],
)
def test_a_wrong_command_line_is_refused_in_a_sentence_and_writes_nothing(
    options, sentence, tmp_path, capsys, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status = main(["evidence", "paper", "paper", "--out", "folder", *options])
    assert status == EXIT_WRONG_INPUT
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "folder").exists()
