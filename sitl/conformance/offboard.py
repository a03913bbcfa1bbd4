"""OFFBOARD by attitude setpoints: how it begins, what it refuses, how it ends on the ground."""

from __future__ import annotations

import math
import statistics

from sitl.conformance.facts import FactReport, number, word
from sitl.conformance.hover import Hover, airborne, fast_streams, grounded, settle
from sitl.conformance.phase import Phase
from sitl.conformance.pilot import ARM, Pilot, Stuck, quaternion

_EARLY_THRUST = 0.6
_HEIGHT_M = 2.5
START = (
    word("offboard.streamed-status", "10", "OFFBOARD while setpoints stream: ready to arm", "STANDBY"),
    word("offboard.base-mode", "5", "base_mode in OFFBOARD with attitude setpoints, disarmed", "17"),
    word("offboard.base-mode-armed", "5", "and armed", "145"),
    number("offboard.no-spool", "5", "motors at the thrust asked for after arming", 0.0, 0.07, "s"),
    number("offboard.takeoff-text", "5", "'Takeoff detected' after arming with thrust 0.6", 0.0, 0.7, "s"),
    number("offboard.early-climb", "5", "climb 0.44 s after arming", 0.1, 0.8, "m/s"),
)
KEPT = (
    word("offboard.two-hertz", "5", "stays in OFFBOARD with two setpoints a second", "OFFBOARD"),
    word("offboard.disarm-in-air", "5", "disarming in the air", "TEMPORARILY_REJECTED"),
    word("offboard.disarm-text", "5", "text", repr("Disarming denied: not landed\t")),
    word("offboard.disarm-severity", "5", "its severity", "2"),
    word("offboard.hold-sticks", "6", "a mode asked for stays, though setpoints go on", "AUTO.LOITER"),
    word("offboard.hold-base-mode", "5", "base_mode in AUTO.LOITER, armed", "157"),
    word("offboard.refused", "5", "OFFBOARD in the air without fresh setpoints", "ACCEPTED, TEMPORARILY_REJECTED"),
    word("offboard.refused-mode", "5", "the mode after that", "AUTO.LOITER"),
    word("offboard.refused-text", "5", "texts about it", "none"),
    word("offboard.again", "5", "OFFBOARD in the air with setpoints", "ACCEPTED, ACCEPTED"),
    word("offboard.no-position-target", "4", "no POSITION_TARGET_LOCAL_NED while attitudes are flown", "none"),
    word("quirk.odometry-velocity", "4", "ODOMETRY's velocity is north, east, down, at any heading", "NED"),
    number("hover.thrust", "8", "thrust that hovers", 0.465, 0.515),
    number("hover.servo", "8", "SERVO_OUTPUT_RAW in hover", 1450.0, 1515.0),
)
END = (
    number("offboard.cut-disarm", "14", "on the ground, thrust cut: disarms by itself", 3.6, 5.3, "s"),
    word("offboard.forced", "5", "forced disarming in the air", "ACCEPTED"),
    word("offboard.forced-text", "5", "text", repr("Disarmed by external command\t")),
    word("offboard.forced-servo", "5", "motors at once", "900"),
)


def run(pilot: Pilot, report: FactReport) -> None:
    """Start, fly, ask for the impossible, put down."""
    pilot.greet(as_ground_station=True)
    grounded(pilot)
    pilot.spend(1.0)
    hover = _start(pilot, report)
    if report.wants("hover.*", "offboard.no-position-target"):
        _hover(pilot, report)
    if report.wants("quirk.odometry-velocity"):
        _odometry(pilot, report, hover)
    if report.wants("offboard.two-hertz"):
        _slowly(pilot, report, hover)
    if report.wants("offboard.disarm-*"):
        since_s = pilot.now_s
        report.add("offboard.disarm-in-air", pilot.command(ARM, 0.0))
        pilot.spend(0.3)
        _, severity, words, _ = pilot.text("Disarming denied", since_s) or (0.0, -1, "", 0)
        report.add("offboard.disarm-text", repr(words))
        report.add("offboard.disarm-severity", str(severity))
    if report.wants("offboard.hold*", "offboard.refused*", "offboard.again"):
        _hold(pilot, report, hover)
    if report.wants("offboard.cut-disarm"):
        _cut(pilot, report, hover)
    if report.wants("offboard.forced*"):
        _forced(pilot, report)


def _start(pilot: Pilot, report: FactReport) -> Hover:
    fast_streams(pilot)
    hover = Hover(pilot)
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    pilot.interval("SERVO_OUTPUT_RAW", 250.0)
    pilot.stream(lambda: pilot.attitude(level, _EARLY_THRUST))
    pilot.spend(0.3)
    pilot.set_mode("OFFBOARD")
    pilot.next_heartbeat()
    report.add("offboard.streamed-status", pilot.status)
    report.add("offboard.base-mode", str(pilot.newest("HEARTBEAT").base_mode))
    armed_s = pilot.now_s
    pilot.send_command(ARM, 1.0)
    pilot.spend(0.7)
    answers = pilot.seen.of("COMMAND_ACK", armed_s)
    if not answers or answers[0].message.result:
        pilot.interval("SERVO_OUTPUT_RAW", 0.0)
        raise Stuck("it did not arm in OFFBOARD")
    pilot.stream(hover)
    hover.to_height(_HEIGHT_M)
    acked_s = answers[0].at_s
    turning = [p.at_s for p in pilot.seen.of("SERVO_OUTPUT_RAW", armed_s) if p.message.servo1_raw > 1500]
    report.add("offboard.no-spool", max(0.0, turning[0] - acked_s) if turning else math.nan)
    climbing = [
        packet.message.vz
        for packet in pilot.seen.of("LOCAL_POSITION_NED", armed_s)
        if abs(packet.at_s - acked_s - 0.44) < 0.06
    ]
    report.add("offboard.early-climb", -statistics.fmean(climbing) if climbing else math.nan)
    pilot.spend(0.5)
    text = pilot.text("Takeoff detected", armed_s)
    report.add("offboard.takeoff-text", max(0.0, text[0] - acked_s) if text else math.nan)
    pilot.interval("SERVO_OUTPUT_RAW", 0.0)
    pilot.next_heartbeat()
    report.add("offboard.base-mode-armed", str(pilot.newest("HEARTBEAT").base_mode))
    settle(pilot, hover)
    return hover


