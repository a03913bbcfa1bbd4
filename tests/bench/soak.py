"""``make bench-soak``: three agents fly to and fro for long; does their memory grow, is an order
lost, is a tick late?

Memory is what the kernel says of each process: its own pages, without those of files. Growth is
counted from the end of the first minutes, in which caches fill, to the end, between medians of a
minute each, so that no single sample decides. The ground is this process: its memory is shown and
not judged, since it keeps every order's result and the index of the record, which MCAP wants at its
end (some 60 kB a minute). A late tick is explained when the ticks of another process were late at
the same time, or the machine was busy with others: then the machine was, not the agent.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from groundstation.missions.api import NotReady, OrderFailed
from groundstation.processes.supervisor import ProcessError
from onboard.bus.schema import Message, TickBatch
from onboard.bus.topics import Topic
from tests.bench.fixture import BenchFleet, fleet_data
from tests.bench.process_usage import busy_share, processor_times, usage

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_WRONG_INPUT = 2
GROWTH_MIB = 1.0
GROUND = "ground"
LATE_S = 0.020
PERIOD_S = 0.020
_SAMPLE_S = 5.0
_TOGETHER_S = 0.3
_BUSY = 0.9
_VEHICLES = 3
_SPACING_M = 2.0
_STEP_M = 0.5


@dataclass(frozen=True, slots=True)
class LateTick:
    """A tick that came more than 20 ms late; explained: by what, in words, or empty."""

    vehicle: str
    at_s: float
    late_ms: float
    explained: str


@dataclass(frozen=True, slots=True)
class Soak:
    """Results of a soak.

    time_s: of each sample. memory_mib: of each process at these times. growth_mib: see above.
    orders, missed: how many were given, and the sentences of those that did not end as done.
    """

    minutes: float
    time_s: list[float]
    memory_mib: dict[str, list[float]]
    growth_mib: dict[str, float]
    orders: int
    missed: list[str]
    late: list[LateTick]

    def problems(self) -> list[str]:
        """Sentences for the values that are past their limits."""
        found = [
            f"{name} grew by {grown:.2f} MiB, asked are less than {GROWTH_MIB:g}"
            for name, grown in self.growth_mib.items()
            if name != GROUND and not grown < GROWTH_MIB
        ]
        found += [f"missed order: {sentence}" for sentence in self.missed]
        found += [
            f"{one.vehicle}: a tick {one.late_ms:.0f} ms late at {one.at_s:.0f} s, unexplained"
            for one in self.late
            if not one.explained
        ]
        return found


@dataclass(slots=True)
class Watcher:
    """Takes notes while the fleet flies: ticks that were late, and how busy the machine was."""

    begin_ns: int = field(default_factory=time.monotonic_ns)
    late: list[tuple[str, float, float]] = field(default_factory=list)
    busy: list[tuple[float, float]] = field(default_factory=list)

    def put(self, _topic: Topic, name: str, message: Message, _received_ns: int) -> None:
        """A sink of the client; called on the bus's threads."""
        if isinstance(message, TickBatch):
            for tick in message.ticks:
                if tick.period_s > PERIOD_S + LATE_S:
                    at_s = (tick.stamp_ns - self.begin_ns) * 1e-9
                    self.late.append((name, at_s, 1e3 * (tick.period_s - PERIOD_S)))

    def explained(self) -> list[LateTick]:
        """All late ticks with what explains them."""
        return [
            LateTick(name, at_s, late_ms, self._why(name, at_s))
            for name, at_s, late_ms in self.late
        ]

    def _why(self, name: str, at_s: float) -> str:
        others = sorted(
            {
                vehicle_name
                for vehicle_name, when, _ in self.late
                if vehicle_name != name and abs(when - at_s) < _TOGETHER_S
            }
        )
        if others:
            return f"{', '.join(others)} stood still at the same time: the machine did"
        shares = [share for when, share in self.busy if abs(when - at_s) < 2.0]
        if shares and max(shares) > _BUSY:
            return f"all processors were busy ({100 * max(shares):.0f} %)"
        return ""


async def soak(minutes: float, folder: Path, *, settle_minutes: float) -> Soak:
    """Fly for that long."""
    bench_fleet = BenchFleet(fleet_data(_VEHICLES, _SPACING_M, "soak"), folder, has_record=True)
    watcher = Watcher()
    samples = Samples()
    async with bench_fleet:
        await bench_fleet.fleet.takeoff(height_m=1.0)
        bench_fleet.client.add_sink(watcher.put)
        pids = {**bench_fleet.processes.pids, GROUND: os.getpid()}
        tasks = [
            asyncio.create_task(samples.take(pids)),
            asyncio.create_task(_watch_machine(watcher)),
        ]
        orders, missed = await _fly(bench_fleet, minutes * 60.0)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if not await bench_fleet.fleet.land_all():
            missed.append("land all: not everybody is down")
    return Soak(
        minutes=minutes,
        time_s=samples.time_s,
        memory_mib=samples.memory_mib,
        growth_mib={
            name: samples.growth_mib(name, settle_minutes * 60.0) for name in samples.memory_mib
        },
        orders=orders,
        missed=missed,
        late=watcher.explained(),
    )


