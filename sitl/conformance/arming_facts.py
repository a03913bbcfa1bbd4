"""On the ground: texts and their receivers, mode requests, arming, the motors' first seconds."""

from __future__ import annotations

import itertools
import math

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import grounded
from sitl.conformance.vehicle_client import ARM, MODE_NUMBERS, SET_MODE, SILENCE, VehicleClient

_DENIED = "Arming denied: Resolve system health failures first\t"
MODES_ON_GROUND = facts("arming", "modes_on_ground")
TEXTS = facts("arming", "texts")
ARMED = facts("arming", "armed")


def run(client: VehicleClient, report: FactReport) -> None:
    """Be refused, as a companion and as a ground station, then arm and wait."""
    if report.wants("mode.*", "text.*", "event.*", "arm.denied"):
        _refusals(client, report)
    if report.wants(*(fact.name for fact in ARMED)):
        _armed(client, report)


def _refusals(client: VehicleClient, report: FactReport) -> None:
    grounded(client)
    was_ground_station = client.is_ground_station
    client.greet(as_ground_station=False)
    # Until older texts and the last ground station are forgotten.
    client.spend(5.2 if was_ground_station else 0.5)

    report.add("mode.two-acks", client.set_mode("OFFBOARD"))
    client.next_heartbeat()
    beat = client.newest("HEARTBEAT")
    report.add("mode.offboard-disarmed", client.mode)
    report.add("mode.offboard-disarmed-base", str(beat.base_mode))
    report.add("mode.offboard-disarmed-status", client.status)

    since_s = client.now_s
    report.add("arm.denied", client.command(ARM, 1.0))
    client.spend(0.5)
    report.add("event.denied", "sent" if client.received.of("EVENT", since_s) else "not sent")
    report.add("text.none-for-companion", client.said(since_s))

    if report.wants("text.backlog", "text.denied*", "text.chunks", "text.stops"):
        client.greet(as_ground_station=True)
        client.text("Arming denied", since_s, wait_s=1.5)
        client.spend(0.2)
        text = client.text("Arming denied", since_s)
        report.add("text.backlog", "sent" if text else "not sent")
        _, severity, words, pieces = text or (0.0, -1, "", 0)
        report.add("text.denied", repr(words))
        report.add("text.denied-severity", str(severity))
        report.add("text.chunks", str(pieces))

    if report.wants("text.stops"):
        client.greet(as_ground_station=False)
        client.spend(5.0)
        since_s = client.now_s
        client.command(ARM, 1.0)
        client.spend(0.5)
        report.add("text.stops", client.said(since_s))

    if report.wants("mode.set-mode-message"):
        since_s = client.now_s
        loiter = MODE_NUMBERS["AUTO.LOITER"]
        client.send("SET_MODE", target_system=client.system_id, base_mode=1, custom_mode=loiter)
        # Which command an acknowledgement of this message names is not known to us.
        client.acks(SET_MODE, since_s)
        answers: list[str] = []
        for packet in client.received.of("COMMAND_ACK", since_s):
            is_accepted = packet.message.result == 0
            answers.append("ACCEPTED" if is_accepted else "refused")
        report.add("mode.set-mode-message", ", ".join(answers) or SILENCE)
    grounded(client)


def _armed(client: VehicleClient, report: FactReport) -> None:
    grounded(client)
    client.greet(as_ground_station=True)
    client.spend(1.2)
    report.add("arm.disarm-disarmed", client.command(ARM, 0.0))

    # Half way between two heartbeats, where one that is sent because of the change would be seen as
    # such.
    client.next_heartbeat()
    client.spend(0.4)
    armed_s = client.now_s
    report.add("arm.accepted", client.command(ARM, 1.0))
    client.next_heartbeat(2)
    beats = [packet.at_s for packet in client.received.of("HEARTBEAT", armed_s - 2.0)]
    gaps = [after - before for before, after in itertools.pairwise(beats)]
    report.add("heartbeat.not-on-change", min(gaps, default=math.nan))

    report.add("arm.status", client.status)
    report.add("arm.base-mode", str(client.newest("HEARTBEAT").base_mode))
    report.add("arm.text", client.quote("Armed by", armed_s))
    report.add("arm.servo", float(client.newest("SERVO_OUTPUT_RAW").servo1_raw))

    again_s = client.now_s
    report.add("arm.again", client.command(ARM, 1.0))
    report.add("arm.again-text", client.said(again_s))

    if not report.wants("arm.auto-disarm*"):
        return
    text = client.text("Disarmed by", armed_s, wait_s=14.0)
    at_s, severity, words, _ = text or (math.inf, -1, "", 0)
    report.add("arm.auto-disarm", at_s - armed_s)
    report.add("arm.auto-disarm-text", repr(words))
    report.add("arm.auto-disarm-severity", str(severity))
    client.next_heartbeat()


FACT_GROUP = FactGroup("arming on the ground", (*MODES_ON_GROUND, *TEXTS, *ARMED), run)
