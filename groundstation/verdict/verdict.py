"""The verdict on a flight: each expectation and its outcome, in numbers and in words. Pure.

A mission has passed if everything that it declares came true, every vehicle that took part has done
every step, and no vehicle was left in the air without a declaration. The exit status follows from
the same facts. If several of them hold, the first one in `_exit_status` counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from groundstation.fleet.slot_owners import out_of_service
from groundstation.fleet.state import FleetState, Separation, unknown_until
from groundstation.fleet.touchdown import is_fall
from groundstation.fleet.unknown_time import UnknownTime
from groundstation.recording.flight_report import PERIOD_NOMINAL_MS, FlightReport, LoopTiming
from groundstation.verdict.expectations import Expect, ExpectationResult, check, metres
from groundstation.verdict.observations import (
    RIGHT_PHASES,
    Arrival,
    FlightObservations,
    StepResult,
    collided_vehicles,
    flown_law,
)
from onboard.config.fleet import FleetConfig
from onboard.exit_status import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_MIXED,
    EXIT_NO_ANSWER,
    EXIT_OK,
    EXIT_WRONG_INPUT,
)
from onboard.plain_text import listed, plain_line

_MAX_LOOPS = 4  # the loop periods of up to this many vehicles are all stated; of more, the longest


class SmallestSeparation(msgspec.Struct, frozen=True):
    """The smallest separation of the flight."""

    first: str
    second: str
    distance_m: float
    time_s: float  # since the flight's start
    source: str  # truth or telemetry


class NearestPerson(msgspec.Struct, frozen=True):
    """The smallest distance of a vehicle that flew to the circle of a person who was seen."""

    vehicle: str
    person: str
    distance_m: float  # horizontal, to the circle; negative inside it
    time_s: float  # since the flight's start
    safety_distance_m: float  # what the law keeps from the circle


class LandingSpeed(msgspec.Struct, frozen=True):
    """Vertical speed at a first contact with the ground, by the emulator's physics."""

    vehicle: str
    time_s: float  # since the flight's start
    speed_m_s: float  # downwards
    # depends on what gives the vehicle its position (poses, satellites or nothing), and on whether
    # PX4 landed it alone
    limit_m_s: float
    had_thrust: bool  # False: its motors were off, weak or dead; then the limit does not count


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
    closest: SmallestSeparation | None
    is_collision: bool
    arrivals: list[Arrival]
    worst_arrival_m: float | None
    landed: dict[str, bool]
    loop: dict[str, LoopTiming]
    duration_s: float
    is_interrupted: bool = False
    record: str = ""
    schema: int = 1
    # height that counts as much as the safety distance; None: heights do not count
    vertical_separation_m: float | None = None
    # times in which two vehicles were not seen, and may have come nearer than permitted
    unknown_times: list[UnknownTime] = []
    touchdowns: list[LandingSpeed] = []  # contacts of simulated vehicles, oldest first
    collided: list[str] = []  # simulated vehicles that have touched another one
    nearest_person: NearestPerson | None = None  # None: the motion capture saw no person
    is_anybody_heard: bool = True  # whether any vehicle has sent telemetry

    @property
    def sentences(self) -> list[str]:
        """The verdict in words, one sentence a line."""
        return [*describe(self), self.summary]