class Samples:
    """Memory of processes over time."""

    def __init__(self) -> None:
        self.time_s: list[float] = []
        self.memory_mib: dict[str, list[float]] = {}

    async def take(self, pids: dict[str, int]) -> None:
        """One sample every few seconds, until cancelled."""
        begin_s = time.monotonic()
        while True:
            self.time_s.append(time.monotonic() - begin_s)
            for name, pid in pids.items():
                found = usage(pid)
                self.memory_mib.setdefault(name, []).append(
                    float("nan") if found is None else found.own_mib
                )
            await asyncio.sleep(_SAMPLE_S)

    def growth_mib(self, name: str, settle_s: float) -> float:
        """From the minute that ends the settling to the last one; nan when the flight was not
        longer than that.
        """
        rows = list(zip(self.time_s, self.memory_mib[name], strict=False))
        end_s = rows[-1][0]
        first = [mib for at_s, mib in rows if settle_s <= at_s < settle_s + 60.0]
        last = [mib for at_s, mib in rows if at_s > max(settle_s, end_s - 60.0)]
        return (
            statistics.median(last) - statistics.median(first) if first and last else float("nan")
        )


async def _fly(bench_fleet: BenchFleet, seconds: float) -> tuple[int, list[str]]:
    """The repeated mission; how many orders were given, and what became of those that were not
    done.
    """
    orders = 0
    missed = []
    end_s = time.monotonic() + seconds
    side = 1.0
    while time.monotonic() < end_s:
        goals = {
            name: bench_fleet.config.vehicles[name].start_enu_m
            for name in bench_fleet.config.enabled_names
        }
        for name, (x, y, _) in goals.items():
            orders += 1
            try:
                await bench_fleet.fleet[name].move((x, y + side * _STEP_M, 1.0), timeout_s=20.0)
            except OrderFailed as error:
                missed.append(str(error))
                if len(missed) > 20:
                    return orders, missed
        side = -side
        bench_fleet.processes.check()
    return orders, missed


async def _watch_machine(watcher: Watcher) -> None:
    """Share of all processors that was busy, every second."""
    before = processor_times()
    while True:
        await asyncio.sleep(1.0)
        now = processor_times()
        at_s = (time.monotonic_ns() - watcher.begin_ns) * 1e-9
        watcher.busy.append((at_s, busy_share(before, now)))
        before = now


def draw(found: Soak, path: Path) -> None:
    """Memory over time and late ticks, as a figure."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 5.5), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    for name, sizes in found.memory_mib.items():
        first = next((size for size in sizes if size == size), 0.0)
        times = [at_s / 60.0 for at_s in found.time_s[: len(sizes)]]
        top.plot(times, [size - first for size in sizes], label=f"{name} (from {first:.0f} MiB)")
    top.set_ylabel("own memory, change [MiB]")
    top.legend(loc="upper left", fontsize=8)
    top.grid(alpha=0.3)
    for is_explained, color in ((True, "0.6"), (False, "tab:red")):
        ticks = [one for one in found.late if bool(one.explained) is is_explained]
        label = "explained" if is_explained else "unexplained"
        bottom.plot(
            [one.at_s / 60.0 for one in ticks],
            [one.late_ms for one in ticks],
            ".",
            color=color,
            label=label,
        )
    bottom.set_ylabel("late ticks [ms]")
    bottom.set_xlabel("time [min]")
    bottom.legend(loc="upper left", fontsize=8)
    bottom.grid(alpha=0.3)
    figure.savefig(path)


def text(found: Soak) -> str:
    """For people."""
    lines = [
        f"{found.minutes:g} minutes, {found.orders} orders, {len(found.missed)} of them missed"
    ]
    for name, sizes in found.memory_mib.items():
        lines.append(
            f"{name:<8} {sizes[-1]:7.1f} MiB of its own at the end, grown by "
            f"{found.growth_mib[name]:+.2f} MiB"
        )
    unexplained = sum(not one.explained for one in found.late)
    lines.append(
        f"{len(found.late)} ticks more than {1e3 * LATE_S:.0f} ms late, {unexplained} of them "
        "unexplained"
    )
    return "\n".join(lines + [f"NOT AS ASKED: {sentence}" for sentence in found.problems()])


def main(argv: Sequence[str] | None = None) -> int:
    """Entry of ``make bench-soak``; exit status 0 when everything is as asked."""
    parser = argparse.ArgumentParser(
        prog="make bench-soak",
        description="Three agents, emulator and recording for long: memory, orders, late ticks.",
    )
    parser.add_argument("--minutes", type=float, default=30.0, help="of flight (default 30)")
    parser.add_argument(
        "--settle-minutes",
        type=float,
        help="that do not count (default 5, or a third of a short one)",
    )
    parser.add_argument(
        "--figure", type=Path, help="draw memory and late ticks into this file (PNG or SVG)"
    )
    parser.add_argument("--keep", type=Path, help="folder for logs and record")
    parser.add_argument("--json", action="store_true", help="figures as JSON on stdout")
    options = parser.parse_args(argv)
    if not 0.2 <= options.minutes <= 24 * 60:
        print("bench soak: give 0.2 to 1440 minutes.", file=sys.stderr)
        return EXIT_WRONG_INPUT
    settle = (
        min(5.0, options.minutes / 3.0)
        if options.settle_minutes is None
        else options.settle_minutes
    )
    with tempfile.TemporaryDirectory(prefix="covey-soak-") as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            found = asyncio.run(soak(options.minutes, folder, settle_minutes=settle))
        except (ProcessError, NotReady, OrderFailed) as error:
            print(f"bench soak: {error}", file=sys.stderr)
            return EXIT_WRONG_INPUT
    if options.figure is not None:
        draw(found, options.figure)
    print(
        json.dumps({**asdict(found), "problems": found.problems()}) if options.json else text(found)
    )
    return EXIT_FAILED if found.problems() else EXIT_OK


if __name__ == "__main__":
    sys.exit(main())
