"""Made-up logs of PX4: a vehicle that tilts as some smooth random signal says."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np

from onboard.arrays import Array
from onboard.bus.schema import TickSample
from sitl.px4.flight_log import (
    ATTITUDE,
    ATTITUDE_SETPOINT,
    BATTERY,
    LOCAL_POSITION,
    STATUS,
    LogWriter,
)
from tests.groundstation.report.made_up import BEGIN_NS, rows, write


def tilts_rad(time_s: Array, seed: int = 1) -> Array:
    """Roll and pitch (n, 2) of a flight that never repeats itself."""
    rng = np.random.default_rng(seed)
    total = np.zeros((time_s.size, 2))
    for _ in range(12):
        rate_rad_s, amplitude = rng.uniform(0.4, 4.0), rng.uniform(0.005, 0.03, 2)
        phase_rad = rng.uniform(0.0, 2.0 * math.pi, 2)
        total += amplitude * np.sin(rate_rad_s * time_s[:, None] + phase_rad)
    return total


def quaternions(time_s: Array, seed: int = 1, *, yaw_rad: float = 0.0) -> Array:
    """Attitudes (n, 4) NED <- FRD with those tilts and a heading."""
    half_roll, half_pitch = (tilts_rad(time_s, seed) / 2.0).T
    half_yaw = yaw_rad / 2.0
    cr, sr, cp, sp = np.cos(half_roll), np.sin(half_roll), np.cos(half_pitch), np.sin(half_pitch)
    cy, sy = math.cos(half_yaw), math.sin(half_yaw)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=-1,
    )


def enu_of_ned(quaternion_ned_frd: Array) -> Array:
    """The same attitudes as ENU <- FLU."""
    w, x, y, z = quaternion_ned_frd.T
    # FLU from FRD turns by half a turn about x; ENU from NED by half a turn about (1, 1, 0)
    half = math.sqrt(0.5)
    return np.stack([half * (w + z), half * (x + y), half * (x - y), half * (w - z)], axis=-1)


def log_bytes(
    *,
    length_s: float = 30.0,
    start_s: float = 100.0,
    shift_s: float = 0.0,
    seed: int = 1,
    yaw_rad: float = 0.3,
    rate_hz: float = 50.0,
    drift_frac: float = 0.0,
) -> bytes:
    """A log; at its time start_s + t the vehicle tilts as the signal says at shift_s + t.

    PX4's clock runs faster than that by the drift.
    """
    writer = LogWriter(round(start_s * 1e6), {"ver_sw_release_str": "1.17"}, {"MAV_SYS_ID": 3})
    times_s = np.arange(0.0, length_s, 1.0 / rate_hz)
    attitudes = quaternions(times_s + shift_s, seed, yaw_rad=yaw_rad)
    for step, (time_s, attitude) in enumerate(zip(times_s, attitudes, strict=True)):
        stamp_us = round((start_s + time_s * (1.0 + drift_frac)) * 1e6)
        writer.sample(ATTITUDE, stamp_us, *attitude)
        if step % 5 == 0:
            writer.sample(ATTITUDE_SETPOINT, stamp_us, *attitude, 0.0, 0.0, -0.5)
            place = (7.0 + 0.1 * time_s, -3.0, -1.0)
            writer.sample(LOCAL_POSITION, stamp_us, *place, 0.1, 0.0, 0.0, 0.0, True, True)
        if step % 50 == 0:
            writer.sample(BATTERY, stamp_us, 16.0 - 0.01 * time_s, 0.9 - 0.001 * time_s, 4, True)
            writer.sample(STATUS, stamp_us, 2, 14 if time_s > 5.0 else 4, False)
    writer.text(round((start_s + 3.0) * 1e6), 6, "Armed by external command\t")
    writer.text(round((start_s + 9.5) * 1e6), 4, "\x1b[33mBattery <b>low</b>\x1b[0m")
    return bytes(writer.content)


def write_log(
    path: Path,
    *,
    length_s: float = 30.0,
    start_s: float = 100.0,
    shift_s: float = 0.0,
    seed: int = 1,
    drift_frac: float = 0.0,
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = log_bytes(
        length_s=length_s, start_s=start_s, shift_s=shift_s, seed=seed, drift_frac=drift_frac
    )
    path.write_bytes(data)
    return path


def write_flight_with_logs(
    folder: Path, *, length_s: float, log_s: float, start_s: float, drift_frac: float = 0.0
) -> Path:
    """Two vehicles that tilt differently; their logs begin 3 s after the record."""
    told = []
    for at_ns, topic, name, message in rows(length_s=length_s):
        if isinstance(message, TickSample):
            time_s = np.array([(at_ns - BEGIN_NS) * 1e-9])
            attitude = enu_of_ned(quaternions(time_s, seed_of(name), yaw_rad=0.1))[0]
            message = msgspec.structs.replace(
                message, attitude_quaternion_enu_flu_wxyz=tuple(attitude.tolist())
            )
        told.append((at_ns, topic, name, message))
    write(folder, told)
    for name in ("mav0", "mav1"):
        path = folder / "px4" / f"{name}-2026-11-26_05_21_29.ulg"
        write_log(
            path,
            shift_s=3.0,
            seed=seed_of(name),
            length_s=log_s,
            start_s=start_s,
            drift_frac=drift_frac,
        )
    return folder


def seed_of(name: str) -> int:
    """The signal by which a vehicle tilts."""
    return 1 + int(name[-1])
