"""Whether this computer is fit for an agent or a ground: looked up, and measured where that takes
no second.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import shutil
import socket
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

_OLDEST, _NEWEST = (3, 11), (3, 13)  # Python that Covey is tested with
# the base: an agent has no more
_BASE = ("cryptography", "eclipse-zenoh", "mavsdk", "msgspec", "numpy")
_FULL_MB, _LITTLE_MB, _SLOW_MB_S = 50, 1000, 5.0
_TRIAL_MB = 4
_COLUMNS, _ROWS = 80, 24
_LATE_MS, _SLEEPS, _SLEEP_S = 5.0, 100, 0.002
_UNSYNCHRONISED = 0x40  # STA_UNSYNC of adjtimex(2)
_FIRST_YEAR = 2025  # earlier than this no Covey was written
_GET_WIFI_POWER, _GET_MTU = 0x8B2D, 0x8921  # SIOCGIWPOWER, SIOCGIFMTU
_LEAST_MTU, _USUAL_MTU = 1280, 1500
_INTERFACES = Path("/sys/class/net")
_GOVERNORS = Path("/sys/devices/system/cpu")


def machine() -> list[Diagnosis]:
    """Return everything about this computer."""
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


def _python() -> Diagnosis:
    own = sys.version_info[:2]
    text = f"Python {sys.version.split()[0]}."
    if own < _OLDEST:
        return Diagnosis(
            "Python", Grade.FAIL, text, f"Covey needs {_OLDEST[0]}.{_OLDEST[1]} or newer."
        )
    remedy = f"Covey is tested with {_OLDEST[0]}.{_OLDEST[1]} to {_NEWEST[0]}.{_NEWEST[1]}."
    return graded("Python", own <= _NEWEST, text, remedy)


def _libraries() -> Iterator[Diagnosis]:
    """Return whether each library is there, in a version that Covey allows."""
    try:
        needed = metadata.requires("covey") or []
    except metadata.PackageNotFoundError:
        yield Diagnosis(
            "libraries",
            Grade.WARN,
            "Covey is not installed.",
            "In a clone: make demo; else install its wheel.",
        )
        return
    found, missing, wrong = list[str](), list[str](), list[str]()
    for name, bounds in _bounds(needed).items():
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            missing.append(name)
            continue
        (found if _is_within(version, bounds) else wrong).append(f"{name} {version}")
    for word, names, bad in (
        ("Missing", [name for name in missing if name in _BASE], Grade.FAIL),
        (
            "Not here, and needed for a ground only",
            [name for name in missing if name not in _BASE],
            Grade.WARN,
        ),
        ("Versions that Covey was not made for", wrong, Grade.WARN),
    ):
        if names:
            remedy = "In a clone: make demo. Of a wheel: install it with [all]."
            yield Diagnosis("libraries", bad, f"{word}: {', '.join(names)}.", remedy)
    yield Diagnosis("libraries", Grade.OK, f"{', '.join(found)}.")


def _bounds(needed: Iterable[str]) -> dict[str, str]:
    """Return the libraries of a drone and of a ground, with the versions that are allowed."""
    bounds = {}
    for line in needed:
        requirement, _, condition = line.partition(";")
        extra = re.search(r"extra == ['\"](\w+)['\"]", condition)
        name = re.match(r"[A-Za-z0-9._-]+", requirement)
        if name is not None and (extra is None or extra[1] == "ground"):
            bounds[name[0]] = requirement[name.end() :].strip()
    return bounds


def _is_within(version: str, bounds: str) -> bool:
    own = _number(version)
    for sign, bound in re.findall(r"(>=|<)\s*([0-9.]+)", bounds):
        if (own < _number(bound)) is (sign == ">="):
            return False
    return True


def _number(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:3])


def _cores() -> Diagnosis:
    count = len(os.sched_getaffinity(0))
    text = (
        f"{count}, enough for one agent or a ground, "
        f"or for {most_agents()} agents with their emulator."
    )
    return graded(
        "cores", count >= 2, text, "With one core, agent and network hold each other up: take two."
    )


def _governor() -> Diagnosis:
    files = sorted(_GOVERNORS.glob("cpu[0-9]*/cpufreq/scaling_governor"))
    governors = sorted({file.read_text().strip() for file in files})
    if not governors:
        return Diagnosis("CPU governor", Grade.OK, "The clock of the processor is not ours to set.")
    text = f"{', '.join(governors)}."
    return graded(
        "CPU governor",
        "powersave" not in governors,
        text,
        "On a drone: cpupower frequency-set -g performance",
    )


def _priority() -> Diagnosis:
    allowed: list[bool] = []

    def attempt() -> None:  # a thread's own priority, which ends with it
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
            allowed.append(True)
        except OSError:
            allowed.append(False)

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    text = (
        "Allowed."
        if allowed == [True]
        else "Not allowed: a busy computer makes control loops late."
    )
    remedy = (
        "The service of covey agent install has it; "
        "else add to /etc/security/limits.conf: USER - rtprio 10"
    )
    return graded("real-time priority", allowed == [True], text, remedy)


def _timer() -> Diagnosis:
    """Return how late this computer wakes up who sleeps."""
    late_ms = []
    for _ in range(_SLEEPS):
        begin_s = time.perf_counter()
        time.sleep(_SLEEP_S)
        late_ms.append(1e3 * (time.perf_counter() - begin_s - _SLEEP_S))
    p99_ms = sorted(late_ms)[round(0.99 * (_SLEEPS - 1))]
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
        return Diagnosis(
            "clock",
            Grade.FAIL,
            f"It says {today}: certificates are not valid then.",
            "Set it: timedatectl",
        )
    buffer = (ctypes.c_int * 64)()  # struct timex, all zero: only asks
    try:
        state = ctypes.CDLL(None).adjtimex(buffer)
    except (OSError, AttributeError):
        state = -1
    is_synchronised = state >= 0 and state != 5 and not _status(buffer) & _UNSYNCHRONISED
    text = f"{today}, {'' if is_synchronised else 'not '}synchronised."
    return graded(
        "clock",
        is_synchronised,
        text,
        "Records of several computers do not match: timedatectl set-ntp true",
    )


def _status(buffer: ctypes.Array[ctypes.c_int]) -> int:
    """Return the field ``status`` of struct timex, behind an int and four longs."""
    offset = 5 * ctypes.sizeof(ctypes.c_long)
    return int(struct.unpack_from("i", bytes(buffer), offset)[0])


def _disk() -> Iterator[Diagnosis]:
    free_mb = shutil.disk_usage(".").free / 1e6
    text = f"{free_mb:.0f} MB free in {os.getcwd()}."
    bad = Grade.FAIL if free_mb < _FULL_MB else Grade.WARN
    yield graded(
        "disk",
        free_mb > _LITTLE_MB,
        text,
        "A record needs about 1 MB a minute and vehicle: free some.",
        bad=bad,
    )
    if free_mb < _FULL_MB:
        return
    try:
        with tempfile.TemporaryFile(dir=".") as file:
            begin_s = time.perf_counter()
            file.write(os.urandom(_TRIAL_MB * 1_000_000))
            file.flush()
            os.fsync(file.fileno())
            speed = _TRIAL_MB / (time.perf_counter() - begin_s)
    except OSError as error:
        remedy = "Start Covey in a folder of yours."
        yield Diagnosis(
            "disk's speed",
            Grade.WARN,
            f"{os.getcwd()} cannot be written ({error.strerror}).",
            remedy,
        )
        return
    yield graded(
        "disk's speed",
        speed > _SLOW_MB_S,
        f"{speed:.0f} MB/s.",
        "Too slow for a record: take another disk.",
    )


def _terminal() -> Iterator[Diagnosis]:
    if not sys.stdout.isatty():
        yield Diagnosis(
            "terminal", Grade.OK, "None here: the console needs one, all else does not."
        )
        return
    columns, rows = shutil.get_terminal_size()
    is_large = columns >= _COLUMNS and rows >= _ROWS
    yield graded(
        "terminal",
        is_large,
        f"{columns} x {rows}.",
        f"The console needs {_COLUMNS} x {_ROWS}: make it larger.",
    )
    has_colours = "truecolor" in os.environ.get("COLORTERM", "") or "256" in os.environ.get(
        "TERM", ""
    )
    yield graded(
        "colours", has_colours, f"TERM={os.environ.get('TERM', '')}.", "export TERM=xterm-256color"
    )
    encoding = sys.stdout.encoding or ""
    remedy = "export LANG=C.UTF-8, or covey --ascii"
    yield graded("letters", encoding.lower().replace("-", "") == "utf8", f"{encoding}.", remedy)


def interfaces() -> list[Diagnosis]:
    """Return the largest packet of each network interface, and whether Wi-Fi sleeps between
    packets.
    """
    found = []
    try:
        names = sorted(file.name for file in _INTERFACES.iterdir() if file.name != "lo")
    except OSError:
        names = []
    for name in names:
        if (_INTERFACES / name / "operstate").read_text().strip() == "down":
            continue
        mtu = _ask(name, _GET_MTU)
        if mtu is not None:
            value = int(struct.unpack_from("i", mtu, 16)[0])
            bad = Grade.FAIL if value < _LEAST_MTU else Grade.WARN
            remedy = (
                f"ip link set {name} mtu {_USUAL_MTU}; below {_LEAST_MTU} QUIC does not connect."
            )
            found.append(
                graded(
                    f"packets of {name}",
                    value >= _USUAL_MTU,
                    f"Up to {value} bytes.",
                    remedy,
                    bad=bad,
                )
            )
        power = _ask(name, _GET_WIFI_POWER) if (_INTERFACES / name / "wireless").exists() else None
        if power is not None:
            sleeps = not power[21]  # iw_param.disabled
            text = (
                "Wi-Fi sleeps between packets: states come up to 0.1 s late."
                if sleeps
                else "Wi-Fi stays awake."
            )
            found.append(
                graded(f"power of {name}", not sleeps, text, f"iw dev {name} set power_save off")
            )
    return found or [
        Diagnosis(
            "network", Grade.WARN, "No interface but this computer's own.", "Plug in or join one."
        )
    ]


def _ask(interface: str, request: int) -> bytes | None:
    """Ask the kernel about an interface; None where it does not say."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            return fcntl.ioctl(
                asked.fileno(), request, interface.encode()[:15].ljust(16, b"\0") + bytes(24)
            )
        except OSError:
            return None
