"""All phases in order, on one vehicle, and how a check begins and ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.conformance import (
    arming_facts,
    automatic_facts,
    battery_facts,
    link_facts,
    loss_facts,
    offboard_facts,
    parameter_facts,
    request_facts,
    response_facts,
    sender_facts,
    setpoint_facts,
    stream_facts,
    vision_facts,
)
from sitl.conformance.endpoint import Port
from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import Fact, FactReport, facts_of, nearest
from sitl.conformance.hover import default_streams, grounded
from sitl.conformance.vehicle_client import Gone, Signature, Stuck, VehicleClient

# Streams are watched before anybody has spoken and before any rate was changed: both last until the
# vehicle restarts.
FACT_GROUPS: tuple[FactGroup, ...] = (
    stream_facts.FACT_GROUP,
    sender_facts.FACT_GROUP,
    parameter_facts.FACT_GROUP,
    request_facts.FACT_GROUP,
    arming_facts.FACT_GROUP,
    automatic_facts.FACT_GROUP,
    offboard_facts.FACT_GROUP,
    response_facts.FACT_GROUP,
    setpoint_facts.FACT_GROUP,
    loss_facts.FACT_GROUP,
    battery_facts.FACT_GROUP,
    setpoint_facts.STICKS_GROUP,
    vision_facts.FACT_GROUP,
    sender_facts.SIGNING_GROUP,
    setpoint_facts.BREAKING_GROUP,
)
# Each on a port of its own, and the option of sitl-check that names it.
LINKS: tuple[tuple[FactGroup, str], ...] = (
    (link_facts.GROUND_LINK, "--gcs"),
    (link_facts.SIMULATOR_LINK, "--sih"),
)
FACTS: tuple[Fact, ...] = tuple(
    fact for phase in (*FACT_GROUPS, *(phase for phase, _ in LINKS)) for fact in phase.facts
)

_NOT_SIMULATED = (
    "it does not look simulated (no ground truth comes by HIL_STATE_QUATERNION), and this turns motors: "
    "see --i-have-removed-the-propellers"
)


_READY_S = 8.0


class NobodyAnsweredError(RuntimeError):
    """Nothing that could be a PX4 came in time."""


@dataclass(frozen=True, slots=True)
class Terms:
    """Permissions and waiting time of a check."""

    may_turn_motors: bool = False  # also on a vehicle that does not look simulated
    wait_s: float = 10.0  # for the first heartbeat
    from_elsewhere: bool = False  # let the first sender be another port than the one listened on
    key: bytes | None = None  # of MAVLink signing, which the vehicle has


def check(
    port: Port,
    ground_port: Port | None,
    report: FactReport,
    terms: Terms,
    say: Callable[[str], None],
    simulator_port: Port | None = None,
) -> VehicleClient:
    """Settle every fact of `report`; the client knows pace and system id.

    Raises:
        NobodyAnsweredError: no heartbeat of a PX4 within the time.
    """
    client = VehicleClient(port)
    client.moves_first_sender = terms.from_elsewhere
    client.signature = _signature(terms)
    _meet(client, terms)
    try:
        _fly(client, report, terms, say)
    except Gone:
        report.fail(report.facts.values(), "it fell silent")
        return client
    for (phase, option), other_port in zip(LINKS, (ground_port, simulator_port), strict=True):
        if other_port is None:
            report.skip(phase.facts, f"no {option} endpoint was given")
        elif _is_wanted(phase, report):
            while other_port.receive(0.0):
                pass  # what came while nobody read
            other = VehicleClient(other_port)
            other.system_id, other.signature = client.system_id, _signature(terms)
            try:
                _settle(phase, other, report, say)
            except Gone:
                report.fail(phase.facts, "it fell silent")
    return client


def _signature(terms: Terms) -> Signature | None:
    return (
        None
        if terms.key is None
        else Signature(terms.key, sender_facts.LINK_ID, sender_facts.signing_time())
    )


def is_simulated(client: VehicleClient) -> bool:
    """Whether it knows its own true state, which only a simulated vehicle can."""
    client.interval("HIL_STATE_QUATERNION", 20.0)
    found = client.spend(2.0, lambda: client.received.newest("HIL_STATE_QUATERNION") is not None)
    client.interval("HIL_STATE_QUATERNION", 0.0)
    return found


def _meet(client: VehicleClient, terms: Terms) -> None:
    def met() -> bool:
        beats = client.received.of("HEARTBEAT")
        return any(beat.component_id == 1 and beat.message.autopilot == 12 for beat in beats)

    if not client.listen(terms.wait_s, lambda: client.received.datagrams > 0):
        # A link that speaks only when spoken to.
        client.system_id = 1
        client.send_heartbeat()
    if not client.listen(3.0, met):
        raise NobodyAnsweredError
    client.system_id = next(
        beat for beat in client.received.of("HEARTBEAT") if beat.component_id == 1
    ).system_id


def _is_wanted(phase: FactGroup, report: FactReport) -> bool:
    return any(fact.name in report.facts for fact in phase.facts)


def _fly(
    client: VehicleClient, report: FactReport, terms: Terms, say: Callable[[str], None]
) -> None:
    may_turn_motors: bool | None = True if terms.may_turn_motors else None
    try:
        for phase in FACT_GROUPS:
            if not _is_wanted(phase, report):
                continue
            if (
                phase not in (stream_facts.FACT_GROUP, sender_facts.FACT_GROUP)
                and client.heartbeat_duty.act is None
            ):
                client.greet(as_ground_station=False)
                client.spend(0.5)
            if client.heartbeat_duty.act is not None:
                _judge_by_version(client, report, say)
            if phase.turns_motors and may_turn_motors is None:
                may_turn_motors = is_simulated(client)
            if phase.turns_motors and may_turn_motors:
                # With vision only it never says so on the ground: then on without.
                client.spend(_READY_S - min(_READY_S, client.now_s), client.shows_ready)
            if phase.turns_motors and not may_turn_motors:
                report.skip(phase.facts, _NOT_SIMULATED)
            else:
                _settle(phase, client, report, say)
        _judge_by_version(client, report, say)
    finally:
        # Also when somebody interrupts: nothing is left in the air or changed.
        client.params.restore()
        if may_turn_motors:
            _put_down(client, say)
        if client.heartbeat_duty.act is not None:
            default_streams(client)


def _judge_by_version(
    client: VehicleClient, report: FactReport, say: Callable[[str], None]
) -> None:
    if not report.is_version_known:
        if client.heartbeat_duty.act is None:
            client.greet(as_ground_station=False)
            client.spend(0.5)
        version, trouble = nearest(client.reported_version())
        say(trouble or f"it is PX4 v{version}")
        report.expect(facts_of(version, FACTS))


def _settle(
    phase: FactGroup, client: VehicleClient, report: FactReport, say: Callable[[str], None]
) -> None:
    # A phase may leave the vehicle in the air: the next one goes on from there or brings it down
    # first.
    say(phase.name)
    reason = "not seen"
    try:
        phase.run(client, report)
    except Stuck as error:
        reason = str(error)
    client.vision_duty.act = None
    client.params.restore()
    report.fail(phase.facts, reason)


def _put_down(client: VehicleClient, say: Callable[[str], None]) -> None:
    try:
        grounded(client)
    except Stuck as error:
        say(f"afterwards: {error}")
