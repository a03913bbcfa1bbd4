"""One vehicle as its messages show it: estimate and sensors, in PX4's frames, computed once per
step and kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sitl.emulator.emulator import Emulator
from sitl.physics import frames
from sitl.px4.commander import EmulatedPx4
from sitl.px4.estimator import HOME_ALTITUDE_M as HOME_ALTITUDE_M

HOME_LATITUDE_DEG, HOME_LONGITUDE_DEG = 47.397742, 8.545594
METRES_PER_DEGREE = 111_319.49
METRES_PER_DEGREE_EAST = METRES_PER_DEGREE * math.cos(math.radians(HOME_LATITUDE_DEG))
# of roll, pitch and yaw
HALF_NOISE_RAD = tuple(0.5 * math.radians(std_deg) for std_deg in (0.06, 0.06, 0.11))
_GYRO_NOISE_RAD_S = math.radians(0.33)
# Accelerometer noise of PX4's simulator per sample, and the little that is left on the ground.
_ACCEL_NOISE_M_S2 = (0.5, 1.7, 1.4)
_ACCEL_NOISE_RESTING_M_S2 = 0.05
_NOISE_BLOCK = 4096

Vector = tuple[float, float, float]
Quaternion = frames.Quaternion


class Sensed(NamedTuple):
    """Values of one vehicle at one step of the physics, in its own frame."""

    attitude: Quaternion  # as the autopilot believes it, wxyz, with a sample of noise
    rates_rad_s: Vector  # measured body rates
    position_ned_m: Vector  # estimated
    velocity_ned_m_s: Vector


class View:
    """Values that the streams of one vehicle carry.

    Sensor noise has a generator of its own, so that who listens, and to what, does not change how
    the vehicle flies.

    Args:
        emulator, index: the vehicle.
        seed: of the sensor noise.
    """

    def __init__(self, emulator: Emulator, index: int, *, seed: int = 0) -> None:
        self.emulator = emulator
        self.index = index
        self.system_id = emulator.specs[index].system_id
        self._rng = np.random.default_rng([seed, 7, index])
        self._noise: list[float] = []
        self._step = self._clock_step = -1
        self._clock_s = 0.0
        self._sensed: Sensed | None = None

    @property
    def autopilot(self) -> EmulatedPx4:
        """The vehicle's PX4; asked for anew each time, since a restart makes a new one."""
        return self.emulator.autopilots[self.index]

    @property
    def now_s(self) -> float:
        """The autopilot's clock: simulated time, unless a fault lets it drift."""
        step = self.emulator.world.vehicles.steps
        if step != self._clock_step:
            self._clock_step, self._clock_s = step, self.emulator.clock_s(self.index)
        return self._clock_s

    @property
    def time_s(self) -> float:
        """Time since this autopilot started, by its own clock."""
        return self.now_s - self.autopilot.boot_time_s

    @property
    def boot_ms(self) -> int:
        """time_boot_ms."""
        return round(self.time_s * 1e3) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        """time_usec of messages that count from boot."""
        return round(self.time_s * 1e6)

    @property
    def unix_s(self) -> float:
        """The date, as seconds since 1970."""
        return self.emulator.unix_start_s + self.emulator.time_s

    @property
    def home_ned_m(self) -> Vector:
        """Position at the last arming, or the present one before the first."""
        north, east, down = self.autopilot.mode_control.home_ned_m.tolist()
        return north, east, down

    @property
    def home_altitude_m(self) -> float:
        """Altitude of that place."""
        return HOME_ALTITUDE_M - float(self.autopilot.mode_control.home_ned_m[2])

    @property
    def sensed(self) -> Sensed:
        """Values of the present step, the same for all who ask within it."""
        step = self.emulator.world.vehicles.steps
        if self._sensed is None or step != self._step:
            self._step, self._sensed = step, self._sense()
        return self._sensed

    @property
    def yaw_rad(self) -> float:
        """Estimated heading, without noise."""
        return self.emulator.believed_yaw_rad(self.index)

    @property
    def origin_deg(self) -> tuple[float, float]:
        """Latitude and longitude of the local frame's origin."""
        east, north, _ = self.emulator.specs[self.index].start_enu_m
        return (
            HOME_LATITUDE_DEG + north / METRES_PER_DEGREE,
            HOME_LONGITUDE_DEG + east / METRES_PER_DEGREE_EAST,
        )

    @property
    def global_position(self) -> Vector:
        """Latitude [deg], longitude [deg], altitude [m] of the estimate."""
        return self.to_global(self.sensed.position_ned_m)

    def to_global(self, position_ned_m: Vector) -> Vector:
        """Latitude [deg], longitude [deg], altitude [m] of a place in the local frame."""
        latitude, longitude = self.origin_deg
        north, east, down = position_ned_m
        return (
            latitude + north / METRES_PER_DEGREE,
            longitude + east / METRES_PER_DEGREE_EAST,
            HOME_ALTITUDE_M - down,
        )

    def to_local(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Vector:
        """The inverse of :meth:`to_global`."""
        latitude, longitude = self.origin_deg
        return (
            (latitude_deg - latitude) * METRES_PER_DEGREE,
            (longitude_deg - longitude) * METRES_PER_DEGREE_EAST,
            HOME_ALTITUDE_M - altitude_m,
        )

    @property
    def has_fix(self) -> bool:
        """Whether satellites are seen."""
        return self.emulator.estimator.sees_satellites(self.index, self.emulator.time_s)

    @property
    def has_origin(self) -> bool:
        """Whether PX4 knows where on earth its local frame is: from satellites, or because somebody
        said so.
        """
        return self.has_fix or self.emulator.has_global_origin[self.index]

    @property
    def origin_altitude_m(self) -> float:
        """Of the local frame's origin above the sea."""
        known = self.emulator.estimator.origin_altitude_m[self.index]
        return HOME_ALTITUDE_M if known is None else known

    @property
    def reset_counter(self) -> int:
        """Number of jumps of the estimate, modulo 256; PX4's filter has jumped a dozen times before
        it rests.
        """
        return self.emulator.estimator.reset_counter(self.index)

    def accelerometer(self) -> Vector:
        """One sample of the specific force in the body frame [m/s^2]."""
        states = self.emulator.world.vehicles.states
        a, b, c = self._draw(), self._draw(), self._draw()
        if states.on_ground[self.index]:
            s = _ACCEL_NOISE_RESTING_M_S2
            return s * a, s * b, s * c - 9.80665
        lift = 9.80665 * float(states.thrust_frac[self.index])
        lift /= self.emulator.specs[self.index].profile.hover_thrust_frac
        x, y, z = _ACCEL_NOISE_M_S2
        return x * a, y * b, z * c - lift

    def _sense(self) -> Sensed:
        i, states = self.index, self.emulator.world.vehicles.states
        yaw_error_rad = float(self.emulator.estimator.yaw_error_rad[i])
        noise = [half_rad * self._draw() for half_rad in HALF_NOISE_RAD]
        tilt_error_rad = self.emulator.estimator.tilt_error_rad[i].tolist()
        attitude = measured_attitude(
            states.attitude[i].tolist(), yaw_error_rad, noise, tilt_error_rad
        )
        p, q = states.tilt_rate_rad_s[i].tolist()
        r = float(states.yaw_rate_rad_s[i])
        std = _GYRO_NOISE_RAD_S
        rates = (p + std * self._draw(), q + std * self._draw(), r + std * self._draw())
        local = self.emulator.estimator.local(i)
        return Sensed(attitude, rates, local.position_ned_m, local.velocity_ned_m_s)

    def _draw(self) -> float:
        if not self._noise:
            self._noise = self._rng.standard_normal(_NOISE_BLOCK).tolist()
        return self._noise.pop()


def measured_attitude(
    attitude: list[float],
    yaw_error_rad: float,
    half_noise_rad: list[float],
    tilt_error_rad: Sequence[float] = (0.0, 0.0),
) -> Quaternion:
    """Return the attitude NED <- FRD that an autopilot believes in, with a sample of noise.

    The compass's error turns it about the vertical, the filter's about north and east; the noise is
    small enough for a linear turn.
    """
    w, x, y, z = attitude
    w, x, y, z = frames.turned(
        frames.tilted((w, x, y, z), -tilt_error_rad[0], -tilt_error_rad[1]), yaw_error_rad
    )
    a, b, d = half_noise_rad
    w, x, y, z = (
        w - x * a - y * b - z * d,
        x + w * a + y * d - z * b,
        y + w * b + z * a - x * d,
        z + w * d + x * b - y * a,
    )
    size = math.sqrt(w * w + x * x + y * y + z * z)
    return w / size, x / size, y / size, z / size
