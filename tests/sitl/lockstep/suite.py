"""One flight of the fault suite: something breaks at one tick, and everything that has to hold is
judged.

    python -m tests.sitl.lockstep.suite --every 25        # the whole table, printed

Judged by ground truth and by what left the agents, not by what they say of themselves.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import numpy as np

from groundstation.mission_files.loading import load_mission, mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.missions.api import OrderFailed
from onboard.bus.schema import Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.config.pair_separation import separation_m
from onboard.config.wind_limit import GUST_SHARE
from onboard.feasibility.blind_descent import blind_descent_findings
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import TABLE, WORDS, Action, Condition, Situation, decide
from onboard.types import AttitudeSetpoint
from sitl.emulator.emulator import Environment
from sitl.lockstep.flight import Lockstep
from sitl.physics.wind import WindSettings
from tests.sitl.lockstep.injections import INJECTIONS, Injection
from tests.sitl.square_fleets import square_fleet

ROOT = Path(__file__).resolve().parents[3]
# a second before the earliest take-off, so that arming is one of the moments; what breaks before
# that is a matter of preflight, not of flight
READY_S = 3.5
FLIGHT_S = 17.0
GROUND_LOST_LAND_S = 4.0
# of the safety distance: what vehicles keep that all have lost their poses
BLIND_SHARE = 0.7 / 0.8
_DIRECT_PORT = 18_570  # never opened in lockstep
_DOWN_TIMEOUT_S = 60.0
_FENCE_SLACK_M = 0.30
_TILT_SLACK_DEG = 0.5


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


@dataclass(frozen=True, slots=True)
class SuiteMission:
    """One mission of the suite."""

    mission: Callable[[Case], Mission]
    flight_s: float  # from the take-off to the landing, at a height of 1 m where it is chosen
    height_m: float = 0.0  # the highest; 0: as the case says
    has_poses: bool = True  # of a motion capture, and no satellites

    def may_break(self, injection: Injection) -> bool:
        """Return whether what breaks is there at all."""
        return injection.needs in ("", "poses" if self.has_poses else "satellites")


CROSSING = "crossing"
MISSIONS = {
    CROSSING: SuiteMission(lambda case: mission_of(case.count, case.height_m), FLIGHT_S),
    "columns": SuiteMission(lambda _: _columns(), 36.0, 4.2),
    "moving formation": SuiteMission(lambda _: _moving_formation(), 30.0, 1.4),
    "by satellites": SuiteMission(lambda _: _by_satellites(), 35.0, 2.0, has_poses=False),
}


class Judge:
    """Looks at every tick of a flight."""

    def __init__(
        self, flight: Lockstep, injection: Injection, victim: str, silenced: Collection[str]
    ) -> None:
        self.flight = flight
        self.injection = injection
        self.victim = victim
        self.silenced = frozenset(silenced)
        self.outcome_wrong: dict[str, None] = {}
        self.seen: dict[str, Counter[Condition]] = {
            name: Counter() for name in flight.config.enabled_names
        }
        # by how many of a pair are silenced
        self.smallest = [math.inf, math.inf, math.inf]
        self.is_injected = self.was_flying = False
        self.highest_m = math.inf
        self._strongest: dict[str, Action] = {}
        self._order_of: dict[str, str] = {}
        self._asked: dict[str, Action] = {}
        self.truths: dict[str, Truth] = {}
        self.height_share = flight.config.fleet.height_share
        node = flight.bus.node("judge")
        node.start()
        node.subscribe(Topic.TRUTH, "*", self._look)
        for shell in flight.agents.values():
            shell.link.send_attitude = functools.partial(  # type: ignore[method-assign]
                self._check_setpoint, shell.name, shell.link.send_attitude
            )

    def wrong(self, sentence: str) -> None:
        """Note something that must not be, once."""
        self.outcome_wrong.setdefault(sentence)

    def _check_setpoint(self, name: str, send: object, setpoint: AttitudeSetpoint) -> None:
        q = np.asarray(setpoint.quaternion_wxyz)
        thrust = setpoint.thrust_frac
        limit_deg = self.flight.config.vehicles[name].max_tilt_deg + _TILT_SLACK_DEG
        if not (np.isfinite(q).all() and math.isfinite(thrust)):
            self.wrong(f"{name} sends what is not finite")
        elif not 0.0 <= thrust <= 1.0 or abs(np.linalg.norm(q) - 1.0) > 1e-6:
            self.wrong(f"{name} sends a thrust of {thrust:.2f} or no unit quaternion")
        elif (
            math.degrees(math.acos(max(-1.0, 1.0 - 2.0 * float(q[1] ** 2 + q[2] ** 2)))) > limit_deg
        ):
            self.wrong(f"{name} sends more tilt than allowed")
        send(setpoint)  # type: ignore[operator]

    def _look(self, _topic: Topic, name: str, truth: object) -> None:
        assert isinstance(truth, Truth)
        self.truths[name] = truth
        if name == self.flight.config.enabled_names[-1]:
            self._measure()
            for shell in self.flight.agents.values():
                if shell.is_ticking:
                    self._check_action(shell.name)

    def _measure(self) -> None:
        truths = list(self.truths.values())
        for place, one in enumerate(truths):
            for other in truths[place + 1 :]:
                if one.is_on_ground and other.is_on_ground:
                    continue
                far_m = separation_m(one.position_enu_m, other.position_enu_m, self.height_share)
                silenced = 0
                if self.is_injected:
                    silenced = len(self.silenced & {one.vehicle, other.vehicle})
                self.smallest[silenced] = min(self.smallest[silenced], far_m)
        fence = self.flight.config.fleet.geofence_m
        for truth in truths:
            x, y, z = truth.position_enu_m
            inside = (
                all(
                    low - _FENCE_SLACK_M <= value <= high + _FENCE_SLACK_M
                    for value, (low, high) in zip((x, y), (fence.x, fence.y), strict=True)
                )
                and z <= fence.z[1] + _FENCE_SLACK_M
            )
            may_leave = self.injection.may_leave_fence and (
                truth.vehicle == self.victim or truth.vehicle in self.silenced
            )
            if not inside and not may_leave:
                self.wrong(f"{truth.vehicle} leaves the fence")
            if truth.vehicle == self.victim and z > self.highest_m:
                self.wrong(f"{truth.vehicle} rises by more than {self.injection.rises_m} m")

    def _check_action(self, name: str) -> None:
        """The table's action, and nothing else: what is done follows from what holds and from
        orders alone.
        """
        core = self.flight.agents[name].core
        flight = core.flight
        conditions = core.failsafes.conditions
        self.seen[name].update(conditions)
        order = flight.order.order_id if flight.order is not None else ""
        if order and order != self._order_of.get(name):
            self._order_of[name] = order
            self._strongest[name] = Action.GO_ON
        situation = flight.situation
        if situation is Situation.GROUND:
            self._strongest[name] = Action.GO_ON
            return
        asked, _ = decide(situation, conditions)
        # what a tick found while it still was in another situation is obeyed by the next one
        before = self._asked.get(name, Action.GO_ON)
        self._asked[name] = asked
        strongest = self._strongest[name] = max(
            self._strongest.get(name, Action.GO_ON), min(before, asked)
        )
        done = _done(core)
        if strongest in _NEEDS and done not in _NEEDS[strongest]:
            held = ", ".join(condition.value for condition in conditions)
            self.wrong(f"{name}: {WORDS[strongest]} is asked for ({held}) and {done} is done")
        if strongest <= Action.SLOW and done in ("failed", "px4") and not flight.reason:
            self.wrong(f"{name}: {done} is done without a reason")

    def finish(self) -> None:
        """After the flight."""
        flight = self.flight
        injection = self.injection
        victim = self.victim
        for collision in flight.simulation.emulator.world.collisions:
            both = {flight.simulation.names[i] for i in (collision.first, collision.second)}
            if not both <= self.silenced:
                self.wrong(f"{' and '.join(sorted(both))} collide")
        for one, autopilot in zip(
            flight.simulation.names, flight.simulation.emulator.autopilots, strict=True
        ):
            if autopilot.is_armed or not self.truths[one].is_on_ground:
                self.wrong(f"{one} is not down and disarmed at the end")
        for sentence in flight.hard_touchdowns:
            self.wrong(sentence)
        for event in flight.events:
            if event.code == "direct_command" and event.vehicle not in self.silenced:
                self.wrong(event.sentence)
        told = {(event.vehicle, event.code) for event in flight.events}
        others = [name for name in self.seen if name != victim]
        for wanted, names in ((injection.own, [victim]), (injection.others, others)):
            if not wanted or not self.was_flying:
                continue
            noticed = {
                condition for name in names for condition in wanted if self.seen[name][condition]
            }
            if not noticed:
                self.wrong(
                    f"{' or '.join(names)} did not notice "
                    f"{' or '.join(sorted(c.value for c in wanted))}"
                )
            elif not injection.is_cut_off:
                spoken = {
                    condition
                    for name in names
                    for condition in noticed
                    if (name, _code(condition)) in told
                }
                quiet = {
                    Condition.NOT_FINITE,
                    Condition.LOOP_LATE,
                    Condition.GROUND_LOST,
                    Condition.SHUTDOWN,
                }
                if not spoken and not noticed <= quiet:
                    self.wrong(f"the record does not tell {', '.join(c.value for c in noticed)}")

    def begin(self) -> None:
        """Now it breaks; on the ground there is nothing that must be noticed."""
        self.is_injected = True
        flights = [shell.core.flight.situation for shell in self.flight.agents.values()]
        self.was_flying = all(situation is Situation.FLYING for situation in flights)
        if self.was_flying:
            self.highest_m = self.truths[self.victim].position_enu_m[2] + self.injection.rises_m


_NEEDS: dict[Action, tuple[str, ...]] = {
    Action.HOLD: ("hold", "land", "px4", "failed", "armed"),
    Action.LEVEL: ("hold", "land", "px4", "failed", "armed"),
    Action.LAND: ("land", "px4", "failed"),
    Action.PX4_LAND: ("px4", "failed"),
    Action.STOP: ("failed",),
}


def _done(core: object) -> str:
    flight = core.flight  # type: ignore[attr-defined]
    if flight.state == "landing":
        return "px4" if flight.step is FlightStep.PX4_LANDING else "land"
    return {"holding": "hold", "failed": "failed", "armed": "armed"}.get(flight.state, "fly")


def _code(condition: Condition) -> str:
    return condition.name.lower().replace("_", "-")


def fly(case: Case, folder: Path | None = None) -> Outcome:
    """Fly one case, recorded into a folder; an error of the flight is what is wrong with it, and
    ends no other.
    """
    try:
        return _fly(case, folder)
    except Exception as error:  # noqa: BLE001 - whatever it is
        return Outcome(case, [f"ends with {type(error).__name__}: {error}"])


def _fly(case: Case, folder: Path | None) -> Outcome:
    first = injection_of(case.injection)
    second = injection_of(case.second) if case.second else None
    injection = first if second is None else both_of(first, second)
    outcome = Outcome(case)
    mission = MISSIONS[case.mission].mission(case)
    environment = Environment(wind=wind_of(case.wind_m_s))
    with Lockstep(mission.fleet, seed=case.tick, folder=folder, environment=environment) as flight:
        victim = flight.config.enabled_names[case.place]
        other = flight.config.enabled_names[case.second_place]
        silenced = set()
        if first.is_silenced:
            silenced.add(victim)
        if second is not None and second.is_silenced:
            silenced.add(other)
        judge = Judge(flight, injection, victim, silenced)

        def inject() -> None:
            judge.begin()
            first.inject(flight, victim)

        at_s = READY_S + 0.02 * case.tick
        flight.at(at_s, inject)
        if second is not None:
            flight.at(at_s + case.gap_s, functools.partial(second.inject, flight, other))
        flight.fly(mission)
        flight.bus.heal()
        flight.run(1.0)
        up = [
            name
            for name, shell in flight.agents.items()
            if shell.core.flight.situation is Situation.FLYING
        ]
        airborne = [name for name in up if flight.agents[name].is_ticking]
        if airborne:
            with contextlib.suppress(OrderFailed):  # who is not down at the end is found below
                flight.land(",".join(airborne))
        names = list(flight.simulation.names)
        px4s = flight.simulation.emulator.autopilots
        flight.until(
            lambda _: all(
                not px4.is_armed and judge.truths[name].is_on_ground
                for name, px4 in zip(names, px4s, strict=True)
            ),
            _DOWN_TIMEOUT_S,
        )
        judge.finish()
        outcome.wrong = list(judge.outcome_wrong)
        for counts in judge.seen.values():
            outcome.seen.update({condition.value: ticks for condition, ticks in counts.items()})
        free_m, silenced_m, unflown_m = judge.smallest
        outcome.min_separation_m = free_m
        outcome.min_silenced_m = silenced_m
        outcome.min_unflown_m = unflown_m

        body_m = flight.config.fleet.body_diameter_m
        promised_m = _promised_m(injection, flight.config, outcome)
        if free_m < promised_m:
            outcome.wrong.append(f"{promised_m:g} m is promised: {free_m:.2f} m")
        if silenced_m < body_m and not injection.is_falling:
            outcome.wrong.append(f"bodies touch: {silenced_m:.2f} m")
    return outcome


def _promised_m(injection: Injection, fleet: FleetConfig, outcome: Outcome) -> float:
    """Return what two vehicles that the law flies keep at least.

    A descent without poses that takes too long is none that ``covey check`` allows: there bodies
    apart are all that is promised.
    """
    body_m = fleet.fleet.body_diameter_m
    if injection.is_astray:
        return body_m

    if Condition.POSITION_LOST.value in outcome.seen:
        spots = {}
        for name in fleet.enabled_names:
            x, y, _ = fleet.vehicles[name].start_enu_m
            spots[name] = (x, y, outcome.case.height_m)
        if any(
            one.status == "refused" for one in blind_descent_findings(fleet, spots, "the crossing")
        ):
            return body_m

    if injection.is_blind:
        return BLIND_SHARE * fleet.fleet.safety_distance_m
    return fleet.fleet.safety_distance_m


def injection_of(name: str) -> Injection:
    """Return the row of the catalogue."""
    return next(one for one in INJECTIONS if one.name == name)


def both_of(first: Injection, second: Injection) -> Injection:
    """Return what may follow when both break; which of them is noticed is not judged."""
    return replace(
        first,
        own=frozenset(),
        others=frozenset(),
        is_silenced=first.is_silenced or second.is_silenced,
        is_cut_off=first.is_cut_off or second.is_cut_off,
        may_leave_fence=first.may_leave_fence or second.may_leave_fence,
        is_falling=first.is_falling or second.is_falling,
        is_astray=first.is_astray or second.is_astray,
        is_blind=first.is_blind or second.is_blind,
        rises_m=max(first.rises_m, second.rises_m),
    )


def wind_of(mean_m_s: float) -> WindSettings:
    """Return a wind from the west, with the gusts that limits count with."""
    return WindSettings(mean_enu_m_s=(mean_m_s, 0.0, 0.0), gust_std_m_s=GUST_SHARE * mean_m_s)


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
        "| what breaks | flights | wrong | smallest distance m | of pairs with the silenced one "
        "m |",
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
