"""A real process on a pseudo-terminal: whatever ends the console, the terminal is as before."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.groundstation.console.conftest import FLEET

LEAVE_SCREEN = b"\x1b[?1049l"
SHOW_CURSOR = b"\x1b[?25h"


class Terminal:
    """A console that somebody started in a terminal of 80 x 24."""

    def __init__(self, home: Path, *words: str) -> None:
        self.master, slave = pty.openpty()
        termios.tcsetwinsize(slave, (24, 80))
        self.before = termios.tcgetattr(slave)
        environ = {**os.environ, "XDG_STATE_HOME": str(home), "TERM": "xterm-256color"}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "groundstation", *words],
            stdin=slave, stdout=slave, stderr=slave, env=environ, start_new_session=True,
            preexec_fn=lambda: _own_terminal(slave), cwd=FLEET.parents[2],
        )  # fmt: skip
        self.slave = slave
        self.seen = b""

    def read_until(self, text: bytes, timeout_s: float = 60.0) -> None:
        """Read what it writes until ``text`` has come."""
        end_s = time.monotonic() + timeout_s
        while text not in self.seen:
            assert time.monotonic() < end_s, self.seen[-2000:]
            if select.select([self.master], [], [], 0.2)[0]:
                with contextlib.suppress(OSError):
                    self.seen += os.read(self.master, 65536)

    def wait(self, timeout_s: float = 60.0) -> int:
        """Its exit status; its last words are read meanwhile."""
        end_s = time.monotonic() + timeout_s
        while self.process.poll() is None:
            assert time.monotonic() < end_s, "it does not end"
            if select.select([self.master], [], [], 0.1)[0]:
                with contextlib.suppress(OSError):
                    self.seen += os.read(self.master, 65536)
        while select.select([self.master], [], [], 0.1)[0]:
            try:
                self.seen += os.read(self.master, 65536)
            except OSError:
                break
        return self.process.returncode

    def close(self) -> None:
        for descriptor in (self.master, self.slave):
            with contextlib.suppress(OSError):
                os.close(descriptor)
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def _own_terminal(slave: int) -> None:
    import fcntl

    fcntl.ioctl(slave, termios.TIOCSCTTY, 0)


@pytest.fixture
def console(tmp_path: Path) -> Iterator[Terminal]:
    terminal = Terminal(tmp_path, "tui", "--fleet", str(FLEET))
    yield terminal
    terminal.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, None])
def test_the_terminal_is_restored_and_the_console_starts_before_anybody_answers(
    console: Terminal, number: signal.Signals | None
) -> None:
    console.read_until(b"waiting for 3 vehicles")
    if number is None:
        os.write(console.master, b"q")
    else:
        console.process.send_signal(number)
    assert console.wait() == (0 if number is None else 130)
    assert LEAVE_SCREEN in console.seen
    assert SHOW_CURSOR in console.seen
    assert termios.tcgetattr(console.slave)[:4] == console.before[:4]


def test_a_terminal_that_closes_ends_the_console(console: Terminal) -> None:
    console.read_until(b"waiting for 3 vehicles")
    os.close(console.slave)
    os.close(console.master)
    assert console.process.wait(timeout=60) == 130


def test_after_a_flight_the_shell_has_the_folder_and_the_next_commands(tmp_path: Path) -> None:
    terminal = Terminal(tmp_path, "demo", "--record", str(tmp_path / "first"))
    try:
        terminal.read_until(b"3 vehicles")
        os.write(terminal.master, b"q")
        terminal.wait()
        after = terminal.seen.rpartition(LEAVE_SCREEN)[2].decode()
    finally:
        terminal.close()
    assert "there is no verdict" in after
    assert f"covey check {tmp_path}/first" in after