def judge(
    flown: FlightObservations,
    expect: Expect,
    report: FlightReport | None = None,
    record: str = "",
    *,
    begin_ns: int | None = None,
    record_failure: str | None = None,
) -> Verdict:
    """Judge a flight by its live state and its record.

    Args:
        flown: observations of the runner.
        expect: expectations at the end of the mission.
        report: evaluation of the record.
        record: folder of the record.
        begin_ns: time that counts as second 0, the start of the record [ns]; None: the mission's
            first step.
        record_failure: sentence about a record that ended early or is not complete.

    Returns:
        The verdict with its exit status.
    """
    state = flown.state
    fleet = flown.fleet
    if begin_ns is None:
        begin_ns = flown.begin_ns

    closest = _smallest_of_all(state, report)
    collided = _collided(flown, report)
    landed = _landed(fleet, state)
    touchdowns = _landing_speeds(flown, begin_ns)
    fallen = [fall.vehicle for fall in falls(touchdowns)]
    checks = check(expect, fleet, closest, flown.arrivals, landed, collided, fallen)

    is_collision = bool(collided)
    is_small = closest is not None and closest.distance_m < fleet.fleet.body_diameter_m
    if fleet.fleet.vertical_separation_m is None and not state.knows_contacts:
        # Otherwise a small distance may be between two vehicles one above the other, and only an
        # emulator of all vehicles knows which have touched.
        is_collision |= is_small

    unknown_times = _unknown_times(flown, expect)
    failures = (
        flown.failure,
        _other_ends(flown),
        _nobody_left(flown),
        _still_up(flown, expect),
        _hard_landings(flown),
        _law_sentence(flown),
        _collision_sentence(closest, collided, is_collision=is_collision),
        _unknown_sentence(unknown_times, begin_ns),
        record_failure,
    )
    failure = " ".join(sentence for sentence in failures if sentence)
    exit_status = _exit_status(flown, checks, failure)

    return Verdict(
        passed=exit_status == EXIT_OK,
        exit_status=exit_status,
        summary=_summary(flown, checks, failure, exit_status),
        mission=flown.mission,
        fleet=fleet.fleet.name,
        law=flown_law(state, fleet),
        checks=checks,
        steps=flown.steps,
        closest=_rounded(closest, begin_ns),
        is_collision=is_collision,
        arrivals=flown.arrivals,
        worst_arrival_m=max(
            (arrival.distance_m for arrival in flown.arrivals if arrival.is_done), default=None
        ),
        landed=landed,
        loop=_loops(state, report),
        duration_s=round((flown.end_ns - flown.begin_ns) * 1e-9, 2),
        is_interrupted=flown.is_interrupted,
        record=record,
        vertical_separation_m=fleet.fleet.vertical_separation_m,
        unknown_times=unknown_times,
        touchdowns=touchdowns,
        collided=collided,
        nearest_person=_nearest_person(fleet, report, begin_ns),
        is_anybody_heard=state.is_anybody_heard,
    )


def _nearest_person(
    fleet: FleetConfig, report: FlightReport | None, begin_ns: int
) -> NearestPerson | None:
    if report is None or report.nearest_person is None:
        return None
    nearest = report.nearest_person
    return NearestPerson(
        vehicle=nearest.vehicle,
        person=nearest.person,
        distance_m=round(nearest.distance_m, 4),
        time_s=round((nearest.stamp_ns - begin_ns) * 1e-9, 2),
        safety_distance_m=fleet.fleet.safety_distance_m,
    )


def _landed(fleet: FleetConfig, state: FleetState) -> dict[str, bool]:
    """Return whether each vehicle is landed and disarmed; a disabled one that rests is left out.

    A vehicle that the fleet file lacks is named while it is armed or flies.
    """
    disabled = out_of_service(state)

    landed = {}
    for name in fleet.enabled_names:
        is_landed = state.is_landed(name)
        rests_disabled = is_landed and name in disabled
        if not rests_disabled:
            landed[name] = is_landed
    for view in state.unlisted_up:
        landed[plain_line(view.name)] = False
    return landed


def falls(touchdowns: Sequence[LandingSpeed]) -> list[LandingSpeed]:
    """Return the contacts of vehicles that fell."""
    return [
        contact
        for contact in touchdowns
        if is_fall(contact.speed_m_s, contact.limit_m_s, had_thrust=contact.had_thrust)
    ]


def fall_sentences(verdict: Mapping[str, Any]) -> list[str]:
    """Return who fell, and how hard, in words.

    Args:
        verdict: content of a ``verdict.json``, which anybody may have written.
    """
    try:
        touchdowns = msgspec.convert(verdict.get("touchdowns", []), list[LandingSpeed])
    except msgspec.ValidationError:
        return []
    return [_fall_sentence(fall) for fall in falls(touchdowns)]


def _fall_sentence(fall: LandingSpeed) -> str:
    return (
        f"Fell: {fall.vehicle}, and hit the ground with {fall.speed_m_s:.1f} m/s,"
        f" at {fall.time_s:.1f} s."
    )


