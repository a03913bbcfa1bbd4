"""OFFBOARD setpoints as PX4 takes them from MAVLink: no number is refused; odd ones become tame, or
not.
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

LOCAL_NED, BODY_NED = 1, 8
# Frames of SET_POSITION_TARGET_GLOBAL_INT: altitude above the sea, and above home.
ABOVE_SEA, ABOVE_HOME = frozenset({0, 5}), frozenset({3, 6})
_IGNORE_ROLL_RATE, _IGNORE_PITCH_RATE, _IGNORE_YAW_RATE = 1, 2, 4
_IGNORE_THRUST, _IGNORE_ATTITUDE = 64, 128
_IGNORE_YAW, _IGNORE_TURN, _IS_FORCE = 1024, 2048, 512
# MC_ROLLRATE_MAX and MC_PITCHRATE_MAX 220 deg/s, MC_YAWRATE_MAX 200
_MOST_RATE_RAD_S = (3.84, 3.84, 3.49)
_SHORT = 1e-6
_HUGE = 1e6


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
    """SET_ATTITUDE_TARGET; None for what PX4 does not count: neither attitude nor rates, in some
    versions no thrust.

    Args:
        attitude_wxyz, rate_rad_s, thrust_frac, type_mask: the message.
        now_s: present time. yaw_rad: present heading, where an attitude without length points.
        version: of PX4.
    """
    if type_mask & _IGNORE_THRUST and not version.counts_ignored_thrust:
        return None
    thrust = (
        0.0
        if type_mask & _IGNORE_THRUST or math.isnan(thrust_frac)
        else min(1.0, max(0.0, thrust_frac))
    )
    if type_mask & _IGNORE_ATTITUDE:
        if type_mask & _IGNORE_ROLL_RATE and type_mask & _IGNORE_PITCH_RATE:
            return None
        ignored = (_IGNORE_ROLL_RATE, _IGNORE_PITCH_RATE, _IGNORE_YAW_RATE)
        rate = np.array(
            [
                0.0
                if type_mask & bit or math.isnan(commanded)
                else min(most, max(-most, commanded))
                for commanded, bit, most in zip(rate_rad_s, ignored, _MOST_RATE_RAD_S, strict=True)
            ]
        )
        return Setpoint(SetpointKind.RATE, now_s, None, rate, thrust)
    norm = (
        math.sqrt(sum(c * c for c in attitude_wxyz))
        if all(abs(c) < _HUGE for c in attitude_wxyz)
        else math.nan
    )
    if math.isnan(norm):
        return Setpoint(SetpointKind.RATE, now_s, None, DRIFT_RAD_S, thrust, is_rotation=False)
    if norm < _SHORT:
        level = frames.yaw_quaternion(np.asarray(yaw_rad))
        return Setpoint(SetpointKind.ATTITUDE, now_s, level, None, thrust, is_rotation=False)
    attitude = np.array([c / norm for c in attitude_wxyz])
    return Setpoint(SetpointKind.ATTITUDE, now_s, attitude, None, thrust)


def from_local(fields: Mapping[str, Any], *, now_s: float, yaw_rad: float) -> Setpoint | str:
    """SET_POSITION_TARGET_LOCAL_NED in LOCAL_NED or BODY_NED; else the key of what PX4 says about
    it.

    Ignored and NaN axes are left alone. In BODY_NED there are no positions, and velocities turn
    with the heading.
    """
    frame = int(fields["coordinate_frame"])
    if frame not in (LOCAL_NED, BODY_NED):
        return "bad frame"
    mask = int(fields["type_mask"])
    position, velocity, acceleration = (
        _axes(fields, names, mask >> shift)
        for names, shift in (
            (("x", "y", "z"), 0),
            (("vx", "vy", "vz"), 3),
            (("afx", "afy", "afz"), 6),
        )
    )
    if frame == BODY_NED:
        position = np.full(3, math.nan)
        velocity, acceleration = _turned(velocity, yaw_rad), _turned(acceleration, yaw_rad)
    return _setpoint(fields, mask, position, velocity, acceleration, now_s)


def from_global(
    fields: Mapping[str, Any], position_ned_m: tuple[float, float, float], *, now_s: float
) -> Setpoint | str:
    """SET_POSITION_TARGET_GLOBAL_INT, its place already turned into the local frame by the caller."""
    mask = int(fields["type_mask"])
    local = {"x": position_ned_m[0], "y": position_ned_m[1], "z": position_ned_m[2]}
    position = _axes(local, ("x", "y", "z"), mask)
    velocity = _axes(fields, ("vx", "vy", "vz"), mask >> 3)
    return _setpoint(
        fields, mask, position, velocity, _axes(fields, ("afx", "afy", "afz"), mask >> 6), now_s
    )


def _axes(fields: Mapping[str, Any], names: tuple[str, str, str], mask: int) -> Array:
    # Numbers that no vehicle can mean are taken for none, before they overflow anything.
    values = [fields[name] if not mask >> bit & 1 else math.nan for bit, name in enumerate(names)]
    return np.array([value if abs(value) < _HUGE else math.nan for value in values])


def _turned(vector: Array, yaw_rad: float) -> Array:
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def _setpoint(
    fields: Mapping[str, Any],
    mask: int,
    position: Array,
    velocity: Array,
    acceleration: Array,
    now_s: float,
) -> Setpoint | str:
    has_acceleration = bool(np.isfinite(acceleration).any())
    if not (has_acceleration or np.isfinite(position).any() or np.isfinite(velocity).any()):
        return "empty setpoint"
    if has_acceleration and mask & _IS_FORCE:
        return "empty setpoint"
    yaw, turn = (
        math.nan if mask & bit or not abs(fields[name]) < _HUGE else float(fields[name])
        for bit, name in ((_IGNORE_YAW, "yaw"), (_IGNORE_TURN, "yaw_rate"))
    )
    goal = PositionGoal(position, velocity, yaw, acceleration, turn)
    return Setpoint(SetpointKind.POSITION, now_s, goal=goal)
