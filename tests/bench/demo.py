"""``make bench-demo``: fly the demo several times and write what was measured as a table.

The judge here reads the record with mcap's own reader and computes separation from the ground truth
by itself; it shares no code with the recorder nor with the flight's own verdict, so that the two
can contradict each other.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

AIRBORNE_HEIGHT_M = 0.10


@dataclass(frozen=True, slots=True)
class Flight:
    """Results of one flight: distances in metres from ground truth, CPU in cores, time in seconds
    of wall clock.
    """

    seed: int
    exit_status: int
    min_separation_m: float
    pair: str
    flight_s: float
    cores: float
    loop_p99_ms: float
    arrival_m: float


def separation(record: Path) -> tuple[float, str, float]:
    """Smallest horizontal distance between centres while one of the two flies, the pair, and the
    time flown.

    Args:
        record: an MCAP with ``truth/<vehicle>`` channels of JSON messages.
    """
    tracks: dict[str, list[tuple[float, ...]]] = {}
    with record.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if channel.topic.startswith("truth/"):
                position = json.loads(message.data)["position_enu_m"]
                tracks.setdefault(channel.topic[6:], []).append((message.log_time / 1e9, *position))
    rows: dict[str, NDArray[np.float64]] = {
        name: np.array(sorted(track)) for name, track in tracks.items()
    }
    worst = math.inf
    pair = "-"
    flown = [row[row[:, 3] > AIRBORNE_HEIGHT_M, 0] for row in rows.values()]
    times = np.concatenate(flown) if flown else np.zeros(0)
    for first, second in itertools.combinations(rows, 2):
        a = rows[first]
        b = rows[second]
        start = max(a[0, 0], b[0, 0])
        end = min(a[-1, 0], b[-1, 0])
        t = np.arange(start, end, 0.01)
        pa = np.stack([np.interp(t, a[:, 0], a[:, axis]) for axis in (1, 2, 3)], axis=-1)
        pb = np.stack([np.interp(t, b[:, 0], b[:, axis]) for axis in (1, 2, 3)], axis=-1)
        airborne = np.maximum(pa[:, 2], pb[:, 2]) > AIRBORNE_HEIGHT_M
        if airborne.any():
            distance = np.hypot(*(pa - pb)[airborne, :2].T)
            if distance.min() < worst:
                worst = float(distance.min())
                pair = f"{first}-{second}"
    return worst, pair, float(np.ptp(times)) if times.size else 0.0


def fly_once(seed: int, folder: Path, arguments: list[str]) -> Flight:
    """One headless demo in a process of its own, judged afterwards."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.monotonic()
    command = [sys.executable, "-m", "groundstation", "demo", "--headless", "--record", str(folder)]
    done = subprocess.run(
        [*command, "--seed", str(seed), *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        check=False,
    )
    wall = time.monotonic() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    worst, pair, flown = separation(folder / "flight.mcap")
    verdict = _verdict(folder)
    loops = [
        float(agent.get("period_p99_ms", math.nan)) for agent in verdict.get("loop", {}).values()
    ]
    return Flight(
        seed=seed,
        exit_status=done.returncode,
        min_separation_m=worst,
        pair=pair,
        flight_s=flown,
        cores=cpu / wall,
        loop_p99_ms=max(loops, default=math.nan),
        arrival_m=float(verdict.get("worst_arrival_m") or math.nan),
    )


def _verdict(folder: Path) -> dict[str, Any]:
    path = folder / "verdict.json"
    return json.loads(path.read_text()) if path.exists() else {}


def table(flights: list[Flight]) -> str:
    """The flights as a Markdown table with a last line for all."""
    lines = [
        "| seed | exit status | smallest distance m | pair | worst arrival m | flown s | loop "
        "p99 ms | cores |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for flight in flights:
        lines.append(
            f"| {flight.seed} | {flight.exit_status} | {flight.min_separation_m:.3f} | "
            f"{flight.pair} "
            f"| {flight.arrival_m:.3f} | {flight.flight_s:.1f} | {flight.loop_p99_ms:.1f} | "
            f"{flight.cores:.2f} |"
        )
    lines.append(
        f"| all {len(flights)} | {max(flight.exit_status for flight in flights)} "
        f"| {min(flight.min_separation_m for flight in flights):.3f} | "
        f"| {max(flight.arrival_m for flight in flights):.3f} | "
        f"| {max(flight.loop_p99_ms for flight in flights):.1f} | "
        f"{max(flight.cores for flight in flights):.2f} |"
    )
    return "\n".join(lines)


def main(argv: list[str]) -> int:
    """Entry of ``make bench-demo``; exit status 0 when every flight came true."""
    parser = argparse.ArgumentParser(
        prog="make bench-demo", description="Fly the demo several times; writes a table."
    )
    parser.add_argument("--flights", type=int, default=10, help="how many flights (default 10)")
    parser.add_argument("--fleet", help="fleet file (default: the paper's)")
    parser.add_argument(
        "--law", choices=["covey", "paper", "off"], help="avoidance law (default: the fleet file's)"
    )
    parser.add_argument("--record", type=Path, help="keep the flight folders below this one")
    parser.add_argument("--out", type=Path, help="write the table to this file as well")
    options = parser.parse_args(argv)
    arguments = ["--fleet", options.fleet] if options.fleet else []
    arguments += ["--law", options.law] if options.law else []
    with tempfile.TemporaryDirectory() as scratch:
        base = options.record or Path(scratch)
        flights = []
        for seed in range(max(1, options.flights)):
            flights.append(fly_once(seed, base / f"flight-{seed}", arguments))
            last = flights[-1]
            print(
                f"flight {seed + 1}/{options.flights}: exit status {last.exit_status}, smallest "
                "distance "
                f"{last.min_separation_m:.3f} m ({last.pair}), loop p99 {last.loop_p99_ms:.1f} ms, "
                f"{last.cores:.2f} cores",
                flush=True,
            )
    command = f'make bench-demo ARGS="{" ".join(["--flights", str(len(flights)), *arguments])}"'
    origin = f"Measured by `{command}`, separation from ground truth by a reader of its own."
    text = f"{origin}\n\n{table(flights)}\n"
    print(text)
    if options.out:
        options.out.write_text(text, encoding="utf-8")
    return 0 if all(flight.exit_status == 0 for flight in flights) else 1