def describe(verdict: Verdict) -> list[str]:
    """Return distance, arrival, landing and timing in words, one sentence a line."""
    lines = []
    if verdict.closest is not None:
        lines.append(_closest_sentence(verdict.closest, verdict))
    if verdict.nearest_person is not None:
        lines.append(_person_sentence(verdict.nearest_person))
    if verdict.collided and not _has_closest_collided(verdict):
        lines.append(f"Collided: {', '.join(verdict.collided)}.")

    expected = [result for result in verdict.checks if result.name == "arrived_within_m"]
    if verdict.arrivals and expected:
        lines.append(expected[-1].sentence)
    elif verdict.worst_arrival_m is not None:
        lines.append(f"Furthest from a goal on arrival: {metres(verdict.worst_arrival_m)}.")

    fallen = falls(verdict.touchdowns)
    names_fallen = {fall.vehicle for fall in fallen}
    landed = [
        name
        for name, has_landed in verdict.landed.items()
        if has_landed and name not in names_fallen
    ]
    not_landed = [name for name, has_landed in verdict.landed.items() if not has_landed]
    landed_sentence = f"Landed and disarmed: {listed(landed) or 'nobody'}"
    if not_landed:
        landed_sentence += f"; NOT: {', '.join(not_landed)}"
    if verdict.exit_status == EXIT_NO_ANSWER or not verdict.is_anybody_heard:
        landed_sentence = "No vehicle was heard, so nothing is known of any"
    lines.append(f"{landed_sentence}.")
    lines += [_fall_sentence(fall) for fall in fallen]

    powered = [landing for landing in verdict.touchdowns if landing.had_thrust]
    hardest = max(powered, key=lambda landing: landing.speed_m_s, default=None)
    if hardest is not None:
        lines.append(
            f"Hardest touchdown: {hardest.vehicle}, {hardest.speed_m_s:.2f} m/s "
            f"(at most {hardest.limit_m_s:.1f} is right)."
        )

    if verdict.loop:
        lines.append(_loop_sentence(verdict.loop))
    return lines


def _person_sentence(nearest: NearestPerson) -> str:
    """Return in words how near a vehicle came to a person."""
    words = f"{nearest.distance_m:.2f} m from the circle of {nearest.person}"
    if nearest.distance_m < 0.0:
        words = f"{-nearest.distance_m:.2f} m inside the circle of {nearest.person}"

    below = ""
    if nearest.distance_m < nearest.safety_distance_m:
        below = f": LESS THAN {nearest.safety_distance_m:.2f} m"
    return f"Nearest to a person: {nearest.vehicle}, {words}, at {nearest.time_s:.1f} s{below}."


def _loop_sentence(loops: Mapping[str, LoopTiming]) -> str:
    """Return the loop period of each vehicle in words; of many vehicles the longest one."""
    periods_ms = {name: loop.period_p99_ms for name, loop in loops.items()}
    words = [f"{name} {period_ms:.1f} ms" for name, period_ms in periods_ms.items()]
    if len(words) > _MAX_LOOPS:
        slowest = max(periods_ms, key=lambda name: periods_ms[name])
        words = [f"at most {periods_ms[slowest]:.1f} ms, {slowest}"]
    nominal = f"nominal {PERIOD_NOMINAL_MS:.0f} ms"
    return f"Loop period, 99th percentile ({nominal}): {', '.join(words)}."


def _closest_sentence(closest: SmallestSeparation, verdict: Verdict) -> str:
    measure = "between centres"
    if verdict.vertical_separation_m:
        height_m = verdict.vertical_separation_m
        measure = f"apart ({height_m:g} m of height count as the safety distance)"

    source = ""
    if closest.source != "truth":
        source = ", by telemetry"

    collision = ""
    if _has_closest_collided(verdict):
        collision = ": THEY COLLIDED"

    return (
        f"Closest: {closest.first} and {closest.second}, {closest.distance_m:.2f} m {measure}, "
        f"at {closest.time_s:.1f} s{source}{collision}."
    )


def _has_closest_collided(verdict: Verdict) -> bool:
    """Return whether the pair that came closest has collided."""
    closest = verdict.closest
    if closest is None or not verdict.is_collision:
        return False
    if not verdict.collided:
        return True  # without ground truth, the distance of this pair shows the collision
    return closest.first in verdict.collided and closest.second in verdict.collided


# -- parts of the judgement ------------------------------------------------------------------------


def _smallest_of_all(state: FleetState, report: FlightReport | None) -> Separation | None:
    """Return the smallest separation by the live state or by the record.

    The record has every sample of ground truth. So it counts if the live separation is larger, or
    is of a pair of which the record has the truth, and is not by truth itself.
    """
    live = state.smallest_known
    if report is None or report.smallest is None:
        return live

    recorded = report.smallest
    if live is None or recorded.distance_m < live.distance_m:
        return recorded

    names = {f"{live.first}-{live.second}", f"{live.second}-{live.first}"}
    is_measured_better = not live.is_truth and not names.isdisjoint(report.pairs)
    return recorded if is_measured_better else live


def _collided(flown: FlightObservations, report: FlightReport | None) -> list[str]:
    """Return the vehicles that touched another one in this flight, by ground truth."""
    names = set(collided_vehicles(flown.state))
    if report is not None:
        names.update(report.collided)
    # a vehicle that collided before this flight stays collided in the emulator's truth
    return sorted(names.difference(flown.earlier_collided))


