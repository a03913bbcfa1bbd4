"""Requests and their answers: message rates, single messages, acknowledgements."""

from __future__ import annotations

import math
import statistics
from functools import partial

from sitl.conformance.endpoint import Packet
from sitl.conformance.facts import FactReport, number, word
from sitl.conformance.phase import Phase
from sitl.conformance.vehicle_client import REQUEST, SET_INTERVAL, VehicleClient, common_id

_WATCH_S = 3.0
_GET_INTERVAL = 510
_UNKNOWN_COMMAND, _UNKNOWN_MESSAGE = 31999, 60000
# Fact, message, asked for [Hz]; two rounds, so that a link is not asked for everything at once.
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
RATES = (
    number("rate.attitude", "4", "ATTITUDE asked for every 4 ms", 205.0, 252.0, "Hz"),
    number("rate.attitude-quaternion", "4", "ATTITUDE_QUATERNION asked for every 4 ms", 205.0, 252.0, "Hz"),
    number("rate.local-position-200", "4", "LOCAL_POSITION_NED asked for every 5 ms", 117.0, 130.0, "Hz"),
    number("rate.local-position-100", "4", "LOCAL_POSITION_NED asked for every 10 ms", 93.0, 104.0, "Hz"),
    number("rate.odometry", "4", "ODOMETRY asked for every 10 ms", 93.0, 104.0, "Hz"),
    number("rate.attitude-target", "4", "ATTITUDE_TARGET asked for every 10 ms", 93.0, 104.0, "Hz"),
    number("rate.battery", "4", "BATTERY_STATUS asked for every 100 ms", 9.0, 11.0, "Hz"),
    number("rate.servo", "4", "SERVO_OUTPUT_RAW asked for every 2.5 ms", 200.0, 255.0, "Hz"),
    number("rate.actuators", "4", "ACTUATOR_OUTPUT_STATUS asked for every 4 ms", 200.0, 255.0, "Hz"),
    number("rate.hil-state", "1", "HIL_STATE_QUATERNION of the simulator asked for every 10 ms", 90.0, 105.0, "Hz"),
    number("rate.default-again", "4", "ATTITUDE after interval 0", 94.0, 106.0, "Hz"),
    word("rate.acknowledged", "4", "SET_MESSAGE_INTERVAL of a known message", "ACCEPTED"),
    word("rate.heartbeat-fixed", "4", "SET_MESSAGE_INTERVAL of HEARTBEAT", "FAILED"),
    word("rate.unknown-message", "4", "SET_MESSAGE_INTERVAL of an unknown message", "FAILED"),
    number("rate.get", "4", "GET_MESSAGE_INTERVAL of ATTITUDE after asking for 4 ms", 3600.0, 5000.0, "us"),
    word("truth.time", "1", "time_usec of HIL_STATE_QUATERNION", "0"),
)
ANSWERS = (
    word("request.autopilot-version", "4", "REQUEST_MESSAGE of AUTOPILOT_VERSION", "ACCEPTED and sent"),
    word("request.version", "4", "AUTOPILOT_VERSION.flight_sw_version", "1.16"),
    word("request.global-origin", "14", "REQUEST_MESSAGE of GPS_GLOBAL_ORIGIN", "ACCEPTED and sent"),
    word("ack.unknown-command", "4", "an unknown command", "UNSUPPORTED"),
    word("ack.wrong-target", "4", "a command to another system", "silence"),
    word("ack.target", "4", "an acknowledgement names its asker", "yes"),
    number("ack.latency", "4", "median time to an acknowledgement, on an idle machine", 0.0, 25.0, "ms"),
)


def run(client: VehicleClient, report: FactReport) -> None:
    """Raise rates and put them back, then ask this and that."""
    if report.wants("rate.*", "truth.*"):
        _rates(client, report)
    _answers(client, report)


