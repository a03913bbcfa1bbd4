"""Evaluates PX4's SYS_STATUS: unhealthy sensors, and whether PX4 hears a radio control."""

from __future__ import annotations

from onboard.autopilot import Snapshot

_RC_RECEIVER = 0x10000

# Each row: bit of MAV_SYS_STATUS_SENSOR, name, whether a flight with poses (of a mocap or a camera)
# requires the sensor, whether a flight by satellites requires it. None: the sensor is not even
# reported. The prearm bit is left out, because PX4 keeps it low in HOLD without satellites, but
# still arms when setpoints arrive.
_SENSORS: tuple[tuple[int, str, bool | None, bool], ...] = (
    (0x1, "gyroscope", True, True),
    (0x2, "accelerometer", True, True),
    (0x4, "magnetometer", False, True),
    (0x8, "barometer", False, True),
    (0x20, "satellites", None, True),
    (0x40, "optical flow", False, False),
    (0x80, "vision position", False, False),
    (0x400, "rate control", True, True),
    (0x800, "attitude control", True, True),
    (0x8000, "motors", True, True),
    (_RC_RECEIVER, "radio control", False, False),
    (0x200000, "attitude estimate", True, True),
    (0x1000000, "log", False, False),
    (0x2000000, "battery", True, True),
)


def unhealthy(snapshot: Snapshot, by_satellites: bool) -> tuple[tuple[str, bool], ...]:
    """Return the sensors that are enabled and not healthy.

    Args:
        snapshot: newest snapshot of PX4.
        by_satellites: whether the vehicle flies by satellites.
    Returns:
        Each sensor's name, and whether this flight requires the sensor.
    """
    if snapshot.sensors_ns == 0:
        return ()

    unhealthy_bits = snapshot.sensors_enabled & ~snapshot.sensors_healthy
    reported: list[tuple[str, bool]] = []
    for bit, name, with_poses, with_satellites in _SENSORS:
        is_required = with_satellites if by_satellites else with_poses
        if unhealthy_bits & bit and is_required is not None:
            reported.append((name, is_required))
    return tuple(reported)


def sensors(snapshot: Snapshot) -> tuple[tuple[str, bool], ...]:
    """Return the name of each sensor that is enabled, and whether it is healthy."""
    return tuple(
        (name, bool(snapshot.sensors_healthy & bit))
        for bit, name, _, _ in _SENSORS
        if snapshot.sensors_enabled & bit
    )


def has_rc(snapshot: Snapshot) -> bool | None:
    """Whether PX4 hears a radio control; None before the first SYS_STATUS."""
    if snapshot.sensors_ns == 0:
        return None
    return bool(snapshot.sensors_enabled & snapshot.sensors_healthy & _RC_RECEIVER)
