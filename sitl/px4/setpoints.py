"""Setpoints for OFFBOARD as PX4 reads them from MAVLink messages.

PX4 does not refuse any number. Some unusual numbers are replaced or limited here; for example, a
thrust of NaN becomes 0 and rates are limited. Others act as on a real PX4; for example, an attitude
of NaN makes the vehicle drift.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.px4.position_control import PositionGoal
from sitl.px4.signals import DRIFT_RAD_S, Setpoint, SetpointKind
from sitl.px4.versions import Version

# Frames of SET_POSITION_TARGET_LOCAL_NED.
LOCAL_NED = 1
BODY_NED = 8
# Frames of SET_POSITION_TARGET_GLOBAL_INT: altitude above the sea, and above home.
ABOVE_SEA = frozenset({0, 5})
ABOVE_HOME = frozenset({3, 6})

# Bits of the type mask of SET_ATTITUDE_TARGET.
_IGNORE_ROLL_RATE = 1
_IGNORE_PITCH_RATE = 2
_IGNORE_YAW_RATE = 4
_IGNORE_THRUST = 64
_IGNORE_ATTITUDE = 128

# Bits of the type mask of the two position targets. Bits 0 to 8 ignore the axes of position,
# velocity and acceleration.
_IGNORE_YAW = 1024
_IGNORE_TURN = 2048
_IS_FORCE = 512

# For each body rate, the bit that ignores it and its limit [rad/s].
_RATES: tuple[tuple[int, float], ...] = (
    (_IGNORE_ROLL_RATE, 3.84),  # MC_ROLLRATE_MAX, 220 deg/s
    (_IGNORE_PITCH_RATE, 3.84),  # MC_PITCHRATE_MAX, 220 deg/s
    (_IGNORE_YAW_RATE, 3.49),  # MC_YAWRATE_MAX, 200 deg/s
)
_MIN_NORM = 1e-6  # a shorter quaternion counts as zero
_MAX_VALUE = 1e6  # larger numbers are ignored


def from_attitude(
    attitude_wxyz: list[float],
    rate_rad_s: list[float],
    thrust_frac: float,
    type_mask: int,
    *,
    now_s: float,
    yaw_rad: float,
    version: Version,
) -> Setpoint | None:
    """Return the setpoint of a SET_ATTITUDE_TARGET; None for a message that PX4 ignores.

    PX4 ignores a message with neither attitude nor rates. Some versions ignore one without thrust.

    Args:
        attitude_wxyz: attitude of the message, NED <- FRD.
        rate_rad_s: rates of the message about the axes of the body.
        thrust_frac: thrust of the message.
        type_mask: type mask of the message.
        now_s: present time.
        yaw_rad: present heading, for an attitude without length.
        version: version of PX4.
    """
    ignores_thrust = bool(type_mask & _IGNORE_THRUST)
    if ignores_thrust and not version.counts_ignored_thrust:
        return None
    if ignores_thrust or math.isnan(thrust_frac):
        thrust_frac = 0.0
    thrust_frac = min(1.0, max(0.0, thrust_frac))

    if type_mask & _IGNORE_ATTITUDE:
        if type_mask & _IGNORE_ROLL_RATE and type_mask & _IGNORE_PITCH_RATE:
            return None
        limited_rad_s = _limited_rates(rate_rad_s, type_mask)
        return Setpoint(
            kind=SetpointKind.RATE, time_s=now_s, rate_rad_s=limited_rad_s, thrust_frac=thrust_frac
        )

    norm = math.nan
    if all(abs(part) < _MAX_VALUE for part in attitude_wxyz):
        norm = math.sqrt(sum(part * part for part in attitude_wxyz))

    if math.isnan(norm):
        return Setpoint(
            kind=SetpointKind.RATE,
            time_s=now_s,
            rate_rad_s=DRIFT_RAD_S,
            thrust_frac=thrust_frac,
            is_rotation=False,
        )
    if norm < _MIN_NORM:
        return Setpoint(
            kind=SetpointKind.ATTITUDE,
            time_s=now_s,
            attitude=frames.yaw_quaternion(np.asarray(yaw_rad)),
            thrust_frac=thrust_frac,
            is_rotation=False,
        )
    return Setpoint(
        kind=SetpointKind.ATTITUDE,
        time_s=now_s,
        attitude=np.array([part / norm for part in attitude_wxyz]),
        thrust_frac=thrust_frac,
    )


def _limited_rates(rate_rad_s: list[float], type_mask: int) -> Array:
    """Return body rates (3,) within their limits; 0 where one is ignored or NaN."""
    limited_rad_s: list[float] = []
    for requested_rad_s, (ignore_bit, limit_rad_s) in zip(rate_rad_s, _RATES, strict=True):
        if type_mask & ignore_bit or math.isnan(requested_rad_s):
            limited_rad_s.append(0.0)
        else:
            limited_rad_s.append(min(limit_rad_s, max(-limit_rad_s, requested_rad_s)))
    return np.array(limited_rad_s)


def from_local(fields: Mapping[str, Any], *, now_s: float, yaw_rad: float) -> Setpoint | str:
    """Return the setpoint of a SET_POSITION_TARGET_LOCAL_NED, or the key of PX4's refusal.

    The setpoint does not control ignored and NaN axes. In BODY_NED positions are ignored, as are a
    velocity and an acceleration of which an axis is ignored; the others turn with the heading.
    """
    frame = int(fields["coordinate_frame"])
    if frame not in (LOCAL_NED, BODY_NED):
        return "bad frame"

    mask = int(fields["type_mask"])
    position = _axes(fields, ("x", "y", "z"), mask)
    velocity = _axes(fields, ("vx", "vy", "vz"), mask >> 3)
    acceleration = _axes(fields, ("afx", "afy", "afz"), mask >> 6)

    if frame == BODY_NED:
        position = np.full(3, math.nan)
        velocity = _turned(velocity, mask >> 3, yaw_rad)
        acceleration = _turned(acceleration, mask >> 6, yaw_rad)
    return _setpoint(fields, mask, position, velocity, acceleration, now_s)


def from_global(
    fields: Mapping[str, Any], position_ned_m: tuple[float, float, float], *, now_s: float
) -> Setpoint | str:
    """Return the setpoint of a SET_POSITION_TARGET_GLOBAL_INT, or the key of PX4's refusal.

    Args:
        fields: fields of the message.
        position_ned_m: position of the setpoint, which the caller has converted to the local frame.
        now_s: present time.
    """
    mask = int(fields["type_mask"])
    north_m, east_m, down_m = position_ned_m
    position = _axes({"x": north_m, "y": east_m, "z": down_m}, ("x", "y", "z"), mask)
    velocity = _axes(fields, ("vx", "vy", "vz"), mask >> 3)
    acceleration = _axes(fields, ("afx", "afy", "afz"), mask >> 6)
    return _setpoint(fields, mask, position, velocity, acceleration, now_s)


def _axes(fields: Mapping[str, Any], names: tuple[str, str, str], mask: int) -> Array:
    """Return one quantity (3,); NaN on the axes that the lowest three bits of the mask ignore."""
    values: list[float] = []
    for bit, name in enumerate(names):
        is_ignored = bool(mask >> bit & 1)
        # Too large numbers are ignored before they overflow.
        is_usable = abs(fields[name]) < _MAX_VALUE
        if is_ignored or not is_usable:
            values.append(math.nan)
        else:
            values.append(fields[name])
    return np.array(values)


def _turned(vector: Array, mask: int, yaw_rad: float) -> Array:
    """Return a vector (3,) of the body's frame, turned by the heading to NED.

    It is NaN if one of the lowest three bits of the mask ignores an axis.
    """
    if mask & 0b111:
        return np.full(3, math.nan)
    c = math.cos(yaw_rad)
    s = math.sin(yaw_rad)
    ahead, right, down = vector
    return np.array([c * ahead - s * right, s * ahead + c * right, down])


def _setpoint(
    fields: Mapping[str, Any],
    mask: int,
    position: Array,
    velocity: Array,
    acceleration: Array,
    now_s: float,
) -> Setpoint | str:
    """Return the setpoint of a position target, or the key of PX4's refusal."""
    has_position = bool(np.isfinite(position).any())
    has_velocity = bool(np.isfinite(velocity).any())
    has_acceleration = bool(np.isfinite(acceleration).any())
    if not has_position and not has_velocity and not has_acceleration:
        return "empty setpoint"
    if has_acceleration and mask & _IS_FORCE:  # PX4 does not accept forces
        return "empty setpoint"

    goal = PositionGoal(
        position_ned_m=position,
        velocity_ned_m_s=velocity,
        yaw_rad=_angle(fields, "yaw", bool(mask & _IGNORE_YAW)),
        acceleration_ned_m_s2=acceleration,
        yaw_rate_rad_s=_angle(fields, "yaw_rate", bool(mask & _IGNORE_TURN)),
    )
    return Setpoint(kind=SetpointKind.POSITION, time_s=now_s, goal=goal)


def _angle(fields: Mapping[str, Any], name: str, is_ignored: bool) -> float:
    """Return a heading or its rate; NaN when it is ignored, NaN or too large."""
    if is_ignored or not abs(fields[name]) < _MAX_VALUE:
        return math.nan
    return float(fields[name])
