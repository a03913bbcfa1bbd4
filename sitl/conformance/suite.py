"""All phases in order, on one vehicle, and how a check begins and ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.conformance import (
    arming,
    automatic,
    battery,
    ground_link,
    lock,
    loss,
    offboard,
    pad,
    parameters,
    requests,
    responses,
    setpoints,
    vision,
)
from sitl.conformance.endpoint import Port
from sitl.conformance.facts import Fact, FactReport
from sitl.conformance.hover import default_streams, grounded
from sitl.conformance.phase import Phase
from sitl.conformance.pilot import Gone, Pilot, Stuck

# Streams are watched before anybody has spoken and before any rate was changed: both last until the vehicle restarts.
PHASES: tuple[Phase, ...] = (
    pad.PHASE,
    lock.PHASE,
    parameters.PHASE,
    requests.PHASE,
    arming.PHASE,
    automatic.PHASE,
    offboard.PHASE,
    responses.PHASE,
    setpoints.PHASE,
    loss.PHASE,
    battery.PHASE,
    vision.PHASE,
)
GROUND_LINK: Phase = ground_link.PHASE
FACTS: tuple[Fact, ...] = tuple(fact for phase in (*PHASES, GROUND_LINK) for fact in phase.facts)

_NOT_SIMULATED = (
    "it does not look simulated (no ground truth comes by HIL_STATE_QUATERNION), and this turns motors: "
    "see --i-have-removed-the-propellers"
)


_READY_S = 8.0


class NobodyAnsweredError(RuntimeError):
    """Nothing that could be a PX4 came in time."""


@dataclass(frozen=True, slots=True)
class Terms:
    """How a check may go about it.

    Attributes:
        may_turn_motors: also on a vehicle that does not look simulated.
        wait_s: for the first heartbeat.
        from_elsewhere: let the first sender be another port than the one listened on.
    """

    may_turn_motors: bool = False
    wait_s: float = 10.0
    from_elsewhere: bool = False


def check(port: Port, ground_port: Port | None, report: FactReport, terms: Terms, say: Callable[[str], None]) -> Pilot:
    """Settle every fact of `report`; the pilot knows pace and system id.

    Raises:
        NobodyAnsweredError: no heartbeat of a PX4 within the time.
    """
    pilot = Pilot(port)
    pilot.moves_first_sender = terms.from_elsewhere
    _meet(pilot, terms)
    try:
        _fly(pilot, report, terms, say)
    except Gone:
        report.fail(report.facts.values(), "it fell silent")
        return pilot
    if ground_port is None:
        report.skip(GROUND_LINK.facts, "no --gcs endpoint was given")
    elif _is_wanted(GROUND_LINK, report):
        while ground_port.receive(0.0):
            pass  # what came while nobody read
        ground = Pilot(ground_port)
        ground.system_id = pilot.system_id
        try:
            _settle(GROUND_LINK, ground, report, say)
        except Gone:
            report.fail(GROUND_LINK.facts, "it fell silent")
    return pilot


def is_simulated(pilot: Pilot) -> bool:
    """Whether it knows its own true state, which only a simulated vehicle can."""
    pilot.interval("HIL_STATE_QUATERNION", 20.0)
    found = pilot.spend(2.0, lambda: pilot.seen.newest("HIL_STATE_QUATERNION") is not None)
    pilot.interval("HIL_STATE_QUATERNION", 0.0)
    return found


def _meet(pilot: Pilot, terms: Terms) -> None:
    def met() -> bool:
        beats = pilot.seen.of("HEARTBEAT")
        return any(beat.component_id == 1 and beat.message.autopilot == 12 for beat in beats)

    if not pilot.listen(terms.wait_s, lambda: pilot.seen.datagrams > 0):
        # A link that speaks only when spoken to.
        pilot.system_id = 1
        pilot.send_heartbeat()
    if not pilot.listen(3.0, met):
        raise NobodyAnsweredError
    pilot.system_id = next(beat for beat in pilot.seen.of("HEARTBEAT") if beat.component_id == 1).system_id


def _is_wanted(phase: Phase, report: FactReport) -> bool:
    return any(fact.name in report.facts for fact in phase.facts)


def _fly(pilot: Pilot, report: FactReport, terms: Terms, say: Callable[[str], None]) -> None:
    may_turn_motors: bool | None = True if terms.may_turn_motors else None
    try:
        for phase in PHASES:
            if not _is_wanted(phase, report):
                continue
            if phase not in (pad.PHASE, lock.PHASE) and pilot.heartbeat_duty.act is None:
                pilot.greet(as_ground_station=False)
                pilot.spend(0.5)
            if phase.turns_motors and may_turn_motors is None:
                may_turn_motors = is_simulated(pilot)
            if phase.turns_motors and may_turn_motors:
                # With vision only it never says so on the ground: then on without.
                pilot.spend(_READY_S - min(_READY_S, pilot.now_s), pilot.shows_ready)
            if phase.turns_motors and not may_turn_motors:
                report.skip(phase.facts, _NOT_SIMULATED)
            else:
                _settle(phase, pilot, report, say)
    finally:
        # Also when somebody interrupts: nothing is left in the air or changed.
        pilot.restore_parameters()
        if may_turn_motors:
            _put_down(pilot, say)
        if pilot.heartbeat_duty.act is not None:
            default_streams(pilot)


def _settle(phase: Phase, pilot: Pilot, report: FactReport, say: Callable[[str], None]) -> None:
    # A phase may leave the vehicle in the air: the next one goes on from there or brings it down first.
    say(phase.name)
    reason = "not seen"
    try:
        phase.run(pilot, report)
    except Stuck as error:
        reason = str(error)
    pilot.vision_duty.act = None
    pilot.restore_parameters()
    report.fail(phase.facts, reason)


def _put_down(pilot: Pilot, say: Callable[[str], None]) -> None:
    try:
        grounded(pilot)
    except Stuck as error:
        say(f"afterwards: {error}")
