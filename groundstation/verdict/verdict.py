"""The verdict on a flight: each expectation and its outcome, in numbers and in words. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import msgspec

from groundstation.fleet.state import FleetState, Separation, VehicleView
from groundstation.recording.flight_report import PERIOD_NOMINAL_MS, FlightReport, LoopTiming
from groundstation.verdict.expectations import Expect
from onboard.config.fleet import FleetConfig, Vec3
from onboard.exit_status import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_MIXED,
    EXIT_NO_ANSWER,
    EXIT_OK,
    EXIT_WRONG_INPUT,
)

_LAW_REFUSED = "own-law-refused"  # code of the agents' event


class ExpectationResult(msgspec.Struct, frozen=True):
    """One expectation and whether it came true."""

    name: str
    has_come_true: bool
    sentence: str


class Arrival(msgspec.Struct, frozen=True):
    """Distance of a vehicle from its goal when its order was done."""

    step: str
    vehicle: str
    distance_m: float
    is_truth: bool  # by ground truth, otherwise by telemetry


def arrival_of(step: str, view: VehicleView, goal: Vec3, now_ns: int) -> Arrival:
    """Return the distance of a vehicle from its goal now, by ground truth where there is one."""
    if view.truth is not None and view.has_truth(now_ns):
        return Arrival(step, view.name, round(math.dist(view.truth.position_enu_m, goal), 4), True)
    position = view.position_enu_m(now_ns)
    distance_m = math.inf if position is None else round(math.dist(position, goal), 4)
    return Arrival(step, view.name, distance_m, False)


class StepResult(msgspec.Struct, frozen=True):
    """One step of the mission, with each vehicle's phase and sentence."""

    step: str
    duration_s: float
    vehicles: dict[str, str]
    sentences: dict[str, str]

    @property
    def is_done(self) -> bool:
        """Whether every vehicle did it."""
        return all(phase == "done" for phase in self.vehicles.values())


class Closest(msgspec.Struct, frozen=True):
    """The smallest separation of the flight."""

    first: str
    second: str
    distance_m: float
    time_s: float
    source: str


class Verdict(msgspec.Struct, frozen=True):
    """The content of ``verdict.json``."""

    passed: bool  # everything that the mission declares came true
    exit_status: int
    summary: str
    mission: str
    fleet: str
    law: str
    checks: list[ExpectationResult]
    steps: list[StepResult]
    closest: Closest | None
    is_collision: bool
    arrivals: list[Arrival]
    worst_arrival_m: float | None
    landed: dict[str, bool]
    loop: dict[str, LoopTiming]
    duration_s: float
    is_interrupted: bool = False
    record: str = ""
    schema: int = 1
    # counts as much as the safety distance, where it is set
    vertical_separation_m: float | None = None

    @property
    def sentences(self) -> list[str]:
        """The verdict in words, one sentence a line."""
        return [*describe(self), self.summary]


@dataclass(slots=True)
class FlightObservations:
    """Observations of a mission's runner, which writes them; the input of :func:`judge`."""

    mission: str
    fleet: FleetConfig
    state: FleetState  # at the end
    steps: list[StepResult]
    arrivals: list[Arrival]
    begin_ns: int
    end_ns: int
    left_out: Collection[str] = ()  # vehicles that the mission went on without
    failure: str = ""  # sentence that ended the mission
    nobody: bool = False  # no vehicle answered
    is_wrong_input: bool = False
    is_interrupted: bool = False


def flown_law(state: FleetState, fleet: FleetConfig) -> str:
    """Return the law that the agents report; that of the fleet file as long as none has reported."""
    vehicles_by_law: dict[str, list[str]] = {}
    for name, view in state.vehicles.items():
        if view.telemetry is not None:
            vehicles_by_law.setdefault(view.telemetry.law, []).append(name)
    if len(vehicles_by_law) > 1:
        return ", ".join(f"{law} ({', '.join(names)})" for law, names in vehicles_by_law.items())
    return next(iter(vehicles_by_law), fleet.law.name)


def _still_up(state: FleetState, expect: Expect) -> str:
    """A sentence about vehicles that a mission has left armed or in the air without declaring it."""
    up = [
        name
        for name, view in state.vehicles.items()
        if view.telemetry is not None
        and (view.is_airborne or view.telemetry.is_armed)
        and not state.is_landed(name)
    ]
    if not up or expect.all_landed is not None:
        return ""
    return (
        f"The mission has ended and {', '.join(up)} {'is' if len(up) == 1 else 'are'} not down. End it with a step "
        "'land', or declare expect.all_landed = false."
    )


