"""Values of the messages of one vehicle: estimate and sensors, in PX4's frames.

Each value is computed at most once in a step of the physics, for all messages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sitl.emulator.emulator import Emulator
from sitl.physics import frames
from sitl.physics.earth import EarthPoint, degrees_at, metres_from
from sitl.physics.random_streams import Stream
from sitl.px4.commander import EmulatedPx4
from sitl.px4.satellite_receiver import ACCURACIES_M

# Half of the standard deviations of roll, pitch and yaw, for the noise of a quaternion.
HALF_NOISE_RAD = tuple(0.5 * math.radians(std_deg) for std_deg in (0.06, 0.06, 0.11))
_GYRO_NOISE_RAD_S = math.radians(0.33)
# Noise of the accelerometer of PX4's simulator per sample, in flight and on the ground.
_ACCEL_NOISE_M_S2 = (0.5, 1.7, 1.4)
_ACCEL_NOISE_RESTING_M_S2 = 0.05
_GRAVITY_M_S2 = 9.80665
_NOISE_BLOCK = 4096  # random numbers drawn in one batch

Vector = tuple[float, float, float]
Quaternion = frames.Quaternion


class Sensed(NamedTuple):
    """Values of one vehicle at one step of the physics, in its local frame."""

    attitude: Quaternion  # estimated, wxyz, with a sample of noise
    rates_rad_s: Vector  # measured body rates
    position_ned_m: Vector  # estimated
    velocity_ned_m_s: Vector  # estimated


class View:
    """Values in the streams of one vehicle.

    Sensor noise has a separate generator of random numbers, so that requested streams do not change
    the flight of the vehicle.

    Args:
        emulator: emulator with the vehicle.
        index: index of the vehicle.
        seed: seed of the sensor noise.
    """

    def __init__(self, emulator: Emulator, index: int, *, seed: int = 0) -> None:
        self.emulator = emulator
        self.index = index
        self.system_id = emulator.specs[index].system_id
        self.ground_altitude_m = emulator.origin.altitude_m  # ground at the start
        self.start_on_earth = emulator.start_on_earth(index)
        self._rng = np.random.default_rng([seed, Stream.VIEW, index])
        self._noise: list[float] = []
        self._clock_step = -1  # step of the physics at which the clock was read
        self._clock_s = 0.0
        self._sensed_step = -1  # step of the physics at which the values were computed
        self._sensed: Sensed | None = None

    @property
    def autopilot(self) -> EmulatedPx4:
        """The vehicle's PX4; a restart replaces this object."""
        return self.emulator.autopilots[self.index]

    @property
    def now_s(self) -> float:
        """Time of the autopilot's clock: simulated time, unless a fault disturbs the clock."""
        step = self.emulator.world.vehicles.steps
        if step != self._clock_step:
            self._clock_step = step
            self._clock_s = self.emulator.clock_s(self.index)
        return self._clock_s

    @property
    def time_s(self) -> float:
        """Time since the start of the autopilot, by its clock."""
        return self.now_s - self.autopilot.boot_time_s

    @property
    def boot_ms(self) -> int:
        """Value of the field time_boot_ms."""
        return round(self.time_s * 1e3) & 0xFFFFFFFF

    @property
    def boot_us(self) -> int:
        """Value of the field time_usec of messages that count from boot."""
        return round(self.time_s * 1e6)

    @property
    def unix_s(self) -> float:
        """The date, as seconds since 1970."""
        return self.emulator.unix_start_s + self.emulator.time_s

    @property
    def home_ned_m(self) -> Vector:
        """Position of home, set at the last arming or by a command; zeros before."""
        north, east, down = self.autopilot.mode_control.home_ned_m.tolist()
        return north, east, down

    @property
    def home_altitude_m(self) -> float:
        """Altitude of home above the sea."""
        return self.origin_altitude_m - float(self.autopilot.mode_control.home_ned_m[2])

    @property
    def sensed(self) -> Sensed:
        """Values of the present step."""
        step = self.emulator.world.vehicles.steps
        if self._sensed is None or step != self._sensed_step:
            self._sensed_step = step
            self._sensed = self._sense()
        return self._sensed

    @property
    def yaw_rad(self) -> float:
        """Estimated heading, without noise."""
        return self.emulator.believed_yaw_rad(self.index)

    @property
    def local_origin(self) -> EarthPoint:
        """Latitude and longitude of the local frame's origin, with the altitude of the ground."""
        return self.emulator.local_origins[self.index]

    @property
    def origin_deg(self) -> tuple[float, float]:
        """Latitude and longitude of the local frame's origin."""
        return self.local_origin.latitude_deg, self.local_origin.longitude_deg

    @property
    def global_position(self) -> Vector:
        """Latitude [deg], longitude [deg], altitude [m] of the estimate."""
        return self.to_global(self.sensed.position_ned_m)

    @property
    def true_height_m(self) -> float:
        """True height above the ground below."""
        return self.emulator.world.vehicles.height_m(self.index)

    @property
    def true_altitude_m(self) -> float:
        """True altitude above the sea."""
        _, _, start_up_m = self.emulator.specs[self.index].start_enu_m
        down_m = float(self.emulator.world.vehicles.states.position_ned_m[self.index, 2])
        return self.ground_altitude_m - (down_m + start_up_m)

    def to_global(self, position_ned_m: Vector) -> Vector:
        """Return latitude [deg], longitude [deg], altitude [m] of a position in the local frame."""
        north, east, down = position_ned_m
        latitude_deg, longitude_deg = degrees_at(self.local_origin, north, east)
        return latitude_deg, longitude_deg, self.origin_altitude_m - down

    def to_local(self, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Vector:
        """Return a global position in the local frame, NED [m]."""
        north, east = metres_from(self.local_origin, latitude_deg, longitude_deg)
        return north, east, self.origin_altitude_m - altitude_m

    @property
    def has_fix(self) -> bool:
        """Whether satellites give a position."""
        return self.emulator.estimator.sees_satellites(self.index, self.emulator.time_s)

    @property
    def fix_type(self) -> int:
        """Value of GPS_RAW_INT.fix_type."""
        return self.emulator.fix_type(self.index)

    @property
    def fix_accuracy_mm(self) -> int:
        """Value of GPS_RAW_INT.h_acc."""
        return round(1000.0 * ACCURACIES_M[self.fix_type])

    @property
    def has_origin(self) -> bool:
        """Whether PX4 knows the global origin of its local frame, from satellites or a message."""
        return self.has_fix or self.emulator.has_global_origin[self.index]

    @property
    def origin_altitude_m(self) -> float:
        """Altitude of the local frame's origin above the sea."""
        altitude_m = self.emulator.estimator.origin_altitude_m(self.index)
        if altitude_m is None:
            return self.ground_altitude_m
        return altitude_m

    @property
    def reset_counter(self) -> int:
        """Number of jumps of the estimate, modulo 256."""
        return self.emulator.estimator.reset_counter(self.index)

    def accelerometer(self) -> Vector:
        """Draw one sample of the specific force in the body frame [m/s^2]."""
        states = self.emulator.world.vehicles.states
        noise_x = self._draw()
        noise_y = self._draw()
        noise_z = self._draw()

        if states.on_ground[self.index]:
            std = _ACCEL_NOISE_RESTING_M_S2
            return std * noise_x, std * noise_y, std * noise_z - _GRAVITY_M_S2

        lift_m_s2 = _GRAVITY_M_S2 * float(states.thrust_frac[self.index])
        lift_m_s2 /= self.emulator.specs[self.index].profile.hover_thrust_frac
        std_x, std_y, std_z = _ACCEL_NOISE_M_S2
        return std_x * noise_x, std_y * noise_y, std_z * noise_z - lift_m_s2

    def _sense(self) -> Sensed:
        """Return the values of the present step, with a sample of noise."""
        states = self.emulator.world.vehicles.states
        estimator = self.emulator.estimator
        index = self.index

        half_noise_rad = [half_rad * self._draw() for half_rad in HALF_NOISE_RAD]
        attitude = measured_attitude(
            states.attitude[index].tolist(),
            float(estimator.yaw_error_rad[index]),
            half_noise_rad,
            estimator.tilt_error_rad[index].tolist(),
        )

        roll_rate, pitch_rate = states.tilt_rate_rad_s[index].tolist()
        yaw_rate = float(states.yaw_rate_rad_s[index])
        rates_rad_s = (
            roll_rate + _GYRO_NOISE_RAD_S * self._draw(),
            pitch_rate + _GYRO_NOISE_RAD_S * self._draw(),
            yaw_rate + _GYRO_NOISE_RAD_S * self._draw(),
        )

        local = estimator.local(index)
        return Sensed(
            attitude=attitude,
            rates_rad_s=rates_rad_s,
            position_ned_m=local.position_ned_m,
            velocity_ned_m_s=local.velocity_ned_m_s,
        )

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
    """Return the estimated attitude NED <- FRD of an autopilot, with a sample of noise.

    Args:
        attitude: true attitude, wxyz.
        yaw_error_rad: error of the heading, which turns the attitude about the vertical.
        half_noise_rad: half of the noise about the axes of the body, which has to be small.
        tilt_error_rad: error of the level, which turns the attitude about north and east.
    """
    w, x, y, z = attitude
    north_rad, east_rad = tilt_error_rad
    level = frames.tilted((w, x, y, z), -north_rad, -east_rad)
    w, x, y, z = frames.turned(level, yaw_error_rad)

    # Product of the attitude and the quaternion (1, a, b, d) of a small rotation, whose vector part
    # is half of the rotation's angles.
    a, b, d = half_noise_rad
    noisy_w = w - x * a - y * b - z * d
    noisy_x = x + w * a + y * d - z * b
    noisy_y = y + w * b + z * a - x * d
    noisy_z = z + w * d + x * b - y * a

    size = math.sqrt(noisy_w * noisy_w + noisy_x * noisy_x + noisy_y * noisy_y + noisy_z * noisy_z)
    return noisy_w / size, noisy_x / size, noisy_y / size, noisy_z / size
