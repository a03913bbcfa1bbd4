"""A build of PX4 for simulation (SITL with SIH), and instances of it that start and end with a
flight.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

# PX4 derives its ports and its MAVLink id from the number of the instance: above 9 all share one
# onboard port.
_LAST_INSTANCE = 9
_PORTS = {
    "onboard, from": 14580,
    "onboard, to": 14540,
    "ground": 18570,
    "truth, from": 19450,
    "truth, to": 19410,
}
_BETWEEN_STARTS_S = 3.0  # SIH draws the same random numbers in each instance
_PRIORITY = 50
_STOP_S = 8.0
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)
_MODEL = {
    "PX4_SYS_AUTOSTART": "10040",
    "PX4_SIM_MODEL": "sihsim_quadx",
    "PX4_PARAM_SDLOG_MODE": "-1",
}


def _home(latitude_deg: float, longitude_deg: float) -> dict[str, str]:
    """The environment of a PX4 that starts at a place on Earth."""
    return {
        "PX4_HOME_LAT": f"{latitude_deg:.7f}",
        "PX4_HOME_LON": f"{longitude_deg:.7f}",
        "PX4_HOME_ALT": "489.4",
    }


_HOME = _home(47.3977060, 8.5455408)


def die_with_parent() -> None:
    """Have the kernel end a child when the tests end, however they do."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


@dataclass(frozen=True, slots=True)
class Px4Build:
    """A build directory of a PX4 checkout, for instance ``PX4/build/px4_sitl_default``."""

    folder: Path

    @property
    def problem(self) -> str:
        """Sentence that says why it cannot be flown; empty if it can."""
        for part in ("bin/px4", "etc/init.d-posix/rcS"):
            if not (self.folder / part).exists():
                return (
                    f"PX4_BUILD={self.folder} holds no {part}: "
                    "give the build directory of 'make px4_sitl'."
                )
        return ""

    @property
    def _numbers(self) -> str:
        header = self.folder / "src/lib/version/build_git_version.h"
        return header.read_text(encoding="utf-8") if header.exists() else ""

    @property
    def name(self) -> str:
        """Tag and commit of the checkout."""
        tag = re.search(r'PX4_GIT_TAG_STR "([^"]+)"', self._numbers)
        commit = re.search(r'PX4_GIT_VERSION_STR "([^"]{10})', self._numbers)
        return (
            f"{tag[1] if tag else 'unknown version'} ({commit[1] if commit else 'unknown commit'})"
        )

    @property
    def version(self) -> tuple[int, int] | None:
        """Major and minor number of the version."""
        numbers = re.match(r"v(\d+)\.(\d+)", self.name)
        return (int(numbers[1]), int(numbers[2])) if numbers else None


def is_taken(port: int) -> bool:
    """Whether a UDP port of this machine is in use."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", port))
        except OSError:
            return True
    return False


def free_instances(count: int) -> list[int]:
    """Return the first instances in a row whose ports nobody has.

    Raises:
        RuntimeError: there are none; a sentence.
    """
    for first in range(_LAST_INSTANCE + 2 - count):
        row = range(first, first + count)
        if not any(is_taken(base + number) for number in row for base in _PORTS.values()):
            return list(row)
    raise RuntimeError(
        f"{count} PX4s in a row need free UDP ports "
        f"{', '.join(f'{base}+N ({what})' for what, base in _PORTS.items())} "
        f"for N from 0 to {_LAST_INSTANCE}; another PX4 or emulator has them. Stop it."
    )


class Px4s:
    """PX4s of one build, each in a directory of its own; all end with the block.

    Args:
        build: of all of them.
        folder: for their directories.

    Attributes:
        processes: number of the instance -> its process, as long as it was not stopped here.
    """

    def __init__(self, build: Px4Build, folder: Path) -> None:
        self.processes: dict[int, subprocess.Popen[bytes]] = {}
        self._build = build
        self._folder = folder
        self._started_s = -math.inf  # monotonic time of the last start

    def __enter__(self) -> Px4s:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop(*self.processes)

    def start(
        self,
        number: int,
        params: Mapping[str, float | int],
        place_deg: tuple[float, float] | None = None,
    ) -> None:
        """Start one, some seconds after the one before.

        Args:
            number: of the instance. One that was stopped keeps its directory and its parameters.
            params: parameters that it starts with.
            place_deg: latitude and longitude where it starts; None: one place for all.
        """
        wait_s = self._started_s + _BETWEEN_STARTS_S - time.monotonic()
        time.sleep(max(0.0, wait_s))

        home = _HOME if place_deg is None else _home(*place_deg)
        folder = self._folder / f"px4-{number}"
        self.processes[number] = _start(self._build, number, params, home, folder)
        self._started_s = time.monotonic()

    def stop(self, *numbers: int) -> None:
        """Stop some, and wait until they have ended."""
        stopped = [self.processes.pop(number) for number in numbers]
        for process in stopped:
            process.terminate()
        for process in stopped:
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _start(
    build: Px4Build,
    number: int,
    params: Mapping[str, float | int],
    home: Mapping[str, str],
    folder: Path,
) -> subprocess.Popen[bytes]:
    folder.mkdir(parents=True, exist_ok=True)
    own = {f"PX4_PARAM_{name}": f"{value}" for name, value in params.items()}
    with (folder / "px4.log").open("ab") as log:
        process = subprocess.Popen(
            [str(build.folder / "bin/px4"), "-d", "-i", str(number), str(build.folder / "etc")],
            cwd=folder,
            env={**os.environ, **_MODEL, **home, **own},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            process_group=0,
            preexec_fn=die_with_parent,
        )
    time.sleep(0.5)
    # without the right to it, a busy machine stalls PX4
    with contextlib.suppress(OSError, AttributeError):
        for thread in Path(f"/proc/{process.pid}/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(_PRIORITY))
    return process
