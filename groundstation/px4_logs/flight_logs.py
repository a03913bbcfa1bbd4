"""Reads the PX4 logs in a flight folder and puts each on the clock of the flight's record.

``covey log fetch`` puts the logs into ``DIR/px4`` as ``VEHICLE-DATE_TIME.ulg``. Each vehicle gets
its newest log whose attitude fits the record. A vehicle without such a log gets a note with the
reasons. PX4's positions are in a frame of its own. They are shifted by their median difference from
the record's positions. So the shapes of the two paths can be compared, but not their places.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from groundstation.px4_logs.alignment import (
    Alignment,
    NoAlignment,
    align,
    flu_of_frd,
    up_in_body,
)
from groundstation.px4_logs.log_age import age_key
from groundstation.px4_logs.px4_log import LoggedText, LogRows, Px4Log, read_log
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.recorded_flight import Flight, VehicleFlight, between_times
from onboard.arrays import Array
from onboard.config.fleet import ConfigError
from onboard.frames import enu_from_ned
from onboard.plain_text import plain_line

FOLDER = "px4"  # folder of the logs, in a flight folder
SUFFIX = ".ulg"
_MAX_TRIED = 8  # most logs tried for one vehicle
_MAX_FILES = 2_000
_GAP_S = 1.0  # positions are not interpolated between samples that are farther apart


class FlightLog(NamedTuple):
    """One vehicle's PX4 log on the record's clock."""

    vehicle: str
    log: Px4Log  # its times are seconds since PX4's start
    alignment: Alignment
    # record's position minus log's (3,); NaN if the positions cannot be compared
    shift_enu_m: Array
    # standard deviation of the positions' difference after the shift; NaN in the same case
    position_residual_m: float

    @property
    def begin_s(self) -> float:
        """Begin of the log on the record's clock."""
        return self.on_record_s(self.log.begin_s)

    @property
    def end_s(self) -> float:
        """End of the log on the record's clock."""
        return self.on_record_s(self.log.end_s)

    def on_record_s(self, time_s: float) -> float:
        """Return a time of the log on the record's clock."""
        return float(self.alignment.on_record(np.array(time_s)))

    def on_record(self, rows: LogRows) -> LogRows:
        """Return samples of the log with their times on the record's clock."""
        return rows._replace(time_s=self.alignment.on_record(rows.time_s))

    @property
    def texts(self) -> list[LoggedText]:
        """PX4's messages on the record's clock."""
        return [text._replace(time_s=self.on_record_s(text.time_s)) for text in self.log.texts]

    @property
    def position_enu_m(self) -> LogRows:
        """PX4's position in the fleet's frame, on the record's clock."""
        return self._in_fleet(self.log.position)

    @property
    def position_setpoint_enu_m(self) -> LogRows:
        """PX4's position setpoint in the fleet's frame, on the record's clock."""
        return self._in_fleet(self.log.position_setpoint)

    def _in_fleet(self, rows: LogRows) -> LogRows:
        """Return positions of PX4 in the fleet's frame, on the record's clock."""
        on_record = self.on_record(rows)
        return on_record._replace(values=enu_of_ned(on_record.values) + self.shift_enu_m)


class FoundLogs(NamedTuple):
    """Logs of a flight folder."""

    logs: dict[str, FlightLog]  # by vehicle
    notes: tuple[str, ...]  # sentences about logs that are left out


def enu_of_ned(values: Array) -> Array:
    """Return positions NED (n, 3 or more) as ENU (n, 3)."""
    rows_enu_m = [enu_from_ned(row) for row in values[:, :3].tolist()]
    return np.array(rows_enu_m, dtype=np.float64).reshape(-1, 3)


def logs_of_flight(folder: Path, flight: Flight) -> FoundLogs:
    """Read the logs of a flight folder.

    Args:
        folder: the flight folder, or the MCAP file in it.
        flight: the flight's record, already read.
    """
    if not folder.is_dir():
        folder = folder.parent

    logs: dict[str, FlightLog] = {}
    notes: list[str] = []
    files = _files(folder / FOLDER, list(flight.vehicles))
    for name in flight.vehicles:
        reasons = []
        for path in files.get(name, [])[:_MAX_TRIED]:
            try:
                logs[name] = _aligned(flight.vehicles[name], read_log(path))
                break
            except (ConfigError, NoAlignment) as reason:
                reasons.append(f"{plain_line(path.name)} is left out. {reason}")
        if name not in logs:
            notes += reasons
    return FoundLogs(logs, tuple(notes))


