"""``make bench-lockstep``: how much faster than time, where the time goes, and whether a flight
repeats itself.

One process and one thread, the record included. Factors are simulated seconds over processor
seconds while flying; the start of the process (imports, loading compiled code, take-off) is given
beside it, and the profile comes from a span of its own, because profiling slows it down.
"""

from __future__ import annotations

import argparse
import cProfile
import hashlib
import os
import pstats
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from onboard.config.fleet import FleetConfig, load_fleet
from sitl.lockstep.flight import Lockstep
from tests.sitl.square_fleets import square_fleet

ROOT = Path(__file__).resolve().parents[2]
SIZES = (3, 10, 100)
# simulated over real time: what is asked for at least, and what is aimed at
WANTED = {3: (12.0, 20.0), 10: (4.0, 8.0), 100: (0.3, 0.4)}
_WARM_S = 1.0
# Which part of the program a function's time counts for: the first that its path holds. The rest,
# libraries and built-in functions, counts for whoever called it.
_PARTS = (
    (
        "the law and the controller",
        ("/onboard/avoidance/", "/onboard/control/", "/onboard/estimation/", "/onboard/rollout/"),
    ),
    ("the agents' cores around it", ("/onboard/",)),
    ("values for the compiled pipeline", ("/sitl/lockstep/pipeline_rows.py",)),
    ("bus, links and shells", ("/sitl/lockstep/",)),
    ("emulated vehicles and PX4s", ("/sitl/",)),
    ("the record", ("/groundstation/recording/",)),
    ("the ground: client and mission", ("/groundstation/",)),
)


@dataclass(frozen=True, slots=True)
class Speed:
    """One fleet's figures; factors are the best of the spans measured, for others on the machine
    only ever slow it.

    factor_median: of the processor's; how far it lies below the best says how quiet the machine
    was.
    """

    count: int
    factor_cpu: float
    factor_median: float
    factor_wall: float
    start_s: float
    parts: dict[str, float]
    is_repeated: bool


def fleet_of(count: int) -> FleetConfig:
    """The paper's three, or a square of the wanted size."""
    paper = ROOT / "configs" / "fleets" / "paper.toml"
    return load_fleet(paper) if count == 3 and paper.exists() else square_fleet(count)


def measure(count: int, folder: Path, *, span_s: float, spans: int) -> Speed:
    """Fly a fleet up to a hover among its neighbours and measure from there."""
    fleet = fleet_of(count)
    begin_s = time.perf_counter()
    with Lockstep(fleet, folder=folder / f"speed-{count}") as flight:
        flight.takeoff(1.0)
        flight.run(_WARM_S)
        start_s = time.perf_counter() - begin_s
        cpu = []
        wall = []
        for _ in range(spans):
            cpu_s = time.process_time()
            wall_s = time.perf_counter()
            flight.run(span_s)
            cpu.append(span_s / (time.process_time() - cpu_s))
            wall.append(span_s / (time.perf_counter() - wall_s))
        profile = cProfile.Profile()
        profile.enable()
        flight.run(2.0 * span_s)
        profile.disable()
    return Speed(
        count=count,
        factor_cpu=max(cpu),
        factor_median=statistics.median(cpu),
        factor_wall=max(wall),
        start_s=start_s,
        parts=shares(pstats.Stats(profile)),
        is_repeated=_is_repeated(fleet, folder),
    )


def _is_repeated(fleet: FleetConfig, folder: Path) -> bool:
    """Whether two flights of a few seconds have the same record."""
    hashes = []
    for name in ("one", "two"):
        path = folder / f"{name}-{len(fleet.enabled_names)}"
        with Lockstep(fleet, seed=1, folder=path) as flight:
            flight.ready()
            flight.wait_for(flight.client.submit("takeoff all 1.0"))
            flight.run(2.0)
        hashes.append(hashlib.sha256((path / "flight.mcap").read_bytes()).hexdigest())
    return hashes[0] == hashes[1]


