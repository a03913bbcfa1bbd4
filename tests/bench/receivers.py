"""Receivers of satellites as they are and late, in lockstep: how badly positions fit the motion,
when that is noticed, and how near vehicles come.

    make bench-receivers                            # 20 seeds of each delay: about half an hour
    make bench-receivers ARGS="--delays 0.5 --seeds 0:8"

Three vehicles take off by satellites, form a triangle and two of them change places. The receiver
of one of them is late from the end of the take-off on. Prints a line for each flight, then the
table.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from onboard.config.fleet import load_fleet
from onboard.safety.failsafe_table import Condition
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep

FLEET = Path(__file__).parents[2] / "configs" / "fleets" / "px4-sitl.toml"
DELAYS_S = (0.0, 0.25, 0.5)
LATE = "mav1"
_CODE = Condition.POSITION_UNFIT.name.lower().replace("_", "-")
_LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class ReceiverFlight:
    """What came of one flight."""

    # of any receiver that is in time
    largest_miss_m: float
    largest_lateness_m2_s3: float
    noticed_s: float  # after the receiver has become late; NaN: never
    nearest_m: float  # by ground truth
    wrongly_noticed: int  # vehicles whose receivers are in time


def fly(delay_s: float, seed: int) -> ReceiverFlight:
    """Fly with one receiver that is late, or with none for a delay of 0."""
    with Lockstep(load_fleet(FLEET), seed=seed) as flight:
        misfit = _LargestMisfit(flight, {LATE} if delay_s else set())
        flight.takeoff(1.5)
        begin_s = flight.time_s
        if delay_s:
            values = {"delay_s": delay_s}
            flight.inject(Fault("gps_late", LATE, begin_s, parameters=values))
        flight.order("formation triangle 0 0 2", 30.0)
        flight.order("formation swapped 0 0 2", 30.0)

        noticed = {
            event.vehicle: event.stamp_ns * 1e-9 for event in flight.events if event.code == _CODE
        }
        noticed_s = math.nan
        if delay_s and LATE in noticed:
            began_s = flight.simulation.now_ns * 1e-9 - (flight.time_s - begin_s)
            noticed_s = noticed.pop(LATE) - began_s
        return ReceiverFlight(
            largest_miss_m=misfit.miss_m,
            largest_lateness_m2_s3=misfit.lateness_m2_s3,
            noticed_s=noticed_s,
            nearest_m=flight.min_separation_m,
            wrongly_noticed=len(noticed),
        )


class _LargestMisfit:
    """The largest misfit of the receivers that are in time, looked at ten times a second."""

    def __init__(self, flight: Lockstep, late: set[str]) -> None:
        self.miss_m = 0.0
        self.lateness_m2_s3 = 0.0
        self._flight = flight
        self._late = late
        self._look()

    def _look(self) -> None:
        for name, shell in self._flight.agents.items():
            if name not in self._late:
                fit = shell.core.own.fit
                self.miss_m = max(self.miss_m, fit.miss_m)
                self.lateness_m2_s3 = max(self.lateness_m2_s3, fit.lateness_m2_s3)
        self._flight.at(self._flight.time_s + _LOOK_S, self._look)


def table(flights: dict[float, list[ReceiverFlight]]) -> str:
    """Return the flights by delay, as Markdown."""
    lines = [
        "| receiver late by s | flights | noticed | after s, least, median, most |"
        " nearest m, least, median | largest miss of the others m |"
        " largest lateness of the others m^2/s^3 | others blamed |",
        "|---" * 8 + "|",
    ]
    for delay_s, some in flights.items():
        after_s = sorted(one.noticed_s for one in some if not math.isnan(one.noticed_s))
        words = "-"
        if after_s:
            middle_s = statistics.median(after_s)
            words = f"{after_s[0]:.1f}, {middle_s:.1f}, {after_s[-1]:.1f}"
        nearest_m = [one.nearest_m for one in some]
        cells = (
            f"{delay_s:g}",
            str(len(some)),
            str(len(after_s)),
            words,
            f"{min(nearest_m):.2f}, {statistics.median(nearest_m):.2f}",
            f"{max(one.largest_miss_m for one in some):.3f}",
            f"{max(one.largest_lateness_m2_s3 for one in some):.1f}",
            str(sum(one.wrongly_noticed for one in some)),
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main(words: Sequence[str]) -> int:
    """Fly and print; the exit status is 1 when a receiver in time was blamed."""
    parser = argparse.ArgumentParser(
        prog="make bench-receivers", description=(__doc__ or "").partition("\n\n")[0]
    )
    parser.add_argument("--delays", default=",".join(f"{delay:g}" for delay in DELAYS_S))
    parser.add_argument("--seeds", default="0:20", help="first:end")
    options = parser.parse_args(words)
    first, end = (int(part) for part in options.seeds.split(":"))
    delays_s = [float(text) for text in options.delays.split(",")]

    flights: dict[float, list[ReceiverFlight]] = {delay_s: [] for delay_s in delays_s}
    for seed in range(first, end):
        for delay_s in delays_s:
            flown = fly(delay_s, seed)
            flights[delay_s].append(flown)
            print(f"{delay_s:g} s, seed {seed}: {flown}", flush=True)

    print(f"\n{table(flights)}")
    return int(any(one.wrongly_noticed for some in flights.values() for one in some))
