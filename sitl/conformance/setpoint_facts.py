"""Facts of unusual setpoints, of other kinds than attitudes, and of sticks during setpoints."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import Hover, airborne, settle
from sitl.conformance.measurements import mean
from sitl.conformance.vehicle_client import (
    ARM,
    ATTITUDE_AND_THRUST,
    FORCE,
    Quaternion,
    Stuck,
    VehicleClient,
    quaternion,
)

_HEIGHT_M = 8.0
_LOWEST_M = 5.5  # lowest height from which a fall does not reach the ground
_BREAKING_HEIGHT_M = 5.0
_STICKS_HEIGHT_M = 3.0
_UNUSUAL_S = 0.6  # time for which an unusual setpoint is sent

# Type masks.
_IGNORE_THRUST = 64
_RATES = 128
_IGNORE_ALL_BUT_POSITION = 0b0000_1001_1111_1000
_IGNORE_ALL_BUT_VELOCITY = 0b0000_1001_1100_0111
_IGNORE_ALL_BUT_TWO_VELOCITIES = 0b0000_1101_1110_0111
_LOCAL_NED = 1
_BODY_NED = 8

_FULL_STICK = 1000.0
_STICKS_HZ = 20.0
_FAST_1_S = 3.0
_SLOW_1_S = 0.5

FACTS = facts("setpoints", "facts")

STICKS = facts("setpoints", "sticks")
# Some versions do not recover from these setpoints, so they come last.
BREAKING = facts("setpoints", "breaking")


def run(client: VehicleClient, report: FactReport) -> None:
    """Send each setpoint for a moment, and let the vehicle come to rest after it."""
    client.greet(as_ground_station=True)
    hover = airborne(client, _HEIGHT_M)
    since_s = client.now_s

    _thrusts(client, report, hover)
    _attitudes(client, report, hover)
    client.next_heartbeat()
    report.add("setpoint.mode-kept", client.mode)
    report.add("setpoint.silent", client.first_text(since_s))

    if report.wants("setpoint.rates*"):
        _rates(client, report, hover)
    if report.wants("setpoint.any-sender"):
        _other_sender(client, report, hover)
    if report.wants("setpoint.position*", "setpoint.velocity"):
        _positions(client, report, hover)
    if report.wants("setpoint.body-velocity-text"):
        _body_velocity(client, report)
    if report.wants("setpoint.steep*"):
        _steep(client, report, hover)


def _thrusts(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    for name, thrust, mask in (
        ("setpoint.nan-thrust", math.nan, ATTITUDE_AND_THRUST),
        ("setpoint.ignored-thrust", hover.thrust, ATTITUDE_AND_THRUST | _IGNORE_THRUST),
        ("setpoint.negative-thrust", -0.5, ATTITUDE_AND_THRUST),
    ):
        if report.wants(name):
            report.add(name, _sinking_m_s(client, hover, level, thrust, mask))

    if report.wants("setpoint.thrust-above-one"):
        client.interval("SERVO_OUTPUT_RAW", 50.0)
        _for_a_moment(client, partial(client.attitude, level, 1.5), _UNUSUAL_S)
        report.add("setpoint.thrust-above-one", float(client.newest("SERVO_OUTPUT_RAW").servo1_raw))
        client.interval("SERVO_OUTPUT_RAW", 0.0)
        _recover(client, hover)


def _attitudes(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    tilted = quaternion(math.radians(10.0), 0.0, hover.yaw_rad)
    w, x, y, z = tilted
    tripled = (3.0 * w, 3.0 * x, 3.0 * y, 3.0 * z)

    if report.wants("setpoint.scaled-quaternion"):
        _for_a_moment(client, partial(client.attitude, tripled, hover.thrust), _UNUSUAL_S)
        report.add("setpoint.scaled-quaternion", math.degrees(client.euler().roll))
        _recover(client, hover)

    if report.wants("setpoint.mask-zero"):
        _for_a_moment(client, partial(client.attitude, tilted, hover.thrust, mask=0), _UNUSUAL_S)
        report.add("setpoint.mask-zero", math.degrees(client.euler().roll))
        echoed = client.newest("ATTITUDE_TARGET").q
        cosine = min(1.0, abs(sum(a * b for a, b in zip(echoed, tilted, strict=True))))
        report.add("setpoint.echo", math.degrees(2.0 * math.acos(cosine)))
        _recover(client, hover)


def _for_a_moment(client: VehicleClient, send: Callable[[], None], duration_s: float) -> None:
    """Send a setpoint again and again for a time, in place of the hold."""
    client.stream(send)
    client.wait(duration_s)


def _recover(client: VehicleClient, hover: Hover) -> None:
    """Return to the hold, and wait until the vehicle rests."""
    hover.hold_here()
    # Keep the height, unless the next fall would reach the ground.
    hover.to_height(min(_HEIGHT_M + 2.0, max(_LOWEST_M, hover.height_m)))
    client.stream(hover)
    settle(client, hover)


def _sinking_m_s(
    client: VehicleClient, hover: Hover, level: Quaternion, thrust: float, mask: int
) -> float:
    """Return the speed with which the vehicle sinks after a moment with an unusual thrust."""
    _for_a_moment(client, partial(client.attitude, level, thrust, mask=mask), _UNUSUAL_S)
    sinking_m_s = float(client.newest("LOCAL_POSITION_NED").vz)
    _recover(client, hover)
    return sinking_m_s


def _rates(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    ignored: Quaternion = (1.0, 0.0, 0.0, 0.0)
    no_rates = (0.0, 0.0, 0.0)
    roll_rates = (math.radians(25.0), 0.0, 0.0)

    client.stream(lambda: client.attitude(ignored, hover.thrust, mask=_RATES, rates=no_rates))
    client.next_heartbeat(2)
    report.add("setpoint.rates-base-mode", str(client.newest("HEARTBEAT").base_mode))
    _recover(client, hover)

    client.stream(lambda: client.attitude(ignored, hover.thrust, mask=_RATES, rates=roll_rates))
    client.wait(0.45)
    attitudes = client.received.of("ATTITUDE", client.now_s - 0.06)
    roll_rate = mean(packet.message.rollspeed for packet in attitudes)
    report.add("setpoint.rates", math.degrees(roll_rate))
    _recover(client, hover)


def _other_sender(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    was_ground_station = client.is_ground_station
    client.is_ground_station = False
    client.heartbeat_duty.act = None
    client.wait(2.2)
    report.add("setpoint.any-sender", client.mode)
    client.greet(as_ground_station=was_ground_station)


def _positions(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    """Send position and velocity setpoints, and report the motion."""
    start = client.newest("LOCAL_POSITION_NED")
    # Switch the hold off, so that the vehicle flies only these setpoints.
    x = start.x + 1.0
    y = start.y
    z = hover.goal[2]
    yaw = hover.yaw_rad

    def target(mask: int, velocity_east: float = 0.0) -> Callable[[], None]:
        return lambda: client.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            target_system=client.system_id,
            target_component=1,
            coordinate_frame=_LOCAL_NED,
            type_mask=mask,
            x=x,
            y=y,
            z=z,
            vy=velocity_east,
            yaw=yaw,
        )

    client.stream(target(_IGNORE_ALL_BUT_POSITION))
    client.wait(4.0)
    report.add("setpoint.position", client.newest("LOCAL_POSITION_NED").x - start.x)
    report.add("setpoint.position-mode", client.mode)
    client.stream(target(_IGNORE_ALL_BUT_VELOCITY, 1.0))
    client.wait(4.0)
    positions = client.received.of("LOCAL_POSITION_NED", client.now_s - 1.0)
    report.add("setpoint.velocity", mean(packet.message.vy for packet in positions))
    _recover(client, hover)


def _body_velocity(client: VehicleClient, report: FactReport) -> None:
    since_s = client.now_s
    client.send(
        "SET_POSITION_TARGET_LOCAL_NED",
        target_system=client.system_id,
        target_component=1,
        coordinate_frame=_BODY_NED,
        type_mask=_IGNORE_ALL_BUT_TWO_VELOCITIES,
        vx=1.0,
    )
    client.wait(0.5)
    report.add("setpoint.body-velocity-text", client.quote("SET_POSITION", since_s))


def _steep(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    for name, tilt_deg in (("setpoint.steep-50", 50.0), ("setpoint.steep-75", 75.0)):
        tilt_rad = math.radians(tilt_deg)
        tilted = quaternion(tilt_rad, 0.0, hover.yaw_rad)
        tilted_back = quaternion(-tilt_rad, 0.0, hover.yaw_rad)

        tilted_s = client.now_s
        _for_a_moment(client, partial(client.attitude, tilted, 0.9), _UNUSUAL_S)
        attitudes = client.received.of("ATTITUDE", tilted_s)
        report.add(name, max(math.degrees(packet.message.roll) for packet in attitudes))

        # the opposite tilt removes the speed
        _for_a_moment(client, partial(client.attitude, tilted_back, 0.9), _UNUSUAL_S)
        _recover(client, hover)

    client.next_heartbeat()
    # texts count from the last, steepest tilt
    report.add("setpoint.steep-text", client.quote("Preflight Fail", tilted_s))
    report.add("setpoint.steep-failsafe-text", client.quote("Failsafe activated", tilted_s))
    report.add("setpoint.steep-mode", client.mode)


def run_sticks(client: VehicleClient, report: FactReport) -> None:
    """Centre the sticks, then move one, first slowly and then fast."""
    client.greet(as_ground_station=True)
    for name, rate_1_s in (("stick.slow", _SLOW_1_S), ("stick.fast", _FAST_1_S)):
        if not report.wants(name):
            continue
        hover = airborne(client, _STICKS_HEIGHT_M)

        # the duty for vision poses is free here, so it sends the sticks
        client.vision_duty.act = _sticks(client, client.now_s + 2.0, rate_1_s)
        client.vision_duty.period_s = 1.0 / _STICKS_HZ
        client.wait(3.2)
        client.next_heartbeat()
        report.add(name, client.mode)

        client.vision_duty.act = None
        client.vision_duty.period_s = 0.02
        if client.mode != "OFFBOARD":
            client.set_mode("OFFBOARD")
            client.next_heartbeat()
        hover.hold_here()
        settle(client, hover)


def _sticks(client: VehicleClient, from_s: float, rate_1_s: float) -> Callable[[], None]:
    """Return a function that sends sticks; from ``from_s`` on the roll stick moves at a rate."""

    def send() -> None:
        moved = min(0.5, max(0.0, rate_1_s * (client.now_s - from_s)))
        client.send(
            "MANUAL_CONTROL", target=client.system_id, x=0, y=round(_FULL_STICK * moved), z=500, r=0
        )

    return send


def _airborne_at_second_attempt(client: VehicleClient) -> Hover:
    """Let the vehicle hover, at the second attempt if the first one fails."""
    try:
        return airborne(client, _BREAKING_HEIGHT_M)
    except Stuck:  # earlier measurements can leave a poor estimate of the position
        return airborne(client, _BREAKING_HEIGHT_M)


def run_breaking(client: VehicleClient, report: FactReport) -> None:
    """Send attitudes that are not rotations, and report whether the vehicle follows afterwards."""
    client.greet(as_ground_station=True)
    for name, part in (("setpoint.zero-quaternion", 0.0), ("setpoint.nan-quaternion", math.nan)):
        if not report.wants(f"{name}*"):
            continue
        try:
            hover = _airborne_at_second_attempt(client)
            client.wait(1.0)
        except Stuck as error:
            report.skip(
                [fact for fact in BREAKING if fact.name.startswith(name)], f"before it: {error}"
            )
            continue

        no_rotation = (part,) * 4
        _for_a_moment(client, partial(client.attitude, no_rotation, hover.thrust), _UNUSUAL_S)
        roll, pitch, _ = client.euler()
        report.add(name, math.degrees(math.hypot(roll, pitch)))
        hover.hold_here()

        follows = True
        # Check two tilts, because a drifting vehicle may reach one of them by chance.
        for sign in (1.0, -1.0):
            tilted = quaternion(sign * math.radians(10.0), 0.0, hover.yaw_rad)
            _for_a_moment(client, partial(client.attitude, tilted, hover.thrust), _UNUSUAL_S)
            roll_deg = sign * math.degrees(client.euler().roll)
            if not 5.0 < roll_deg < 15.0:
                follows = False

        if follows:
            report.add(f"{name}-after", "follows")
            _recover(client, hover)
        else:
            report.add(f"{name}-after", "lost")
            client.command(ARM, 0.0, FORCE)  # the vehicle would fly away otherwise
            client.next_heartbeat()


FACT_GROUP = FactGroup("odd setpoints", FACTS, run)
STICKS_GROUP = FactGroup("sticks", STICKS, run_sticks)
BREAKING_GROUP = FactGroup("setpoints that break", BREAKING, run_breaking)
