"""One flight of the fault suite: something breaks at one tick, and everything that has to hold is
judged.

    python -m tests.sitl.lockstep.suite --every 25        # the whole table, printed

Judged by ground truth and by what left the agents, not by what they say of themselves.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import CorrectionsConfig, FleetConfig, load_fleet
from onboard.safety.failsafe_table import TABLE, Condition, Situation
from sitl.lockstep.campaign.broken_flight import Breaking, fly_broken, injection_of, wind_of
from sitl.lockstep.campaign.injections import INJECTIONS, Injection
from tests.sitl.square_fleets import square_fleet

ROOT = Path(__file__).resolve().parents[3]
# a second before the earliest take-off, so that arming is one of the moments; what breaks before
# that is a matter of preflight, not of flight
READY_S = 3.5
RTK_READY_S = 10.5  # the emulated receivers have their fix then
FLIGHT_S = 17.0
GROUND_LOST_LAND_S = 4.0
_DIRECT_PORT = 18_570  # never opened in lockstep
# Its gusts push these vehicles, whose drag is large, as those of 3 m/s push the others. In stronger
# ones vehicles without a position may meet.
_WIND_WITH_CAMERA_M_S = 1.0
_ADVISED_WITH_CAMERA = {"EKF2_EVP_NOISE": 0.01, "EKF2_TAU_VEL": 0.02, "EKF2_TAU_POS": 0.1}


@dataclass(frozen=True, slots=True)
class Case:
    """One injection: what breaks, at which tick of the flight, for whom, in which fleet.

    A second fault may follow, of the same vehicle or of another one.
    """

    injection: str
    tick: int
    count: int = 3
    place: int = 1
    height_m: float = 1.0
    wind_m_s: float = 0.0  # in the mean, from the west, with gusts
    second: str = ""  # the second fault; empty: there is none
    second_place: int = 0
    gap_s: float = 0.0  # from the first fault to the second one
    mission: str = "crossing"  # a key of MISSIONS; all others have a fleet of three and a height

    @property
    def name(self) -> str:
        """For people."""
        words = f"{self.injection}, {self.count} vehicles, {0.02 * self.tick:.2f} s"
        if self.mission != CROSSING:
            words += f", {self.mission}"
        if self.second:
            words += f", then {self.second} after {self.gap_s:.2f} s"
        if self.height_m != 1.0:
            words += f", {self.height_m:g} m high"
        if self.wind_m_s:
            words += f", {self.wind_m_s:g} m/s of wind"
        return words


@dataclass(slots=True)
class Outcome:
    """Result of one case; ``wrong`` is empty when all holds."""

    case: Case
    wrong: list[str] = field(default_factory=list)
    seen: Counter[str] = field(default_factory=Counter)
    min_separation_m: float = math.inf
    min_silenced_m: float = math.inf
    min_unflown_m: float = math.inf  # of two that nobody's law flies


@functools.lru_cache
def fleet_of(count: int, height_m: float = 1.0) -> FleetConfig:
    """The paper's three, or a square; with a formation in which everybody stands nearly where
    another started. The fence leaves room above the height.
    """
    fleet = (
        load_fleet(ROOT / "configs" / "fleets" / "paper.toml")
        if count == 3
        else square_fleet(count)
    )
    starts = [fleet.vehicles[name].start_enu_m for name in fleet.enabled_names]
    turned = {
        name: (0.9 * x, 0.9 * y, 0.0)
        for name, (x, y, _) in zip(fleet.enabled_names, starts[1:] + starts[:1], strict=True)
    }
    fleet = _for_suite(fleet, height_m)
    return msgspec.structs.replace(fleet, formations={**fleet.formations, "turned": turned})


def _for_suite(fleet: FleetConfig, height_m: float) -> FleetConfig:
    """Return a fleet that waits for no ground for long, with direct endpoints and room above."""
    fence = fleet.fleet.geofence_m
    fence = msgspec.structs.replace(fence, z=(fence.z[0], max(fence.z[1], height_m + 1.5)))
    section = msgspec.structs.replace(
        fleet.fleet, ground_lost_land_s=GROUND_LOST_LAND_S, geofence_m=fence
    )
    vehicles = {
        name: msgspec.structs.replace(
            vehicle, direct=f"udpout://127.0.0.1:{_DIRECT_PORT + vehicle.index}"
        )
        for name, vehicle in fleet.vehicles.items()
    }
    return msgspec.structs.replace(fleet, fleet=section, vehicles=vehicles)


@functools.lru_cache
def mission_of(count: int, height_m: float = 1.0) -> Mission:
    """Up, everybody across to where another started, down."""
    return _crossing(fleet_of(count, height_m), "turned", height_m)


def _crossing(fleet: FleetConfig, formation: str, height_m: float) -> Mission:
    middle_enu_m = [0.0, 0.0, height_m]
    steps = [
        {"do": "takeoff", "height_m": height_m},
        {"do": "formation", "name": formation, "position_enu_m": middle_enu_m, "timeout_s": 14},
        {"do": "land"},
    ]
    return mission_from_mapping({"schema": 1, "step": steps}, path="suite.toml", fleet=fleet)


@functools.lru_cache
def _columns() -> Mission:
    """Two change heights in one column, and a third one flies across above both."""
    return _of_file("above")


@functools.lru_cache
def _moving_formation() -> Mission:
    """Three on paths about a point that moves: they turn about it and draw nearer."""
    return _of_file("escort")


def _of_file(name: str) -> Mission:
    mission = load_mission(ROOT / "configs" / "missions" / f"{name}.toml")
    fleet = _for_suite(mission.fleet, 0.0)
    return msgspec.structs.replace(mission, fleet=fleet)


@functools.lru_cache
def _by_satellites() -> Mission:
    """Up, and two change places, by PX4's own position."""
    fleet = _for_suite(load_fleet(ROOT / "configs" / "fleets" / "px4-sitl.toml"), 0.0)
    triangle = [0.0, 0.0, 2.0]
    steps = [
        {"do": "takeoff", "height_m": 2.0},
        {"do": "formation", "name": "triangle", "position_enu_m": triangle, "timeout_s": 20},
        {"do": "formation", "name": "swapped", "position_enu_m": triangle, "timeout_s": 20},
        {"do": "land"},
    ]
    return mission_from_mapping({"schema": 1, "step": steps}, path="suite.toml", fleet=fleet)


