"""Facts of external positions on the ground: fusion, ignored messages, and their loss.

Positions are sent by a duty of the client: a function that the client calls periodically while it
waits.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import Hover, grounded
from sitl.conformance.measurements import NOT_MEASURED, count_or_none, mean
from sitl.conformance.vehicle_client import ARM, VehicleClient

_PARAMETERS = {
    "EKF2_EV_CTRL": 15.0,
    "EKF2_GPS_CTRL": 0.0,
    "EKF2_HGT_REF": 3.0,
    "EKF2_MAG_TYPE": 5.0,
}
_POSITION_NED_M = (1.0, -0.5, -0.2)
_JUMP_M = 0.8
_SETTLE_S = 4.0
_NO_GPS_S = 7.0  # PX4's position stays valid for up to 5 s after the loss of satellites
_TURN_RAD = math.radians(40.0)
_ORIGIN_M = 100.0  # altitude of the origin in the fact vision.origin-height
_FLAG_HORIZONTAL_SOURCE = 0x100  # in ESTIMATOR_STATUS.flags
_LATITUDE_1E7 = 473977420
_LONGITUDE_1E7 = 85455940
FUSED = facts("vision", "fused")
LOST = facts("vision", "lost")


def run(client: VehicleClient, report: FactReport) -> None:
    """Switch satellites off, send positions by three messages, then stop."""
    client.greet(as_ground_station=True)
    grounded(client)
    client.interval("ESTIMATOR_STATUS", 5.0)
    for name, value in _PARAMETERS.items():
        client.params.set(name, value)
    _set_origin(client, 0.0)  # it replaces the origin set by satellites

    if report.wants("vision.before-*"):
        client.wait(_NO_GPS_S)
        report.add("vision.before-streams", _streams(client))
        report.add("vision.before-arming", client.command(ARM, 1.0))
        client.command(ARM, 0.0)
    if report.wants(*(fact.name for fact in FUSED)):
        _fused(client, report)
    if report.wants(*(fact.name for fact in LOST)):
        _lost(client, report)
    client.vision_duty.act = None
    client.interval("ESTIMATOR_STATUS", 0.0)


def _streams(client: VehicleClient) -> str:
    """Return "streams" if LOCAL_POSITION_NED is still sent, otherwise "stops"."""
    if client.received.of("LOCAL_POSITION_NED", client.now_s - 0.5):
        return "streams"
    return "stops"


def _fused(client: VehicleClient, report: FactReport) -> None:
    """Report the facts of positions that PX4 fuses."""
    since_s = client.now_s
    position = list(_POSITION_NED_M)  # the duty sends these values, also when they change below
    client.vision_duty.act = _vision(client, position)
    client.wait(_SETTLE_S)
    report.add("vision.estimate", _error_m(client, position))
    report.add("vision.flags", float(client.newest("ESTIMATOR_STATUS").flags))

    if report.wants("vision.jump"):
        position[0] += _JUMP_M
        client.wait(2.0)
        report.add("vision.jump", _error_m(client, position, axes="xy"))

    if report.wants("vision.height-jump"):
        position[2] -= _JUMP_M
        client.wait(8.0)
        report.add("vision.height-jump", _error_m(client, position))

    if report.wants("vision.odometry"):
        position[1] += 0.3
        client.vision_duty.act = _odometry(client, position)
        client.wait(_SETTLE_S)
        report.add("vision.odometry", _error_m(client, position))

    if report.wants("vision.origin-height"):
        _set_origin(client, _ORIGIN_M)
        client.wait(_SETTLE_S)
        report.add("vision.origin-height", _error_m(client, position))
        _set_origin(client, 0.0)
        client.wait(_SETTLE_S)

    if report.wants("vision.heading-ratio", "vision.turned-ratio"):
        client.vision_duty.act = _vision(client, position)
        client.wait(_SETTLE_S)
        report.add("vision.heading-ratio", float(client.newest("ESTIMATOR_STATUS").mag_ratio))
        client.vision_duty.act = _vision(client, position, turned_rad=_TURN_RAD)
        client.wait(1.0)
        report.add("vision.turned-ratio", float(client.newest("ESTIMATOR_STATUS").mag_ratio))

    ack_count = len(client.received.of("COMMAND_ACK", since_s))
    report.add("vision.silent", count_or_none(ack_count, "acknowledgements"))


def _lost(client: VehicleClient, report: FactReport) -> None:
    """Stop the external positions, and report what PX4 still sends and accepts."""
    if client.vision_duty.act is None:
        client.vision_duty.act = _vision(client, list(_POSITION_NED_M))
        client.wait(_SETTLE_S)

    # PX4 does not fuse ATT_POS_MOCAP, so the position is lost even while this message is sent.
    client.vision_duty.act = None
    if report.wants("vision.mocap-ignored"):
        client.vision_duty.act = _mocap(client, list(_POSITION_NED_M))
    since_s = client.now_s
    client.wait(8.0)
    report.add("vision.lost-streams", _streams(client))

    flags = _flags_in_turn(client, since_s)
    report.add("vision.lost-flags", " ".join(flags))
    report.add("vision.lost-after", _noticed_after_s(client, since_s))
    final_flags = "none"
    if flags:
        final_flags = flags[-1]
    report.add("vision.mocap-ignored", final_flags)

    client.vision_duty.act = None
    report.add("vision.lost-arming", client.command(ARM, 1.0))
    if report.wants("vision.offboard-*"):
        _arm_in_offboard(client, report)


def _flags_in_turn(client: VehicleClient, since_s: float) -> list[str]:
    """Return the flags of ESTIMATOR_STATUS since a time, once for each change."""
    flags: list[str] = []
    for packet in client.received.of("ESTIMATOR_STATUS", since_s):
        text = hex(packet.message.flags)
        has_changed = not flags or flags[-1] != text
        if has_changed:
            flags.append(text)
    return flags


def _noticed_after_s(client: VehicleClient, since_s: float) -> float:
    """Return the time from the loss of vision until PX4's flags show no horizontal source."""
    for packet in client.received.of("ESTIMATOR_STATUS", since_s):
        if not packet.message.flags & _FLAG_HORIZONTAL_SOURCE:
            return packet.at_s - since_s
    return math.inf


