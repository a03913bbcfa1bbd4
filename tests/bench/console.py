"""``make bench-console``: what the console costs and how quickly it answers, measured from outside.

The real ``covey tui`` runs in a terminal of its own (a pty) on the real bus, against a crowd that
only talks. Keys are written into the terminal, and the time counts until what they change comes out
of it; an order's time counts until another process has received it. Memory over half an hour is
measured in a second run, in fast motion.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from groundstation.processes.free_ports import toml_text
from onboard.config.fleet import ConfigError, load_fleet
from tests.bench.fixture import fleet_data
from tests.bench.process_usage import usage

EXIT_OK = 0
EXIT_FAILED = 1
SIZE = (180, 50)
SPACING_M = 3.0
KEYS = 60
BURST = 10_000
CPU_LIMIT_PCT = {10: 10.0, 100: 25.0}
KEY_LIMIT_MS = 100.0
ORDER_LIMIT_MS = 50.0
GROWTH_LIMIT_MIB = 5.0
LAND_AFTER_S = (0.03, 0.06, 0.1, 0.2, 0.4)  # a move was given: its preview opens, and computes
_START_TIMEOUT_S = 60.0
_KEY_TIMEOUT_S = 5.0
_BURST_TIMEOUT_S = 60.0
# of one size besides the time asked for, and of a minute in fast motion
_LIMIT_S = 240.0
_LIMIT_S_PER_MIN = 20.0
_ESCAPES = re.compile(
    rb"\x1b(?:\[[0-9;:?<>=]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)|[PX^_].*?\x1b\\|[@-Z\\-_])",
    re.S,
)
_LETTERS = "qzxwvkyj"


@dataclass(frozen=True, slots=True)
class Measured:
    """One run. Latencies in ms: of a key until the screen shows it (also in the burst), of LAND ALL
    until the last vehicle's order has come in at another process (also while a preview opens and
    computes): medians, and the worst."""

    vehicles: int
    cpu_pct: float
    key_p50_ms: float
    key_p99_ms: float
    burst_key_max_ms: float
    land_ms: float
    land_in_preview_ms: float
    land_worst_ms: float
    bytes_per_s: float
    rss_mib: float
    growth_mib: float
    load: float

    def verdict(self) -> list[tuple[str, bool, str]]:
        """What is asked for: what, whether it is met, and the numbers."""
        cpu_limit = CPU_LIMIT_PCT[
            min((size for size in CPU_LIMIT_PCT if size >= self.vehicles), default=100)
        ]
        rows = [
            ("processor, % of a core", self.cpu_pct, cpu_limit),
            ("key to screen, p99 ms", self.key_p99_ms, KEY_LIMIT_MS),
            ("LAND ALL at the last vehicle, ms", self.land_ms, ORDER_LIMIT_MS),
            ("the same while a preview computes, ms", self.land_in_preview_ms, ORDER_LIMIT_MS),
        ]
        if np.isfinite(self.growth_mib):
            rows.append(("memory grown over 25 of 30 min, MiB", self.growth_mib, GROWTH_LIMIT_MIB))
        return [
            (name, value <= limit, f"{value:.1f} (limit {limit:g})") for name, value, limit in rows
        ]


class Terminal:
    """A program in a pty: what it writes is kept without its control sequences, with the time at
    which it came.
    """

    def __init__(self, words: list[str], environ: Mapping[str, str]) -> None:
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", SIZE[1], SIZE[0], 0, 0))
        self.process = subprocess.Popen(
            words,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, **environ},
            start_new_session=True,
        )
        os.close(slave)
        self.bytes = 0
        self._pieces: deque[tuple[float, bytes]] = deque(maxlen=20_000)
        self._news = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def press(self, keys: bytes) -> float:
        """Write keys; when that was."""
        now_s = time.monotonic()
        os.write(self._master, keys)
        return now_s

    def wait(self, text: bytes, since_s: float, timeout_s: float) -> float | None:
        """Seconds from ``since_s`` until ``text`` came; None when it did not."""
        limit_s = time.monotonic() + timeout_s
        with self._news:
            while True:
                pieces = [piece for piece in self._pieces if piece[0] >= since_s]
                whole = b""
                for at_s, data in pieces:
                    whole += data
                    if text in _ESCAPES.sub(b"", whole):
                        return at_s - since_s
                left_s = limit_s - time.monotonic()
                if left_s <= 0.0 or not self._news.wait(left_s):
                    return None

    def end(self) -> None:
        """End the program."""
        self.process.terminate()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        with contextlib.suppress(OSError):
            os.close(self._master)

    def _read(self) -> None:
        while True:
            try:
                select.select([self._master], [], [])
                data = os.read(self._master, 65_536)
            except OSError:
                return
            if not data:
                return
            with self._news:
                self.bytes += len(data)
                self._pieces.append((time.monotonic(), data))
                self._news.notify_all()


class Crowd:
    """The crowd's process, and when it received which order."""

    def __init__(self, fleet_path: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.bench.telemetry_source", fleet_path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._told: list[dict[str, object]] = []
        self._news = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def wait(
        self, key: str, value: object, count: int, timeout_s: float, since_s: float = 0.0
    ) -> float | None:
        """When the ``count``-th such line came after ``since_s``; None when it did not."""
        limit_s = time.monotonic() + timeout_s
        with self._news:
            while True:
                found = [
                    one
                    for one in self._told
                    if one.get(key) == value and float(str(one.get("at_s", 1e18))) >= since_s
                ]
                if len(found) >= count:
                    return float(str(found[count - 1].get("at_s", 0.0)))
                left_s = limit_s - time.monotonic()
                if left_s <= 0.0 or not self._news.wait(left_s):
                    return None

    def burst(self, count: int) -> None:
        """Many events at once."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"burst {count}\n")
        self._process.stdin.flush()

    def end(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            with self._news:
                self._told.append(json.loads(line))
                self._news.notify_all()


@contextlib.contextmanager
def _running(vehicles: int) -> Iterator[tuple[Terminal, Crowd, tuple[float, float]]]:
    """Crowd and console, and a place that the first vehicle could be sent to."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fleet.toml"
        path.write_text(toml_text(dict(fleet_data(vehicles, SPACING_M, "bench"))), encoding="utf-8")
        crowd = Crowd(str(path))
        environ = {"TERM": "xterm-256color", "COLORTERM": "truecolor", "XDG_STATE_HOME": folder}
        terminal = None
        try:
            if crowd.wait("ready", True, 1, _START_TIMEOUT_S) is None:
                raise ConfigError("The crowd did not start. Is the machine very busy?")
            terminal = Terminal(
                [sys.executable, "-m", "groundstation", "tui", "--fleet", str(path)], environ
            )
            if (
                terminal.wait(f"{vehicles} of {vehicles} fly".encode(), 0.0, _START_TIMEOUT_S)
                is None
            ):
                raise ConfigError(
                    "The console did not show the whole fleet in time. Is the machine very busy?"
                )
            time.sleep(3.0)  # the first pictures, imports and caches are not what is measured
            start = next(iter(load_fleet(str(path)).vehicles.values())).start_enu_m
            yield terminal, crowd, (start[0] + 1.0, start[1] + 1.0)
        finally:
            if terminal is not None:
                terminal.end()
            crowd.end()


def measure(vehicles: int, seconds: float, minutes: float) -> Measured:
    """One run; ConfigError when it does not come to a start."""
    load = os.getloadavg()[0]
    with _running(vehicles) as (terminal, crowd, goal):
        _say(f"{vehicles} vehicles: watching the processor for {seconds:g} s")
        cpu_pct, bytes_per_s = _cost(terminal, seconds)
        _say("pressing keys")
        keys_ms = _type(terminal, KEYS)
        _say("landing all, also while a preview computes")
        lands_ms = [_land(terminal, crowd, vehicles) for _ in LAND_AFTER_S]
        previews_ms = [_land(terminal, crowd, vehicles, goal, after_s) for after_s in LAND_AFTER_S]
        _say(f"a burst of {BURST} events")
        crowd.burst(BURST)
        burst_ms = _type(terminal, 20)
        if (
            crowd.wait("burst", BURST, 1, _BURST_TIMEOUT_S) is None
            or terminal.process.poll() is not None
        ):
            burst_ms = [float("inf")]
        used = usage(terminal.process.pid)
    return Measured(
        vehicles=vehicles,
        cpu_pct=cpu_pct,
        key_p50_ms=float(np.percentile(keys_ms, 50)),
        key_p99_ms=float(np.percentile(keys_ms, 99)),
        burst_key_max_ms=max(burst_ms),
        land_ms=float(np.median(lands_ms)),
        land_in_preview_ms=float(np.median(previews_ms)),
        land_worst_ms=max(*lands_ms, *previews_ms),
        bytes_per_s=bytes_per_s,
        rss_mib=used.rss_mib if used is not None else float("nan"),
        growth_mib=_growth(vehicles, minutes) if minutes > 0.0 else float("nan"),
        load=load,
    )


def _cost(terminal: Terminal, seconds: float) -> tuple[float, float]:
    """Processor in % of a core, and bytes for the terminal a second."""
    before = usage(terminal.process.pid)
    bytes_before = terminal.bytes
    begin_s = time.monotonic()
    time.sleep(seconds)
    after = usage(terminal.process.pid)
    past_s = time.monotonic() - begin_s
    if before is None or after is None:
        raise ConfigError("The console has ended by itself while it was measured.")
    return 100.0 * (after.cpu_s - before.cpu_s) / past_s, (terminal.bytes - bytes_before) / past_s


def _type(terminal: Terminal, count: int) -> list[float]:
    """Letters on the order line: ms from each key until the line with it is on the screen. None
    after one is lost.
    """
    found: list[float] = []
    _write_order(terminal, "")
    written = ""
    for number in range(count):
        if len(written) == 12:
            terminal.press(b"\x15")
            time.sleep(0.15)
            written = ""
        written += _LETTERS[(7 * number + len(written)) % len(_LETTERS)]
        since_s = terminal.press(written[-1].encode())
        past_s = terminal.wait(written.encode(), since_s, _KEY_TIMEOUT_S)
        if past_s is None:
            return [*found, float("inf")]
        found.append(1e3 * past_s)
        time.sleep(0.03 + 0.011 * (number % 7))  # not in step with the console's own period
    terminal.press(b"\x15")
    time.sleep(0.3)
    return found


def _write_order(terminal: Terminal, words: str) -> None:
    """Put these words on the order line, whatever has the keys: escape leaves it, and a question
    that is open.
    """
    for keys in (b"\x1b", b":", b"\x15"):  # not at once: what follows an escape would belong to it
        terminal.press(keys)
        time.sleep(0.3)
    if words:
        terminal.press(words.encode())


def _land(
    terminal: Terminal,
    crowd: Crowd,
    vehicles: int,
    goal: tuple[float, float] | None = None,
    after_s: float = 0.0,
) -> float:
    """Ms from ctrl+l until the last vehicle has received its order; ``after_s`` a move to ``goal``
    was given.
    """
    if goal is not None:
        _write_order(terminal, f"move mav0 {goal[0]:.1f} {goal[1]:.1f} 1.5\r")
        time.sleep(after_s)
    since_s = terminal.press(b"\x0c")
    at_s = crowd.wait("order", "land", vehicles, _KEY_TIMEOUT_S, since_s)
    time.sleep(1.0)
    return 1e3 * (at_s - since_s) if at_s is not None else float("inf")


def _say(line: str) -> None:
    """Progress, beside the result."""
    print(f"{time.strftime('%H:%M:%S')} {line}", file=sys.stderr, flush=True)


def _growth(vehicles: int, minutes: float) -> float:
    """MiB that the console grows in fast motion between the sixth part of the time and its end."""
    limit_s = _LIMIT_S_PER_MIN * minutes
    _say(f"{minutes:g} min in fast motion, at most {limit_s / 60:.0f} min")
    words = [sys.executable, "-m", "tests.bench.console_memory", str(vehicles), str(minutes)]
    try:
        done = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
            timeout=limit_s,
        )
    except subprocess.TimeoutExpired:
        return float("inf")
    return float(json.loads(done.stdout)["growth_mib"]) if done.returncode == 0 else float("inf")