def logs_of_folder(folder: Path) -> FoundLogs:
    """Read the logs of a flight folder; its record is read only if there are logs.

    Raises:
        ConfigError: there is no record.
    """
    flight_folder = folder
    if not folder.is_dir():
        flight_folder = folder.parent
    log_folder = flight_folder / FOLDER
    has_logs = log_folder.is_dir() and any(log_folder.glob(f"*{SUFFIX}"))
    if not has_logs:
        return FoundLogs({}, ())
    return logs_of_flight(folder, read_flight(folder))


def _files(folder: Path, vehicles: list[str]) -> dict[str, list[Path]]:
    """Return the log files of each vehicle, the newest first."""
    files: dict[str, list[Path]] = {}
    if not folder.is_dir():
        return files
    for path in sorted(folder.iterdir(), reverse=True)[:_MAX_FILES]:
        if path.suffix != SUFFIX:
            continue
        # One vehicle's name may begin with another's: mav1, mav1-b.
        owners = [name for name in vehicles if path.name.startswith(f"{name}-")]
        if owners:
            files.setdefault(max(owners, key=len), []).append(path)

    return {name: _newest_first(name, paths) for name, paths in files.items()}


def _newest_first(vehicle: str, paths: list[Path]) -> list[Path]:
    """Return log files of a vehicle, whose names begin with its own, the newest first."""
    start = len(f"{vehicle}-")
    return sorted(paths, key=lambda path: age_key(path.name[start:]), reverse=True)


def _aligned(vehicle: VehicleFlight, log: Px4Log) -> FlightLog:
    """Put a log on the record's clock.

    Raises:
        NoAlignment: it does not fit.
    """
    record_time_s, quaternion = _attitude(vehicle)
    alignment = align(
        record_time_s,
        up_in_body(quaternion),
        log.attitude.time_s,
        up_in_body(flu_of_frd(log.attitude.values)),
    )

    shift_enu_m = np.full(3, np.nan)
    residual_m = float("nan")
    if log.position.size > 1:
        path_time_s, path_enu_m = vehicle.path
        log_time_s = alignment.on_record(log.position.time_s)
        log_enu_m = between_times(log_time_s, enu_of_ned(log.position.values), path_time_s, _GAP_S)
        difference_m = path_enu_m - log_enu_m
        difference_m = difference_m[np.isfinite(difference_m).all(-1)]
        if difference_m.shape[0] > 1:
            shift_enu_m = np.median(difference_m, axis=0)
            residual_m = float(np.sqrt(((difference_m - shift_enu_m) ** 2).sum(-1).mean()))
    return FlightLog(
        vehicle=vehicle.name,
        log=log,
        alignment=alignment,
        shift_enu_m=shift_enu_m,
        position_residual_m=residual_m,
    )


def _attitude(vehicle: VehicleFlight) -> tuple[Array, Array]:
    """Return times and attitudes of a vehicle in the record.

    They are those of PX4's telemetry, or else the true ones of a simulation. A tick contains the
    attitude that had arrived last, and its age.

    Raises:
        NoAlignment: the record has no attitude of this vehicle.
    """
    ticks = vehicle.ticks
    time_s = ticks.time_s - np.nan_to_num(ticks.attitude_age_s)
    values = ticks.attitude_quaternion_enu_flu_wxyz
    if np.isfinite(values).all(-1).sum() < 2:
        time_s = vehicle.truth.time_s
        values = vehicle.truth.quaternion_enu_flu_wxyz
    is_known = np.isfinite(values).all(-1)
    time_s, values = time_s[is_known], values[is_known]

    if time_s.size < 2:
        raise NoAlignment("The record has no attitude of this vehicle.")
    # several ticks may contain the same attitude: only samples later than all before are kept
    latest_before_s = np.concatenate(([-np.inf], np.maximum.accumulate(time_s)[:-1]))
    is_later = time_s > latest_before_s
    return time_s[is_later], values[is_later]