def _arm_in_offboard(client: VehicleClient, report: FactReport) -> None:
    """Report whether the vehicle can be armed in OFFBOARD without a position."""
    hover = Hover(client)
    client.stream(hover)
    client.wait(0.3)
    client.set_mode("OFFBOARD")
    client.wait(0.6)
    report.add("vision.offboard-prearm", client.prearm_bit)
    report.add("vision.offboard-arming", client.command(ARM, 1.0))

    client.command(ARM, 0.0)
    client.next_heartbeat()
    client.stream(None)


def _error_m(client: VehicleClient, position: list[float], axes: str = "xyz") -> float:
    """Return the distance of the mean estimate of the last second from a position [m]."""
    packets = client.received.of("LOCAL_POSITION_NED", client.now_s - 1.0)
    if not packets:
        return NOT_MEASURED

    estimate: list[float] = []
    for axis in axes:
        estimate.append(mean(getattr(packet.message, axis) for packet in packets))
    return math.dist(estimate, position[: len(axes)])


def _set_origin(client: VehicleClient, altitude_m: float) -> None:
    """Set the global origin of the local frame."""
    client.send(
        "SET_GPS_GLOBAL_ORIGIN",
        target_system=client.system_id,
        latitude=_LATITUDE_1E7,
        longitude=_LONGITUDE_1E7,
        altitude=round(altitude_m * 1e3),
        time_usec=_usec(client),
    )


def _usec(client: VehicleClient) -> int:
    """Return the present time [us]."""
    return round(client.now_s * 1e6)


def _xyz(position: list[float]) -> dict[str, float]:
    return dict(zip("xyz", position, strict=True))


# Each of these functions returns a function for the duty, which sends the values of `position`.


def _vision(
    client: VehicleClient, position: list[float], *, turned_rad: float = 0.0
) -> Callable[[], None]:
    yaw = client.euler().yaw + turned_rad
    return lambda: client.send(
        "VISION_POSITION_ESTIMATE",
        usec=_usec(client),
        **_xyz(position),
        yaw=yaw,
    )


def _mocap(client: VehicleClient, position: list[float]) -> Callable[[], None]:
    return lambda: client.send(
        "ATT_POS_MOCAP", time_usec=_usec(client), q=[1.0, 0.0, 0.0, 0.0], **_xyz(position)
    )


def _odometry(client: VehicleClient, position: list[float]) -> Callable[[], None]:
    yaw = client.euler().yaw
    unknown = dict.fromkeys(("vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed"), math.nan)
    return lambda: client.send(
        "ODOMETRY",
        time_usec=_usec(client),
        frame_id=1,  # MAV_FRAME_LOCAL_NED
        child_frame_id=12,  # MAV_FRAME_BODY_FRD
        **_xyz(position),
        q=[math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)],
        **unknown,
        pose_covariance=[math.nan] * 21,
        velocity_covariance=[math.nan] * 21,
        estimator_type=2,  # MAV_ESTIMATOR_TYPE_VISION
        quality=100,
    )


FACT_GROUP = FactGroup("external position", (*FUSED, *LOST), run)
