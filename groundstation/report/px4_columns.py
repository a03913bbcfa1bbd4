"""Packs PX4's own log for a report: its curves on the report's times, its modes and messages.

Angles have PX4's signs: roll to the right, pitch with the nose up, heading clockwise from north
[deg]. Positions are in the fleet's frame, shifted by their median difference from the record's.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.px4_logs.flight_logs import FlightLog, FoundLogs
from groundstation.px4_logs.log_summary import modes
from groundstation.px4_logs.px4_log import LogRows
from groundstation.recording.recorded_flight import VehicleFlight, at_times
from groundstation.report.columns import Column, packed
from onboard.arrays import Array
from onboard.plain_text import plain_line

MAX_TEXTS = 1_000  # most messages, and most mode changes, of one vehicle
_ANGLE_DEG = 0.02
_METRE = 0.001
_VOLT = 0.005
_FRACTION = 0.0005
_ATTITUDE_GAP_S = 0.5
_SLOW_GAP_S = 3.0
_ANGLES = ("roll", "pitch", "heading")


def px4_columns(
    number: int, vehicle: VehicleFlight, found: FlightLog, grid_s: Array
) -> Iterator[Column]:
    """Yield the curves of one vehicle's log, and the record's attitude in the same angles.

    Args:
        number: the vehicle's number in the report.
        vehicle: the vehicle's part of the record.
        found: the vehicle's log.
        grid_s: times of the report.
    """
    log = found.log
    for prefix, rows in (("px4_", log.attitude), ("px4_setpoint_", log.attitude_setpoint)):
        angles_deg = _angles_of_ned_deg(found.on_record(rows), grid_s)
        yield from _columns(number, prefix, _ANGLES, angles_deg, _ANGLE_DEG)
    if vehicle.ticks.size:
        ticks = vehicle.ticks
        recorded = LogRows(ticks.time_s, ticks.attitude_quaternion_enu_flu_wxyz)
        angles_deg = _angles_of_enu_deg(recorded, grid_s)
        yield from _columns(number, "own_", _ANGLES, angles_deg, _ANGLE_DEG)

    for prefix, rows in (
        ("px4_", found.position_enu_m),
        ("px4_setpoint_", found.position_setpoint_enu_m),
    ):
        positions_enu_m = _shown(rows, grid_s, _ATTITUDE_GAP_S)
        yield from _columns(number, prefix, ("x", "y", "z"), positions_enu_m, _METRE)

    battery = _shown(found.on_record(log.battery), grid_s, _SLOW_GAP_S)
    yield packed(f"{number}/px4_voltage", battery[:, 0], _VOLT)
    yield packed(f"{number}/px4_battery", battery[:, 1], _FRACTION)


def px4_header(found: FoundLogs, names: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return the header's entry for each vehicle that has a log: everything but the curves.

    Args:
        found: the logs of the flight.
        names: the vehicles' names, in the order of their numbers.
    """
    return [
        {
            "vehicle": names.index(name),
            "file": plain_line(Path(flight_log.log.path).name),
            "from_s": round(flight_log.begin_s, 3),
            "to_s": round(flight_log.end_s, 3),
            "residual_deg": round(flight_log.alignment.residual_deg, 3),
            "place_m": _finite(flight_log.position_residual_m),
            "about": [[key, value] for key, value in flight_log.log.about.items()],
            "modes": [
                [round(flight_log.on_record_s(time_s), 2), mode]
                for time_s, mode in modes(flight_log.log.status)[:MAX_TEXTS]
            ],
            "texts": [
                [round(text.time_s, 3), plain_line(text.level), text.text]
                for text in flight_log.texts[:MAX_TEXTS]
            ],
        }
        for name, flight_log in found.logs.items()
    ]


def _finite(value: float) -> float | None:
    """Return a value rounded for JSON; None if it is not finite."""
    if not np.isfinite(value):
        return None
    return round(value, 3)


def _columns(
    number: int, prefix: str, names: tuple[str, ...], values: Array, resolution: float
) -> Iterator[Column]:
    for column, name in enumerate(names):
        yield packed(f"{number}/{prefix}{name}", values[:, column], resolution)


def _shown(rows: LogRows, grid_s: Array, gap_s: float) -> Array:
    """Return the samples at the report's times; NaN in gaps."""
    if not rows.size:
        return np.full((grid_s.size, rows.values.shape[-1]), np.nan)
    return at_times(rows.time_s, rows.values, grid_s, gap_s)


def _angles_of_ned_deg(rows: LogRows, grid_s: Array) -> Array:
    """Return roll, pitch and heading (n, 3) of quaternions NED <- FRD."""
    w, x, y, z = _shown(rows, grid_s, _ATTITUDE_GAP_S).T
    roll_rad = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch_rad = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    heading_rad = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    angles_deg: Array = np.degrees(np.stack([roll_rad, pitch_rad, heading_rad], axis=-1))
    angles_deg[:, 2] %= 360.0
    return angles_deg


def _angles_of_enu_deg(rows: LogRows, grid_s: Array) -> Array:
    """Return roll, pitch and heading (n, 3) of quaternions ENU <- FLU.

    The formulas for NED <- FRD give the pitch with the nose down, and the turn from east to north.
    """
    angles_deg = _angles_of_ned_deg(rows, grid_s)
    roll_deg, nose_down_deg, from_east_deg = angles_deg.T
    return np.stack([roll_deg, -nose_down_deg, (90.0 - from_east_deg) % 360.0], axis=-1)