@functools.lru_cache
def _by_cameras() -> Mission:
    """Up, into a triangle across each other's ways, and down, by visual odometry."""
    fleet = load_fleet(ROOT / "configs" / "fleets" / "sih.toml")
    vehicles = {
        name: msgspec.structs.replace(
            vehicle,
            mocap_required=False,
            px4_position="vision",
            px4_params={**vehicle.px4_params, **_ADVISED_WITH_CAMERA},
        )
        for name, vehicle in fleet.vehicles.items()
    }
    fleet = _for_suite(msgspec.structs.replace(fleet, vehicles=vehicles), 1.0)
    section = msgspec.structs.replace(fleet.fleet, max_wind_m_s=_WIND_WITH_CAMERA_M_S)
    fleet = msgspec.structs.replace(fleet, fleet=section)
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "formation", "name": "triangle", "position_enu_m": [0.0, 1.2, 1.0]},
        {"do": "land"},
    ]
    return mission_from_mapping({"schema": 1, "step": steps}, path="suite.toml", fleet=fleet)


@functools.lru_cache
def _by_rtk() -> Mission:
    """The same with corrections, and nobody takes off without an RTK fix."""
    mission = _by_satellites()
    corrections = CorrectionsConfig(source="mock", fix="rtk_fixed")
    fleet = msgspec.structs.replace(mission.fleet, corrections=corrections)
    return msgspec.structs.replace(mission, fleet=fleet)


@dataclass(frozen=True, slots=True)
class SuiteMission:
    """One mission of the suite."""

    mission: Callable[[Case], Mission]
    flight_s: float  # from the take-off to the landing, at a height of 1 m where it is chosen
    height_m: float = 0.0  # the highest; 0: as the case says
    source: str = "poses"  # of positions, see Injection.needs
    has_corrections: bool = False  # nothing else of it breaks
    ready_s: float = READY_S

    def may_break(self, injection: Injection) -> bool:
        """Return whether what breaks is there at all."""
        if self.has_corrections:
            return injection.needs == "corrections"
        if self.source == "camera" and injection.needs_global_position:
            return False
        return injection.needs in ("", self.source)


CROSSING = "crossing"
MISSIONS = {
    CROSSING: SuiteMission(lambda case: mission_of(case.count, case.height_m), FLIGHT_S),
    "columns": SuiteMission(lambda _: _columns(), 36.0, 4.2),
    "moving formation": SuiteMission(lambda _: _moving_formation(), 30.0, 1.4),
    "by satellites": SuiteMission(lambda _: _by_satellites(), 35.0, 2.0, source="satellites"),
    "by RTK": SuiteMission(
        lambda _: _by_rtk(),
        35.0,
        2.0,
        source="satellites",
        has_corrections=True,
        ready_s=RTK_READY_S,
    ),
    "by cameras": SuiteMission(lambda _: _by_cameras(), 18.0, 1.0, source="camera"),
}


