"""``make bench-blind ARGS="--out FILE"``: fleets that lose the poses of all, or of one, at any
moment of a mission, in lockstep.

A case is a fleet, its height, a moment after a leg of the mission has begun, and for how long the
poses stay away. What is judged is ground truth: how near two bodies came while one of them flew,
how fast each came down, and whether anybody throttled after that. What a vehicle believed beside
what was true is kept as well, for the error of its dead reckoning.

Each flight is a line of JSON in the file. Flights that stand there already are not flown again, so
a sweep that was stopped goes on.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.bus.schema import Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.config.pair_separation import separation_m
from onboard.flight.types import FlightStep
from sitl.emulator.emulator import Environment
from sitl.faults.catalogue import Fault
from sitl.lockstep.agents import AgentShell
from sitl.lockstep.campaign.broken_flight import wind_of
from sitl.lockstep.flight import Lockstep
from tests.sitl.lockstep.suite import fleet_of

CONFIGS = Path(__file__).parents[2] / "configs"

FLEETS = ("three", "six", "pair", "above")
HEIGHTS_M = {"three": (1.0, 2.5), "six": (1.0, 2.5), "pair": (2.5,), "above": (4.2,)}
LEGS = {"three": (1,), "six": (1,), "pair": (1, 2), "above": (1, 2)}

_DOWN_TIMEOUT_S = 45.0
_STANDS_S = 1.0  # on the ground, after which thrust is not that of a touch-down any more
_THROTTLES_FRAC = 0.5  # of the thrust that hovers
_TOUCHDOWN_S = 0.1  # before contact: the speed is the largest of this time
_AGES_S = (1, 2, 3, 4, 5, 6)  # since the last pose: errors are noted then


class Case(NamedTuple):
    """One flight."""

    fleet: str
    height_m: float
    leg: int  # 0: the climb; 1, 2, ...: the moves after it
    moment_s: float  # since that leg has begun
    back_s: float = 0.0  # after which the poses are back; 0: never
    is_of_all: bool = True
    seed: int = 0
    wind_m_s: float = 0.0  # from the west, with its usual gusts

    @property
    def name(self) -> str:
        """Key of the case in the file."""
        whose = "all" if self.is_of_all else "one"
        back = f"{self.back_s:g} s" if self.back_s else "for good"
        name = (
            f"{self.fleet} at {self.height_m:g} m, leg {self.leg} + {self.moment_s:.2f} s,"
            f" {whose} {back}, seed {self.seed}"
        )
        if self.wind_m_s:
            name += f", {self.wind_m_s:g} m/s of wind"
        return name


@dataclass
class Flown:
    """What became of it, by ground truth."""

    case: str = ""
    nearest_m: float = math.inf  # after the loss, as the fleet's promise measures it
    bodies_m: float = math.inf  # after the loss, between centres in space
    nearest_s: float = math.nan  # when, after the loss
    nearest_pair: list[str] = field(default_factory=list)
    before_m: float = math.inf  # as nearest_m, but before the loss
    collisions: int = 0
    down_s: dict[str, float] = field(default_factory=dict)  # after the loss
    touchdown_m_s: dict[str, float] = field(default_factory=dict)
    by_px4: list[str] = field(default_factory=list)  # landed by PX4
    throttled_s: dict[str, float] = field(default_factory=dict)  # after it stood
    errors_m: dict[str, list[list[float]]] = field(default_factory=dict)  # age: sideways, height
    intervention_m_s2: float = 0.0  # of the law, largest after the loss
    wall_s: float = 0.0
    wrong: str = ""  # the flight itself failed


class Watch:
    """Looks at every truth of a flight, and at every setpoint that leaves."""

    def __init__(self, flight: Lockstep, case: Case) -> None:
        self.flown = Flown(case.name)
        self.lost_s = math.inf
        self._flight = flight
        self._names = list(flight.config.enabled_names)
        self._truths: dict[str, Truth] = {}
        self._speeds: dict[str, list[float]] = defaultdict(list)
        self._stands_since_s: dict[str, float] = {}
        self._height_share = flight.config.fleet.height_share

        node = flight.bus.node("judge")
        node.start()
        node.subscribe(Topic.TRUTH, "*", self._look)
        for shell in flight.agents.values():
            self._listen(shell)

    def _listen(self, shell: AgentShell) -> None:
        send = shell.link.send_attitude

        def watched(setpoint: Any) -> None:
            self._judge_thrust(shell, setpoint.thrust_frac)
            send(setpoint)

        shell.link.send_attitude = watched  # type: ignore[method-assign]

    def _judge_thrust(self, shell: AgentShell, thrust_frac: float) -> None:
        stands_s = self._flight.time_s - self._stands_since_s.get(shell.name, math.inf)
        tick = shell.core.control.tick
        hover_frac = shell.core.control.hover_frac
        if stands_s > _STANDS_S and thrust_frac > _THROTTLES_FRAC * hover_frac:
            known_s = self.flown.throttled_s.get(shell.name, 0.0)
            self.flown.throttled_s[shell.name] = known_s + 0.02
        if tick is not None and self._flight.time_s > self.lost_s:
            self.flown.intervention_m_s2 = max(
                self.flown.intervention_m_s2, tick.law.intervention_m_s2
            )

    def _look(self, _topic: Topic, name: str, truth: object) -> None:
        assert isinstance(truth, Truth)
        self._truths[name] = truth
        if self._flight.time_s >= self.lost_s:
            self._follow_landing(name, truth)
        if name == self._names[-1] and len(self._truths) == len(self._names):
            self._measure()

    def _follow_landing(self, name: str, truth: Truth) -> None:
        after_s = self._flight.time_s - self.lost_s
        if not truth.is_on_ground:
            self._speeds[name].append(-truth.velocity_enu_m_s[2])
            self._stands_since_s.pop(name, None)
            return
        self._stands_since_s.setdefault(name, self._flight.time_s)
        if name not in self.flown.down_s and self._speeds[name]:
            self.flown.down_s[name] = round(after_s, 2)
            last = self._speeds[name][-round(_TOUCHDOWN_S / 0.02) :]
            self.flown.touchdown_m_s[name] = round(max(last), 2)

    def _measure(self) -> None:
        flown = self.flown
        is_after = self._flight.time_s >= self.lost_s
        for one, other in itertools.combinations(self._truths.values(), 2):
            if one.is_on_ground and other.is_on_ground:
                continue
            far_m = separation_m(one.position_enu_m, other.position_enu_m, self._height_share)
            if not is_after:
                flown.before_m = min(flown.before_m, far_m)
                continue
            flown.bodies_m = min(
                flown.bodies_m, math.dist(one.position_enu_m, other.position_enu_m)
            )
            if far_m < flown.nearest_m:
                flown.nearest_m = far_m
                flown.nearest_s = self._flight.time_s - self.lost_s
                flown.nearest_pair = [one.vehicle, other.vehicle]

    def note_errors(self, age_s: int) -> None:
        """Note what is believed beside what is true, of those still in the air."""
        for name, truth in self._truths.items():
            core = self._flight.agents[name].core
            if truth.is_on_ground or not core.own.is_dead_reckoned:
                continue
            x, y, z = core.own.position_enu_m
            true_x, true_y, true_z = truth.position_enu_m
            error = [math.hypot(x - true_x, y - true_y), z - true_z]
            self.flown.errors_m.setdefault(str(age_s), []).append([round(e, 3) for e in error])

    def are_down(self) -> bool:
        """Whether everybody is on the ground and disarmed."""
        px4s = self._flight.simulation.emulator.autopilots
        is_armed = any(px4.is_armed for px4 in px4s)
        return not is_armed and all(truth.is_on_ground for truth in self._truths.values())


@functools.lru_cache
def fleet_and_mission(fleet_name: str, height_m: float) -> tuple[FleetConfig, Mission]:
    """Return a fleet and what it flies at a height."""
    if fleet_name == "above":
        return _above(CONFIGS / "missions" / "above.toml")
    if fleet_name == "pair":
        fleet = load_fleet(CONFIGS / "fleets" / "above.toml")
        steps: list[dict[str, Any]] = [
            {"do": "takeoff"},
            {"do": "goto", "goals": {"mav0": [0, 0, 1], "mav1": [0, 0, height_m]}},
            {"do": "goto", "goals": {"mav0": [0, 0, height_m], "mav1": [0, 0, 1]}},
            {"do": "home"},
        ]
        mission = {"schema": 1, "step": steps}
        return fleet, mission_from_mapping(mission, path="pair.toml", fleet=fleet)

    fleet = fleet_of({"three": 3, "six": 6}[fleet_name])
    steps = [
        {"do": "takeoff", "height_m": height_m},
        {
            "do": "formation",
            "name": "turned",
            "position_enu_m": [0.0, 0.0, height_m],
            "timeout_s": 14,
        },
        {"do": "land"},
    ]
    mission = {"schema": 1, "step": steps}
    return fleet, mission_from_mapping(mission, path="blind.toml", fleet=fleet)


def _above(path: Path) -> tuple[FleetConfig, Mission]:
    mission = load_mission(path)
    return mission.fleet, mission


def fly(case: Case, folder: Path | None = None) -> Flown:
    """Fly one case; an error of the flight is what is wrong with it."""
    begin_s = time.monotonic()
    fleet, mission = fleet_and_mission(case.fleet, case.height_m)
    seed = case.seed * 1000 + round(50 * case.moment_s) + 7 * case.leg
    environment = Environment(wind_of((case.wind_m_s, 0.0)))
    with Lockstep(fleet, seed=seed, folder=folder, environment=environment) as flight:
        watch = Watch(flight, case)
        _plan_loss(flight, case, watch)
        try:
            flight.fly(mission)
            flight.until(lambda _: watch.are_down(), _DOWN_TIMEOUT_S)
        except Exception as error:  # noqa: BLE001 - whatever it is
            watch.flown.wrong = f"{type(error).__name__}: {error}"
        watch.flown.collisions = len(flight.simulation.emulator.world.collisions)
        if not watch.are_down():
            watch.flown.wrong += "not down and disarmed at the end"
    watch.flown.wall_s = round(time.monotonic() - begin_s, 1)
    return watch.flown


def _plan_loss(flight: Lockstep, case: Case, watch: Watch) -> None:
    """Lose the poses at the case's moment, and look on from then on."""
    names = flight.config.enabled_names

    def lose() -> None:
        watch.lost_s = flight.time_s
        count = len(names)
        first = round(50 * case.moment_s) % count
        for name in names if case.is_of_all else names[first:][:1]:
            flight.inject(Fault("mocap_lost", name, flight.time_s, case.back_s))
        for age_s in _AGES_S:
            flight.at(flight.time_s + age_s, functools.partial(watch.note_errors, age_s))
        look()

    def look() -> None:
        for name, agent in flight.agents.items():
            is_by_px4 = agent.core.flight.step is FlightStep.PX4_LANDING
            if is_by_px4 and name not in watch.flown.by_px4:
                watch.flown.by_px4.append(name)
        flight.at(flight.time_s + 0.1, look)

    def wait() -> None:
        cores = [agent.core for agent in flight.agents.values()]
        if any(_has_begun(core.flight, case.leg) for core in cores):
            flight.at(flight.time_s + case.moment_s, lose)
        else:
            flight.at(flight.time_s + 0.02, wait)

    flight.at(0.0, wait)


