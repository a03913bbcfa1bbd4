"""The autopilot's estimate of its own state: not an EKF, but an estimate that errs as PX4's does.

Each vehicle has its own local origin. Position and velocity carry the slow errors of
`estimator_errors.py`, sized by the source: satellites, external vision, nothing. Without satellites
the estimate follows vision, right or wrong: a jump sideways at once, one in height when it has been
refused for 5 s; each jump of the estimate counts up PX4's reset counters. Without any source it
drifts away.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics.frames import Array
from sitl.physics.jit import records
from sitl.physics.step import STEP_S
from sitl.px4 import estimator_errors
from sitl.px4.estimator_errors import GPS as GPS
from sitl.px4.estimator_errors import RESTING as RESTING
from sitl.px4.estimator_errors import RESTING_WITH_VISION as RESTING_WITH_VISION
from sitl.px4.estimator_errors import VISION_DEFAULT as VISION_DEFAULT
from sitl.px4.estimator_errors import VISION_TRUSTED as VISION_TRUSTED
from sitl.px4.estimator_errors import VISION_TUNED as VISION_TUNED
from sitl.px4.estimator_errors import VISION_TUNED_WITH_VELOCITY as VISION_TUNED_WITH_VELOCITY
from sitl.px4.estimator_errors import ErrorLevel as ErrorLevel
from sitl.px4.estimator_errors import Source as Source
from sitl.px4.estimator_errors import vision_level as vision_level

ESTIMATE_EVERY_STEPS = 2  # 125 Hz, the rate of PX4's estimator
GPS_FIX_S = 2.3
PERIOD_S = ESTIMATE_EVERY_STEPS * STEP_S
_BLOCK = 64  # random numbers are drawn for so many periods at once
_SELECT_EVERY = 4  # periods between looks at the sources: 31 Hz
_HISTORY = 64
# after which it says that it has lost it; after which it errs
_VISION_TIMEOUT_S, _VISION_GAP_S = 1.0, 0.1
_HEIGHT_REFUSED_S = 5.0
_FLAGS_FADE_S = 5.0
_FUSE_GAIN = 0.2
_YAW_FUSE_GAIN = 0.1
_GATE_SIGMAS, _SMALLEST_GATE_M = 5.0, 0.2
# Dead reckoning, measured on PX4 v1.16 that had lost its vision in flight, uniform between two
# values: displacement after 3.5 s, error of the attitude then, and by how much height soon reads
# too high. On the ground the estimate wanders on as fast as it did, until it sees that it rests.
_DRIFT_M, _LEAN_DEG, _HIGH_M = (0.9, 2.0), (1.4, 3.5), (0.08, 0.34)
_DRIFT_ACCELERATION_1_S2 = 0.214  # that leads, damped, one metre away in that time
_RESTS_AFTER_S = 4.0
_COMPASS_MEAN_DEG, _COMPASS_STD_DEG = (2.0, 17.0), (2.0, 7.0)
_YAW_KEEP = math.exp(-PERIOD_S / estimator_errors.YAW_CORRELATION_S)
# Reset counters in PX4's order, and how often its filter has jumped before it has any position: 13
# on the pad.
XY, VXY, Z, VZ, HEADING = range(5)
_RESETS_AT_START = (2, 2, 2, 2, 1)
HOME_ALTITUDE_M = 489.4  # of the ground where simulated vehicles start
# What ESTIMATOR_STATUS says of the horizontal error, measured on PX4 v1.18 (SIH) that lost its
# satellites in flight:
# 0.3 m with a source; 0.37, 0.53, 0.74, 1.0, 1.3 m one to five seconds after it; then 5 m and more.
_ACCURACY_M, _ACCURACY_LOST_M, _ACCURACY_M_S, _ACCURACY_M_S2, _ACCURACY_KNOWN_S = (
    0.3,
    4.8,
    0.185,
    0.012,
    5.7,
)
# ESTIMATOR_STATUS.flags. With satellites PX4 adds what is absolute to what it was measured to say
# with vision.
_FLAGS = {Source.VISION: 0x1EF, Source.GPS: 0x3FF}
_FLAGS_RECKONING, _FLAGS_LOST = 0xEF, 0xE5
_FLAG_ABSOLUTE = 0x10  # it is known where on Earth the local frame lies


@dataclass(frozen=True, slots=True)
class LocalEstimate:
    """One vehicle's estimate in its own local NED frame."""

    position_ned_m: tuple[float, float, float]
    velocity_ned_m_s: tuple[float, float, float]


