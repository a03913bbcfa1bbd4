"""Starts and watches the processes of a simulated flight, and ends all of them.

Each process has a process group of its own, so that a Ctrl-C at the terminal does not reach it. A
session of its own would have the same effect. But on a busy machine the kernel gives every session
the same share (autogroups), and a thread then can wait for up to half a second, which is too long
for an agent in the air.

Each process ends with this one. If this process is killed, the kernel sends SIGKILL to the others
(Linux); on a normal end ``atexit`` does.
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

_PR_SET_PDEATHSIG = 1  # option of prctl(2)
_LIBC = ctypes.CDLL(None) if sys.platform.startswith("linux") else None

STOP_TIMEOUT_S = 4.0  # longest wait for the end of a process after SIGTERM
_KILL_TIMEOUT_S = 2.0  # the same after SIGKILL
_LINE_POLL_S = 0.05
_END_POLL_S = 0.02
LOG_TAIL_LINES = 6

# Agents' loops with real-time priority per core; more would leave nothing for network and ground.
_LOOPS_PER_CORE = 5
_MAX_PER_CORE = 6.5  # agents per core up to which flights keep their time (docs/processes.md)


def agent_command(path: str, name: str, *, is_realtime: bool = True) -> list[str]:
    """Return the words after ``python -m`` that start one vehicle's agent.

    Args:
        path: path of the fleet file.
        name: name of the vehicle.
        is_realtime: whether its loop takes real-time priority.
    """
    words = ["onboard", "--fleet", path, "--vehicle", name, "--apply-params", "--mocap", "bus"]
    if is_realtime:
        words.append("--realtime")
    return words


def leaves_room(count: int) -> bool:
    """Return whether this number of loops may take real-time priority on this machine.

    The loops must leave enough time for network and ground.
    """
    return count <= _LOOPS_PER_CORE * (os.cpu_count() or 1)


def most_agents() -> int:
    """Return how many agents this machine can fly in real time, together with their emulator."""
    return int(_MAX_PER_CORE * (os.cpu_count() or 1))


class ProcessError(RuntimeError):
    """A process did not start or ended too early; the message contains the end of its log."""


@dataclass(frozen=True, slots=True)
class StartedProcess:
    """One process and its log."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path  # file with its output
    ends_last: bool = False  # whether it ends after the others, which need it until then

    @property
    def has_ended(self) -> bool:
        """Whether it has ended."""
        return self.process.poll() is not None

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
        """A sentence about its end, which came by a signal or by itself."""
        status = self.process.returncode
        if status is not None and status < 0:
            # The last line of its log was written before the signal, so it gives no reason.
            name = _signal_name(-status)
            return f"{self.name} was ended by signal {-status} ({name}), see {self.log}"

        complaint = ""
        last_line = self.tail.rpartition("\n")[2]
        if last_line:
            complaint = f": {last_line}"
        return f"{self.name} ended by itself (status {status}), see {self.log}{complaint}"


def _signal_name(number: int) -> str:
    """Return the name of a signal, SIGKILL for 9; signals without a name are real-time signals."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return "a real-time signal"


class Processes:
    """Starts, watches and stops processes.

    Any thread may call :meth:`kill`, any number of times.
    """

    def __init__(self, log_folder: Path) -> None:
        self._folder = log_folder
        self._started: list[StartedProcess] = []
        self._is_stopping = False
        atexit.register(self.kill)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the processes in the order of their start."""
        return tuple(started.name for started in self._started)

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name, including those of processes that have ended."""
        return {started.name: started.process.pid for started in self._started}

    def start(self, name: str, arguments: Sequence[str], *, ends_last: bool = False) -> None:
        """Start ``python -m ...`` with its output in ``<name>.log``.

        Args:
            name: name of the process.
            arguments: arguments after ``python -m``.
            ends_last: whether :meth:`stop` ends it after all others.

        Raises:
            ProcessError: the process cannot be started.
        """
        log = self._folder / f"{name}.log"
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        try:
            with log.open("wb") as file:
                process = subprocess.Popen(
                    [sys.executable, "-m", *arguments],
                    stdin=subprocess.DEVNULL,
                    stdout=file,
                    stderr=subprocess.STDOUT,
                    process_group=0,  # not a session of its own: see the head of this module
                    env=environment,
                    preexec_fn=_die_with_parent,  # safe: this process has no threads yet
                )
        except OSError as error:
            raise ProcessError(
                f"{name} cannot be started ({error}). Is there disk space and memory left?"
            ) from None
        self._started.append(StartedProcess(name, process, log, ends_last=ends_last))

    def dead(self) -> list[StartedProcess]:
        """Return the processes that have ended before they were stopped."""
        if self._is_stopping:
            return []
        return [started for started in self._started if started.has_ended]

    def check(self) -> None:
        """Check that all processes run.

        Raises:
            ProcessError: one of them has ended.
        """
        dead = self.dead()
        if dead:
            first = dead[0]
            raise ProcessError(f"{first.ending}\nThe end of its log:\n{first.tail}")

    async def wait_for_line(self, name: str, text: str, timeout_s: float) -> None:
        """Wait until a process has written a line that begins with a text.

        Args:
            name: name of the process.
            text: start of the line.
            timeout_s: longest wait for the line.

        Raises:
            ProcessError: the line did not come in time, or a process has ended.
        """
        started = next(started for started in self._started if started.name == name)
        try:
            async with asyncio.timeout(timeout_s):
                while not _has_line(started.log, text):
                    self.check()
                    await asyncio.sleep(_LINE_POLL_S)
        except TimeoutError:
            raise ProcessError(
                f"{name} was not ready within {timeout_s:g} s."
                f" The end of {started.log}:\n{started.tail}"
            ) from None

    async def stop(self, timeout_s: float = STOP_TIMEOUT_S) -> list[str]:
        """End all processes with SIGTERM, and those that remain with SIGKILL.

        An agent in the air lands before it ends, and needs the emulator for that. So the emulator
        and the routers end last.

        Args:
            timeout_s: longest wait for the end after SIGTERM.

        Returns:
            Names of the processes that had to be killed.
        """
        self._is_stopping = True
        killed = []
        first = [started for started in self._started if not started.ends_last]
        last = [started for started in self._started if started.ends_last]
        for group in (first, last):
            for started in group:
                _signal_group(started.process, signal.SIGTERM)
            try:
                async with asyncio.timeout(timeout_s):
                    while not all(started.has_ended for started in group):  # noqa: ASYNC110 - a child's end sets no Event
                        await asyncio.sleep(_END_POLL_S)
            except TimeoutError:
                killed += [started.name for started in group if not started.has_ended]
        self.kill()
        return killed

    def kill(self) -> None:
        """End all processes at once with SIGKILL."""
        self._is_stopping = True
        for started in self._started:
            _signal_group(started.process, signal.SIGKILL)
        for started in self._started:
            with contextlib.suppress(subprocess.TimeoutExpired):
                started.process.wait(_KILL_TIMEOUT_S)
        atexit.unregister(self.kill)


def _has_line(log: Path, text: str) -> bool:
    lines = log.read_text(errors="replace").splitlines()
    return any(line.startswith(text) for line in lines)


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    """Send a signal to the process group of a process that has not ended."""
    # The id of a process that has ended may belong to another process by now.
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)


def _die_with_parent() -> None:
    """Let the kernel kill this process when its parent ends (Linux)."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
