"""Processes of a simulated flight: started in groups of their own, watched, and never left behind.

A group keeps a Ctrl-C at the terminal away from them. A session for each would do so too, but the
kernel gives every session of a busy machine the same share (autogroups), and a thread of one whose
other threads run elsewhere then waits for up to half a second: ten agents that fill two cores fell
out of the air, and fly when they share one session.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None) if sys.platform.startswith("linux") else None
STOP_TIMEOUT_S = 4.0
_LOOPS_PER_CORE = 5
_MOST_PER_CORE = 6.5  # flights of 13 on two cores kept their time, of 20 did not: docs/processes.md
LOG_TAIL_LINES = 6


def agent_command(path: str, name: str, *, is_realtime: bool = True) -> list[str]:
    """Return the words after ``python -m`` that start the agent of vehicle ``name`` of the fleet
    file at ``path``.
    """
    words = ["onboard", "--fleet", path, "--vehicle", name, "--apply-params", "--mocap", "bus"]
    return [*words, "--realtime"] if is_realtime else words


def leaves_room(count: int) -> bool:
    """Whether so many loops may go first on this machine: more of them would leave nothing for
    network and ground.
    """
    return count <= _LOOPS_PER_CORE * (os.cpu_count() or 1)


def most_agents() -> int:
    """Return how many agents this machine flies in real time, with their emulator beside them."""
    return int(_MOST_PER_CORE * (os.cpu_count() or 1))


class ProcessError(RuntimeError):
    """A process did not start or ended too early: a sentence with the end of its log."""


@dataclass(frozen=True, slots=True)
class Started:
    """One process and where its output goes."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    @property
    def tail(self) -> str:
        """The end of its log."""
        try:
            lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return ""
        return "\n".join(lines[-LOG_TAIL_LINES:])

    @property
    def ending(self) -> str:
        """A sentence on its end: by a signal from elsewhere, or by itself with the last line of its
        log.
        """
        status = self.process.returncode
        # the last line of its log was written in good health: no reason
        if status is not None and status < 0:
            return f"{self.name} was ended by signal {-status} ({_signal_name(-status)}), see {self.log}"
        last_line = self.tail.rpartition("\n")[2]
        complaint = f": {last_line}" if last_line else ""
        return f"{self.name} ended by itself (status {status}), see {self.log}{complaint}"


def _signal_name(number: int) -> str:
    """SIGKILL for 9; signals without a name of their own are real-time signals."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return "a real-time signal"


class Processes:
    """Start, watch and stop; :meth:`kill` may be called from anywhere, any number of times."""

    def __init__(self, log_folder: Path) -> None:
        self._folder = log_folder
        self._started: list[Started] = []
        self._is_stopping = False
        atexit.register(self.kill)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the processes in the order of their start."""
        return tuple(one.name for one in self._started)

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name, of those that have ended too."""
        return {one.name: one.process.pid for one in self._started}

    def start(self, name: str, arguments: Sequence[str]) -> None:
        """Start ``python -m ...`` with its output in ``<name>.log``; ProcessError when that fails."""
        log = self._folder / f"{name}.log"
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        try:
            with log.open("wb") as file:
                process = subprocess.Popen(
                    [sys.executable, "-m", *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    process_group=0,  # not a session: see above
                    env=environment,
                    preexec_fn=_die_with_parent,  # started before this process has threads
                )
        except OSError as error:
            raise ProcessError(
                f"{name} cannot be started ({error}). Is there disk space and memory left?"
            ) from None
        self._started.append(Started(name, process, log))

    def dead(self) -> list[Started]:
        """Processes that ended although nobody stopped them."""
        if self._is_stopping:
            return []
        return [one for one in self._started if one.process.poll() is not None]

    def check(self) -> None:
        """ProcessError when one of them ended."""
        for one in self.dead():
            raise ProcessError(f"{one.ending}\nThe end of its log:\n{one.tail}")

    async def wait_for_line(self, name: str, text: str, timeout_s: float) -> None:
        """Wait until a process has written a line that begins with ``text``; ProcessError when it
        does not.
        """
        one = next(one for one in self._started if one.name == name)
        try:
            async with asyncio.timeout(timeout_s):
                while not any(
                    line.startswith(text)
                    for line in one.log.read_text(errors="replace").splitlines()
                ):
                    self.check()
                    await asyncio.sleep(0.05)
        except TimeoutError:
            raise ProcessError(
                f"{name} was not ready within {timeout_s:g} s. The end of {one.log}:\n{one.tail}"
            ) from None

    async def stop(self, timeout_s: float = STOP_TIMEOUT_S) -> list[str]:
        """End them with SIGTERM and then SIGKILL; returns who had to be killed.

        The one started first, the emulator, ends last: an agent in the air lands before it goes,
        and needs it for that.
        """
        self._is_stopping = True
        killed = []
        for group in (self._started[1:], self._started[:1]):
            for one in group:
                _signal_group(one.process, signal.SIGTERM)
            try:
                async with asyncio.timeout(timeout_s):
                    while any(one.process.poll() is None for one in group):  # noqa: ASYNC110 - no Event for a child's end
                        await asyncio.sleep(0.02)
            except TimeoutError:
                killed += [one.name for one in group if one.process.poll() is None]
        self.kill()
        return killed

    def kill(self) -> None:
        """End everything at once."""
        self._is_stopping = True
        for one in self._started:
            _signal_group(one.process, signal.SIGKILL)
        for one in self._started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                one.process.wait(2.0)
        atexit.unregister(self.kill)


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    if process.poll() is None:  # an ended process's number may belong to somebody else by now
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)


def _die_with_parent() -> None:
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