def text(results: list[Measured]) -> str:
    """For people."""
    lines = []
    for one in results:
        lines.append(
            f"{one.vehicles} vehicles at 10 Hz, terminal of {SIZE[0]}x{SIZE[1]}, load at the "
            f"start {one.load:.1f}"
        )
        for name, is_met, numbers in one.verdict():
            lines.append(f"  {'✔' if is_met else '✖'} {name:<40} {numbers}")
        lines.append(
            f"    key to screen p50 {one.key_p50_ms:.1f} ms; slowest key in a burst of {BURST} "
            "events "
            f"{one.burst_key_max_ms:.0f} ms; slowest LAND ALL {one.land_worst_ms:.0f} ms; "
            f"{one.bytes_per_s / 1000:.0f} kB/s to the terminal; {one.rss_mib:.0f} MiB"
        )
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    """Entry of ``make bench-console``."""
    parser = argparse.ArgumentParser(
        prog="make bench-console",
        description="What the console costs and how quickly it answers, against a crowd on the "
        "real bus.",
        epilog="Exit status: 0 all within the limits; 1 something is not. Latencies need a "
        "machine without other work.",
    )
    parser.add_argument("--vehicles", default="10,100", help="fleet sizes (default 10,100)")
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="how long the processor is watched (default 20)"
    )
    parser.add_argument(
        "--minutes",
        type=float,
        default=30.0,
        help="simulated time for memory, 0: leave out (default 30)",
    )
    parser.add_argument("--json", action="store_true", help="JSON instead of lines")
    options = parser.parse_args(argv)
    try:
        sizes = [int(word) for word in options.vehicles.split(",")]
    except ValueError:
        raise ConfigError(
            f"--vehicles {options.vehicles}: give numbers with commas, for instance 10,100."
        ) from None
    if not sizes or min(sizes) < 1 or max(sizes) > 250 or not options.seconds > 0.0:
        raise ConfigError("A fleet has 1 to 250 vehicles here, and is watched for more than 0 s.")
    limit_s = len(sizes) * (_LIMIT_S + options.seconds + _LIMIT_S_PER_MIN * options.minutes)
    _say(
        f"a verdict comes within {limit_s / 60:.0f} min, on a machine that does nothing else "
        "much sooner"
    )
    # and end what was started
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    results = [measure(size, options.seconds, options.minutes) for size in sizes]
    if options.json:
        print(json.dumps([asdict(one) for one in results], indent=2))
    else:
        print(text(results))
    return (
        EXIT_OK if all(is_met for one in results for _, is_met, _ in one.verdict()) else EXIT_FAILED
    )
