"""Checks whether this computer is fit for an agent or a ground: libraries, timing, disk, terminal.

Most values are looked up; speeds are measured, each in less than a second.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shutil
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path

from groundstation.network.diagnosis import Diagnosis, Grade, graded
from groundstation.processes.supervisor import most_agents

# versions of Python that Covey is tested with
_OLDEST = (3, 11)
_NEWEST = (3, 13)

# libraries of an agent; a ground needs more
_AGENT_LIBRARIES = ("cryptography", "eclipse-zenoh", "mavsdk", "msgspec", "numpy")

_GOVERNORS = Path("/sys/devices/system/cpu")
_TRIAL_PRIORITY = 10

# The timer: how late this computer wakes up a process after a sleep.
_SLEEP_COUNT = 100
_SLEEP_S = 0.002
_LATE_MS = 5.0

# The clock: a year before Covey's first version is wrong.
_FIRST_YEAR = 2025
# adjtimex(2)
_CLOCK_ERROR = 5  # TIME_ERROR, its return value
_UNSYNCHRONISED = 0x40  # STA_UNSYNC, a bit of timex.status

# The disk.
_FULL_MB = 50
_LITTLE_MB = 1000
_TRIAL_MB = 4
_SLOW_MB_S = 5.0

# The terminal.
_COLUMNS = 80
_ROWS = 24


def machine() -> list[Diagnosis]:
    """Return all findings about this computer."""
    return [
        _python(),
        *_libraries(),
        _cores(),
        _governor(),
        _priority(),
        _timer(),
        _clock(),
        *_disk(),
        *_terminal(),
    ]


# -- Python and its libraries ----------------------------------------------------------------------


def _python() -> Diagnosis:
    version_words, *_ = sys.version.split()
    text = f"Python {version_words}."
    oldest = ".".join(map(str, _OLDEST))
    newest = ".".join(map(str, _NEWEST))

    running = sys.version_info[:2]
    if running < _OLDEST:
        return Diagnosis("Python", Grade.FAIL, text, f"Covey needs {oldest} or newer.")
    return graded("Python", running <= _NEWEST, text, f"Covey is tested with {oldest} to {newest}.")


def _libraries() -> Iterator[Diagnosis]:
    """Yield the missing libraries, those of a wrong version, and then the right ones."""
    try:
        requirements = metadata.requires("covey") or []
    except metadata.PackageNotFoundError:
        remedy = "In a clone: make demo; else install its wheel."
        yield Diagnosis("libraries", Grade.WARN, "Covey is not installed.", remedy)
        return

    right: list[str] = []
    wrong: list[str] = []
    missing_of_agent: list[str] = []
    missing_of_ground: list[str] = []
    for name, bounds in _bounds(requirements).items():
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            if name in _AGENT_LIBRARIES:
                missing_of_agent.append(name)
            else:
                missing_of_ground.append(name)
            continue

        if _is_within(version, bounds):
            right.append(f"{name} {version}")
        else:
            wrong.append(f"{name} {version}")

    remedy = "In a clone: make demo. Of a wheel: install it with [all]."
    for grade, words, names in (
        (Grade.FAIL, "Missing", missing_of_agent),
        (Grade.WARN, "Not here, and needed for a ground only", missing_of_ground),
        (Grade.WARN, "Versions that Covey was not made for", wrong),
    ):
        if names:
            yield Diagnosis("libraries", grade, f"{words}: {', '.join(names)}.", remedy)
    yield Diagnosis("libraries", Grade.OK, f"{', '.join(right)}.")


def _bounds(requirements: Iterable[str]) -> dict[str, str]:
    """Return the libraries of an agent and of a ground, each with its allowed versions.

    Args:
        requirements: requirement lines of a package, such as ``textual>=1,<2; extra == 'ground'``.
    """
    bounds = {}
    for line in requirements:
        requirement, _, condition = line.partition(";")
        name = re.match(r"[A-Za-z0-9._-]+", requirement)
        if name is None:
            continue

        extra = re.search(r"extra == ['\"](\w+)['\"]", condition)
        if extra is None or extra[1] == "ground":
            bounds[name[0]] = requirement[name.end() :].strip()
    return bounds


def _is_within(version: str, bounds: str) -> bool:
    """Return whether a version lies within bounds such as ``>=1.2,<2``."""
    numbers = _numbers(version)
    for sign, bound_text in re.findall(r"(>=|<)\s*([0-9.]+)", bounds):
        bound = _numbers(bound_text)
        if sign == ">=" and numbers < bound:
            return False
        if sign == "<" and numbers >= bound:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    """Return the first three numbers of a version."""
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


# -- processor and clock ---------------------------------------------------------------------------


def _cores() -> Diagnosis:
    count = len(os.sched_getaffinity(0))
    text = (
        f"{count}, enough for one agent or a ground, "
        f"or for {most_agents()} agents with their emulator."
    )
    remedy = "With one core, agent and network hold each other up: take two."
    return graded("cores", count >= 2, text, remedy)


def _governor() -> Diagnosis:
    names = set()
    for file in _GOVERNORS.glob("cpu[0-9]*/cpufreq/scaling_governor"):
        # the governor of a processor that is switched off cannot be read
        with contextlib.suppress(OSError):
            names.add(file.read_text().strip())
    governors = sorted(names)
    if not governors:
        sentence = "The clock of the processor is not ours to set."
        return Diagnosis("CPU governor", Grade.OK, sentence)

    text = f"{', '.join(governors)}."
    remedy = "On a drone: cpupower frequency-set -g performance"
    return graded("CPU governor", "powersave" not in governors, text, remedy)


def _priority() -> Diagnosis:
    """Return the finding whether threads may have real-time priority, by trying it."""
    is_allowed = False

    def attempt() -> None:
        nonlocal is_allowed
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_TRIAL_PRIORITY))
            is_allowed = True
        except OSError:
            is_allowed = False

    # The priority belongs to a thread, so it ends with this one.
    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()

    if is_allowed:
        text = "Allowed."
    else:
        text = "Not allowed: a busy computer makes control loops late."
    remedy = (
        "The service of covey agent install has it; "
        "else add to /etc/security/limits.conf: USER - rtprio 10"
    )
    return graded("real-time priority", is_allowed, text, remedy)


def _timer() -> Diagnosis:
    """Return the finding about how late this computer wakes up a sleeping process."""
    delays_ms = []
    for _ in range(_SLEEP_COUNT):
        begin_s = time.perf_counter()
        time.sleep(_SLEEP_S)
        delays_ms.append(1e3 * (time.perf_counter() - begin_s - _SLEEP_S))
    p99_ms = sorted(delays_ms)[round(0.99 * (_SLEEP_COUNT - 1))]

    try:
        slack_ms = int(Path("/proc/self/timerslack_ns").read_text()) * 1e-6
    except (OSError, ValueError):
        slack_ms = 0.0

    text = f"Who sleeps wakes up {p99_ms:.1f} ms late (p99), with a slack of {slack_ms:.2f} ms."
    remedy = "Something else computes here: end it, or give agents real-time priority."
    return graded("timer", p99_ms < _LATE_MS, text, remedy)


def _clock() -> Diagnosis:
    year = time.localtime().tm_year
    today = time.strftime("%Y-%m-%d %H:%M")
    if year < _FIRST_YEAR:
        sentence = f"It says {today}: certificates are not valid then."
        return Diagnosis("clock", Grade.FAIL, sentence, "Set it: timedatectl")

    is_synchronised = _is_synchronised()
    text = f"{today}, synchronised." if is_synchronised else f"{today}, not synchronised."
    remedy = "Records of several computers do not match: timedatectl set-ntp true"
    return graded("clock", is_synchronised, text, remedy)


def _is_synchronised() -> bool:
    """Return whether the kernel's clock is synchronised; False if the kernel does not say."""
    timex = (ctypes.c_int * 64)()  # struct timex; all zero means that nothing is to be changed
    try:
        state = ctypes.CDLL(None).adjtimex(timex)
    except (OSError, AttributeError):
        return False
    if state < 0 or state == _CLOCK_ERROR:
        return False

    # The field ``status`` comes after an int with its padding, and four longs.
    offset = 5 * ctypes.sizeof(ctypes.c_long)
    (status,) = struct.unpack_from("i", bytes(timex), offset)
    return not int(status) & _UNSYNCHRONISED


