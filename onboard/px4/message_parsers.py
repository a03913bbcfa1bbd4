"""Parsers of PX4's messages. They convert the fields of a message to fields of a snapshot.

A parser takes the fields of a message and its arrival [ns]. It returns the fields of
:class:`onboard.autopilot.Snapshot` that the message changes. The dictionary is empty if the
message's numbers cannot be used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from onboard.autopilot import Landed
from onboard.frames import enu_flu_from_ned_frd
from onboard.px4 import modes

# AUTOPILOT_VERSION.uid of a PX4 that was built for simulation and has system id 1; the next system
# id has the next uid. The number comes from the letters SIMULATIONID0000: BOARD_OVERRIDE_UUID of
# PX4's board px4_sitl.
_SIMULATION_UID = 0x4954414C44494E4F
_MAX_SYSTEM_IDS = 255
_FIX_3D = 3  # GPS_FIX_TYPE of a three-dimensional fix; larger values are better fixes
_SATELLITES_UNKNOWN = 255
_NO_CELL_MV = 65535  # marks an absent cell
# Bits of ESTIMATOR_STATUS_FLAGS. PX4 leaves the first set for EKF2_NOAID_TOUT (5 s) after its last
# source is lost; it clears the second as soon as it stops to use that source.
_HORIZONTAL_POSITION = 0x08  # the position relative to the start of the local frame is known
_HORIZONTAL_SOURCE = 0x100  # at least one source corrects the horizontal position or velocity
_POSITION_KNOWN = _HORIZONTAL_POSITION | _HORIZONTAL_SOURCE


def _attitude(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    ned_frd_wxyz = (fields["q1"], fields["q2"], fields["q3"], fields["q4"])
    enu_flu_wxyz = enu_flu_from_ned_frd(ned_frd_wxyz)
    if not math.isfinite(sum(enu_flu_wxyz)):
        return {}
    return {
        "quaternion_enu_flu_wxyz": enu_flu_wxyz,
        "attitude_ns": arrival_ns,
        "px4_boot_ms": int(fields["time_boot_ms"]),
    }


def _local_position(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    position = (fields["x"], fields["y"], fields["z"])
    velocity = (fields["vx"], fields["vy"], fields["vz"])
    for value in (*position, *velocity):
        if not (isinstance(value, float) and math.isfinite(value)):
            return {}
    return {
        "position_local_ned_m": position,
        "velocity_local_ned_m_s": velocity,
        "local_position_ns": arrival_ns,
    }


def _estimator_status(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    return {
        "is_position_known": fields["flags"] & _POSITION_KNOWN == _POSITION_KNOWN,
        "position_ratio": fields["pos_horiz_ratio"],
        "heading_ratio": fields["mag_ratio"],  # of the heading by a camera, too
        "position_accuracy_m": _accuracy_m(fields["pos_horiz_accuracy"]),
        "height_accuracy_m": _accuracy_m(fields["pos_vert_accuracy"]),
        "position_accuracy_ns": arrival_ns,
    }


def _accuracy_m(value: object) -> float:
    """Return a standard deviation; infinite for an impossible value."""
    if isinstance(value, float) and math.isfinite(value) and value >= 0.0:
        return value
    return math.inf


def _satellites(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    fix_type = int(fields["fix_type"])
    satellites = int(fields["satellites_visible"])
    if satellites == _SATELLITES_UNKNOWN:
        satellites = -1
    return {
        "has_fix": fix_type >= _FIX_3D,
        "fix_ns": arrival_ns,
        "fix_type": fix_type,
        "satellites": satellites,
        "fix_accuracy_m": int(fields["h_acc"]) * 1e-3,
    }


def _global_origin(fields: dict[str, Any], _: int) -> dict[str, Any]:
    return {
        "global_origin": (
            fields["latitude"] * 1e-7,
            fields["longitude"] * 1e-7,
            fields["altitude"] * 1e-3,
        )
    }


def _heartbeat(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    return {
        "heartbeat_ns": arrival_ns,
        "is_armed": bool(int(fields["base_mode"]) & modes.BASE_MODE_ARMED),
        "mode": modes.mode_name(int(fields["custom_mode"])),
        "is_failsafe": int(fields["system_status"]) in modes.FAILSAFE_STATUSES,
    }


def _sticks(_: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    return {"sticks_ns": arrival_ns}


def _extended_state(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    return {"landed": Landed(int(fields["landed_state"])), "landed_ns": arrival_ns}


def _battery(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    remaining_percent = int(fields["battery_remaining"])
    remaining_frac = math.nan
    if remaining_percent >= 0:  # -1: PX4 does not know it
        remaining_frac = remaining_percent / 100.0

    voltage_mv = sum(cell_mv for cell_mv in fields["voltages"] if cell_mv < _NO_CELL_MV)
    return {
        "battery_frac": remaining_frac,
        "battery_voltage_v": voltage_mv / 1000.0,
        "battery_ns": arrival_ns,
    }


def _status_text(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    text = fields["text"]
    if isinstance(text, bytes):
        written, _, _ = text.partition(b"\0")
        text = written.decode("ascii", "replace")
    return {"status_text": text.strip(), "status_text_ns": arrival_ns}


def _sys_status(fields: dict[str, Any], arrival_ns: int) -> dict[str, Any]:
    return {
        "sensors_enabled": int(fields["onboard_control_sensors_enabled"]),
        "sensors_healthy": int(fields["onboard_control_sensors_health"]),
        "sensors_ns": arrival_ns,
    }


def _version(fields: dict[str, Any], _: int) -> dict[str, Any]:
    # four bytes, most significant first: major, minor, patch, kind of release; 0: not known
    number = int(fields["flight_sw_version"])
    version: tuple[int, int] | None = None
    if number != 0:
        major = number >> 24 & 0xFF
        minor = number >> 16 & 0xFF
        version = (major, minor)

    system_index = int(fields["uid"]) - _SIMULATION_UID
    return {
        "px4_version": version,
        "is_simulated": 0 <= system_index < _MAX_SYSTEM_IDS,
    }


PARSERS: dict[str, Callable[[dict[str, Any], int], dict[str, Any]]] = {
    "HEARTBEAT": _heartbeat,
    "ATTITUDE_QUATERNION": _attitude,
    "LOCAL_POSITION_NED": _local_position,
    "ESTIMATOR_STATUS": _estimator_status,
    "MANUAL_CONTROL": _sticks,
    "EXTENDED_SYS_STATE": _extended_state,
    "GPS_RAW_INT": _satellites,
    "GPS_GLOBAL_ORIGIN": _global_origin,
    "AUTOPILOT_VERSION": _version,
    "BATTERY_STATUS": _battery,
    "STATUSTEXT": _status_text,
    "SYS_STATUS": _sys_status,
}