def smallest(state: FleetState) -> Separation | None:
    """Return the smallest separation so far, by ground truth where there is one."""
    return state.smallest_truth or state.smallest


def check(
    expect: Expect,
    fleet: FleetConfig,
    closest: Separation | None,
    arrivals: Sequence[Arrival],
    landed: Mapping[str, bool],
    collided: Sequence[str] = (),
) -> list[ExpectationResult]:
    """Compare each declared expectation with the flight.

    Args:
        expect: the expectations.
        fleet: the fleet file.
        closest: smallest separation; None when none was measured.
        arrivals: distances from goals at the end of orders.
        landed: whether each vehicle is landed and disarmed.
        collided: vehicles that touched something.

    Returns:
        One result for each declared expectation.
    """
    checks: list[ExpectationResult] = []
    limit = expect.min_separation_m
    if limit is not None:
        is_met, outcome = len(fleet.enabled_names) < 2, "no separation was measured"
        if closest is not None:
            is_met = closest.distance_m >= limit and not collided
            touched = f". {' and '.join(collided)} collided" if collided else ""
            outcome = (
                f"{closest.first} and {closest.second} came to {closest.distance_m:.3f} m{touched}"
            )
        elif is_met:
            outcome = "there is only one vehicle"
        sentence = f"At least {limit:.2f} m between all: {outcome}."
        checks.append(ExpectationResult("min_separation_m", is_met, sentence))
    limit = expect.arrived_within_m
    if limit is not None:
        worst = max(arrivals, key=lambda arrival: arrival.distance_m, default=None)
        near = [arrival for arrival in arrivals if arrival.distance_m <= limit]
        outcome = "no goal was flown to"
        if worst is not None:
            outcome = f"{len(near)} of {len(arrivals)}; furthest off was {worst.vehicle}, "
            outcome += f"{_metres(worst.distance_m)} at '{worst.step}'"
        sentence = f"Goals reached within {limit:.2f} m: {outcome}."
        checks.append(
            ExpectationResult("arrived_within_m", 0 < len(near) == len(arrivals), sentence)
        )
    if expect.all_landed is not None:
        flying = [name for name in fleet.enabled_names if not landed.get(name, False)]
        outcome = f"not {', '.join(flying)}" if flying else "all"
        sentence = f"Landed and disarmed: {outcome}."
        checks.append(ExpectationResult("all_landed", (not flying) == expect.all_landed, sentence))
    return checks


def judge(
    flown: FlightObservations,
    expect: Expect,
    report: FlightReport | None = None,
    record: str = "",
    *,
    begin_ns: int | None = None,
    record_failure: str | None = None,
) -> Verdict:
    """Judge a flight. Of the live state and the record, the smaller distance counts.

    Args:
        flown: observations of the runner.
        expect: expectations at the end of the mission.
        report: evaluation of the record.
        record: its folder.
        begin_ns: zero of the flight's seconds, the begin of the record [ns]; None: the mission's
            first step.
        record_failure: sentence about a record that ended early.

    Returns:
        The verdict with its exit status.
    """
    state, fleet = flown.state, flown.fleet
    closest = smallest(state)
    if (
        report is not None
        and report.smallest is not None
        and (
            closest is None
            or not closest.is_truth
            or report.smallest.distance_m < closest.distance_m
        )
    ):
        closest = report.smallest
    touched = {
        name
        for name, view in state.vehicles.items()
        if view.truth is not None and view.truth.is_collided
    }
    collided = sorted(touched.union(report.collided if report is not None else ()))
    landed = {name: state.is_landed(name) for name in fleet.enabled_names}
    checks = check(expect, fleet, closest, flown.arrivals, landed, collided)
    is_collision = bool(collided)
    # with heights only the emulator knows
    if closest is not None and fleet.fleet.vertical_separation_m is None:
        is_collision = is_collision or closest.distance_m < fleet.fleet.body_diameter_m
    broken = " ".join(filter(None, (flown.failure, _still_up(state, expect), record_failure)))
    lost = [
        {name: step.vehicles[name] for name in step.vehicles if name not in flown.left_out}
        for step in flown.steps
    ]
    failed = [step for step in lost if any(phase != "done" for phase in step.values())]
    is_mixed = any(len(set(step.values())) > 1 for step in failed)
    statuses = (
        (flown.is_interrupted, EXIT_INTERRUPTED),
        (flown.nobody, EXIT_NO_ANSWER),
        (flown.is_wrong_input, EXIT_WRONG_INPUT),
        (not all(one.has_come_true for one in checks), EXIT_FAILED),
        (is_mixed, EXIT_MIXED),
        (bool(failed or broken), EXIT_FAILED),
    )
    exit_status = next((status for is_so, status in statuses if is_so), EXIT_OK)
    law = flown_law(state, fleet)
    refused = {one.event.vehicle for one in state.events if one.event.code == _LAW_REFUSED}
    taken_over = f" (Covey's in its place on {', '.join(sorted(refused))})" if refused else ""
    summary = _summary(flown, f"'{law}'{taken_over}", checks, broken, exit_status)
    return Verdict(
        passed=exit_status == EXIT_OK,
        exit_status=exit_status,
        summary=summary,
        mission=flown.mission,
        fleet=fleet.fleet.name,
        law=law,
        checks=checks,
        steps=flown.steps,
        closest=None
        if closest is None
        else Closest(
            closest.first,
            closest.second,
            round(closest.distance_m, 4),
            round(
                (closest.stamp_ns - (flown.begin_ns if begin_ns is None else begin_ns)) * 1e-9, 2
            ),
            "truth" if closest.is_truth else "telemetry",
        ),
        is_collision=is_collision,
        arrivals=flown.arrivals,
        worst_arrival_m=max((arrival.distance_m for arrival in flown.arrivals), default=None),
        landed=landed,
        loop=_loops(state, report),
        duration_s=round((flown.end_ns - flown.begin_ns) * 1e-9, 2),
        is_interrupted=flown.is_interrupted,
        record=record,
        vertical_separation_m=fleet.fleet.vertical_separation_m,
    )