class Estimator:
    """Estimates of all vehicles; rows as in the world.

    Args:
        start_ned_m: (n, 3) true start positions: each is the origin of its vehicle's local frame.
        seed: of all errors.
        is_common: all vehicles err alike, as PX4 instances do that are started together and share
            SIH's random numbers; otherwise each errs on its own.
        scale: of all random errors; 0 for an estimate that is right.

    Attributes:
        offset_ned_m: (n, 3) of the local frame against the true motion since the start.
        yaw_error_rad: (n,) believed heading minus true heading.
        lean_rad: (n, 2) turn about north and east that takes the believed attitude to the true one.
        source: what each estimate rests on.
        has_gps, uses_vision_yaw, vision_levels, vision_noise_m: by parameters, per vehicle.
        gps_blocked: (list) satellites are not received, whatever the parameters say.
        resets: (n, 5) counters XY, VXY, Z, VZ, HEADING.
        origin_altitude_m: (list) of the local frame's origin above the sea: from satellites, or as
            somebody said; None before either.
        jumps: which vehicle's position jumped by how much, until somebody takes them.
    """

    def __init__(
        self,
        start_ned_m: Array,
        *,
        seed: int,
        is_common: bool = False,
        scale: float = 1.0,
    ) -> None:
        n = start_ned_m.shape[0]
        self._rng = np.random.default_rng([seed, 2])
        self._drift_rngs = [
            np.random.default_rng([seed, 5, 0 if is_common else i]) for i in range(n)
        ]
        self._is_common, self._scale = is_common, scale
        self._origin = np.array(start_ned_m, dtype=np.float64)
        self._errors = records(n, estimator_errors.ERRORS)
        self._draws = np.zeros((_BLOCK, n, 4))
        self._period = 0
        self._errors["unit_velocity"] = self._random(
            lambda size: self._rng.standard_normal((size, 3))
        )
        self._bias_draw = scale * self._random(lambda size: self._rng.standard_normal((size, 3)))
        # The filter starts before the vehicle rests: height on the ground is not exactly zero.
        self.offset_ned_m = self._errors["offset"]
        self.offset_ned_m[:, 2] = scale * self._random(
            lambda size: self._rng.uniform(-0.2, 0.2, size)
        )
        sign = self._random(lambda size: self._rng.choice([-1.0, 1.0], size))
        mean = scale * np.radians(
            self._random(lambda size: self._rng.uniform(*_COMPASS_MEAN_DEG, size))
        )
        std = scale * np.radians(
            self._random(lambda size: self._rng.uniform(*_COMPASS_STD_DEG, size))
        )
        self._errors["yaw_mean"], self._errors["yaw_std"] = sign * mean, std
        self._errors["yaw_share"] = self._errors["yaw_share_goal"] = 1.0
        self.yaw_error_rad = self._errors["yaw_error"]
        self.tilt_error_rad = self._errors["tilt_error"]
        self.yaw_error_rad[:] = sign * mean
        self._vision_time_s = [-math.inf] * n
        self._height_time_s = [-math.inf] * n
        self._lost_time_s = [-math.inf] * n
        self._start_time_s = [0.0] * n
        self._vision_frame: list[Array | None] = [None] * n
        self._history = np.zeros((_HISTORY, n, 3))
        self._history_index = 0
        self.source = [Source.NONE] * n
        self.has_gps = [True] * n
        self.gps_blocked = [False] * n
        self.uses_vision_yaw = [True] * n
        self.vision_levels = [VISION_DEFAULT] * n
        self.vision_noise_m = [0.1] * n
        self.resets = np.tile(np.array(_RESETS_AT_START, dtype=np.int64), (n, 1))
        self.jumps: list[tuple[int, Array]] = []
        self.origin_altitude_m: list[float | None] = [None] * n
        self._levels: list[ErrorLevel | None] = [None] * n
        self._rests = [True] * n
        self._rests_since_s = [-math.inf] * n

    def step(
        self,
        time_s: float,
        position_ned_m: Array,
        velocity_ned_m_s: Array,
        on_ground: NDArray[np.bool_],
    ) -> None:
        """Advance the errors by one estimator period and form the estimates from the true motion."""
        if self._period % _SELECT_EVERY == 0:
            for i, is_resting in enumerate(on_ground.tolist()):
                self._select_source(i, time_s, is_resting)
        block = self._period % _BLOCK
        if block == 0:
            self._draws[:] = self._random(
                lambda size: self._rng.standard_normal((size, _BLOCK, 4))
            ).swapaxes(0, 1)
        self._period += 1
        local = position_ned_m - self._origin
        estimator_errors.advance(
            self._errors, self._draws[block], PERIOD_S, local, velocity_ned_m_s, _YAW_KEEP
        )
        self._history_index = (self._history_index + 1) % _HISTORY
        self._history[self._history_index] = self._errors["base"]

    def fuse_vision(
        self,
        index: int,
        time_s: float,
        position_ned_m: Array,
        *,
        delay_s: float,
        yaw_error_rad: float = 0.0,
    ) -> None:
        """Take one external position of a vehicle, in the frame of its sender; what is not finite
        is ignored.

        While satellites give the frame, vision only steadies the estimate (PX4 then estimates the
        offset between both).

        Args:
            index, time_s, position_ned_m: which vehicle, when, where.
            delay_s: how old PX4 takes it to be (EKF2_EV_DELAY).
            yaw_error_rad: the sender's heading minus the true one.
        """
        x, y, z = position_ned_m.tolist()
        if not math.isfinite(x + y + z):
            return
        back = min(_HISTORY - 1, max(0, round(delay_s / PERIOD_S)))
        bx, by, bz = self._history[(self._history_index - back) % _HISTORY, index].tolist()
        is_first = time_s - self._vision_time_s[index] >= _VISION_TIMEOUT_S
        self._vision_time_s[index] = time_s
        if is_first:
            self._errors["vision_yaw"][index] = yaw_error_rad
        else:
            miss = math.remainder(yaw_error_rad - self._errors["vision_yaw"][index], 2.0 * math.pi)
            self._errors["vision_yaw"][index] += _YAW_FUSE_GAIN * miss
        if self.sees_satellites(index, time_s):
            frame = self._vision_frame[index]
            if frame is None or is_first:
                frame = self._vision_frame[index] = np.array([bx - x, by - y, bz - z])
            fx, fy, fz = frame.tolist()
            x, y, z = x + fx, y + fy, z + fz
            self._height_time_s[index] = time_s
            self._correct(
                index, (_FUSE_GAIN * (x - bx), _FUSE_GAIN * (y - by), _FUSE_GAIN * (z - bz))
            )
            return
        # PX4 takes the height for one above the sea: its local height is off by the altitude of its
        # origin
        z += self.origin_altitude_m[index] or 0.0
        ex, ey, ez = x - bx, y - by, z - bz
        gate_m = max(_SMALLEST_GATE_M, _GATE_SIGMAS * self.vision_noise_m[index])
        jumps = is_first or math.hypot(ex, ey) > gate_m
        if not jumps:
            ex, ey = _FUSE_GAIN * ex, _FUSE_GAIN * ey
        is_refused = abs(ez) > gate_m and not is_first
        lifts = is_first or (
            is_refused and time_s - self._height_time_s[index] >= _HEIGHT_REFUSED_S
        )
        if not is_refused or lifts:
            self._height_time_s[index] = time_s
        if not lifts:
            ez = 0.0 if is_refused else _FUSE_GAIN * ez
        self._correct(index, (ex, ey, ez))
        self.resets[index, XY] += jumps
        self.resets[index, Z] += lifts
        if jumps or lifts:
            shift = np.array([ex if jumps else 0.0, ey if jumps else 0.0, ez if lifts else 0.0])
            self.jumps.append((index, shift))

    def set_origin_altitude(self, index: int, altitude_m: float) -> None:
        """Somebody says how high the local frame's origin lies: local heights change by the
        difference.
        """
        before, self.origin_altitude_m[index] = self.origin_altitude_m[index], altitude_m
        shift_m = altitude_m - (before or 0.0)
        if shift_m and self.source[index] is not Source.NONE:
            self._correct(index, (0.0, 0.0, shift_m))
            self.resets[index, Z] += 1

    def begin_vision_anew(self, index: int) -> None:
        """The sender says that its positions are other ones from here on: the next is taken
        wherever it lies.
        """
        self._vision_time_s[index] = -math.inf

    def restart(self, index: int, time_s: float, position_ned_m: Array) -> None:
        """Begin anew, as after a reboot: a new origin where the vehicle is, no source yet, counters
        as at a start.
        """
        local = position_ned_m - self._origin[index]
        self._errors["offset"][index] = -local
        self._errors["unit_position"][index] = 0.0
        self._errors["drift_velocity"][index] = 0.0
        self._errors["tilt_error"][index] = 0.0
        self._history[:, index] = 0.0
        self._vision_time_s[index] = self._height_time_s[index] = self._lost_time_s[
            index
        ] = -math.inf
        self._start_time_s[index] = time_s
        self._vision_frame[index] = None
        self._levels[index] = None
        self.origin_altitude_m[index] = None
        self.source[index] = Source.NONE
        self.resets[index] = _RESETS_AT_START

    def local(self, index: int) -> LocalEstimate:
        """The newest estimate of one vehicle."""
        x, y, z = self._errors["position"][index].tolist()
        vx, vy, vz = self._errors["velocity"][index].tolist()
        return LocalEstimate((x, y, z), (vx, vy, vz))

    @property
    def position_ned_m(self) -> Array:
        """Estimated positions (n, 3), each in its own frame: a window, not a copy."""
        return self._errors["position"]

    @property
    def bias_ned_m(self) -> Array:
        """Constant errors (n, 3) of the positions: a window, not a copy."""
        return self._errors["bias"]

    @property
    def velocity_ned_m_s(self) -> Array:
        """Estimated velocities (n, 3): a window, not a copy."""
        return self._errors["velocity"]

    def reset_counter(self, index: int) -> int:
        """ODOMETRY.reset_counter: all jumps of the estimate so far, modulo 256."""
        return int(self.resets[index].sum()) & 0xFF

    def flags(self, index: int, time_s: float) -> int:
        """ESTIMATOR_STATUS.flags: they fade in two stages when the last source is gone."""
        absolute = _FLAG_ABSOLUTE if self.origin_altitude_m[index] is not None else 0
        known = _FLAGS.get(self.source[index])
        if known is not None:
            return known | absolute
        return (
            _FLAGS_RECKONING | absolute
            if time_s - self._lost_time_s[index] < _FLAGS_FADE_S
            else _FLAGS_LOST
        )

    def accuracy_m(self, index: int, time_s: float) -> float:
        """ESTIMATOR_STATUS.pos_horiz_accuracy: it grows when the last source is gone."""
        if self.source[index] is not Source.NONE or not math.isfinite(self._lost_time_s[index]):
            return _ACCURACY_M
        lost_s = time_s - self._lost_time_s[index]
        if lost_s > _ACCURACY_KNOWN_S:
            return _ACCURACY_LOST_M
        return math.hypot(_ACCURACY_M, _ACCURACY_M_S * lost_s + _ACCURACY_M_S2 * lost_s**2)

    def sees_satellites(self, index: int, time_s: float) -> bool:
        """Whether the estimate may rest on satellites: allowed, received, and a fix since the
        start.
        """
        has_fix = time_s - self._start_time_s[index] >= GPS_FIX_S
        return self.has_gps[index] and has_fix and not self.gps_blocked[index]

    def _select_source(self, i: int, time_s: float, is_resting: bool) -> None:
        """Follow the sources of one vehicle: what its estimate rests on, and so how it errs."""
        if time_s - self._vision_time_s[i] < _VISION_TIMEOUT_S:
            source, level = (
                Source.VISION,
                RESTING_WITH_VISION if is_resting else self.vision_levels[i],
            )
        elif self.sees_satellites(i, time_s):
            source, level = Source.GPS, RESTING if is_resting else GPS
        else:
            source, level = Source.NONE, RESTING if is_resting else GPS
        before = self.source[i]
        if not is_resting:
            self._rests_since_s[i] = time_s
        has_flown = time_s - self._rests_since_s[i] < _RESTS_AFTER_S
        is_aided = time_s - self._vision_time_s[i] < _VISION_GAP_S or self.sees_satellites(
            i, time_s
        )
        was_drifting = bool(self._errors["is_drifting"][i])
        is_drifting = has_flown and not is_aided and (was_drifting or before is not Source.NONE)
        if is_drifting and not was_drifting:
            self._begin_drift(i)
        self._errors["is_drifting"][i] = is_drifting
        if source is before and level is self._levels[i] and is_resting is self._rests[i]:
            return
        self._rests[i] = is_resting
        if level is not self._levels[i]:
            self._levels[i] = level
            estimator_errors.set_level(self._errors[i], level, self._bias_draw[i], PERIOD_S)
            if self._scale != 1.0:
                self._errors["std_position_goal"][i] *= self._scale
                self._errors["std_velocity_goal"][i] *= self._scale
        self._errors["is_flying"][i] = not is_resting
        if source is before:
            return
        self.source[i] = source
        if source is Source.GPS and self.origin_altitude_m[i] is None:
            self.origin_altitude_m[i] = HOME_ALTITUDE_M
        if source is not Source.VISION:
            self._vision_frame[i] = None
        has_yaw = source is Source.VISION and self.uses_vision_yaw[i]
        # When everything is gone the gyros carry the heading on from where it was.
        if source is not Source.NONE:
            self._errors["yaw_share_goal"][i] = 0.0 if has_yaw else 1.0
        if has_yaw:
            self.resets[i, HEADING] += 1
        if source is Source.NONE:
            self._lost_time_s[i] = time_s
        elif before is Source.NONE:
            # A first position is a jump of everything; vision has counted its own of the position.
            counted = [VXY, VZ] if source is Source.VISION else [XY, VXY, Z, VZ]
            self.resets[i, counted] += 1

    def _begin_drift(self, i: int) -> None:
        """The estimate runs away in one direction; the vehicle, not as level as believed, in the
        other.
        """
        draw, errors = self._drift_rngs[i].uniform, self._errors
        heading, far_m, lean_deg, high_m = (
            draw(0.0, 2.0 * math.pi),
            draw(*_DRIFT_M),
            draw(*_LEAN_DEG),
            draw(*_HIGH_M),
        )
        north, east = math.cos(heading), math.sin(heading)
        push_m_s2 = self._scale * _DRIFT_ACCELERATION_1_S2 * far_m
        tilt_error_rad = self._scale * math.radians(lean_deg)
        errors["drift_acceleration"][i] = push_m_s2 * north, push_m_s2 * east, 0.0
        errors["drift_velocity"][i] = (
            0.0,
            0.0,
            -self._scale * high_m / estimator_errors.DRIFT_DAMPING_S[2],
        )
        errors["tilt_error_most"][i] = -tilt_error_rad * east, tilt_error_rad * north
        errors["tilt_error"][i] = (
            estimator_errors.TILT_ERROR_AT_FIRST * errors["tilt_error_most"][i]
        )

    def _correct(self, index: int, correction: tuple[float, float, float]) -> None:
        self._errors["offset"][index] += correction
        self._history[:, index] += correction

    def _random(self, draw: Callable[[int], Array]) -> Array:
        n = self._origin.shape[0]
        return np.repeat(draw(1), n, axis=0) if self._is_common else draw(n)
