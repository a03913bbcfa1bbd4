"""Text from outside on its way to a terminal: nothing in it commands the terminal."""

from __future__ import annotations

import io
import logging
import sys
from pathlib import Path

import pytest

from groundstation import cli
from onboard.plain_text import PlainStream, drawing, plain_line, plain_lines
from onboard.process import realtime

PAPER = Path(__file__).parents[2] / "configs" / "fleets" / "paper.toml"
_ESCAPE = "\x1b]0;owned\x07\x1b[2J\x9b1m\r\u202e"


def test_control_characters_become_spaces_and_all_else_stays() -> None:
    assert plain_lines("  Größe: 3 m²\n→ ok\n") == "  Größe: 3 m²\n→ ok\n"
    assert plain_lines(f"a{_ESCAPE}b\n\tc") == "a ]0;owned  [2J 1m  b\n c"
    assert plain_line("one\n  two\x1b") == "one two"


def test_what_a_process_prints_passes_through_it_and_drawings_do_not() -> None:
    raw = io.StringIO()
    stream = PlainStream(raw)
    print(f"PX4 says {_ESCAPE}", file=stream)
    assert raw.getvalue() == "PX4 says  ]0;owned  [2J 1m  \n"
    assert stream.encoding == raw.encoding
    assert drawing(stream) is raw  # type: ignore[arg-type]
    assert drawing(sys.stdout) is sys.stdout


def test_no_command_prints_what_a_file_has_put_into_its_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fleet.toml"
    words = PAPER.read_text(encoding="utf-8").replace(
        "[fleet]", '[fleet]\n"\\u001b]0;owned\\u0007" = 1', 1
    )
    path.write_text(words, encoding="utf-8")
    before = sys.stdout, sys.stderr
    assert cli.main(["check", str(path)]) == 2
    assert (sys.stdout, sys.stderr) == before
    said = "".join(capsys.readouterr())
    assert "owned" in said
    assert "\x1b" not in said


def test_an_agents_log_is_plain(capsys: pytest.CaptureFixture[str]) -> None:
    lines = realtime.log_elsewhere("mav0", "INFO")
    logging.getLogger("covey.agent").info("order %s of %s", "arm", f"me{_ESCAPE}")
    lines.stop()
    said = capsys.readouterr().err
    assert "order arm of me ]0;owned" in said
    assert "\x1b" not in said
