"""MAVProxy, scripted through its own prompt, against the emulator's companion and ground links."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.clients.running import Running, running_emulator, wait_until_armable

_MAVPROXY = Path(sys.executable).parent / "mavproxy.py"
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        not _MAVPROXY.exists(), reason="MAVProxy is not installed: pip install MAVProxy"
    ),
]


class Prompt:
    """A running MAVProxy: type a line, wait for what it prints."""

    def __init__(self, master: str, folder: Path) -> None:
        modules = "mode,arm,param,cmdlong,misc"
        words = ["--master", master, "--no-state", "--default-modules", modules, "--streamrate=-1"]
        self._process = subprocess.Popen(
            [sys.executable, str(_MAVPROXY), *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            bufsize=1,
            cwd=folder,
        )
        self._lines: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line.rstrip())

    def wait(self, pattern: str, timeout_s: float, since: int = 0) -> str:
        """The first line since a place that matches."""
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            for line in self._lines[since:]:
                if re.search(pattern, line):
                    return line
            time.sleep(0.05)
        raise AssertionError(
            f"no {pattern!r} within {timeout_s} s:\n" + "\n".join(self._lines[-20:])
        )

    def type(self, command: str, pattern: str, timeout_s: float = 30.0) -> str:
        """Type a command and wait for the line that answers it."""
        since = len(self._lines)
        self.enter(command)
        return self.wait(pattern, timeout_s, since)

    def enter(self, command: str) -> None:
        """Type a command that answers nothing."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def said(self, pattern: str) -> bool:
        """Whether something was printed so far."""
        return any(re.search(pattern, line) for line in self._lines)

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.wait(10)


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[Running]:
    """A running emulator that can be armed."""
    with running_emulator(tmp_path) as running:
        wait_until_armable(running)
        yield running


@pytest.mark.parametrize("link", ["companion", "station"])
def test_mavproxy_shows_sets_arms_takes_off_and_lands(
    emulator: Running, link: str, tmp_path: Path
) -> None:
    prompt = Prompt(f"udpin:127.0.0.1:{getattr(emulator, link)}", tmp_path)
    try:
        prompt.wait("Detected vehicle 1:1", 30)
        assert re.search(r"Received \d+ parameters", prompt.wait("Received", 60))
        assert "autopilot : 12" in prompt.type("status HEARTBEAT", "HEARTBEAT {")
        assert "0.5" in prompt.type("param show MPC_THR_HOVER", r"MPC_THR_HOVER\s+0\.5")
        prompt.enter("param set MPC_THR_HOVER 0.55")
        time.sleep(1.0)
        prompt.type("param show MPC_THR_HOVER", r"MPC_THR_HOVER\s+0\.55")
        prompt.type("mode", "Available modes:.*LOITER")
        prompt.type("takeoff 2.5", "NAV_TAKEOFF: ACCEPTED")
        prompt.type("arm throttle", "COMPONENT_ARM_DISARM: ACCEPTED")
        prompt.wait("AP: Takeoff detected", 30)
        prompt.wait("Mode LOITER", 40)
        prompt.type("disarm", "COMPONENT_ARM_DISARM: TEMPORARILY_REJECTED")
        # MAVProxy's `land` is DO_LAND_START, the landing part of a mission: without one PX4 flies
        # on.
        prompt.type("land", "DO_LAND_START: ")
        prompt.type("long NAV_LAND 0 0 0 0 0 0 0", "NAV_LAND: ACCEPTED")
        prompt.wait("AP: Disarmed by landing", 60)
        prompt.wait("DISARMED", 10)
        assert not prompt.said("Traceback|no link|link 1 down")
    finally:
        prompt.close()