def describe(verdict: Verdict) -> list[str]:
    """Return distance, arrival, landing and timing in words, one sentence a line."""
    lines = []
    if verdict.closest is not None:
        near = verdict.closest
        by = "" if near.source == "truth" else ", by telemetry"
        height_m = verdict.vertical_separation_m
        measure = (
            f"apart ({height_m:g} m of height count as the safety distance)"
            if height_m
            else "between centres"
        )
        touch = ": THEY COLLIDED" if verdict.is_collision else ""
        lines.append(
            f"Closest: {near.first} and {near.second}, {near.distance_m:.2f} m {measure}, "
            f"at {near.time_s:.1f} s{by}{touch}."
        )
    if verdict.arrivals:
        within = next(
            (one.sentence for one in verdict.checks if one.name == "arrived_within_m"), ""
        )
        lines.append(
            within or f"Furthest from a goal on arrival: {_metres(verdict.worst_arrival_m or 0.0)}."
        )
    down = [name for name, has_landed in verdict.landed.items() if has_landed]
    up = [name for name, has_landed in verdict.landed.items() if not has_landed]
    lines.append(
        f"Landed and disarmed: {', '.join(down) or 'nobody'}"
        + (f"; NOT: {', '.join(up)}." if up else ".")
    )
    if verdict.loop:
        parts = (f"{name} {loop.period_p99_ms:.1f} ms" for name, loop in verdict.loop.items())
        lines.append(
            f"Loop period, 99th percentile (nominal {PERIOD_NOMINAL_MS:.0f} ms): {', '.join(parts)}."
        )
    return lines


def _summary(
    flown: FlightObservations,
    law: str,
    checks: Sequence[ExpectationResult],
    failure: str,
    exit_status: int,
) -> str:
    if exit_status == EXIT_OK:
        return (
            f"PASSED: mission '{flown.mission}' with law {law}: everything it declares came true."
        )
    if exit_status == EXIT_INTERRUPTED:
        return f"INTERRUPTED: mission '{flown.mission}' was ended by the operator."
    broken = [one.sentence for one in checks if not one.has_come_true]
    return (
        f"FAILED: mission '{flown.mission}' with law {law}. {' '.join([*broken, failure])}".strip()
    )


def _loops(state: FleetState, report: FlightReport | None) -> dict[str, LoopTiming]:
    if report is not None and report.loops:
        return report.loops
    return {
        name: LoopTiming(one.loop_period_p50_ms, one.loop_period_p99_ms, one.loop_period_max_ms, 0)
        for name, view in state.vehicles.items()
        if (one := view.telemetry) is not None
    }


def _metres(value: float) -> str:
    return f"{value:.3f} m" if math.isfinite(value) else "an unknown distance"