def _has_begun(flight: Any, leg: int) -> bool:
    if leg == 0:
        return flight.step in (FlightStep.LIFTOFF, FlightStep.CLIMB)
    return bool(flight.leg_count >= leg)


# -- the sweep -------------------------------------------------------------------------------------


def cases(options: argparse.Namespace) -> Iterator[Case]:
    """Yield the cases of a sweep, in an order in which each part of it is a cross-section."""
    backs = [float(word) for word in options.back.split(",")]
    wholes = {"all": [True], "one": [False], "both": [True, False]}[options.whose]
    fleets = options.fleets.split(",")
    for number in range(options.moments):
        # the golden ratio spreads any number of moments evenly
        share = math.modf((number + 0.5 + options.seed) * 0.6180339887)[0]
        for name in fleets:
            heights = HEIGHTS_M[name]
            if options.heights:
                heights = tuple(float(word) for word in options.heights.split(","))
            for height_m, back_s, is_of_all in itertools.product(heights, backs, wholes):
                for leg in LEGS[name] if options.leg is None else (options.leg,):
                    moment_s = round(options.span * share, 2)
                    yield Case(
                        fleet=name,
                        height_m=height_m,
                        leg=leg,
                        moment_s=moment_s,
                        back_s=back_s,
                        is_of_all=is_of_all,
                        seed=options.seed,
                        wind_m_s=options.wind,
                    )


