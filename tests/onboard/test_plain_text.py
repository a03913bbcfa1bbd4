"""Text from outside on its way to a terminal: nothing in it commands the terminal."""

from __future__ import annotations

import fcntl
import io
import logging
import os
import struct
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TextIO, cast

import pytest

from groundstation import cli
from onboard.plain_text import (
    PlainStream,
    drawing,
    fitted,
    listed,
    natural_sort_key,
    plain_line,
    plain_lines,
)
from onboard.process import realtime

PAPER = Path(__file__).parents[2] / "configs" / "fleets" / "paper.toml"
_ESCAPE = "\x1b]0;owned\x07\x1b[2J\x9b1m\r\u202e"


def test_control_characters_become_spaces_and_all_else_stays() -> None:
    assert plain_lines("  Größe: 3 m²\n→ ok\n") == "  Größe: 3 m²\n→ ok\n"
    assert plain_lines(f"a{_ESCAPE}b\n\tc") == "a ]0;owned  [2J 1m  b\n c"
    assert plain_line("one\n  two\x1b") == "one two"


def test_many_names_are_counted_and_few_are_named() -> None:
    names = [f"mav{number}" for number in range(30)]
    assert listed(names[:2]) == "mav0, mav1"
    assert listed(names[:12]) == ", ".join(names[:12])
    assert listed(names) == ", ".join(names[:12]) + " and 18 more"


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
    lines = realtime.log_in_thread("mav0", "INFO")
    logging.getLogger("covey.agent").info("order %s of %s", "arm", f"me{_ESCAPE}")
    lines.stop()
    said = capsys.readouterr().err
    assert "order arm of me ]0;owned" in said
    assert "\x1b" not in said


class Terminal(NamedTuple):
    """A terminal of 40 columns, and the end from which its screen is read."""

    stream: TextIO
    screen: int

    def text(self) -> str:
        self.stream.flush()
        return os.read(self.screen, 10_000).decode().replace("\r\n", "\n")


@pytest.fixture
def narrow_terminal() -> Iterator[Terminal]:
    screen, terminal = os.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 40, 0, 0))
    with os.fdopen(terminal, "w") as stream:
        yield Terminal(stream, screen)
    os.close(screen)


def test_on_a_terminal_no_line_is_longer_than_the_terminal_and_no_word_breaks(
    narrow_terminal: Terminal,
) -> None:
    text = "  a well-known refusal that is much longer than one line\nand /a/path" + "/x" * 30
    assert fitted(text, cast(TextIO, PlainStream(narrow_terminal.stream))).split("\n") == [
        "  a well-known refusal that is much",
        "  longer than one line",
        "and",
        "/a/path" + "/x" * 30,
    ]


def test_in_a_file_or_a_pipe_a_long_line_stays_whole(tmp_path: Path) -> None:
    text = "a word " * 50
    with (tmp_path / "refusals.txt").open("w") as file:
        assert fitted(text, file) == text
    assert fitted(text, io.StringIO()) == text


def test_a_refusal_of_a_command_is_wrapped_on_a_terminal(
    narrow_terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", narrow_terminal.stream)
    assert cli.main(["tui", "--fleet", "nowhere.toml"]) == 2
    lines = narrow_terminal.text().splitlines()
    assert len(lines) > 2
    assert max(map(len, lines)) <= 40
    assert " ".join(lines).startswith("covey: nowhere.toml: there is no such fleet file.")


def test_names_are_sorted_by_their_numbers() -> None:
    names = ["mav10", "mav9", "b2", "mav1", "b\u00b2", "12"]
    assert sorted(names, key=natural_sort_key) == ["12", "b2", "b\u00b2", "mav1", "mav9", "mav10"]
