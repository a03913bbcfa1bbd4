"""Facts on the ground: texts and their receivers, mode requests, arming, motors after arming."""

from __future__ import annotations

import itertools

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import grounded
from sitl.conformance.measurements import NOT_MEASURED, sent_or_not
from sitl.conformance.vehicle_client import (
    ARM,
    FORCE,
    MAV_RESULT_ACCEPTED,
    MODE_NUMBERS,
    NO_TEXT,
    SET_MODE,
    SILENCE,
    VehicleClient,
)

# After this time PX4 no longer sends older texts and has lost the last ground station.
_TEXTS_END_S = 5.2
MODES_ON_GROUND = facts("arming", "modes_on_ground")
TEXTS = facts("arming", "texts")
BY_HAND = facts("arming", "by_hand")
ARMED = facts("arming", "armed")
# Largest position of a stick in MANUAL_CONTROL, and the rate of the sticks.
_FULL_STICK = 1000
_STICKS_PERIOD_S = 0.05


def run(client: VehicleClient, report: FactReport) -> None:
    """Request refused actions as a companion and as a ground station, then arm and wait."""
    if report.wants("mode.*", "text.*", "event.*", "arm.denied"):
        _refusals(client, report)
    if report.wants(*(fact.name for fact in BY_HAND)):
        _by_hand(client, report)
    if report.wants(*(fact.name for fact in ARMED)):
        _armed(client, report)


def _refusals(client: VehicleClient, report: FactReport) -> None:
    grounded(client)
    _greet_as_companion(client)

    _mode_on_ground(client, report)
    since_s = client.now_s
    _arming_denied(client, report)
    if report.wants("text.backlog", "text.denied*", "text.chunks", "text.stops"):
        _text_about_denial(client, report, since_s)
    if report.wants("text.stops"):
        _texts_stop(client, report)
    if report.wants("mode.set-mode-message"):
        _set_mode_message(client, report)
    grounded(client)


def _greet_as_companion(client: VehicleClient) -> None:
    was_ground_station = client.is_ground_station
    client.greet(as_ground_station=False)
    if was_ground_station:
        client.wait(_TEXTS_END_S)
    else:
        client.wait(0.5)


def _mode_on_ground(client: VehicleClient, report: FactReport) -> None:
    report.add("mode.two-acks", client.set_mode("OFFBOARD"))
    client.next_heartbeat()
    beat = client.newest("HEARTBEAT")
    report.add("mode.offboard-disarmed", client.mode)
    report.add("mode.offboard-disarmed-base", str(beat.base_mode))
    report.add("mode.offboard-disarmed-status", client.status)


def _arming_denied(client: VehicleClient, report: FactReport) -> None:
    since_s = client.now_s
    report.add("arm.denied", client.command(ARM, 1.0))
    client.wait(0.5)
    report.add("event.denied", sent_or_not(client.received.of("EVENT", since_s)))
    report.add("text.none-for-companion", client.first_text(since_s))


def _text_about_denial(client: VehicleClient, report: FactReport, denied_s: float) -> None:
    """Report the text about a denial that came before the ground station appeared."""
    client.greet(as_ground_station=True)
    client.text("Arming denied", denied_s, wait_s=1.5)  # wait until its first piece has come
    client.wait(0.2)  # for the remaining pieces of the text

    text = client.text("Arming denied", denied_s)
    report.add("text.backlog", sent_or_not(text))
    shown = text or NO_TEXT
    report.add("text.denied", repr(shown.words))
    report.add("text.denied-severity", str(shown.severity))
    report.add("text.chunks", str(shown.pieces))


def _texts_stop(client: VehicleClient, report: FactReport) -> None:
    client.greet(as_ground_station=False)
    client.wait(5.0)
    since_s = client.now_s
    client.command(ARM, 1.0)
    client.wait(0.5)
    report.add("text.stops", client.first_text(since_s))