def fly(case: Case, folder: Path | None = None) -> Outcome:
    """Fly one case, recorded into a folder; an error of the flight is what is wrong with it, and
    ends no other.
    """
    try:
        return _fly(case, folder)
    except Exception as error:  # noqa: BLE001 - whatever it is
        return Outcome(case, [f"ends with {type(error).__name__}: {error}"])


def _fly(case: Case, folder: Path | None) -> Outcome:
    mission = MISSIONS[case.mission].mission(case)
    names = mission.fleet.enabled_names
    second = injection_of(case.second) if case.second else None
    breaking = Breaking(
        injection=injection_of(case.injection),
        victim=names[case.place],
        at_s=MISSIONS[case.mission].ready_s + 0.02 * case.tick,
        second=second,
        second_victim=names[case.second_place],
        gap_s=case.gap_s,
    )
    flown = fly_broken(
        mission,
        breaking,
        seed=case.tick,
        wind=wind_of((case.wind_m_s, 0.0)),
        height_m=case.height_m,
        folder=folder,
    )
    free_m, silenced_m, unflown_m = flown.smallest_m
    return Outcome(
        case=case,
        wrong=flown.wrong,
        seen=Counter(flown.seen),
        min_separation_m=free_m,
        min_silenced_m=silenced_m,
        min_unflown_m=unflown_m,
    )


def cases(every: int, counts: Iterable[int] = (3, 6), stagger: int = 0) -> list[Case]:
    """Each injection of what has poses at every k-th tick of a flight; with ``stagger`` each one
    begins that much later than the last.
    """
    ticks = round(FLIGHT_S / 0.02)
    return [
        Case(injection.name, tick, count, place=(tick // every) % count)
        for count in counts
        for number, injection in enumerate(INJECTIONS)
        if MISSIONS[CROSSING].may_break(injection)
        for tick in range((number * stagger) % every, ticks, every)
    ]


def summary(outcomes: Sequence[Outcome]) -> str:
    """Counts and smallest distances as Markdown, then what is wrong."""
    lines = [
        "| fault | flights | wrong | smallest distance m | to a vehicle that stops avoiding m |",
        "|---|---|---|---|---|",
    ]
    for injection in INJECTIONS:
        of = [outcome for outcome in outcomes if outcome.case.injection == injection.name]
        if of:
            free = min(o.min_separation_m for o in of)
            silenced = min(o.min_silenced_m for o in of)
            bad = sum(bool(o.wrong) for o in of)
            told = f"{silenced:.2f}" if math.isfinite(silenced) else "-"
            lines.append(f"| {injection.name} | {len(of)} | {bad} | {free:.2f} | {told} |")
    undecided = [(s, c) for s in Situation for c in Condition if (s, c) not in TABLE]
    lines += ["", f"{len(outcomes)} injections, {sum(bool(o.wrong) for o in outcomes)} wrong, "
              f"{len(undecided)} pairs of situation and condition undecided."]  # fmt: skip
    lines += [f"* {outcome.case.name} (seed {outcome.case.tick}): {'; '.join(outcome.wrong)}"
              for outcome in outcomes
              if outcome.wrong]  # fmt: skip
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the suite; exit status 1 when anything is wrong."""
    parser = argparse.ArgumentParser(description="The fault suite in lockstep.")
    parser.add_argument(
        "--every",
        type=int,
        default=25,
        help="inject at every k-th tick (default 25, half a second)",
    )
    parser.add_argument(
        "--stagger",
        type=int,
        default=0,
        help="ticks that each injection begins later than the last",
    )
    parser.add_argument("--counts", default="3,6", help="fleet sizes (default 3,6)")
    parser.add_argument("--only", default="", help="injections whose name contains this")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(argv)
    todo = [
        case
        for case in cases(
            options.every, [int(word) for word in options.counts.split(",")], options.stagger
        )
        if options.only in case.injection
    ]
    begin_s = time.perf_counter()
    outcomes = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for number, outcome in enumerate(pool.map(fly, todo), 1):
            outcomes.append(outcome)
            print(
                f"\r{number}/{len(todo)} {time.perf_counter() - begin_s:.0f} s ", end="", flush=True
            )
            if outcome.wrong:
                print(f"\n{outcome.case.name}: {'; '.join(outcome.wrong)}", flush=True)
    print("\n\n" + summary(outcomes))
    return int(any(outcome.wrong for outcome in outcomes))


if __name__ == "__main__":
    raise SystemExit(main())