def _rates(client: VehicleClient, report: FactReport) -> None:
    for requests in _ROUNDS:
        matching = [
            request
            for request in requests
            if report.wants(request[0], "rate.acknowledged", "rate.default-again", "rate.get")
        ]
        if not matching:
            continue
        answers = {client.interval(message, hz) for _, message, hz in matching if message != "HIL_STATE_QUATERNION"}
        if any(message == "HIL_STATE_QUATERNION" for _, message, _ in matching):
            client.interval("HIL_STATE_QUATERNION", 100.0)
        report.add("rate.acknowledged", ", ".join(sorted(answers)))
        if any(message == "ATTITUDE" for _, message, _ in matching):
            report.add("rate.get", _get_interval(client))
        since_s = client.now_s
        client.spend(_WATCH_S)
        elapsed_s = client.now_s - since_s
        for fact, message, _ in matching:
            report.add(fact, len(client.received.of(message, since_s)) / elapsed_s)
        for _, message, _ in matching:
            client.interval(message, 0.0)
    truth = client.received.newest("HIL_STATE_QUATERNION")
    report.add("truth.time", str(truth.message.time_usec) if truth else "no HIL_STATE_QUATERNION")
    if report.wants("rate.default-again"):
        since_s = client.now_s
        client.spend(1.5)
        report.add("rate.default-again", len(client.received.of("ATTITUDE", since_s)) / (client.now_s - since_s))
    report.add("rate.heartbeat-fixed", client.interval("HEARTBEAT", 5.0))
    report.add("rate.unknown-message", client.interval(_UNKNOWN_MESSAGE, 5.0))


def _get_interval(client: VehicleClient) -> float:
    since_s = client.now_s
    client.command(_GET_INTERVAL, float(common_id("ATTITUDE")))
    for packet in client.received.of("MESSAGE_INTERVAL", since_s):
        if packet.message.message_id == common_id("ATTITUDE"):
            return float(packet.message.interval_us)
    return math.nan


def _requested(client: VehicleClient, name: str) -> str:
    since_s = client.now_s
    answer = client.command(REQUEST, float(common_id(name)))
    return f"{answer} and {'sent' if client.received.of(name, since_s) else 'not sent'}"


def _answers(client: VehicleClient, report: FactReport) -> None:
    if report.wants("request.autopilot-version"):
        report.add("request.autopilot-version", _requested(client, "AUTOPILOT_VERSION"))
    if report.wants("request.version"):
        report.add("request.version", ".".join(map(str, client.reported_version() or ())) or "none")
    if report.wants("request.global-origin"):
        report.add("request.global-origin", _requested(client, "GPS_GLOBAL_ORIGIN"))
    if report.wants("ack.unknown-command"):
        report.add("ack.unknown-command", client.command(_UNKNOWN_COMMAND))
    if report.wants("ack.wrong-target"):
        wrong = client.system_id % 250 + 3
        report.add("ack.wrong-target", client.command(SET_INTERVAL, 1.0, 2e5, target=wrong))
    if report.wants("ack.target", "ack.latency"):
        _latency(client, report)


def _latency(client: VehicleClient, report: FactReport) -> None:
    times_ms: list[float] = []
    targets: set[tuple[int, int]] = set()
    acks = client.received.packets[common_id("COMMAND_ACK")]
    for _ in range(15):
        sent_s, before = client.port.now_s(), len(acks)
        client.send_command(SET_INTERVAL, float(common_id("SYS_STATUS")), 0.0)
        answered = client.spend(max(0.3, 0.2 * client.clock.pace), partial(_longer, acks, before))
        times_ms.append((client.port.now_s() - sent_s) * 1e3 if answered else math.inf)
        targets |= {(ack.message.target_system, ack.message.target_component) for ack in acks[before:]}
        client.spend(0.02)
    report.add("ack.target", "yes" if targets == {client.identity} else f"it names {sorted(targets)}")
    report.add("ack.latency", statistics.median(times_ms))


def _longer(packets: list[Packet], before: int) -> bool:
    return len(packets) > before


PHASE = Phase("requests and answers", (*RATES, *ANSWERS), run, turns_motors=False)