def sweep(flights: Iterable[Case], path: Path, say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Fly what the file does not hold yet; return all of it that belongs to the sweep."""
    known: dict[str, dict[str, Any]] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            record = json.loads(line)
            known[record["case"]] = record

    records = []
    for case in flights:
        record = known.get(case.name)
        if record is None:
            record = asdict(fly(case))
            with path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(record) + "\n")
            say(sentence(record))
        records.append(record)
    return records


def sentence(record: dict[str, Any]) -> str:
    """Return a line about a flight."""
    down_s = max(record["down_s"].values(), default=math.nan)
    fastest_m_s = max(record["touchdown_m_s"].values(), default=math.nan)
    line = (
        f"{record['case']}: {record['nearest_m']:.2f} m after {record['nearest_s']:.1f} s,"
        f" down after {down_s:.1f} s with {fastest_m_s:.2f} m/s"
    )
    if record["collisions"]:
        line += ", COLLISION"
    if record["by_px4"]:
        line += f", PX4 lands {', '.join(record['by_px4'])}"
    if record["throttled_s"]:
        line += f", throttles on the ground: {record['throttled_s']}"
    if record["wrong"]:
        line += f", {record['wrong']}"
    return line


def summary(records: Sequence[dict[str, Any]]) -> str:
    """Return a table: fleet and height, and what was worst."""
    groups: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in records:
        fleet, _, rest = record["case"].partition(", leg")
        whose = "one" if " one " in rest else "all"
        back = "for good" if "for good" in rest else "back"
        groups[f"{fleet}, {whose} {back}"].append(record)
    groups["all of them"] = list(records)

    lines = [
        "| fleet | flights | touched | below .70 m | nearest | 5 % | median | last one down s |"
        " touch-down m/s, 95 %, worst | by PX4 | throttled | wrong |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, some in groups.items():
        near = sorted(record["nearest_m"] for record in some)
        down = sorted(max(record["down_s"].values(), default=math.nan) for record in some)
        speeds = sorted(v for record in some for v in record["touchdown_m_s"].values())
        cells = [
            name,
            len(some),
            sum(record["nearest_m"] < 0.5 or record["collisions"] > 0 for record in some),
            sum(value < 0.70 for value in near),
            f"{near[0]:.2f}",
            f"{quantile(near, 0.05):.2f}",
            f"{quantile(near, 0.5):.2f}",
            f"{down[-1]:.1f}",
            f"{quantile(speeds, 0.95):.2f}, {quantile(speeds, 1.0):.2f}",
            sum(bool(record["by_px4"]) for record in some),
            sum(bool(record["throttled_s"]) for record in some),
            sum(bool(record["wrong"]) for record in some),
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")

    lines += ["", "| age s | vehicles | sideways, median, 95 %, worst m | height, least, most m |"]
    lines.append("|---|---|---|---|")
    for age_s in _AGES_S:
        errors = [e for record in records for e in record["errors_m"].get(str(age_s), [])]
        if not errors:
            continue
        sideways = sorted(error[0] for error in errors)
        heights = sorted(error[1] for error in errors)
        lines.append(
            f"| {age_s} | {len(errors)} | {quantile(sideways, 0.5):.2f},"
            f" {quantile(sideways, 0.95):.2f}, {sideways[-1]:.2f} |"
            f" {heights[0]:.2f}, {heights[-1]:.2f} |"
        )
    return "\n".join(lines)


def quantile(ascending: Sequence[float], share: float) -> float:
    """Return the value below which this share of sorted numbers lies; NaN of none."""
    if not ascending:
        return math.nan
    return ascending[min(int(share * len(ascending)), len(ascending) - 1)]


def main(words: Sequence[str]) -> int:
    """Fly the sweep and print its table; 1 when two touched or a flight was wrong."""
    parser = argparse.ArgumentParser(
        prog="make bench-blind", description=(__doc__ or "").partition("\n\n")[0]
    )
    parser.add_argument("--out", type=Path, required=True, help="flights, a line of JSON each")
    parser.add_argument("--fleets", default=",".join(FLEETS), help="of three, six, pair, above")
    parser.add_argument("--heights", default="", help="in metres, instead of the usual ones")
    parser.add_argument(
        "--leg", type=int, help="0 the climb, 1 the first move; else those in which vehicles meet"
    )
    parser.add_argument("--moments", type=int, default=12, help="of each leg (default 12)")
    parser.add_argument("--span", type=float, default=6.0, help="seconds they spread over")
    parser.add_argument("--back", default="0", help="seconds without poses, 0 for good: 0,0.3,2")
    parser.add_argument("--whose", default="all", choices=("all", "one", "both"))
    parser.add_argument("--wind", type=float, default=0.0, help="m/s from the west")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--quiet", action="store_true", help="the table only")
    options = parser.parse_args(words)

    def say(line: str) -> None:
        if not options.quiet:
            print(line, flush=True)

    records = sweep(cases(options), options.out, say)
    print(summary(records))
    is_bad = any(
        record["collisions"] or record["nearest_m"] < 0.5 or record["wrong"] for record in records
    )
    return int(is_bad)
