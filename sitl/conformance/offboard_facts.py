"""Facts of OFFBOARD by attitude setpoints: its start, refused requests, its end on the ground."""

from __future__ import annotations

import math

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import Hover, airborne, fast_streams, grounded, settle
from sitl.conformance.measurements import NOT_MEASURED, count_or_none, mean
from sitl.conformance.vehicle_client import (
    ARM,
    FORCE,
    MAV_RESULT_ACCEPTED,
    NO_TEXT,
    Stuck,
    VehicleClient,
    quaternion,
)

_EARLY_THRUST = 0.6
_HEIGHT_M = 2.5
_TURNING_US = 1500  # shortest pulse of a motor that gives lift
# The early climb is measured around this time after the acknowledgement of arming.
_EARLY_CLIMB_S = 0.44
_EARLY_CLIMB_HALF_WIDTH_S = 0.06
START = facts("offboard", "start")
KEPT = facts("offboard", "kept")
END = facts("offboard", "end")


def run(client: VehicleClient, report: FactReport) -> None:
    """Start OFFBOARD, fly, request refused actions, and land."""
    client.greet(as_ground_station=True)
    grounded(client)
    client.wait(1.0)
    hover = _start(client, report)

    if report.wants("hover.*", "offboard.no-position-target"):
        _hover(client, report)
    if report.wants("quirk.odometry-velocity"):
        _odometry(client, report, hover)
    if report.wants("offboard.two-hertz"):
        _send_at_two_hertz(client, report, hover)
    if report.wants("offboard.disarm-*"):
        _request_disarm_in_air(client, report)
    if report.wants("offboard.hold*", "offboard.refused*", "offboard.again"):
        _hold(client, report, hover)
    if report.wants("offboard.cut-disarm"):
        _land_and_cut_thrust(client, report, hover)
    if report.wants("offboard.forced*"):
        _force_disarm(client, report)


def _request_disarm_in_air(client: VehicleClient, report: FactReport) -> None:
    since_s = client.now_s
    report.add("offboard.disarm-in-air", client.command(ARM, 0.0))
    client.wait(0.3)
    text = client.text("Disarming denied", since_s) or NO_TEXT
    report.add("offboard.disarm-text", repr(text.words))
    report.add("offboard.disarm-severity", str(text.severity))


def _start(client: VehicleClient, report: FactReport) -> Hover:
    """Take off in OFFBOARD by attitude setpoints; return the controller that then hovers."""
    fast_streams(client)
    hover = Hover(client)
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    client.interval("SERVO_OUTPUT_RAW", 250.0)
    client.stream(lambda: client.attitude(level, _EARLY_THRUST))
    client.wait(0.3)

    client.set_mode("OFFBOARD")
    client.next_heartbeat()
    report.add("offboard.streamed-status", client.status)
    report.add("offboard.base-mode", str(client.newest("HEARTBEAT").base_mode))

    armed_s = client.now_s
    client.send_command(ARM, 1.0)
    client.wait(0.7)
    answers = client.received.of("COMMAND_ACK", armed_s)
    if not answers or answers[0].message.result != MAV_RESULT_ACCEPTED:
        client.interval("SERVO_OUTPUT_RAW", 0.0)
        raise Stuck("it did not arm in OFFBOARD")
    acked_s = answers[0].at_s
    client.stream(hover)
    hover.to_height(_HEIGHT_M)

    turning = [
        packet
        for packet in client.received.of("SERVO_OUTPUT_RAW", armed_s)
        if packet.message.servo1_raw > _TURNING_US
    ]
    spool_s = NOT_MEASURED
    if turning:
        spool_s = max(0.0, turning[0].at_s - acked_s)
    report.add("offboard.no-spool", spool_s)

    sinking_m_s = [
        packet.message.vz
        for packet in client.received.of("LOCAL_POSITION_NED", armed_s)
        if abs(packet.at_s - acked_s - _EARLY_CLIMB_S) < _EARLY_CLIMB_HALF_WIDTH_S
    ]
    report.add("offboard.early-climb", -mean(sinking_m_s))

    client.wait(0.5)
    takeoff_s = client.delay_s("Takeoff detected", armed_s) + armed_s
    report.add("offboard.takeoff-text", max(takeoff_s - acked_s, 0.0))

    client.interval("SERVO_OUTPUT_RAW", 0.0)
    client.next_heartbeat()
    report.add("offboard.base-mode-armed", str(client.newest("HEARTBEAT").base_mode))
    settle(client, hover)
    return hover


