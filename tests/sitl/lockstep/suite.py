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
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.missions.api import OrderFailed
from onboard.bus.schema import Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import TABLE, WORDS, Action, Condition, Situation, decide
from onboard.types import AttitudeSetpoint
from sitl.lockstep.flight import Lockstep
from tests.sitl.lockstep.injections import INJECTIONS, Injection
from tests.sitl.square_fleets import square_fleet

ROOT = Path(__file__).resolve().parents[3]
# the earliest take-off; what breaks before it is a matter of preflight, not of flight
READY_S = 3.5
FLIGHT_S = 17.0
_DOWN_TIMEOUT_S = 60.0
_FENCE_SLACK_M = 0.30
_TILT_SLACK_DEG = 0.5


@dataclass(frozen=True, slots=True)
class Case:
    """One injection: what breaks, at which tick of the flight, for whom, in which fleet."""

    injection: str
    tick: int
    count: int = 3
    place: int = 1

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.injection}, {self.count} vehicles, {0.02 * self.tick:.2f} s"


@dataclass(slots=True)
class Outcome:
    """Result of one case; ``wrong`` is empty when all holds."""

    case: Case
    wrong: list[str] = field(default_factory=list)
    seen: Counter[str] = field(default_factory=Counter)
    min_separation_m: float = math.inf
    min_silenced_m: float = math.inf


@functools.lru_cache
def fleet_of(count: int) -> FleetConfig:
    """The paper's three, or a square; with a formation in which everybody stands nearly where
    another started.
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
    section = msgspec.structs.replace(fleet.fleet, ground_lost_land_s=4.0)
    return msgspec.structs.replace(
        fleet, fleet=section, formations={**fleet.formations, "turned": turned}
    )


@functools.lru_cache
def mission_of(count: int) -> Mission:
    """Up, everybody across to where another started, down."""
    steps = [
        {"do": "takeoff", "height_m": 1.0},
        {"do": "formation", "name": "turned", "position_enu_m": [0.0, 0.0, 1.0], "timeout_s": 14},
        {"do": "land"},
    ]
    return mission_from_mapping(
        {"schema": 1, "step": steps}, path="suite.toml", fleet=fleet_of(count)
    )


class Judge:
    """Looks at every tick of a flight."""

    def __init__(self, flight: Lockstep, injection: Injection, victim: str) -> None:
        self.flight, self.injection, self.victim = flight, injection, victim
        self.outcome_wrong: dict[str, None] = {}
        self.seen: dict[str, Counter[Condition]] = {
            name: Counter() for name in flight.config.enabled_names
        }
        self.smallest = {True: math.inf, False: math.inf}
        self.is_injected = self.was_flying = False
        self.highest_m = math.inf
        self._strongest: dict[str, Action] = {}
        self._order_of: dict[str, str] = {}
        self._asked: dict[str, Action] = {}
        self.truths: dict[str, Truth] = {}
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
        q, thrust = np.asarray(setpoint.quaternion_wxyz), setpoint.thrust_frac
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
                far_m = math.dist(one.position_enu_m[:2], other.position_enu_m[:2])
                silenced = self.is_injected and self.injection.is_silenced
                is_its = silenced and self.victim in (one.vehicle, other.vehicle)
                self.smallest[is_its] = min(self.smallest[is_its], far_m)
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
            if not inside and not (truth.vehicle == self.victim and self.injection.may_leave_fence):
                self.wrong(f"{truth.vehicle} leaves the fence")
            if truth.vehicle == self.victim and z > self.highest_m:
                self.wrong(f"{truth.vehicle} rises by more than {self.injection.rises_m} m")

    def _check_action(self, name: str) -> None:
        """The table's action, and nothing else: what is done follows from what holds and from
        orders alone.
        """
        core = self.flight.agents[name].core
        flight, conditions = core.flight, core.failsafes.conditions
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
        before, self._asked[name] = self._asked.get(name, Action.GO_ON), asked
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
        flight, injection, victim = self.flight, self.injection, self.victim
        if flight.simulation.emulator.world.collisions:
            self.wrong(f"collisions: {len(flight.simulation.emulator.world.collisions)}")
        for one, autopilot in zip(
            flight.simulation.names, flight.simulation.emulator.autopilots, strict=True
        ):
            if autopilot.is_armed or not self.truths[one].is_on_ground:
                self.wrong(f"{one} is not down and disarmed at the end")
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
    injection = next(one for one in INJECTIONS if one.name == case.injection)
    outcome = Outcome(case)
    with Lockstep(fleet_of(case.count), seed=case.tick, folder=folder) as flight:
        victim = flight.config.enabled_names[case.place]
        judge = Judge(flight, injection, victim)

        def inject() -> None:
            judge.begin()
            injection.inject(flight, victim)

        flight.at(READY_S + 0.02 * case.tick, inject)
        flight.fly(mission_of(case.count))
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
        outcome.min_separation_m, outcome.min_silenced_m = (
            judge.smallest[False],
            judge.smallest[True],
        )
        body_m = flight.config.fleet.body_diameter_m
        nearest_m = judge.smallest[False] if injection.is_falling else min(judge.smallest.values())
        if nearest_m < body_m:
            outcome.wrong.append(f"bodies touch: {nearest_m:.2f} m")
    return outcome


def cases(every: int, counts: Iterable[int] = (3, 6), stagger: int = 0) -> list[Case]:
    """Each injection at every k-th tick of a flight; with ``stagger`` each one begins that much
    later than the last.
    """
    ticks = round(FLIGHT_S / 0.02)
    return [
        Case(injection.name, tick, count, place=(tick // every) % count)
        for count in counts
        for number, injection in enumerate(INJECTIONS)
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
            free, silenced = min(o.min_separation_m for o in of), min(o.min_silenced_m for o in of)
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
    begin_s, outcomes = time.perf_counter(), []
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