# -- disk and terminal -----------------------------------------------------------------------------


def _disk() -> Iterator[Diagnosis]:
    """Yield the findings about free space and speed of the disk of this folder."""
    free_mb = shutil.disk_usage(".").free / 1e6
    is_full = free_mb < _FULL_MB
    yield graded(
        "disk",
        free_mb > _LITTLE_MB,
        f"{free_mb:.0f} MB free in {os.getcwd()}.",
        "A record needs about 2 MB a minute and vehicle: free some.",
        bad=Grade.FAIL if is_full else Grade.WARN,
    )
    if is_full:
        return

    try:
        speed_mb_s = _write_speed_mb_s()
    except OSError as error:
        sentence = f"{os.getcwd()} cannot be written ({error.strerror})."
        remedy = "Start Covey in a folder of yours."
        yield Diagnosis("disk's speed", Grade.WARN, sentence, remedy)
        return

    text = f"{speed_mb_s:.0f} MB/s."
    remedy = "Too slow for a record: take another disk."
    yield graded("disk's speed", speed_mb_s > _SLOW_MB_S, text, remedy)


def _write_speed_mb_s() -> float:
    """Return the speed [MB/s] at which a file in this folder is written.

    Raises:
        OSError: the folder cannot be written.
    """
    with tempfile.TemporaryFile(dir=".") as file:
        begin_s = time.perf_counter()
        file.write(os.urandom(_TRIAL_MB * 1_000_000))
        file.flush()
        os.fsync(file.fileno())
        return _TRIAL_MB / (time.perf_counter() - begin_s)


def _terminal() -> Iterator[Diagnosis]:
    """Yield the findings about size, colours and letters of this terminal."""
    if not sys.stdout.isatty():
        sentence = "None here: the console needs one, all else does not."
        yield Diagnosis("terminal", Grade.OK, sentence)
        return

    columns, rows = shutil.get_terminal_size()
    is_large = columns >= _COLUMNS and rows >= _ROWS
    remedy = f"The console needs {_COLUMNS} x {_ROWS}: make it larger."
    yield graded("terminal", is_large, f"{columns} x {rows}.", remedy)

    terminal_type = os.environ.get("TERM", "")
    has_true_colours = "truecolor" in os.environ.get("COLORTERM", "")
    has_colours = has_true_colours or "256" in terminal_type
    yield graded("colours", has_colours, f"TERM={terminal_type}.", "export TERM=xterm-256color")

    encoding = sys.stdout.encoding or ""
    is_utf8 = encoding.lower().replace("-", "") == "utf8"
    remedy = "export LANG=C.UTF-8, or covey --ascii"
    yield graded("letters", is_utf8, f"{encoding}.", remedy)
