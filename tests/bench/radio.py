"""``make bench-radio``: fleets that change places in lockstep over the model of one radio channel,
recorded.

Each row of the fleet moves on by one place, and its last vehicle flies back along the whole row to
the first, so that it meets everybody else of its row. Orders, poses, states, telemetry and the
record share the channel.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from groundstation.missions.api import OrderFailed
from onboard.bus.schema import Message, TickBatch
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.feasibility.airtime import airtime_finding
from onboard.neighbours.subscription import most_near
from sitl.lockstep.flight import Lockstep
from tests.bench.fixture import fleet_data

SPACING_M = 3.0
MOVE_TIMEOUT_S = 90.0


class Case(NamedTuple):
    """A fleet and its channel."""

    vehicles: int
    rate_mbit_s: float
    states_hz: int
    most_near: int  # neighbours that are followed at full rate
    expected_delay_s: float


CASES = (
    Case(vehicles=6, rate_mbit_s=65.0, states_hz=50, most_near=6, expected_delay_s=0.04),
    Case(vehicles=12, rate_mbit_s=65.0, states_hz=25, most_near=6, expected_delay_s=0.1),
    Case(vehicles=20, rate_mbit_s=390.0, states_hz=25, most_near=6, expected_delay_s=0.1),
    Case(vehicles=30, rate_mbit_s=390.0, states_hz=25, most_near=6, expected_delay_s=0.1),
)


@dataclass(frozen=True, slots=True)
class Flown:
    """What a flight showed; ages are those of the states that the law used, at every tick of every
    vehicle.
    """

    case: Case
    check_pct: float
    busy_pct: float
    dropped: int
    min_separation_m: float
    age_p50_ms: float
    age_p99_ms: float
    failure: str

    def row(self) -> str:
        """A row of the table in docs/network.md."""
        case = self.case
        fleet = f"{case.vehicles}, {SPACING_M:g} m apart, up to {case.most_near} near"
        channel = f"access point, {case.rate_mbit_s:g} Mbit/s, {case.states_hz} Hz"
        if self.failure:
            shares = f"{self.check_pct:.0f} % | {self.busy_pct:.0f} %"
            return f"| {fleet} | {channel} | {shares} | {self.failure} | |"
        return (
            f"| {fleet} | {channel} | {self.check_pct:.0f} % | {self.busy_pct:.0f} % | "
            f"{self.min_separation_m:.2f} m | "
            f"{self.age_p50_ms:.0f} / {self.age_p99_ms:.0f} ms |"
        )


def fleet_of(case: Case) -> FleetConfig:
    """Return the fleet of a case."""
    data: dict[str, Any] = fleet_data(case.vehicles, SPACING_M, "radio")
    data["radio"] = {
        "rate_mbit_s": case.rate_mbit_s,
        "states_hz": case.states_hz,
        "expected_delay_s": case.expected_delay_s,
    }
    data["law"] = {"max_neighbours": case.most_near}
    return fleet_from_mapping(data)


def goals_m(fleet: FleetConfig) -> dict[str, tuple[float, float, float]]:
    """Return where each vehicle goes: to the next place of its row, the last one to the first place
    [m], fleet ENU.
    """
    starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    rows: dict[float, list[str]] = {}
    for name, (_, north_m, _) in starts.items():
        rows.setdefault(north_m, []).append(name)
    return {
        name: (*starts[following][:2], 1.0)
        for row in rows.values()
        for name, following in zip(row, [*row[1:], row[0]], strict=True)
    }


def fly(case: Case, seed: int = 1) -> Flown:
    """Fly one case."""
    fleet = fleet_of(case)
    ages_s: list[float] = []

    def put(_topic: Topic, _name: str, message: Message, _received_ns: int) -> None:
        if isinstance(message, TickBatch):
            for tick in message.ticks:
                ages_s.extend(tick.neighbour_ages_s.values())

    failure = ""
    with (
        tempfile.TemporaryDirectory() as folder,
        Lockstep(fleet, seed=seed, folder=Path(folder)) as flight,
    ):
        channel = flight.bus.channel
        assert channel is not None
        begin_s = flight.time_s
        before_ns = channel.busy_ns
        try:
            flight.takeoff(1.0)
            begin_s = flight.time_s
            before_ns = channel.busy_ns
            flight.client.add_sink(put)
            flight.wait_for(flight.fleet.go_to(goals_m(fleet), timeout_s=MOVE_TIMEOUT_S))
        except OrderFailed as error:
            failure = str(error).partition(" failed. ")[2] or str(error)
        busy_pct = (channel.busy_ns - before_ns) / max(flight.time_s - begin_s, 0.1) * 1e-7
        separation_m = flight.min_separation_m
        dropped = channel.dropped
    assert fleet.radio is not None
    starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    check_pct = airtime_finding(fleet, fleet.radio, most_near(fleet, starts)).value
    p50_s, p99_s = np.percentile(ages_s or [0.0], [50.0, 99.0])
    return Flown(
        case=case,
        check_pct=check_pct,
        busy_pct=busy_pct,
        dropped=dropped,
        min_separation_m=separation_m,
        age_p50_ms=1e3 * p50_s,
        age_p99_ms=1e3 * p99_s,
        failure=failure,
    )


def main(words: Sequence[str] | None = None) -> int:
    """Fly all cases, or those with so many vehicles, and print the table; 1 when somebody did not
    arrive.
    """
    parser = argparse.ArgumentParser(prog="bench-radio", description=__doc__)
    parser.add_argument(
        "--vehicles", type=int, nargs="*", help="only the cases with so many vehicles"
    )
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(words)
    print(
        "| fleet | channel | taken by `covey check` | by the model | smallest distance | age p50 "
        "/ p99 |"
    )
    print("|---|---|---|---|---|---|")
    failed = False
    for case in CASES:
        if given.vehicles is None or case.vehicles in given.vehicles:
            flown = fly(case, given.seed)
            print(flown.row(), flush=True)
            failed |= bool(flown.failure)
    return int(failed)
