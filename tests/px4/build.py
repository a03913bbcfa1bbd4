"""A build of PX4 for simulation (SITL with SIH), and instances of it that start and end with a
flight.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

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


@contextlib.contextmanager
def running(
    build: Px4Build,
    instances: Mapping[int, Mapping[str, float | int]],
    folder: Path,
    places_deg: Mapping[int, tuple[float, float]] | None = None,
) -> Iterator[dict[int, subprocess.Popen[bytes]]]:
    """PX4s in directories of their own, ended with the block.

    Args:
        build: of all of them.
        instances: number -> parameters that it starts with.
        folder: for their directories.
        places_deg: number -> latitude and longitude where it starts; None: all at one place.
    """
    started: dict[int, subprocess.Popen[bytes]] = {}
    try:
        for number, params in instances.items():
            if started:
                time.sleep(_BETWEEN_STARTS_S)
            home = _HOME
            if places_deg is not None:
                latitude_deg, longitude_deg = places_deg[number]
                home = _home(latitude_deg, longitude_deg)
            started[number] = _start(build, number, params, home, folder / f"px4-{number}")
        yield started
    finally:
        for process in started.values():
            process.terminate()
        for process in started.values():
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
    folder.mkdir(parents=True)
    own = {f"PX4_PARAM_{name}": f"{value}" for name, value in params.items()}
    with (folder / "px4.log").open("wb") as log:
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
