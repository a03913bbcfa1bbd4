"""Setpoints stop: how long nothing happens, what happens then for every COM_OBL_RC_ACT, and what when they return."""

from __future__ import annotations

import math

from sitl.conformance.facts import Fact, FactReport, number, word
from sitl.conformance.hover import Hover, airborne, fast_streams, grounded, settle
from sitl.conformance.phase import Phase
from sitl.conformance.pilot import ARM, Pilot, quaternion

_HEIGHT_M = 3.0
_TEXT = "Failsafe activated"
_TOLD = ("loss.status", "loss.base-mode", "loss.text", "loss.severity", "loss.event")
_ACTIONS = {1: "ALTCTL", 3: "AUTO.RTL", 4: "AUTO.LAND", 5: "AUTO.LOITER", 0: "POSCTL"}


def _action_facts(action: int, mode: str) -> tuple[Fact, ...]:
    return (
        word(f"loss.action-{action}", "6", f"COM_OBL_RC_ACT {action}: mode", mode),
        number(f"loss.action-{action}-time", "6", f"COM_OBL_RC_ACT {action}: after the last setpoint", 0.97, 1.25, "s"),
        word(f"loss.action-{action}-return", "6", f"COM_OBL_RC_ACT {action}: when setpoints return", "OFFBOARD"),
    )


AIR = (
    word("loss.short-gap", "6", "setpoints pause for 0.8 s", "nothing"),
    *(fact for action, mode in _ACTIONS.items() for fact in _action_facts(action, mode)),
    word("loss.status", "6", "system_status in failsafe", "CRITICAL"),
    word("loss.base-mode", "5", "base_mode in POSCTL, armed", "209"),
    word("loss.text", "6", "text", repr("Failsafe activated\t")),
    word("loss.severity", "6", "its severity", "2"),
    word("loss.event", "6", "EVENT (410) about it", "sent"),
    number("loss.timeout-follows", "6", "COM_OF_LOSS_T 0.5: after the last setpoint", 0.47, 0.75, "s"),
    number("loss.wrong-target", "5", "setpoints for another system do not count", 0.97, 1.25, "s"),
)
DESCENT = (
    number("loss.descent", "6", "blind descent in POSCTL without RC", 0.5, 0.95, "m/s"),
    number("loss.landed", "6", "from 2.6 m: 'Landing detected' after the last setpoint", 6.0, 13.0, "s"),
    number("loss.disarmed", "6", "disarmed after that", 1.8, 2.4, "s"),
    word("loss.mode-after", "5", "mode after it, if OFFBOARD was flown before", "OFFBOARD"),
    word("loss.status-after", "5", "and system_status while no setpoints flow", "UNINIT"),
    word("loss.arming-after", "5", "and arming", "TEMPORARILY_REJECTED"),
)
GROUND = (
    word("loss.ground-mode", "6", "on the ground, armed: mode", "POSCTL"),
    word("loss.ground-armed", "6", "and 5 s later", "armed"),
    word("loss.ground-return", "6", "when setpoints return", "OFFBOARD"),
)


def run(pilot: Pilot, report: FactReport) -> None:
    """Pause, stop, and stop for good; then the same on the ground."""
    pilot.greet(as_ground_station=True)
    if report.wants(*(fact.name for fact in (*AIR, *DESCENT))):
        hover = airborne(pilot, _HEIGHT_M)
        _in_the_air(pilot, report, hover)
        if report.wants(*(fact.name for fact in DESCENT)):
            _descend(pilot, report, hover)
    if report.wants("loss.ground-*"):
        _on_the_ground(pilot, report)


def _in_the_air(pilot: Pilot, report: FactReport, hover: Hover) -> None:
    if report.wants("loss.short-gap"):
        since_s = _stop(pilot, hover)
        pilot.spend(0.8)
        _resume(pilot, hover)
        pilot.next_heartbeat(2)
        quiet = pilot.text(_TEXT, since_s) is None and pilot.mode == "OFFBOARD"
        report.add("loss.short-gap", "nothing" if quiet else f"failsafe, {pilot.mode}")
    for action in _ACTIONS:
        also = _TOLD if action == 0 else ()
        if report.wants(f"loss.action-{action}*", *also):
            _act(pilot, report, hover, action)
    if report.wants("loss.timeout-follows"):
        pilot.set_parameter("COM_OF_LOSS_T", 0.5)
        report.add("loss.timeout-follows", _until_failsafe(pilot, _stop(pilot, hover)))
        _resume(pilot, hover)
        pilot.restore_parameters()
        pilot.next_heartbeat()
        settle(pilot, hover)
    if report.wants("loss.wrong-target"):
        since_s = _stop(pilot, hover)
        wrong = pilot.system_id % 250 + 3
        level = quaternion(0.0, 0.0, hover.yaw_rad)
        pilot.stream(lambda: pilot.attitude(level, hover.thrust, target=wrong))
        report.add("loss.wrong-target", _until_failsafe(pilot, since_s))
        _resume(pilot, hover)
        pilot.next_heartbeat()
        settle(pilot, hover)


