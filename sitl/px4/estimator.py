"""The autopilot's estimate of its state: the true state with errors like those of PX4's EKF.

Each vehicle has its own local origin. Position and velocity carry the slow errors of
`estimator_errors.py`, whose size depends on the source: satellites, external vision or nothing.

* With satellites, vision only corrects the estimate slightly.
* Without satellites the estimate follows vision, right or wrong. It follows a horizontal jump after
  refusing it for 1 s, and a jump in height after refusing it for 5 s. Each jump of the estimate
  counts up PX4's reset counters.
* Without any source the estimate drifts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics.earth import ZURICH
from sitl.physics.frames import Array
from sitl.physics.jit import records
from sitl.physics.random_streams import Stream
from sitl.physics.step import STEP_S
from sitl.px4 import estimator_errors
from sitl.px4.estimator_errors import (
    RECKONING,
    RESTING,
    RESTING_WITH_VISION,
    ErrorLevel,
    Source,
)
from sitl.px4.satellite_receiver import RTK_FIXED, RTK_FLOAT
from sitl.px4.vehicle_estimate import GPS_ACCURACY_M, SensorSettings, VehicleEstimate

ESTIMATE_EVERY_STEPS = 2  # 125 Hz, the rate of PX4's estimator
PERIOD_S = ESTIMATE_EVERY_STEPS * STEP_S
_BLOCK = 64  # random numbers are drawn for this many periods at a time
_SELECT_EVERY = 4  # number of periods between two selections of the sources: 31 Hz
_HISTORY = 64  # number of periods whose positions are stored for delayed vision

GPS_FIX_S = 2.3  # time from the start until satellites give a position
_VISION_TIMEOUT_S = 0.45  # time without vision after which PX4 no longer counts on it
_VISION_GAP_S = 0.1  # time without vision after which the estimate drifts

# Fusion of vision.
_FUSE_GAIN = 0.2
_GATE_SIGMAS = 5.0  # a difference beyond this multiple of EKF2_EVP_NOISE is a jump
_SMALLEST_GATE_M = 0.2
# how long a heading that differs by too much is refused, without a gap before it
_HEADING_REFUSAL_S = 5.0
# How long a jump is refused. Sideways measured on PX4 v1.16 and v1.18 (SIH).
_SIDEWAYS_REFUSAL_S = 1.0
_HEIGHT_REFUSAL_S = 5.0

# Dead reckoning, measured on a PX4 v1.16 that lost vision in flight. Pairs are the limits of a
# uniform draw.
_DRIFT_M = (0.9, 2.0)  # displacement after 3.5 s
_TILT_ERROR_DEG = (0.7, 3.5)  # error of the attitude after that time
_TILT_POWER = 1.5  # exponent on the draw of that error, which makes small errors more frequent
_HEIGHT_ERROR_M = (-0.20, 0.30)  # error that the height reaches soon, positive upwards
# This acceleration, damped, moves the estimate one metre in 3.5 s.
_DRIFT_ACCELERATION_1_S2 = 0.214
# On the ground the estimate keeps drifting at the same speed until PX4 detects that the vehicle is
# at rest.
_REST_DETECTION_S = 4.0

_START_HEIGHT_M = (-0.2, 0.2)  # limits of the estimated height before the first flight
# Limits of the mean error of the compass, and of the standard deviation of its changes.
_COMPASS_MEAN_DEG = (2.0, 17.0)
_COMPASS_STD_DEG = (2.0, 7.0)
_POSITION_RATIO = 0.1  # ESTIMATOR_STATUS.pos_horiz_ratio by satellites
_LARGEST_RATIO = 2.0  # of pos_horiz_ratio, measured
_RATIO_FALL_S = 1.1  # time constant with which it falls, measured
_COMPASS_RATIO = 0.1  # ESTIMATOR_STATUS.mag_ratio with a heading by the compass
_YAW_KEEP = math.exp(-PERIOD_S / estimator_errors.YAW_CORRELATION_S)

# Reset counters in PX4's order.
XY, VXY, Z, VZ, HEADING = range(5)
# Counters of PX4's filter before its first position. The first position brings the sum to 13.
_RESETS_AT_START = (2, 2, 2, 2, 1)

# The horizontal error in ESTIMATOR_STATUS with corrections, not measured.
GPS_ACCURACIES_M = {RTK_FLOAT: 0.2, RTK_FIXED: 0.1}
# Error level of the estimate by the type of the fix.
GPS_LEVELS = {RTK_FLOAT: estimator_errors.RTK_FLOAT, RTK_FIXED: estimator_errors.RTK_FIXED}
# With vision: a share of EKF2_EVP_NOISE, and at least this, as measured.
_VISION_ACCURACY_SHARE = 0.4
_LEAST_VISION_ACCURACY_M = 0.006
# That error without a source, measured on PX4 v1.18 (SIH) that lost its satellites in flight: 0.37,
# 0.53, 0.74, 1.0, 1.3 m one to five seconds after the loss; then 5 m and more. The growth is fitted
# by a parabola.
_ACCURACY_M_S = 0.185
_ACCURACY_M_S2 = 0.012
_ACCURACY_KNOWN_S = 5.7  # time after the loss for which the parabola holds
_ACCURACY_LOST_M = 4.8

# ESTIMATOR_STATUS.flags. The value with vision was measured. With satellites PX4 adds the flags of
# an absolute position.
_FLAGS = {Source.VISION: 0x1EF, Source.GPS: 0x3FF}
_FLAGS_RECKONING = 0xEF
_FLAGS_LOST = 0xE5
_RECKONING_S = 5.0  # time after the loss of the last source for which _FLAGS_RECKONING are shown
_FLAGS_POSITION = 0x108  # the position in the local frame is known, and a source corrects it
_FLAG_ABSOLUTE = 0x10  # the position of the local frame on Earth is known


@dataclass(frozen=True, slots=True)
class LocalEstimate:
    """One vehicle's estimate in its own local NED frame."""

    position_ned_m: tuple[float, float, float]
    velocity_ned_m_s: tuple[float, float, float]