def shares(stats: pstats.Stats) -> dict[str, float]:
    """Share of each stage in a profile's time; a library's time counts for whoever called it."""
    table = stats.stats  # type: ignore[attr-defined]
    found: dict[str, float] = defaultdict(float)
    own = {function: row[2] for function, row in table.items()}
    for _ in range(12):  # calls of libraries by libraries are handed on, a few deep
        passed: dict[tuple[str, int, str], float] = defaultdict(float)
        for function, seconds in own.items():
            part = part_of(function[0])
            callers = table[function][4] if function in table else {}
            weight = sum(row[2] for row in callers.values())
            if part is not None or not callers or weight <= 0.0:
                found[part or "the rest"] += seconds
                continue
            for caller, row in callers.items():
                passed[caller] += seconds * row[2] / weight
        own = passed
    found["the rest"] += sum(own.values())
    total = sum(found.values())
    return {
        name: found.get(name, 0.0) / total for name in (*(part for part, _ in _PARTS), "the rest")
    }


def part_of(path: str) -> str | None:
    """Return the part of the program that a file belongs to; None for libraries."""
    name = path.replace(os.sep, "/")
    if not name.startswith(ROOT.as_posix()) or "/.venv/" in name:
        return None
    return next((part for part, words in _PARTS if any(word in name for word in words)), None)


def table(speeds: Sequence[Speed]) -> str:
    """The figures as Markdown."""
    lines = [
        "| vehicles | times real time (processor) | median | times real time (wall clock) | at "
        "least | aim "
        "| in the air after s | same record twice |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for speed in speeds:
        least, aim = WANTED.get(speed.count, (0.0, 0.0))
        lines.append(
            f"| {speed.count} | {speed.factor_cpu:.2f} | {speed.factor_median:.2f} | "
            f"{speed.factor_wall:.2f} "
            f"| {least:g} | {aim:g} | {speed.start_s:.1f} | "
            f"{'yes' if speed.is_repeated else 'NO'} |"
        )
    lines += [
        "",
        "Where the time goes, by the profiler (it makes many small calls look dearer than they "
        "are):",
        "",
    ]
    lines.append("| share of | " + " | ".join(f"{speed.count} vehicles" for speed in speeds) + " |")
    lines.append("|---" * (len(speeds) + 1) + "|")
    for part in speeds[0].parts:
        lines.append(
            f"| {part} | "
            + " | ".join(f"{100.0 * speed.parts[part]:.0f} %" for speed in speeds)
            + " |"
        )
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry of ``make bench-lockstep``; exit status 1 when a record was not repeated or a fleet is
    too slow.
    """
    parser = argparse.ArgumentParser(
        prog="make bench-lockstep",
        description="Measure flights in lockstep: speed, profile, repeatability.",
    )
    parser.add_argument(
        "--vehicles", default=",".join(map(str, SIZES)), help="fleet sizes (default 3,10,100)"
    )
    parser.add_argument(
        "--span-s",
        type=float,
        default=1.0,
        help="simulated seconds of each measurement (default 1)",
    )
    parser.add_argument(
        "--spans", type=int, default=16, help="measurements, of which the best counts (default 16)"
    )
    parser.add_argument("--out", type=Path, help="write the tables to this file as well")
    options = parser.parse_args(argv)
    speeds = []
    with tempfile.TemporaryDirectory() as scratch:
        for word in options.vehicles.split(","):
            count = int(word)
            span_s = options.span_s if count < 50 else options.span_s / 4.0
            speeds.append(measure(count, Path(scratch), span_s=span_s, spans=max(1, options.spans)))
            last = speeds[-1]
            print(
                f"{count} vehicles: {last.factor_cpu:.2f} times real time, same record "
                f"{last.is_repeated}",
                flush=True,
            )
    text = (
        f"Measured by `make bench-lockstep` on one core of {os.cpu_count()}.\n\n{table(speeds)}\n"
    )
    print(text)
    if options.out:
        options.out.write_text(text, encoding="utf-8")
    fast = all(speed.factor_cpu >= WANTED.get(speed.count, (0.0, 0.0))[0] for speed in speeds)
    return 0 if fast and all(speed.is_repeated for speed in speeds) else 1


if __name__ == "__main__":
    raise SystemExit(main())