def _hover(client: VehicleClient, report: FactReport) -> None:
    client.interval("SERVO_OUTPUT_RAW", 50.0)
    since_s = client.now_s
    client.wait(4.0)

    thrusts = [packet.message.thrust for packet in client.received.of("ATTITUDE_TARGET", since_s)]
    pulses_us: list[float] = []
    for packet in client.received.of("SERVO_OUTPUT_RAW", since_s):
        m = packet.message
        pulses_us.append(mean((m.servo1_raw, m.servo2_raw, m.servo3_raw, m.servo4_raw)))
    target_count = len(client.received.of("POSITION_TARGET_LOCAL_NED", since_s + 1.0))

    report.add("hover.thrust", mean(thrusts))
    report.add("hover.servo", mean(pulses_us))
    report.add("offboard.no-position-target", count_or_none(target_count, "in 3 s"))
    client.interval("SERVO_OUTPUT_RAW", 0.0)


def _odometry(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    """Fly at right angles to the heading, and report the frame of the velocity of ODOMETRY."""
    hover.yaw_rad += math.pi / 2
    client.wait(2.5)
    hover.goal[0] += 2.0
    hover.goal[1] += 2.0
    since_s = client.now_s
    client.wait(1.8)

    # Error of the ODOMETRY velocity if it is in NED, and if it is in body axes. The smaller error
    # tells the frame.
    yaw = client.euler().yaw
    from_ned_m_s: list[float] = []
    from_body_m_s: list[float] = []
    positions = client.received.of("LOCAL_POSITION_NED", since_s)
    for packet in client.received.of("ODOMETRY", since_s):
        o = packet.message
        nearest = min(positions, key=lambda position: abs(position.at_s - packet.at_s))
        v = nearest.message
        from_ned_m_s.append(math.hypot(o.vx - v.vx, o.vy - v.vy))

        forward = math.cos(yaw) * v.vx + math.sin(yaw) * v.vy
        right = -math.sin(yaw) * v.vx + math.cos(yaw) * v.vy
        from_body_m_s.append(math.hypot(o.vx - forward, o.vy - right))

    if from_ned_m_s:
        frame = "along the body"
        if mean(from_ned_m_s) < mean(from_body_m_s):
            frame = "NED"
        report.add("quirk.odometry-velocity", frame)

    hover.hold_here()
    settle(client, hover)


def _send_at_two_hertz(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    client.stream(lambda: client.attitude(level, hover.thrust), hz=2.0)
    client.wait(3.0)
    report.add("offboard.two-hertz", client.mode)

    client.stream(hover)
    hover.hold_here()
    client.wait(1.0)


def _hold(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    client.set_mode("AUTO.LOITER")
    client.next_heartbeat(2)
    report.add("offboard.hold-sticks", client.mode)
    report.add("offboard.hold-base-mode", str(client.newest("HEARTBEAT").base_mode))

    client.stream(None)
    client.wait(1.4)
    since_s = client.now_s
    report.add("offboard.refused", client.set_mode("OFFBOARD"))
    client.next_heartbeat()
    report.add("offboard.refused-mode", client.mode)
    report.add("offboard.refused-text", client.first_text(since_s))

    hover.hold_here()
    client.stream(hover)
    client.wait(0.3)
    report.add("offboard.again", client.set_mode("OFFBOARD"))


def _land_and_cut_thrust(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    hover.to_height(-0.3)  # the goal is below the ground
    client.wait(8.0, lambda: hover.height_m < 0.05)
    client.wait(0.5)
    hover.is_resting = True
    since_s = client.now_s
    report.add("offboard.cut-disarm", client.delay_s("Disarmed by", since_s, wait_s=8.0))
    client.next_heartbeat()
    client.stream(None)


def _force_disarm(client: VehicleClient, report: FactReport) -> None:
    hover = airborne(client, 0.6)
    client.interval("SERVO_OUTPUT_RAW", 50.0)
    since_s = client.now_s
    report.add("offboard.forced", client.command(ARM, 0.0, FORCE))
    report.add("offboard.forced-text", client.quote("Disarmed by", since_s))
    report.add("offboard.forced-servo", str(client.newest("SERVO_OUTPUT_RAW").servo1_raw))

    hover.is_resting = True
    client.interval("SERVO_OUTPUT_RAW", 0.0)
    client.next_heartbeat()


FACT_GROUP = FactGroup("OFFBOARD", (*START, *KEPT, *END), run)
