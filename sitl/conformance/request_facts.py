"""Facts of requests and their answers: message rates, single messages, acknowledgements."""

from __future__ import annotations

import math
import statistics
from functools import partial

from sitl.conformance.endpoint import ReceivedPacket
from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.measurements import NOT_MEASURED, sent_or_not
from sitl.conformance.vehicle_client import (
    REQUEST,
    SET_INTERVAL,
    VehicleClient,
    common_id,
    other_system_id,
)

_WATCH_S = 3.0
_LATENCY_SAMPLES = 15
# longest wait for one acknowledgement, by the vehicle's or this computer's clock, if longer
_ACK_S = 0.3
_ACK_REAL_S = 0.2
_GET_INTERVAL = 510
_UNKNOWN_COMMAND = 31999
_UNKNOWN_MESSAGE = 60000
# Fact, message, requested rate [Hz]. There are two rounds, so that fewer messages are requested at
# once.
_ROUNDS = (
    (
        ("rate.attitude", "ATTITUDE", 250.0),
        ("rate.local-position-200", "LOCAL_POSITION_NED", 200.0),
        ("rate.battery", "BATTERY_STATUS", 10.0),
        ("rate.servo", "SERVO_OUTPUT_RAW", 400.0),
        ("rate.hil-state", "HIL_STATE_QUATERNION", 100.0),
    ),
    (
        ("rate.attitude-quaternion", "ATTITUDE_QUATERNION", 250.0),
        ("rate.local-position-100", "LOCAL_POSITION_NED", 100.0),
        ("rate.odometry", "ODOMETRY", 100.0),
        ("rate.attitude-target", "ATTITUDE_TARGET", 100.0),
        ("rate.actuators", "ACTUATOR_OUTPUT_STATUS", 250.0),
    ),
)
RATES = facts("requests", "rates")
ANSWERS = facts("requests", "answers")


def run(client: VehicleClient, report: FactReport) -> None:
    """Raise and restore rates, then request messages."""
    if report.wants("rate.*", "truth.*"):
        _rates(client, report)
    _answers(client, report)


def _rates(client: VehicleClient, report: FactReport) -> None:
    """Request higher rates, watch them for a time, and return to the default rates."""
    for requests in _ROUNDS:
        # three facts about all rates need every request
        requested = [
            (fact, message, hz)
            for fact, message, hz in requests
            if report.wants(fact, "rate.acknowledged", "rate.default-again", "rate.get")
        ]
        if not requested:
            continue
        messages = [message for _, message, _ in requested]

        # Only a simulated PX4 has HIL_STATE_QUATERNION, so the answer to it is not reported.
        answers: set[str] = set()
        for _, message, hz in requested:
            if message != "HIL_STATE_QUATERNION":
                answers.add(client.interval(message, hz))
        if "HIL_STATE_QUATERNION" in messages:
            client.interval("HIL_STATE_QUATERNION", 100.0)
        report.add("rate.acknowledged", ", ".join(sorted(answers)))
        if "ATTITUDE" in messages:
            report.add("rate.get", _get_interval(client))

        since_s = client.now_s
        client.wait(_WATCH_S)
        elapsed_s = client.now_s - since_s
        for fact, message, _ in requested:
            report.add(fact, len(client.received.of(message, since_s)) / elapsed_s)
        for message in messages:
            client.interval(message, 0.0)

    truth = client.received.newest("HIL_STATE_QUATERNION")
    if truth is None:
        report.add("truth.time", "no HIL_STATE_QUATERNION")
    else:
        report.add("truth.time", str(truth.message.time_usec))

    if report.wants("rate.default-again"):
        since_s = client.now_s
        client.wait(1.5)
        elapsed_s = client.now_s - since_s
        count = len(client.received.of("ATTITUDE", since_s))
        report.add("rate.default-again", count / elapsed_s)

    report.add("rate.heartbeat-fixed", client.interval("HEARTBEAT", 5.0))
    report.add("rate.unknown-message", client.interval(_UNKNOWN_MESSAGE, 5.0))


def _get_interval(client: VehicleClient) -> float:
    since_s = client.now_s
    client.command(_GET_INTERVAL, float(common_id("ATTITUDE")))
    for packet in client.received.of("MESSAGE_INTERVAL", since_s):
        if packet.message.message_id == common_id("ATTITUDE"):
            return float(packet.message.interval_us)
    return NOT_MEASURED


def _requested(client: VehicleClient, name: str) -> str:
    since_s = client.now_s
    answer = client.command(REQUEST, float(common_id(name)))
    return f"{answer} and {sent_or_not(client.received.of(name, since_s))}"


def _answers(client: VehicleClient, report: FactReport) -> None:
    if report.wants("request.autopilot-version"):
        report.add("request.autopilot-version", _requested(client, "AUTOPILOT_VERSION"))

    if report.wants("request.version"):
        version = client.reported_version()
        if version is None:
            report.add("request.version", "none")
        else:
            report.add("request.version", ".".join(map(str, version)))

    if report.wants("request.global-origin"):
        report.add("request.global-origin", _requested(client, "GPS_GLOBAL_ORIGIN"))

    if report.wants("ack.unknown-command"):
        report.add("ack.unknown-command", client.command(_UNKNOWN_COMMAND))
    if report.wants("ack.wrong-target"):
        target = other_system_id(client)
        report.add("ack.wrong-target", client.command(SET_INTERVAL, 1.0, 2e5, target=target))
    if report.wants("ack.target", "ack.latency"):
        _latency(client, report)


def _latency(client: VehicleClient, report: FactReport) -> None:
    """Report how long PX4 takes to acknowledge a command, and which receiver it names."""
    times_ms: list[float] = []
    targets: set[tuple[int, int]] = set()
    acks = client.received.packets[common_id("COMMAND_ACK")]

    for _ in range(_LATENCY_SAMPLES):
        count_before = len(acks)
        sent_s = client.port.now_s()
        client.send_command(SET_INTERVAL, float(common_id("SYS_STATUS")), 0.0)
        is_answered = client.wait(
            max(_ACK_S, _ACK_REAL_S * client.clock.pace), partial(_has_more, acks, count_before)
        )
        if is_answered:
            times_ms.append((client.port.now_s() - sent_s) * 1e3)
        else:
            times_ms.append(math.inf)
        for ack in acks[count_before:]:
            targets.add((ack.message.target_system, ack.message.target_component))
        client.wait(0.02)

    identity = client.identity
    if targets == {(identity.system_id, identity.component_id)}:
        report.add("ack.target", "yes")
    else:
        report.add("ack.target", f"it names {sorted(targets)}")
    report.add("ack.latency", statistics.median(times_ms))


def _has_more(packets: list[ReceivedPacket], count: int) -> bool:
    return len(packets) > count


FACT_GROUP = FactGroup("requests and answers", (*RATES, *ANSWERS), run, turns_motors=False)
