"""Frames and rotations: the fleet's ENU with FLU bodies, and PX4's NED with FRD bodies.

Fleet, configuration, bus and control use only ENU/FLU (x forward, y left, z up). NED/FRD appears
only in the link to PX4. Quaternions are Hamilton quaternions, ordered (w, x, y, z) as on MAVLink.
``q_enu_flu`` rotates FLU components into ENU components.
"""

from __future__ import annotations

import math

from onboard.vectors import Vec3

Quaternion = tuple[float, float, float, float]
Triple = tuple[float, float, float]

_SQRT_HALF = math.sqrt(0.5)


def enu_from_ned(vector_ned: Triple) -> Vec3:
    """Return east, north, up from north, east, down, in any unit; this conversion is its own
    inverse.
    """
    north, east, down = vector_ned
    return Vec3(east, north, -down)


def ned_from_enu(vector_enu: Triple) -> Vec3:
    """Return north, east, down from east, north, up, in any unit."""
    east, north, up = vector_enu
    return Vec3(north, east, -up)


def enu_flu_from_ned_frd(q_ned_frd: Quaternion) -> Quaternion:
    """Return PX4's attitude (FRD to NED) as the fleet's (FLU to ENU).

    R_enu_flu = R_enu_ned R_ned_frd R_frd_flu, where R_enu_ned is the half turn about (1, 1, 0), and
    R_frd_flu is the half turn about x.
    """
    w, x, y, z = q_ned_frd
    # the product of the three quaternions, multiplied out
    return (
        _SQRT_HALF * (w + z),
        _SQRT_HALF * (x + y),
        _SQRT_HALF * (x - y),
        _SQRT_HALF * (w - z),
    )


def ned_frd_from_enu_flu(q_enu_flu: Quaternion) -> Quaternion:
    """Return the fleet's attitude (FLU to ENU) as PX4's (FRD to NED).

    The conversion is its own inverse.
    """
    return enu_flu_from_ned_frd(q_enu_flu)


def wrap_rad(angle_rad: float) -> float:
    """Return the angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2.0 * math.pi) - math.pi


def turned_about_up(quaternion: Quaternion, yaw_rad: float) -> Quaternion:
    """Return the attitude after a rotation by ``yaw_rad`` about the outer z axis."""
    # the quaternion of this rotation, (cosine, 0, 0, sine), times that of the attitude
    w, x, y, z = quaternion
    cosine = math.cos(0.5 * yaw_rad)
    sine = math.sin(0.5 * yaw_rad)
    return (
        cosine * w - sine * z,
        cosine * x - sine * y,
        cosine * y + sine * x,
        cosine * z + sine * w,
    )


def turn_about_up_rad(attitude: Quaternion, before: Quaternion) -> float:
    """Return the angle in [-pi, pi) by which an attitude is turned about the outer z axis.

    It is the twist about that axis of the rotation between the two attitudes. Unlike the difference
    of their headings, it is defined at any tilt.
    """
    w, x, y, z = attitude
    before_w, before_x, before_y, before_z = before
    # two components of the product of the attitude and the conjugate of the one before
    twist_w = w * before_w + x * before_x + y * before_y + z * before_z
    twist_z = z * before_w + y * before_x - x * before_y - w * before_z
    return wrap_rad(2.0 * math.atan2(twist_z, twist_w))


def body_up(quaternion: Quaternion) -> Vec3:
    """Return the body's z axis in the outer frame: the direction of thrust for q_enu_flu."""
    w, x, y, z = quaternion
    return Vec3(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))


def yaw_from_quaternion(quaternion: Quaternion) -> float:
    """Return the heading of the body's x axis (ZYX yaw) in (-pi, pi], counterclockwise.

    It is 0 along the outer x axis.
    """
    w, x, y, z = quaternion
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