def _still_up(flown: FlightObservations, expect: Expect) -> str:
    """Return a sentence if a mission has left vehicles armed or flying without declaring it."""
    if expect.all_landed is not None or flown.is_left_flying:
        return ""

    sentences = []
    still_up = [
        name
        for name, view in flown.state.vehicles.items()
        if view.is_up and name not in flown.pilots
    ]
    if still_up:
        sentences.append(
            f"The mission has ended and {_with_verb(still_up)} not down. End it with a step "
            "'land', or declare expect.all_landed = false."
        )
    others = [plain_line(view.name) for view in flown.state.unlisted_up]
    if others:
        sentences.append(
            f"The mission has ended and {_with_verb(others)} not down, which the fleet file lacks. "
            "Land it from a ground with its file."
        )
    return " ".join(sentences)


def _with_verb(names: Sequence[str]) -> str:
    """Return names with "is" or "are"."""
    verb = "is" if len(names) == 1 else "are"
    return f"{', '.join(names)} {verb}"


def _other_ends(flown: FlightObservations) -> str:
    """Return the sentences about vehicles that do not fly although they were ordered to."""
    return " ".join(
        sentence for name, sentence in flown.other_ends.items() if name not in flown.left_out
    )


def _nobody_left(flown: FlightObservations) -> str:
    """Return a sentence if the mission has gone on without all of its vehicles."""
    left_out = set(flown.left_out)
    in_service = set(flown.fleet.enabled_names) - out_of_service(flown.state)
    if not left_out or not in_service <= left_out:
        return ""
    return f"No vehicle was left: the mission went on without {', '.join(sorted(left_out))}."


def _unknown_times(flown: FlightObservations, expect: Expect) -> list[UnknownTime]:
    """Return the times in which a pair was not seen, and may have come nearer than permitted."""
    permitted_m = flown.fleet.fleet.safety_distance_m
    if expect.min_separation_m is not None:
        permitted_m = expect.min_separation_m

    times = []
    for time in unknown_until(flown.state, flown.end_ns):
        is_of_flight = time.end_ns > flown.begin_ns
        if is_of_flight and time.possible_m < permitted_m:
            times.append(time)
    return times


def _unknown_sentence(times: Sequence[UnknownTime], begin_ns: int) -> str:
    """Return a sentence about the times in which distances were not known."""
    if not times:
        return ""

    longest = max(times, key=lambda time: time.duration_s)
    begin_s = (longest.begin_ns - begin_ns) * 1e-9
    end_s = (longest.end_ns - begin_ns) * 1e-9
    sentence = (
        f"From {begin_s:.1f} to {end_s:.1f} s nobody saw where {longest.vehicle} was: it may have "
        f"come to {longest.possible_m:.2f} m of {longest.other}."
    )
    if len(times) > 1:
        sentence += f" {len(times) - 1} more such times are in verdict.json."
    return sentence


def _hard_landings(flown: FlightObservations) -> str:
    """Return a sentence about simulated vehicles that came down too hard, or fell."""
    hard = []
    for touchdown in flown.touchdowns:
        name = touchdown.vehicle
        vehicle = flown.fleet.vehicles[name]

        # a mission may go on without a vehicle that falls
        is_failure = name not in flown.left_out
        if touchdown.is_hard(vehicle) or (touchdown.has_fallen(vehicle) and is_failure):
            hard.append(touchdown.sentence(vehicle))
    if not hard:
        return ""
    return f"{'. '.join(hard)}."


def _collision_sentence(
    closest: Separation | None, collided: Sequence[str], *, is_collision: bool
) -> str:
    """Return a sentence about the vehicles that touched each other."""
    if collided:
        return f"{listed(collided)} collided."
    if is_collision and closest is not None:
        return f"{closest.first} and {closest.second} collided."
    return ""


def _landing_speeds(flown: FlightObservations, begin_ns: int) -> list[LandingSpeed]:
    """Return the contacts with the ground as the verdict writes them."""
    vehicles = flown.fleet.vehicles
    return [
        LandingSpeed(
            vehicle=touchdown.vehicle,
            time_s=round((touchdown.stamp_ns - begin_ns) * 1e-9, 2),
            speed_m_s=round(touchdown.speed_m_s, 3),
            limit_m_s=touchdown.limit_m_s(vehicles[touchdown.vehicle]),
            had_thrust=touchdown.had_thrust,
        )
        for touchdown in flown.touchdowns
    ]