def _hover(pilot: Pilot, report: FactReport) -> None:
    pilot.interval("SERVO_OUTPUT_RAW", 50.0)
    since_s = pilot.now_s
    pilot.spend(4.0)
    thrusts = [packet.message.thrust for packet in pilot.seen.of("ATTITUDE_TARGET", since_s)]
    servos = [
        statistics.fmean((m.servo1_raw, m.servo2_raw, m.servo3_raw, m.servo4_raw))
        for m in (packet.message for packet in pilot.seen.of("SERVO_OUTPUT_RAW", since_s))
    ]
    targets = len(pilot.seen.of("POSITION_TARGET_LOCAL_NED", since_s + 1.0))
    report.add("hover.thrust", statistics.fmean(thrusts) if thrusts else math.nan)
    report.add("hover.servo", statistics.fmean(servos) if servos else math.nan)
    report.add("offboard.no-position-target", "none" if not targets else f"{targets} in 3 s")
    pilot.interval("SERVO_OUTPUT_RAW", 0.0)


def _odometry(pilot: Pilot, report: FactReport, hover: Hover) -> None:
    hover.yaw_rad += math.pi / 2
    pilot.spend(2.5)
    hover.goal[0] += 2.0
    hover.goal[1] += 2.0
    since_s = pilot.now_s
    pilot.spend(1.8)
    yaw = pilot.euler()[2]
    turned, straight = [], []
    places = pilot.seen.of("LOCAL_POSITION_NED", since_s)
    for packet in pilot.seen.of("ODOMETRY", since_s):
        o = packet.message
        v = min(places, key=lambda place: abs(place.at_s - packet.at_s)).message
        straight.append(math.hypot(o.vx - v.vx, o.vy - v.vy))
        forward = math.cos(yaw) * v.vx + math.sin(yaw) * v.vy
        right = -math.sin(yaw) * v.vx + math.cos(yaw) * v.vy
        turned.append(math.hypot(o.vx - forward, o.vy - right))
    if straight:
        is_ned = statistics.fmean(straight) < statistics.fmean(turned)
        report.add("quirk.odometry-velocity", "NED" if is_ned else "along the body")
    hover.here()
    settle(pilot, hover)


def _slowly(pilot: Pilot, report: FactReport, hover: Hover) -> None:
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    pilot.stream(lambda: pilot.attitude(level, hover.thrust), hz=2.0)
    pilot.spend(3.0)
    report.add("offboard.two-hertz", pilot.mode)
    pilot.stream(hover)
    hover.here()
    pilot.spend(1.0)


def _hold(pilot: Pilot, report: FactReport, hover: Hover) -> None:
    pilot.set_mode("AUTO.LOITER")
    pilot.next_heartbeat(2)
    report.add("offboard.hold-sticks", pilot.mode)
    report.add("offboard.hold-base-mode", str(pilot.newest("HEARTBEAT").base_mode))
    pilot.stream(None)
    pilot.spend(1.4)
    since_s = pilot.now_s
    report.add("offboard.refused", pilot.set_mode("OFFBOARD"))
    pilot.next_heartbeat()
    report.add("offboard.refused-mode", pilot.mode)
    texts = pilot.texts(since_s)
    report.add("offboard.refused-text", "none" if not texts else repr(texts[0][2]))
    hover.here()
    pilot.stream(hover)
    pilot.spend(0.3)
    report.add("offboard.again", pilot.set_mode("OFFBOARD"))


def _cut(pilot: Pilot, report: FactReport, hover: Hover) -> None:
    hover.to_height(-0.3)
    pilot.spend(8.0, lambda: hover.height_m < 0.05)
    pilot.spend(0.5)
    hover.is_resting = True
    since_s = pilot.now_s
    pilot.spend(8.0, lambda: pilot.text("Disarmed by", since_s) is not None)
    text = pilot.text("Disarmed by", since_s)
    report.add("offboard.cut-disarm", text[0] - since_s if text else math.nan)
    pilot.next_heartbeat()
    pilot.stream(None)


def _forced(pilot: Pilot, report: FactReport) -> None:
    hover = airborne(pilot, 0.6)
    pilot.interval("SERVO_OUTPUT_RAW", 50.0)
    since_s = pilot.now_s
    report.add("offboard.forced", pilot.command(ARM, 0.0, 21196.0))
    text = pilot.text("Disarmed by", since_s)
    report.add("offboard.forced-text", repr(text[2]) if text else "none")
    report.add("offboard.forced-servo", str(pilot.newest("SERVO_OUTPUT_RAW").servo1_raw))
    hover.is_resting = True
    pilot.interval("SERVO_OUTPUT_RAW", 0.0)
    pilot.next_heartbeat()


PHASE = Phase("OFFBOARD", (*START, *KEPT, *END), run)