def _set_mode_message(client: VehicleClient, report: FactReport) -> None:
    since_s = client.now_s
    loiter = MODE_NUMBERS["AUTO.LOITER"]
    client.send("SET_MODE", target_system=client.system_id, base_mode=1, custom_mode=loiter)
    client.acks(SET_MODE, since_s)  # wait for an answer

    # Count all acknowledgements, because it is not known which command they name for this message.
    answers: list[str] = []
    for packet in client.received.of("COMMAND_ACK", since_s):
        if packet.message.result == MAV_RESULT_ACCEPTED:
            answers.append("ACCEPTED")
        else:
            answers.append("refused")
    report.add("mode.set-mode-message", ", ".join(answers) or SILENCE)


def _by_hand(client: VehicleClient, report: FactReport) -> None:
    """Arm in the modes of a pilot, with different positions of the throttle."""
    grounded(client)
    client.greet(as_ground_station=True)
    client.set_mode("MANUAL")
    client.next_heartbeat()
    report.add("arm.no-sticks", client.command(ARM, 1.0))

    since_s = client.now_s
    report.add("arm.throttle-centred", _arm_with_throttle(client, _FULL_STICK // 2))
    client.wait(0.5)
    report.add("arm.throttle-text", client.quote("Arming denied: ", since_s))
    report.add("arm.throttle-low", _arm_with_throttle(client, 0))

    client.set_mode("POSCTL")
    client.next_heartbeat()
    report.add("arm.posctl-throttle-full", _arm_with_throttle(client, _FULL_STICK))
    client.vision_duty.act = None
    client.vision_duty.period_s = 0.02


def _arm_with_throttle(client: VehicleClient, throttle: int) -> str:
    """Send sticks with a throttle, arm, disarm again; return the answer to the arming."""

    def send() -> None:
        client.send("MANUAL_CONTROL", target=client.system_id, z=throttle)

    # the duty for vision poses is free here, so it sends the sticks
    client.vision_duty.act = send
    client.vision_duty.period_s = _STICKS_PERIOD_S
    client.wait(1.0)
    answer = client.command(ARM, 1.0)
    client.command(ARM, 0.0, FORCE)
    return answer


def _armed(client: VehicleClient, report: FactReport) -> None:
    """Arm on the ground, and report the answers until PX4 disarms by itself."""
    grounded(client)
    client.greet(as_ground_station=True)
    client.wait(1.2)
    report.add("arm.disarm-disarmed", client.command(ARM, 0.0))

    # Arm half way between two heartbeats, so that a heartbeat caused by the change is early.
    client.next_heartbeat()
    client.wait(0.4)
    armed_s = client.now_s
    report.add("arm.accepted", client.command(ARM, 1.0))
    client.next_heartbeat(2)
    beats_s = [packet.at_s for packet in client.received.of("HEARTBEAT", armed_s - 2.0)]
    gaps_s = [after_s - before_s for before_s, after_s in itertools.pairwise(beats_s)]
    report.add("heartbeat.not-on-change", min(gaps_s, default=NOT_MEASURED))

    report.add("arm.status", client.status)
    report.add("arm.base-mode", str(client.newest("HEARTBEAT").base_mode))
    report.add("arm.text", client.quote("Armed by", armed_s))
    report.add("arm.servo", float(client.newest("SERVO_OUTPUT_RAW").servo1_raw))

    again_s = client.now_s
    report.add("arm.again", client.command(ARM, 1.0))
    report.add("arm.again-text", client.first_text(again_s))

    if not report.wants("arm.auto-disarm*"):
        return
    text = client.text("Disarmed by", armed_s, wait_s=14.0) or NO_TEXT
    report.add("arm.auto-disarm", text.at_s - armed_s)
    report.add("arm.auto-disarm-text", repr(text.words))
    report.add("arm.auto-disarm-severity", str(text.severity))
    client.next_heartbeat()


FACT_GROUP = FactGroup("arming on the ground", (*MODES_ON_GROUND, *TEXTS, *BY_HAND, *ARMED), run)
