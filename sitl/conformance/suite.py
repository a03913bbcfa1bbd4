"""A check of one vehicle: all groups of facts in order, with its start and its end.

A check sends nothing at first, because a vehicle's messages change once it has received a datagram.
Then the check runs the groups with requested facts. At its end, and when it is interrupted, it
lands the vehicle and restores parameters and streams.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.conformance import (
    arming_facts,
    automatic_facts,
    battery_facts,
    hold_facts,
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

# Streams are watched before the first datagram to the vehicle and before any change of a rate. The
# effects of both last until the vehicle restarts.
FACT_GROUPS: tuple[FactGroup, ...] = (
    stream_facts.FACT_GROUP,
    sender_facts.FACT_GROUP,
    parameter_facts.FACT_GROUP,
    request_facts.FACT_GROUP,
    arming_facts.FACT_GROUP,
    automatic_facts.FACT_GROUP,
    hold_facts.FACT_GROUP,
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
# Groups on other ports, and the option of `covey check endpoint` for the port of each.
LINKS: tuple[tuple[FactGroup, str], ...] = (
    (link_facts.GROUND_LINK, "--gcs"),
    (link_facts.SIMULATOR_LINK, "--sih"),
)
_LINK_GROUPS = tuple(group for group, _ in LINKS)
FACTS: tuple[Fact, ...] = tuple(
    fact for group in (*FACT_GROUPS, *_LINK_GROUPS) for fact in group.facts
)

# Groups that begin before the first datagram to the vehicle.
_SILENT_GROUPS = (stream_facts.FACT_GROUP, sender_facts.FACT_GROUP)
_NOT_SIMULATED = (
    "it does not look simulated (no ground truth comes by HIL_STATE_QUATERNION), and this turns "
    "motors: see --i-have-removed-the-propellers"
)
_DRAIN_S = 60.0  # time in which PX4's own simulator empties a full battery
_READY_S = 8.0  # the check waits until this long after boot for the vehicle to become ready
_MEETING_S = 3.0  # longest wait for the first heartbeat, after the first datagram
_MAV_AUTOPILOT_PX4 = 12
_MAV_COMP_ID_AUTOPILOT1 = 1


class NobodyAnsweredError(RuntimeError):
    """No heartbeat of a PX4 arrived in time."""


@dataclass(frozen=True, slots=True)
class Terms:
    """Permissions and waiting time of a check."""

    may_turn_motors: bool = False  # whether motors may turn on a vehicle that is not simulated
    wait_s: float = 10.0  # time to wait for the first heartbeat
    from_elsewhere: bool = False  # whether the first sender is not the port that listens
    key: bytes | None = None  # the vehicle's MAVLink signing key


def check(
    port: Port,
    ground_port: Port | None,
    report: FactReport,
    terms: Terms,
    say: Callable[[str], None],
    simulator_port: Port | None = None,
) -> VehicleClient:
    """Measure the facts of a report; return the client, which knows the vehicle's pace and id.

    Args:
        port: link of the companion.
        ground_port: link of the ground station, if it is checked.
        report: report with the requested facts.
        terms: permissions and waiting time.
        say: function that shows a line of progress.
        simulator_port: link of the simulator, if it is checked.

    Raises:
        NobodyAnsweredError: no heartbeat of a PX4 arrives within the time.
    """
    client = VehicleClient(port)
    client.moves_first_sender = terms.from_elsewhere
    client.signature = _signature(terms)
    _meet(client, terms)

    try:
        _measure_all(client, report, terms, say)
    except Gone:
        report.fail(report.facts.values(), "it fell silent")
        return client

    other_ports = (ground_port, simulator_port)
    for (group, option), other_port in zip(LINKS, other_ports, strict=True):
        if other_port is None:
            report.skip(group.facts, f"no {option} endpoint was given")
        elif _is_requested(group, report):
            other = _client_of_link(other_port, client, terms)
            try:
                _measure(group, other, report, say)
            except Gone:
                report.fail(group.facts, "it fell silent")
    return client


def _client_of_link(port: Port, client: VehicleClient, terms: Terms) -> VehicleClient:
    """Return a client of the same vehicle on another link."""
    while port.receive(0.0):
        pass  # drop the datagrams that arrived during the other groups

    other = VehicleClient(port)
    other.system_id = client.system_id
    other.signature = _signature(terms)
    return other


def _signature(terms: Terms) -> Signature | None:
    if terms.key is None:
        return None
    return Signature(terms.key, sender_facts.LINK_ID, sender_facts.signing_time())


def is_simulated(client: VehicleClient) -> bool:
    """Return whether the vehicle sends ground truth, which only a simulated vehicle has."""
    client.interval("HIL_STATE_QUATERNION", 20.0)
    has_truth = client.wait(2.0, lambda: client.received.newest("HIL_STATE_QUATERNION") is not None)
    client.interval("HIL_STATE_QUATERNION", 0.0)
    return has_truth


def _meet(client: VehicleClient, terms: Terms) -> None:
    """Wait for a PX4, and store its system id in the client."""
    if not client.listen(terms.wait_s, lambda: client.received.datagrams > 0):
        # The link may send only after it has received a datagram. PX4's default system id is 1.
        client.system_id = 1
        client.send_heartbeat()

    client.listen(_MEETING_S, lambda: _system_id_of_px4(client) is not None)
    system_id = _system_id_of_px4(client)
    if system_id is None:
        raise NobodyAnsweredError
    client.system_id = system_id


def _system_id_of_px4(client: VehicleClient) -> int | None:
    """Return the system id of the first PX4 that was heard; None if none was."""
    for beat in client.received.of("HEARTBEAT"):
        is_autopilot = beat.component_id == _MAV_COMP_ID_AUTOPILOT1
        if is_autopilot and beat.message.autopilot == _MAV_AUTOPILOT_PX4:
            return int(beat.system_id)
    return None


def _is_requested(group: FactGroup, report: FactReport) -> bool:
    return any(fact.name in report.facts for fact in group.facts)


def _measure_all(
    client: VehicleClient, report: FactReport, terms: Terms, say: Callable[[str], None]
) -> None:
    """Measure the groups on the link of the companion, one after the other."""
    may_turn_motors: bool | None = None  # not known yet
    if terms.may_turn_motors:
        may_turn_motors = True
    try:
        for group in FACT_GROUPS:
            if not _is_requested(group, report):
                continue

            if group not in _SILENT_GROUPS:
                _greet_once(client)
            if _has_greeted(client):
                _judge_by_version(client, report, say)

            if not group.turns_motors:
                _measure(group, client, report, say)
                continue

            if may_turn_motors is None:
                may_turn_motors = is_simulated(client)
            if may_turn_motors:
                # The facts hold for the drain of PX4's own simulator. A fleet file may set a
                # different one.
                client.params.set("SIM_BAT_DRAIN", _DRAIN_S)
                # A vehicle with vision only is never ready on the ground. The check continues.
                left_s = max(0.0, _READY_S - client.now_s)
                client.wait(left_s, client.shows_ready)
                _measure(group, client, report, say)
            else:
                report.skip(group.facts, _NOT_SIMULATED)
        _judge_by_version(client, report, say)
    finally:
        # This runs after an interrupt as well, so that no vehicle stays in the air and no parameter
        # stays changed.
        try:
            client.params.restore()
            if may_turn_motors:
                _put_down(client, say)
            if _has_greeted(client):
                default_streams(client)
        finally:
            _say_what_stays_changed(client, say)


def _has_greeted(client: VehicleClient) -> bool:
    return client.heartbeat_duty.act is not None


def _greet_once(client: VehicleClient) -> None:
    """Start heartbeats, unless they have started already."""
    if not _has_greeted(client):
        client.greet(as_ground_station=False)
        client.wait(0.5)


def _judge_by_version(
    client: VehicleClient, report: FactReport, say: Callable[[str], None]
) -> None:
    """Judge by the version that the vehicle reports, unless a version was requested."""
    if report.is_version_known:
        return
    _greet_once(client)
    version, trouble = nearest(client.reported_version())
    if trouble:
        say(trouble)
    else:
        say(f"it is PX4 v{version}")
    report.expect(facts_of(version, FACTS))


def _measure(
    group: FactGroup, client: VehicleClient, report: FactReport, say: Callable[[str], None]
) -> None:
    """Run one group and report its facts.

    A group may leave the vehicle in the air. The next group continues in the air or lands first.
    """
    say(group.name)
    reason = "not seen"
    try:
        group.run(client, report)
    except Stuck as error:
        reason = str(error)
    client.vision_duty.act = None
    client.params.restore()
    report.fail(group.facts, reason)  # only facts that the group has not measured


def _say_what_stays_changed(client: VehicleClient, say: Callable[[str], None]) -> None:
    """Name the parameters whose original values the vehicle has not confirmed."""
    if client.params.changed:
        listed = ", ".join(f"{name} = {value:g}" for name, value in client.params.changed.items())
        say(
            f"afterwards: the vehicle did not confirm that these parameters have their former "
            f"values again: {listed}. Set them yourself."
        )


def _put_down(client: VehicleClient, say: Callable[[str], None]) -> None:
    try:
        grounded(client)
    except Stuck as error:
        say(f"afterwards: {error}")