class Estimator:
    """Estimates of all vehicles, one row per vehicle.

    Args:
        start_ned_m: true start positions (n, 3), which are the origins of the local frames.
        seed: seed of all errors.
        is_common: whether all vehicles have the same errors, like PX4 instances that are started
            together and share SIH's random numbers; otherwise the errors are independent.
        scale: scale of all random errors; 0 for an estimate without errors.
        ground_altitude_m: altitude above the sea of the ground at the start.

    Attributes:
        offset_ned_m: offset (n, 3) of the local position from the true motion since the start.
        yaw_error_rad: estimated heading minus true heading (n,).
        compass_error_rad: mean error (n,) of a heading that comes from the compass.
        tilt_error_rad: turn (n, 2) about north and east that takes the estimated attitude to the
            true one.
        sensors: settings of each vehicle's sensors, which its emulator changes.
        resets: counters (n, 5) XY, VXY, Z, VZ, HEADING.
        jumps: index and shift of each position that has jumped; the emulator clears the list.
    """

    def __init__(
        self,
        start_ned_m: Array,
        *,
        seed: int,
        is_common: bool = False,
        scale: float = 1.0,
        ground_altitude_m: float = ZURICH.altitude_m,
    ) -> None:
        n = start_ned_m.shape[0]
        self._ground_altitude_m = ground_altitude_m

        # Random numbers.
        self._rng = np.random.default_rng([seed, Stream.ESTIMATES])
        drift_streams = list(range(n))  # different random numbers for each vehicle
        if is_common:
            drift_streams = [0] * n
        self._drift_rngs = [
            np.random.default_rng([seed, Stream.DRIFT, stream]) for stream in drift_streams
        ]
        self._is_common = is_common
        self._scale = scale

        # Errors.
        self._origin = np.array(start_ned_m, dtype=np.float64)
        self._errors = records(n, estimator_errors.ERRORS)
        self._draws = np.zeros((_BLOCK, n, 4))
        self._period = 0

        self._begin_errors()
        self.offset_ned_m = self._errors["offset"]
        self.yaw_error_rad = self._errors["yaw_error"]
        self.compass_error_rad = self._errors["yaw_mean"]
        self.tilt_error_rad = self._errors["tilt_error"]

        # One of each per vehicle.
        self.sensors = [SensorSettings() for _ in range(n)]
        self._vehicles = [VehicleEstimate() for _ in range(n)]

        # The past positions are needed because vision can be delayed.
        self._history = np.zeros((_HISTORY, n, 3))
        self._history_index = 0

        # Reported values besides the estimate.
        self.resets = np.tile(np.array(_RESETS_AT_START, dtype=np.int64), (n, 1))
        self.jumps: list[tuple[int, Array]] = []

    def _begin_errors(self) -> None:
        """Draw the errors at the start."""
        errors = self._errors
        scale = self._scale

        errors["unit_velocity"] = self._random(lambda size: self._rng.standard_normal((size, 3)))
        self._bias_draw = scale * self._random(lambda size: self._rng.standard_normal((size, 3)))

        # The filter starts before the vehicle rests, so the height on the ground is not exactly 0.
        height_m = self._random(lambda size: self._rng.uniform(*_START_HEIGHT_M, size))
        errors["offset"][:, 2] = scale * height_m

        sign = self._random(lambda size: self._rng.choice([-1.0, 1.0], size))
        mean_deg = self._random(lambda size: self._rng.uniform(*_COMPASS_MEAN_DEG, size))
        std_deg = self._random(lambda size: self._rng.uniform(*_COMPASS_STD_DEG, size))
        errors["yaw_mean"] = sign * (scale * np.radians(mean_deg))
        errors["yaw_std"] = scale * np.radians(std_deg)
        errors["yaw_share"] = 1.0
        errors["yaw_share_goal"] = 1.0
        errors["yaw_error"] = errors["yaw_mean"]

    def step(
        self,
        time_s: float,
        position_ned_m: Array,
        velocity_ned_m_s: Array,
        on_ground: NDArray[np.bool_],
    ) -> None:
        """Advance the errors by one period and form the estimates from the true motion."""
        if self._period % _SELECT_EVERY == 0:
            for index, is_resting in enumerate(on_ground.tolist()):
                self._select_source(index, time_s, is_resting)

        block = self._period % _BLOCK
        if block == 0:
            drawn = self._random(lambda size: self._rng.standard_normal((size, _BLOCK, 4)))
            self._draws[:] = drawn.swapaxes(0, 1)
        self._period += 1

        estimator_errors.advance(
            self._errors,
            self._draws[block],
            PERIOD_S,
            position_ned_m - self._origin,
            velocity_ned_m_s,
            _YAW_KEEP,
        )
        self._history_index = (self._history_index + 1) % _HISTORY
        self._history[self._history_index] = self._errors["base"]
        for index, (sensors, vehicle) in enumerate(zip(self.sensors, self._vehicles, strict=True)):
            if sensors.gps_delay_s or vehicle.late:
                self._delay(index, sensors.gps_delay_s)
            if sensors.gps_drift_ned_m_s is not None and vehicle.source is Source.GPS:
                self.offset_ned_m[index] += PERIOD_S * sensors.gps_drift_ned_m_s

    def _delay(self, index: int, delay_s: float) -> None:
        """Replace the horizontal estimate by the one from ``delay_s`` ago.

        The height does not change, because it comes from the barometer.
        """
        late = self._vehicles[index].late
        if self.source(index) is not Source.GPS:
            late.clear()
            return

        position = self.position_ned_m[index, :2]
        velocity = self.velocity_ned_m_s[index, :2]
        late.append((position.copy(), velocity.copy()))
        while len(late) > 1 + round(delay_s / PERIOD_S):
            late.popleft()

        if not delay_s:  # the fault is over
            late.clear()
            return
        position[:], velocity[:] = late[0]

    # -- fusion ------------------------------------------------------------------------------------

    def fuse_vision(
        self,
        index: int,
        time_s: float,
        position_ned_m: Array,
        *,
        delay_s: float,
        yaw_error_rad: float = 0.0,
    ) -> None:
        """Fuse one external position of a vehicle; non-finite positions are ignored.

        With satellites the frame is theirs, and vision only corrects the estimate slightly. PX4
        then estimates the offset between the two frames.

        Args:
            index: index of the vehicle.
            time_s: present time.
            position_ned_m: position (3,) in the frame of the sender.
            delay_s: age that PX4 assumes for the pose (EKF2_EV_DELAY).
            yaw_error_rad: heading of the sender minus the true heading.
        """
        x, y, z = position_ned_m.tolist()
        if not math.isfinite(x + y + z):
            return

        vehicle = self._vehicles[index]
        is_first = time_s - vehicle.vision_time_s >= _VISION_TIMEOUT_S
        vehicle.vision_time_s = time_s
        self._fuse_vision_yaw(index, time_s, yaw_error_rad, is_first=is_first)

        # the estimated position at the time of the pose
        periods_back = min(_HISTORY - 1, max(0, round(delay_s / PERIOD_S)))
        estimated = self._history[(self._history_index - periods_back) % _HISTORY, index].tolist()
        if self.sees_satellites(index, time_s):
            self._fuse_beside_satellites(index, time_s, (x, y, z), estimated, is_first=is_first)
        else:
            # PX4 reads the height as altitude above the sea, so its local height differs by the
            # altitude of its origin.
            z += self._known_origin_m(index)
            self._fuse_as_only_source(index, time_s, (x, y, z), estimated, is_first=is_first)

    def _fuse_vision_yaw(
        self, index: int, time_s: float, yaw_error_rad: float, *, is_first: bool
    ) -> None:
        """Correct the heading by an external one, unless it differs by too much.

        The first one is always taken. After a gap PX4 takes none that differs by too much; without
        a gap it follows such a one after some seconds.

        Args:
            index: index of the vehicle.
            time_s: present time.
            yaw_error_rad: heading of the sender minus the true heading.
            is_first: whether there was no vision before.
        """
        vehicle = self._vehicles[index]
        sensors = self.sensors[index]
        vision_yaw = self._errors["vision_yaw"]
        was_fused = math.isfinite(vehicle.heading_ratio) and not is_first

        difference_rad = math.remainder(yaw_error_rad - vision_yaw[index], 2.0 * math.pi)
        ratio = abs(difference_rad) / sensors.heading_gate_rad
        is_reset = not math.isfinite(vehicle.heading_time_s)
        refused_for_s = time_s - vehicle.heading_time_s
        if was_fused and refused_for_s >= _HEADING_REFUSAL_S:
            is_reset = True

        if is_reset:
            vision_yaw[index] = yaw_error_rad
            vehicle.heading_ratio = 0.0
            vehicle.heading_time_s = time_s
        elif ratio <= 1.0:
            vision_yaw[index] += sensors.heading_gain * difference_rad
            vehicle.heading_ratio = ratio
            vehicle.heading_time_s = time_s
        elif was_fused:
            vehicle.heading_ratio = ratio
        else:
            vehicle.heading_ratio = math.nan

    def _fuse_beside_satellites(
        self,
        index: int,
        time_s: float,
        vision_ned_m: tuple[float, float, float],
        estimated_ned_m: list[float],
        *,
        is_first: bool,
    ) -> None:
        """Correct the estimate slightly by vision, shifted into the frame of the satellites.

        Args:
            index: index of the vehicle.
            time_s: present time.
            vision_ned_m: position by vision, in the frame of the sender.
            estimated_ned_m: estimated position at the time of the pose.
            is_first: whether there was no vision before; the offset of the frames is then new.
        """
        x, y, z = vision_ned_m
        estimated_x, estimated_y, estimated_z = estimated_ned_m

        vehicle = self._vehicles[index]
        frame = vehicle.vision_frame_ned_m
        if frame is None or is_first:
            frame = np.array([estimated_x - x, estimated_y - y, estimated_z - z])
            vehicle.vision_frame_ned_m = frame
        frame_x, frame_y, frame_z = frame.tolist()
        x += frame_x
        y += frame_y
        z += frame_z

        vehicle.height_time_s = time_s
        correction = (
            _FUSE_GAIN * (x - estimated_x),
            _FUSE_GAIN * (y - estimated_y),
            _FUSE_GAIN * (z - estimated_z),
        )
        self._correct(index, correction)

    def _fuse_as_only_source(
        self,
        index: int,
        time_s: float,
        vision_ned_m: tuple[float, float, float],
        estimated_ned_m: list[float],
        *,
        is_first: bool,
    ) -> None:
        """Correct the estimate by vision as the only source, slightly or by a jump.

        Args:
            index: index of the vehicle.
            time_s: present time.
            vision_ned_m: position by vision, in the local frame.
            estimated_ned_m: estimated position at the time of the pose.
            is_first: whether there was no vision before; the estimate then jumps.
        """
        x, y, z = vision_ned_m
        estimated_x, estimated_y, estimated_z = estimated_ned_m
        error_x = x - estimated_x
        error_y = y - estimated_y
        error_z = z - estimated_z
        gate_m = max(_SMALLEST_GATE_M, _GATE_SIGMAS * self.sensors[index].vision_noise_m)

        vehicle = self._vehicles[index]
        sideways_m = math.hypot(error_x, error_y)
        sideways_share = _fused_share(
            sideways_m / gate_m, time_s - vehicle.sideways_time_s, _SIDEWAYS_REFUSAL_S
        )
        height_share = _fused_share(
            abs(error_z) / gate_m, time_s - vehicle.height_time_s, _HEIGHT_REFUSAL_S
        )
        fallen = math.exp(-(time_s - vehicle.ratio_time_s) / _RATIO_FALL_S)
        ratio = max((sideways_m / gate_m) ** 2, fallen * vehicle.position_ratio)
        if is_first:
            sideways_share = 1.0
            height_share = 1.0
            ratio = 0.0

        vehicle.position_ratio = min(ratio, _LARGEST_RATIO)
        vehicle.ratio_time_s = time_s
        if sideways_share > 0.0:
            vehicle.sideways_time_s = time_s
        if height_share > 0.0:
            vehicle.height_time_s = time_s

        correction_m = (
            sideways_share * error_x,
            sideways_share * error_y,
            height_share * error_z,
        )
        self._correct(index, correction_m)

        jumps_sideways = sideways_share == 1.0
        jumps_in_height = height_share == 1.0
        shift = np.zeros(3)
        if jumps_sideways:
            self.resets[index, XY] += 1
            shift[:2] = error_x, error_y
        if jumps_in_height:
            self.resets[index, Z] += 1
            shift[2] = error_z
        if jumps_sideways or jumps_in_height:
            self.jumps.append((index, shift))

    def set_origin_altitude(self, index: int, altitude_m: float) -> None:
        """Set the altitude of the local frame's origin, and shift the height by the change."""
        vehicle = self._vehicles[index]
        shift_m = altitude_m - self._known_origin_m(index)
        vehicle.origin_altitude_m = altitude_m
        if not shift_m or vehicle.source is Source.NONE:
            return

        self._correct(index, (0.0, 0.0, shift_m))
        self.resets[index, Z] += 1
        shift_ned_m = np.array([0.0, 0.0, shift_m])
        self.jumps.append((index, shift_ned_m))

        if vehicle.vision_frame_ned_m is not None:
            vehicle.vision_frame_ned_m = vehicle.vision_frame_ned_m + shift_ned_m

    def _known_origin_m(self, index: int) -> float:
        """Return the altitude of the local frame's origin, 0 while it is not known."""
        altitude_m = self.origin_altitude_m(index)
        if altitude_m is None:
            return 0.0
        return altitude_m

    def begin_vision_anew(self, index: int) -> None:
        """Let the estimate jump to the next external position, as the sender has requested."""
        self._vehicles[index].vision_time_s = -math.inf
        self._vehicles[index].heading_time_s = -math.inf

    def restart(self, index: int, time_s: float, position_ned_m: Array) -> None:
        """Restart the estimate of a vehicle, as a reboot does.

        The origin is the present position, there is no source yet, and the counters are those of a
        start.
        """
        local = position_ned_m - self._origin[index]
        self._errors["offset"][index] = -local
        self._errors["unit_position"][index] = 0.0
        self._errors["drift_velocity"][index] = 0.0
        self._errors["tilt_error"][index] = 0.0
        self._errors["turned_velocity"][index] = 0.0
        self._errors["turned_position"][index] = 0.0

        self._history[:, index] = 0.0
        self._vehicles[index] = VehicleEstimate(start_time_s=time_s)
        self.resets[index] = _RESETS_AT_START

    # -- reported values ---------------------------------------------------------------------------

    def local(self, index: int) -> LocalEstimate:
        """Return the newest estimate of one vehicle."""
        x, y, z = self._errors["position"][index].tolist()
        vx, vy, vz = self._errors["velocity"][index].tolist()
        return LocalEstimate(position_ned_m=(x, y, z), velocity_ned_m_s=(vx, vy, vz))

    @property
    def position_ned_m(self) -> Array:
        """Estimated positions (n, 3), each in its local frame: a view, not a copy."""
        return self._errors["position"]

    @property
    def bias_ned_m(self) -> Array:
        """Constant errors (n, 3) of the positions: a view, not a copy."""
        return self._errors["bias"]

    @property
    def velocity_ned_m_s(self) -> Array:
        """Estimated velocities (n, 3): a view, not a copy."""
        return self._errors["velocity"]

    def source(self, index: int) -> Source:
        """Return the source of one vehicle's estimate."""
        return self._vehicles[index].source

    def origin_altitude_m(self, index: int) -> float | None:
        """Return the altitude of the local frame's origin above the sea, None while not known.

        The altitude is the one that was set or, before that, the one by satellites.
        """
        return self._vehicles[index].origin_altitude_m

    def reset_counter(self, index: int) -> int:
        """Return ODOMETRY.reset_counter: the number of jumps of the estimate, modulo 256."""
        return int(self.resets[index].sum()) & 0xFF

    def flags(self, index: int, time_s: float) -> int:
        """Return ESTIMATOR_STATUS.flags.

        When the last source is lost, some flags are cleared at once, and more after 5 s of dead
        reckoning.
        """
        vehicle = self._vehicles[index]
        absolute = 0
        if vehicle.origin_altitude_m is not None:
            absolute = _FLAG_ABSOLUTE

        flags = _FLAGS.get(vehicle.source)
        if flags is not None:
            return flags | absolute
        if time_s - vehicle.lost_time_s < _RECKONING_S:
            return _FLAGS_RECKONING | absolute
        return _FLAGS_LOST

    def position_ratio(self, index: int) -> float:
        """Return ESTIMATOR_STATUS.pos_horiz_ratio: how far the source of the position differs.

        It is squared, and a share of the largest difference that PX4 fuses. NaN without a source.
        """
        vehicle = self._vehicles[index]
        if vehicle.source is Source.NONE:
            return math.nan
        if vehicle.source is Source.VISION:
            return vehicle.position_ratio
        return _POSITION_RATIO

    def heading_ratio(self, index: int) -> float:
        """Return ESTIMATOR_STATUS.mag_ratio: how far the source of the heading differs from it.

        A difference above 1 is not fused. NaN while nothing corrects the heading.
        """
        vehicle = self._vehicles[index]
        is_by_vision = vehicle.source is Source.VISION and self.sensors[index].uses_vision_yaw
        if vehicle.source is Source.NONE and not self.sensors[index].has_gps:
            return math.nan
        if is_by_vision:
            return vehicle.heading_ratio
        return _COMPASS_RATIO

    def is_position_known(self, index: int, time_s: float) -> bool:
        """Return whether ESTIMATOR_STATUS.flags say that a source gives the horizontal position."""
        return self.flags(index, time_s) & _FLAGS_POSITION == _FLAGS_POSITION

    def accuracy_m(self, index: int, time_s: float) -> float:
        """Return ESTIMATOR_STATUS.pos_horiz_accuracy, which grows without a source."""
        vehicle = self._vehicles[index]
        sensors = self.sensors[index]
        if vehicle.source is Source.GPS:
            return sensors.gps_accuracy_m
        if vehicle.source is Source.VISION:
            of_noise_m = _VISION_ACCURACY_SHARE * sensors.vision_noise_m
            return max(of_noise_m, _LEAST_VISION_ACCURACY_M)
        if not math.isfinite(vehicle.lost_time_s):
            return GPS_ACCURACY_M

        lost_s = time_s - vehicle.lost_time_s
        if lost_s > _ACCURACY_KNOWN_S:
            return _ACCURACY_LOST_M
        return math.hypot(GPS_ACCURACY_M, _ACCURACY_M_S * lost_s + _ACCURACY_M_S2 * lost_s**2)

    def sees_satellites(self, index: int, time_s: float) -> bool:
        """Return whether satellites are allowed, are received and give a fix."""
        sensors = self.sensors[index]
        has_fix = time_s - self._vehicles[index].start_time_s >= GPS_FIX_S
        return sensors.has_gps and has_fix and not sensors.gps_blocked

    # -- sources -----------------------------------------------------------------------------------

    def _select_source(self, index: int, time_s: float, is_resting: bool) -> None:
        """Select the source of one vehicle's estimate, and with it the error level."""
        vehicle = self._vehicles[index]
        sensors = self.sensors[index]

        source = Source.NONE
        if time_s - vehicle.vision_time_s < _VISION_TIMEOUT_S:
            source = Source.VISION
        elif self.sees_satellites(index, time_s):
            source = Source.GPS

        if source is Source.VISION:
            level = sensors.vision_level
            if is_resting:
                level = RESTING_WITH_VISION
        elif is_resting:
            level = RESTING
        elif source is Source.NONE and not sensors.has_gps:
            level = RECKONING
        else:
            level = sensors.gps_level

        self._watch_drift(index, time_s, is_resting=is_resting)

        is_same_source = source is vehicle.source
        is_same_level = level is vehicle.level
        if is_same_source and is_same_level and is_resting is vehicle.is_resting:
            return

        vehicle.is_resting = is_resting
        self._errors["is_flying"][index] = not is_resting
        if not is_same_level:
            self._set_level(index, level)
        if not is_same_source:
            self._change_source(index, time_s, source)

    def _watch_drift(self, index: int, time_s: float, *, is_resting: bool) -> None:
        """Begin and end dead reckoning.

        The estimate of a vehicle in flight drifts from the loss of its last source until it has a
        source again. After a landing it keeps drifting until PX4 detects that the vehicle is at
        rest.
        """
        vehicle = self._vehicles[index]
        if not is_resting:
            vehicle.flight_time_s = time_s
        rested_s = time_s - vehicle.flight_time_s
        is_rest_detected = rested_s >= _REST_DETECTION_S

        has_vision = time_s - vehicle.vision_time_s < _VISION_GAP_S
        is_aided = has_vision or self.sees_satellites(index, time_s)

        had_source = vehicle.source is not Source.NONE
        was_drifting = bool(self._errors["is_drifting"][index])
        can_drift = not is_rest_detected and not is_aided
        is_drifting = can_drift and (was_drifting or had_source)
        if is_drifting and not was_drifting:
            self._begin_drift(index)
        self._errors["is_drifting"][index] = is_drifting

    def _set_level(self, index: int, level: ErrorLevel) -> None:
        self._vehicles[index].level = level
        estimator_errors.set_level(self._errors[index], level, self._bias_draw[index], PERIOD_S)
        if self._scale != 1.0:
            self._errors["std_position_goal"][index] *= self._scale
            self._errors["std_velocity_goal"][index] *= self._scale

    def _change_source(self, index: int, time_s: float, source: Source) -> None:
        """Note the new source of one vehicle's estimate, with all that depends on the source."""
        vehicle = self._vehicles[index]
        before = vehicle.source
        vehicle.source = source
        self._errors["has_satellites"][index] = source is Source.GPS

        if source is Source.GPS and vehicle.origin_altitude_m is None:
            vehicle.origin_altitude_m = self._ground_altitude_m
        if source is not Source.VISION:
            vehicle.vision_frame_ned_m = None

        # The heading comes from vision (share 0 of the compass) or from the compass (share 1).
        # Without a source the gyros keep the heading, with its present error.
        has_vision_yaw = source is Source.VISION and self.sensors[index].uses_vision_yaw
        if has_vision_yaw:
            self._errors["yaw_share_goal"][index] = 0.0
            self.resets[index, HEADING] += 1
        elif source is not Source.NONE:
            self._errors["yaw_share_goal"][index] = 1.0

        if source is Source.NONE:
            vehicle.lost_time_s = time_s
        elif before is Source.NONE:
            # The first position is a jump of position and velocity. With vision, the fusion has
            # already counted the jump of the position (XY and Z).
            counters = [XY, VXY, Z, VZ]
            if source is Source.VISION:
                counters = [VXY, VZ]
            self.resets[index, counters] += 1
            if source is Source.GPS:  # the new position is right again
                self.offset_ned_m[index, :2] = 0.0

    def _begin_drift(self, index: int) -> None:
        """Begin the drift of an estimate in a random direction.

        The error of the attitude makes the vehicle fly in the opposite direction.
        """
        draw = self._drift_rngs[index].uniform
        heading_rad = draw(0.0, 2.0 * math.pi)
        distance_m = draw(*_DRIFT_M)
        least_deg, most_deg = _TILT_ERROR_DEG
        tilt_error_deg = least_deg + (most_deg - least_deg) * draw(0.0, 1.0) ** _TILT_POWER
        height_error_m = draw(*_HEIGHT_ERROR_M)

        north = math.cos(heading_rad)
        east = math.sin(heading_rad)
        errors = self._errors

        push_m_s2 = self._scale * _DRIFT_ACCELERATION_1_S2 * distance_m
        errors["drift_acceleration"][index] = push_m_s2 * north, push_m_s2 * east, 0.0
        # The damped motion with this velocity leads to the error of the height.
        _, _, damping_down_s = estimator_errors.DRIFT_DAMPING_S
        down_m_s = -self._scale * height_error_m / damping_down_s
        errors["drift_velocity"][index] = 0.0, 0.0, down_m_s

        tilt_error_rad = self._scale * math.radians(tilt_error_deg)
        errors["tilt_error_most"][index] = -tilt_error_rad * east, tilt_error_rad * north
        at_first = estimator_errors.TILT_ERROR_AT_FIRST
        errors["tilt_error"][index] = at_first * errors["tilt_error_most"][index]

    def _correct(self, index: int, correction: tuple[float, float, float]) -> None:
        """Shift the estimate, and the past positions with it, by a correction NED [m]."""
        self._errors["offset"][index] += correction
        self._history[:, index] += correction

    def _random(self, draw: Callable[[int], Array]) -> Array:
        """Return random numbers for each vehicle; they are equal if the errors are common.

        Args:
            draw: function from a number of vehicles to their random numbers, one row per vehicle.
        """
        count = self._origin.shape[0]
        if self._is_common:
            return np.repeat(draw(1), count, axis=0)
        return draw(count)


def _fused_share(ratio: float, refused_for_s: float, longest_refusal_s: float) -> float:
    """Return the share of a difference by which a position corrects the estimate; 1: it jumps.

    Args:
        ratio: difference from the estimate, as a share of the largest that is fused.
        refused_for_s: time since the last position that was fused.
        longest_refusal_s: time after which the estimate follows a larger difference.
    """
    if ratio <= 1.0:
        return _FUSE_GAIN
    if refused_for_s >= longest_refusal_s:
        return 1.0
    return 0.0