def _stop(pilot: Pilot, hover: Hover) -> float:
    """Stop sending; when the last setpoint went out. It is a level one: it is held."""
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    pilot.attitude(level, hover.thrust)
    pilot.stream(None)
    return pilot.now_s


def _resume(pilot: Pilot, hover: Hover) -> None:
    hover.here()
    pilot.stream(hover)


def _until_failsafe(pilot: Pilot, since_s: float) -> float:
    pilot.spend(2.5, lambda: pilot.text(_TEXT, since_s) is not None)
    text = pilot.text(_TEXT, since_s)
    return text[0] - since_s if text else math.nan


def _act(pilot: Pilot, report: FactReport, hover: Hover, action: int) -> None:
    pilot.set_parameter("COM_OBL_RC_ACT", action)
    since_s = _stop(pilot, hover)
    report.add(f"loss.action-{action}-time", _until_failsafe(pilot, since_s))
    pilot.next_heartbeat()
    report.add(f"loss.action-{action}", pilot.mode)
    if action == 0:
        text = pilot.text(_TEXT, since_s)
        report.add("loss.status", pilot.status)
        report.add("loss.base-mode", str(pilot.newest("HEARTBEAT").base_mode))
        report.add("loss.text", repr(text[2]) if text else "none")
        report.add("loss.severity", str(text[1]) if text else "none")
        events = list(pilot.seen.of("EVENT", since_s + 0.9))
        report.add("loss.event", "sent" if events else "not sent")
    _resume(pilot, hover)
    pilot.spend(0.1)
    pilot.next_heartbeat()
    report.add(f"loss.action-{action}-return", pilot.mode)
    if pilot.mode != "OFFBOARD":
        pilot.set_mode("OFFBOARD")
        pilot.next_heartbeat()
    pilot.restore_parameters()
    settle(pilot, hover)


def _descend(pilot: Pilot, report: FactReport, hover: Hover) -> None:
    hover.to_height(2.6)
    settle(pilot, hover)
    since_s = _stop(pilot, hover)
    pilot.spend(20.0, lambda: pilot.text("Disarmed by", since_s) is not None)
    sinking = [
        packet.message.vz
        for packet in pilot.seen.of("LOCAL_POSITION_NED", since_s)
        if 0.5 < hover.ground_z - packet.message.z < 1.5
    ]
    report.add("loss.descent", sum(sinking) / len(sinking) if sinking else math.nan)
    landed, disarmed = pilot.text("Landing detected", since_s), pilot.text("Disarmed by", since_s)
    report.add("loss.landed", landed[0] - since_s if landed else math.nan)
    report.add("loss.disarmed", disarmed[0] - landed[0] if landed and disarmed else math.nan)
    pilot.next_heartbeat(2)
    report.add("loss.mode-after", pilot.mode)
    report.add("loss.status-after", pilot.status)
    report.add("loss.arming-after", pilot.command(ARM, 1.0))


def _on_the_ground(pilot: Pilot, report: FactReport) -> None:
    grounded(pilot)
    fast_streams(pilot)
    hover = Hover(pilot)
    pilot.stream(hover)
    pilot.spend(0.3)
    pilot.set_mode("OFFBOARD")
    pilot.command(ARM, 1.0)
    pilot.spend(0.5)
    since_s = _stop_resting(pilot)
    _until_failsafe(pilot, since_s)
    pilot.next_heartbeat()
    report.add("loss.ground-mode", pilot.mode)
    pilot.spend(5.0)
    report.add("loss.ground-armed", "armed" if pilot.is_armed else "disarmed")
    pilot.stream(hover)
    pilot.spend(0.1)
    pilot.next_heartbeat()
    report.add("loss.ground-return", pilot.mode)
    pilot.command(ARM, 0.0)
    pilot.next_heartbeat()


def _stop_resting(pilot: Pilot) -> float:
    pilot.stream(None)
    return pilot.now_s


PHASE = Phase("setpoints stop", (*AIR, *DESCENT, *GROUND), run)