def _exit_status(
    flown: FlightObservations, checks: Sequence[ExpectationResult], failure: str
) -> int:
    """Return the exit status of a mission.

    The results of vehicles that the mission went on without do not count.
    """
    failed_steps: list[Mapping[str, str]] = []  # of each: vehicle -> phase of its order
    for step in flown.steps:
        phases = {
            name: phase for name, phase in step.vehicles.items() if name not in flown.left_out
        }
        if any(phase not in RIGHT_PHASES for phase in phases.values()):
            failed_steps.append(phases)

    if flown.is_interrupted:
        return EXIT_INTERRUPTED
    if flown.is_nobody_heard:
        return EXIT_NO_ANSWER
    if flown.is_wrong_input:
        return EXIT_WRONG_INPUT
    if flown.is_taken:
        return EXIT_FAILED
    if not all(result.has_come_true for result in checks):
        return EXIT_FAILED
    if any(len(set(phases.values())) > 1 for phases in failed_steps):
        return EXIT_MIXED
    if failed_steps or failure:
        return EXIT_FAILED
    return EXIT_OK


def _law_refusals(flown: FlightObservations) -> dict[str, str]:
    """Return the vehicles on which Covey's law flew instead of the user's own, each with why."""
    return {
        name: view.law_refusal for name, view in flown.state.vehicles.items() if view.law_refusal
    }


def _law_sentence(flown: FlightObservations) -> str:
    """Return why a user's own law did not fly on every vehicle; empty if it did."""
    refused = _law_refusals(flown)
    if not refused:
        return ""
    names = listed(sorted(refused))
    first_sentence = refused[min(refused)]
    return f"Covey's law flew in place of the user's own on {names}: {first_sentence}"


def _summary(
    flown: FlightObservations,
    checks: Sequence[ExpectationResult],
    failure: str,
    exit_status: int,
) -> str:
    """Return the verdict's last sentence: passed, interrupted or failed, and why."""
    if exit_status == EXIT_INTERRUPTED:
        return f"INTERRUPTED: mission '{flown.mission}' was ended by the operator."

    law = f"'{flown_law(flown.state, flown.fleet)}'"
    refused = _law_refusals(flown)
    if refused:
        law += f" (Covey's in its place on {', '.join(sorted(refused))})"

    left_out = ""
    if flown.left_out_orders:
        left_out = f" The operator left out: {'; '.join(flown.left_out_orders)}."

    if exit_status == EXIT_OK:
        return (
            f"PASSED: mission '{flown.mission}' with law {law}: everything it declares came true."
            f"{left_out}"
        )
    reasons = [result.sentence for result in checks if not result.has_come_true]
    if not flown.failure:  # which names the step that has ended the mission
        reasons.extend(_undone_words(flown))
    words = " ".join([*reasons, failure])
    return f"FAILED: mission '{flown.mission}' with law {law}. {words}".strip() + left_out


def _undone_words(flown: FlightObservations) -> list[str]:
    """Return a sentence for each step after which the mission went on although it was not done."""
    sentences = []
    for step in flown.steps:
        names_by_end: dict[str, list[str]] = {}  # phase and sentence -> vehicles
        for name, phase in step.vehicles.items():
            if phase not in RIGHT_PHASES and name not in flown.left_out:
                end = f"{phase}: {step.sentences.get(name, '')}".rstrip(" :")
                names_by_end.setdefault(end, []).append(name)

        ends = [f"{', '.join(names)} {end}" for end, names in names_by_end.items()]
        if ends:
            sentences.append(f"'{step.step}': {'; '.join(ends)}")
    return sentences


def _rounded(closest: Separation | None, begin_ns: int) -> SmallestSeparation | None:
    """Return a separation as the verdict writes it."""
    if closest is None:
        return None

    source = "telemetry"
    if closest.is_truth:
        source = "truth"
    return SmallestSeparation(
        first=closest.first,
        second=closest.second,
        distance_m=round(closest.distance_m, 4),
        time_s=round((closest.stamp_ns - begin_ns) * 1e-9, 2),
        source=source,
    )


def _loops(state: FleetState, report: FlightReport | None) -> dict[str, LoopTiming]:
    """Return the timing of each agent's loop, by the record or else by the last telemetry."""
    if report is not None and report.loops:
        return report.loops

    loops = {}
    for name, view in state.vehicles.items():
        telemetry = view.telemetry
        if telemetry is None:
            continue
        loops[name] = LoopTiming(
            period_p50_ms=telemetry.loop_period_p50_ms,
            period_p99_ms=telemetry.loop_period_p99_ms,
            period_max_ms=telemetry.loop_period_max_ms,
            ticks=0,
        )
    return loops
