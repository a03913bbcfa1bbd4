"""Estimates the vehicle's own state from mocap samples, PX4's attitude and the sent throttle.

The pose validator checks each sample on arrival. Accepted samples wait in a queue until the next
tick, when the Kalman filter uses them. A vehicle without a mocap uses PX4's local position instead.
The agent calls :meth:`OwnState.update` at every tick.

PX4's heading may be wrong by tens of degrees, because it comes from a magnetometer. The difference
between the mocap's heading and PX4's (the heading offset) is low-passed. It converts PX4's attitude
to the fleet frame, and attitude setpoints back to PX4's heading.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from msgspec.structs import replace

from onboard import vectors
from onboard.autopilot import Snapshot
from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose
from onboard.config.fleet import HEADING_NOISE_RAD, CorrectionsConfig, Origin, Vehicle
from onboard.config.wind_limit import largest_push_m_s2
from onboard.corrections import fix
from onboard.estimation import kalman, wind
from onboard.estimation.accuracies import ACCURACIES
from onboard.estimation.kalman import KalmanParams
from onboard.frames import (
    enu_from_ned,
    turn_about_up_rad,
    turned_about_up,
    wrap_rad,
    yaw_from_quaternion,
)
from onboard.localization.dead_reckoning import DeadReckoning, VerticalMotion
from onboard.localization.local_frame import LocalFrame, ReckonedPosition
from onboard.localization.motion_fit import LATE_BY_S, MotionFit
from onboard.localization.motion_history import MotionHistory
from onboard.localization.odometry_check import OdometryCheck
from onboard.localization.pose_validator import PoseValidator, PoseVerdict, Px4Evidence
from onboard.localization.px4_position_check import Px4PositionCheck
from onboard.message_counts import MessageCounts
from onboard.safety.limits import LARGEST_POSITION_STD_M, LARGEST_VELOCITY_STD_M_S
from onboard.tuples import Wxyz, Xyz
from onboard.types import AttitudeSetpoint, State

_UNIT_NORM = 1e-6  # a norm that differs from 1 by less is that of a unit quaternion
_MAX_POSITION_M = 1e4  # largest coordinate of a pose
_MAX_QUEUE = 8  # number of samples that may wait for a tick; the newest are kept
_FUTURE_NS = 5_000_000  # a stamp may be ahead of its arrival by this time
_HEADING_TIME_S = 1.0  # time constant of the heading offset
_REJECTED_TO_RESTART = 10  # rejected samples in a row after which the filter restarts on the ground
_WITHOUT_FIX_NS = 500_000_000  # after this time without a fix, satellites count as lost
_TRUSTED_S = 0.1  # an estimate without a sample newer than this is not compared with PX4's position

# For positions from PX4. ACCURACIES has their slow error.
_PX4_POSITION_STD_M = 0.05  # noise between two positions
_PX4_JUMP_GATE_M = 1.0  # a larger innovation is a jump
# A camera whose heading differs by more than this from PX4's has not the frame of the start.
_LARGEST_TURN_RAD = math.radians(8.5)
# A heading jumps if it changes by that and more than by this rate within a short time.
_FASTEST_TURN_RAD_S = math.radians(220.0)
_LONGEST_ATTITUDE_GAP_S = 0.2
_HEADING_GATE_SIGMAS = 2.6  # EKF2_HDG_GATE
_LEAST_HEADING_NOISE_RAD = 0.01  # PX4 counts on no smaller one
_TAKING_NOISE_AS_VARIANCE = ("1.16", "1.17")  # versions of PX4 that do so with EKF2_EVA_NOISE
_ZERO: Xyz = (0.0, 0.0, 0.0)
_SQRT_HALF = math.sqrt(0.5)


class _Sample(NamedTuple):
    """A position that waits for the next tick."""

    position_enu_m: vectors.Vec3
    stamp_ns: int
    yaw_rad: float


class _TimedAttitude(NamedTuple):
    """An attitude that PX4 reported."""

    stamp_ns: int  # of its arrival; 0: none yet
    quaternion_enu_flu_wxyz: Wxyz


_NO_ATTITUDE = _TimedAttitude(0, (1.0, 0.0, 0.0, 0.0))


class OwnEstimate(NamedTuple):
    """Estimate of our own motion at one tick."""

    state: State | None  # None before the first usable sample
    attitude_wxyz: Wxyz  # in the fleet frame
    age_s: float  # age of the newest used sample; inf before the first
    is_dead_reckoned: bool  # whether this agent flies the vehicle by dead reckoning
    jumps: int  # number of impossible samples in a row
    is_mocap_frozen: bool
    is_mocap_late: bool
    gust_m_s2: float  # standard deviation of the present gusts, per axis
    expected_gust_m_s2: float  # of the gusts to expect: the strongest lately, or the usual ones


@dataclass(slots=True)
class OwnState:
    """Estimate of one vehicle.

    Call :meth:`update` once a tick, and :meth:`add_pose` whenever a mocap sample arrives.
    """

    vehicle: Vehicle
    origin: Origin | None = None
    corrections: CorrectionsConfig | None = None  # None: the vehicle uses no corrections
    # whether the fleet passes above each other, so that the accuracy of heights counts, too
    uses_heights: bool = False
    # Height of the ground by the fleet file, see LocalFrame; None: level.
    ground_at: Callable[[float, float], float] | None = None
    counts: MessageCounts = field(default_factory=MessageCounts)  # poses that were not used
    heading_offset_rad: float = 0.0  # heading in the fleet frame minus PX4's heading
    # only for vehicles with a mocap
    validator: PoseValidator = field(default_factory=PoseValidator)
    px4_check: Px4PositionCheck = field(default_factory=Px4PositionCheck)
    # only for vehicles without a mocap
    has_lost_satellites: bool = False
    fit: MotionFit = field(init=False)
    # Whether this agent's setpoints fly the vehicle. Only then is the thrust known, which dead
    # reckoning needs.
    is_flown: bool = False

    _has_flown: bool = False  # by this agent
    _is_on_ground: bool = False  # at the last update
    _params: KalmanParams = field(init=False)
    _memory: kalman.KalmanMemory | None = None  # filter's memory; None before the first sample
    _reckoning: DeadReckoning = field(default_factory=DeadReckoning)
    _wind: wind.WindMemory = field(default_factory=wind.initial)
    # least published standard deviations of position [m] and velocity [m/s]
    _least_std: tuple[float, float] = (0.0, 0.0)

    _queue: list[_Sample] = field(default_factory=list)
    _newest_ns: int = 0  # stamp of the newest usable mocap sample
    # position of the newest sample that the filter rejected; accepted samples do not clear it
    _rejected_enu_m: Xyz | None = None

    _has_heading: bool = False  # whether the heading offset is known
    # heading of the newest used mocap sample minus PX4's; NaN while it is not known
    _heading_difference_rad: float = math.nan
    _yaw_rad: float = 0.0  # heading of the newest sample

    _attitude: _TimedAttitude = _NO_ATTITUDE  # newest one of PX4
    _largest_heading_ratio: float = field(init=False)  # of a camera with the frame of the start
    _local_frame: LocalFrame = field(init=False)
    # only for vehicles with a camera
    _odometry_check: OdometryCheck = field(default_factory=OdometryCheck)
    _history: MotionHistory = field(default_factory=MotionHistory)
    _local_ns: int = 0  # stamp of PX4's newest local position
    _fix_ns: int = 0  # last time at which PX4 had a fix; 0: never

    def __post_init__(self) -> None:
        vehicle = self.vehicle
        self.fit = MotionFit(vehicle.drag_1_s)
        # A PX4 that flies by vision does not know where on Earth its local frame begins.
        origin = self.origin if vehicle.flies_by_satellites else None
        self._local_frame = LocalFrame(vehicle.start_enu_m, origin, self.ground_at)
        self._largest_heading_ratio = _LARGEST_TURN_RAD / _heading_gate_rad(vehicle)
        self._params = KalmanParams(
            drag_1_s=vehicle.drag_1_s,
            gust_time_s=kalman.gust_time_s(vehicle.lag_s),
            max_bias_m_s2=kalman.largest_bias_m_s2(largest_push_m_s2(vehicle)),
        )
        if not vehicle.mocap_required:
            self._params = self._params._replace(
                position_noise_m=_PX4_POSITION_STD_M, jump_gate_m=_PX4_JUMP_GATE_M
            )

    def add_pose(self, pose: MocapPose, received_ns: int) -> bool:
        """Queue a mocap sample for the next update, and return whether it was accepted."""
        if not pose.is_tracked:
            return False

        if not _is_usable(pose):
            self.counts.malformed += 1
            return False

        # All stamps come from one clock, so a sample that is not newer arrived out of order.
        # Sequence numbers are not used, because a single wrong number could exclude all later
        # samples.
        is_new = self._newest_ns < pose.stamp_ns <= received_ns + _FUTURE_NS
        if not is_new:
            self.counts.late += 1
            return False
        self._newest_ns = pose.stamp_ns

        difference_rad = math.nan
        attitude_age_s = (received_ns - self._attitude.stamp_ns) * 1e-9
        if attitude_age_s < _LONGEST_ATTITUDE_GAP_S:
            difference_rad = turn_about_up_rad(
                pose.quaternion_enu_flu_wxyz, self._attitude.quaternion_enu_flu_wxyz
            )

        verdict = self.validator.judge(
            pose.position_enu_m,
            pose.quaternion_enu_flu_wxyz,
            pose.stamp_ns,
            received_ns,
            evidence=self._px4_evidence(pose.position_enu_m, difference_rad, received_ns),
        )
        if verdict is not PoseVerdict.ACCEPTED:
            self.counts.refused += 1
            return False

        self._heading_difference_rad = difference_rad
        yaw_rad = yaw_from_quaternion(pose.quaternion_enu_flu_wxyz)
        self._queue.append(_Sample(vectors.Vec3(*pose.position_enu_m), pose.stamp_ns, yaw_rad))
        del self._queue[:-_MAX_QUEUE]
        return True

    def _px4_evidence(
        self, position_enu_m: Xyz, heading_difference_rad: float, received_ns: int
    ) -> Px4Evidence:
        """Return what PX4's own estimate says about a mocap sample.

        Args:
            position_enu_m: position of the sample.
            heading_difference_rad: its heading minus PX4's; NaN if PX4's is not known.
            received_ns: time of its arrival.
        """
        heading_jump_rad = wrap_rad(heading_difference_rad - self._heading_difference_rad)
        if math.isnan(heading_jump_rad):
            heading_jump_rad = 0.0
        return Px4Evidence(
            is_after_landing=self._has_flown and self._is_on_ground,
            is_contradicted=self.px4_check.contradicts(position_enu_m, received_ns),
            heading_jump_rad=heading_jump_rad,
        )

    def update(
        self,
        now_ns: int,
        dt_s: float,
        snapshot: Snapshot,
        thrust_frac: float,
        hover_frac: float,
        is_on_ground: bool,
    ) -> OwnEstimate:
        """Propagate the estimate to now, use the queued samples, and return the estimate.

        Args:
            now_ns: time of the tick.
            dt_s: length of the tick.
            snapshot: newest snapshot of PX4, with its measured attitude.
            thrust_frac: last throttle sent.
            hover_frac: hover throttle.
            is_on_ground: whether the vehicle stands on the ground.
        """
        self._has_flown |= self.is_flown and not is_on_ground
        self._is_on_ground = is_on_ground
        self._follow_px4_heading(snapshot)
        if self.vehicle.flies_by_satellites:
            self._notice_lost_satellites(snapshot, now_ns)
        if not self.vehicle.mocap_required:
            self._queue_local_position(snapshot)

        driven_enu_m_s2 = vectors.ZERO_3
        if self._memory is not None:
            self._memory = kalman.drive(
                self._memory,
                turned_about_up(snapshot.quaternion_enu_flu_wxyz, self.heading_offset_rad),
                thrust_frac,
                hover_frac,
                self._params,
                dt_s,
                is_on_ground,
            )
            if not self.vehicle.mocap_required:
                driven_enu_m_s2 = kalman.driven_enu_m_s2(self._memory, self._params)
                self.fit.drive(driven_enu_m_s2)

        for sample in self._queue:
            self._use(sample, snapshot, now_ns, dt_s, is_on_ground)
        self._queue.clear()

        if self._memory is not None:
            vertical = self._px4_vertical(snapshot, now_ns)
            self._memory = self._reckoning.step(self._memory, vertical, dt_s, is_on_ground)
            if not self._reckoning.is_on:
                self._wind = wind.step(self._wind, self._memory.bias_enu_m_s2, dt_s, is_on_ground)
            if self.vehicle.flies_by_vision:
                self._note_motion(now_ns, self._memory, driven_enu_m_s2, dt_s)

        jumps = self.jumps
        age_s = self.age_s
        is_dead_reckoned = self.is_dead_reckoned

        if self.vehicle.mocap_required:
            trusted_enu_m = None
            if is_dead_reckoned or (jumps == 0 and age_s < _TRUSTED_S):
                trusted_enu_m = self.position_enu_m
            dead_reckoned_std_m = None
            if is_dead_reckoned:
                dead_reckoned_std_m, _ = self._reckoning.std
            self.px4_check.update(
                snapshot, trusted_enu_m, now_ns, dead_reckoned_std_m=dead_reckoned_std_m
            )

        # convert again, because the samples have changed the heading offset
        attitude_wxyz = turned_about_up(snapshot.quaternion_enu_flu_wxyz, self.heading_offset_rad)
        state = self._state(is_dead_reckoned=is_dead_reckoned)
        gust_m_s2 = wind.gust_std_m_s2(self._wind)
        expected_gust_m_s2 = wind.strongest_gust_std_m_s2(self._wind)
        return OwnEstimate(
            state=state,
            attitude_wxyz=attitude_wxyz,
            age_s=age_s,
            is_dead_reckoned=is_dead_reckoned,
            jumps=jumps,
            is_mocap_frozen=self.validator.is_frozen,
            is_mocap_late=self.validator.is_late,
            gust_m_s2=gust_m_s2,
            expected_gust_m_s2=expected_gust_m_s2,
        )

    def _use(
        self, sample: _Sample, snapshot: Snapshot, now_ns: int, dt_s: float, is_on_ground: bool
    ) -> None:
        """Correct the estimate by a queued sample, or restart the estimate at it."""
        memory = self._memory
        if memory is None or (is_on_ground and memory.rejected_count >= _REJECTED_TO_RESTART):
            memory = kalman.initial(sample.position_enu_m, self._params)

        age_s = max(0.0, (now_ns - sample.stamp_ns) * 1e-9)
        position_enu_m = sample.position_enu_m
        measured_s = age_s  # time since the position was measured
        if not self.vehicle.mocap_required:
            memory = self._update_fit(memory, sample, snapshot, age_s, is_on_ground)
        if self.fit.is_late:
            measured_s += LATE_BY_S
            position_enu_m = _with_past_height(memory, position_enu_m, age_s)

        self._memory = kalman.correct(memory, position_enu_m, measured_s, self._params)
        if self._memory.rejected_count > memory.rejected_count:
            self.counts.refused += 1
            self._rejected_enu_m = sample.position_enu_m
            return

        if self.fit.is_late and kalman.remembers(memory, measured_s):
            # late positions still arrive regularly, so the estimate does not become stale
            self._memory = self._memory._replace(last_age_s=min(memory.last_age_s, age_s))

        self._yaw_rad = sample.yaw_rad
        if self.vehicle.mocap_required:
            self._follow_heading(sample.yaw_rad, snapshot, dt_s)

    def _update_fit(
        self,
        memory: kalman.KalmanMemory,
        sample: _Sample,
        snapshot: Snapshot,
        age_s: float,
        is_on_ground: bool,
    ) -> kalman.KalmanMemory:
        """Compare a position of PX4 with the vehicle's motion, and return the filter's memory.

        If the positions turn out to be late, the estimate so far is wrong, because the filter
        assumed newer positions. The returned memory then has a larger covariance.
        """
        was_late = self.fit.is_late
        expected_enu_m = kalman.position_at(memory, age_s)
        if was_late:
            expected_enu_m = kalman.position_at(memory, age_s + LATE_BY_S)
        self.fit.step(
            innovation_m=vectors.subtract(sample.position_enu_m, expected_enu_m),
            velocity_enu_m_s=vectors.Vec3(*enu_from_ned(snapshot.velocity_local_ned_m_s)),
            stamp_ns=sample.stamp_ns,
            is_on_ground=is_on_ground,
        )
        if self.fit.is_late and not was_late:
            return kalman.doubted(memory)
        return memory

    def _follow_heading(self, yaw_rad: float, snapshot: Snapshot, dt_s: float) -> None:
        """Update the heading offset with a sample's heading. The first sample sets it."""
        if snapshot.attitude_ns == 0:
            return

        px4_yaw_rad = yaw_from_quaternion(snapshot.quaternion_enu_flu_wxyz)
        error_rad = wrap_rad(yaw_rad - px4_yaw_rad - self.heading_offset_rad)
        weight = 1.0
        if self._has_heading:
            weight = min(1.0, dt_s / _HEADING_TIME_S)
        self.heading_offset_rad = wrap_rad(self.heading_offset_rad + weight * error_rad)
        self._has_heading = True

    def _notice_lost_satellites(self, snapshot: Snapshot, now_ns: int) -> None:
        """Find out whether satellites are lost. If so, PX4's position drifts, and is not used.

        A PX4 that has never had a fix gets its position from another sensor.
        """
        if snapshot.sees_satellites(now_ns):
            self._fix_ns = now_ns
        has_had_fix = self._fix_ns != 0
        self.has_lost_satellites = has_had_fix and now_ns - self._fix_ns > _WITHOUT_FIX_NS

    def _queue_local_position(self, snapshot: Snapshot) -> None:
        """Queue PX4's local position, if there is a new one that PX4's estimator stands for."""
        is_known = snapshot.is_position_known and not self.has_lost_satellites
        if self.vehicle.flies_by_vision:
            is_known = is_known and not self._is_camera_contradicted(snapshot)
        # a camera whose heading PX4 does not use may have begun its frame anew, turned
        is_turned = is_known and self.has_turned_camera(snapshot)
        is_usable = is_known and not is_turned
        if not is_usable:
            self._local_frame.skip(snapshot, is_turned=is_turned)
        if snapshot.local_position_ns == self._local_ns or not is_usable:
            return
        self._local_ns = snapshot.local_position_ns

        # When the fix type becomes worse, PX4's estimated accuracy stays good for a while, but the
        # receiver reports its new accuracy at once. Both values are for two axes together.
        accuracy_m = snapshot.position_accuracy_m
        if fix.is_below(snapshot, self.corrections, snapshot.local_position_ns):
            accuracy_m = max(accuracy_m, snapshot.fix_accuracy_m)
        std_m = accuracy_m * _SQRT_HALF
        if self.uses_heights:
            std_m = max(std_m, snapshot.height_accuracy_m)
        least = ACCURACIES[self.vehicle.px4_position]
        position_enu_m = self._local_frame.take(snapshot, self._reckoned_position(snapshot))
        std_m = max(least.position_std_m, std_m, self._local_frame.offset_std_m)
        self._least_std = (std_m, least.velocity_std_m_s)
        if position_enu_m is not None:
            yaw_rad = yaw_from_quaternion(snapshot.quaternion_enu_flu_wxyz)
            self._queue.append(_Sample(vectors.Vec3(*position_enu_m), self._local_ns, yaw_rad))

    def _note_motion(
        self, now_ns: int, memory: kalman.KalmanMemory, driven_enu_m_s2: vectors.Vec3, dt_s: float
    ) -> None:
        """Note the motion at the end of a tick, if dead reckoning could begin with it later.

        Until the push of the wind is known, dead reckoning needs the newest one.
        """
        if self._reckoning.has_learned_bias:
            mean_bias_m_s2 = self._reckoning.mean_bias_m_s2
            self._history.note(now_ns, memory, mean_bias_m_s2, driven_enu_m_s2, dt_s)
        else:
            self._history.forget()

    def _is_camera_contradicted(self, snapshot: Snapshot) -> bool:
        """Return whether the camera contradicts PX4.

        When this begins, the time since the camera has been wrong is reckoned anew.
        """
        check = self._odometry_check
        was_contradicted = check.is_contradicted
        check.update(snapshot.position_ratio, snapshot.position_accuracy_ns)

        if check.is_contradicted and not was_contradicted and self.is_flown:
            reckoned = self._history.reckoned(check.rising_since_ns, self._params)
            if reckoned is not None:
                self._memory = reckoned
                self._reckoning.begin_at(reckoned)
        return check.is_contradicted

    def _follow_px4_heading(self, snapshot: Snapshot) -> None:
        """Take PX4's newest heading. It jumps if it changes faster than a vehicle turns.

        PX4 then follows a camera that has begun its frame anew, or corrects itself. The vehicle has
        not turned, so its heading in the fleet frame stays.
        """
        before = self._attitude
        if snapshot.attitude_ns == before.stamp_ns:
            return
        attitude_wxyz = snapshot.quaternion_enu_flu_wxyz
        self._attitude = _TimedAttitude(snapshot.attitude_ns, attitude_wxyz)

        dt_s = (snapshot.attitude_ns - before.stamp_ns) * 1e-9
        if before.stamp_ns == 0 or dt_s > _LONGEST_ATTITUDE_GAP_S:
            self._heading_difference_rad = math.nan  # PX4 may have jumped unseen
            return
        turned_rad = turn_about_up_rad(attitude_wxyz, before.quaternion_enu_flu_wxyz)
        if abs(turned_rad) <= _LARGEST_TURN_RAD + _FASTEST_TURN_RAD_S * dt_s:
            return

        if self.vehicle.has_heading_by_vision:
            self._local_frame.turn(snapshot)
        if self.vehicle.mocap_required:
            self.heading_offset_rad = wrap_rad(self.heading_offset_rad - turned_rad)
            self._heading_difference_rad = wrap_rad(self._heading_difference_rad - turned_rad)

    def has_turned_camera(self, snapshot: Snapshot) -> bool:
        """Return whether the camera's heading is missing, or differs from PX4's by 8.5 degrees.

        Headings by cameras that PX4 fused differed by 1 degree. Of a camera that knows no heading
        nothing can be said: PX4 then compares a compass.

        Args:
            snapshot: newest snapshot of PX4.
        """
        if not self.vehicle.has_heading_by_vision:
            return False
        return not snapshot.heading_ratio <= self._largest_heading_ratio  # also for NaN

    def _reckoned_position(self, snapshot: Snapshot) -> ReckonedPosition | None:
        """Return the position that a camera's position is compared with after a gap.

        It is None where dead reckoning may be worse than PX4's position: by satellites, which never
        begin a frame anew, with late positions, and while somebody else flies the vehicle.
        """
        if self._memory is None or not self.vehicle.flies_by_vision or self.fit.is_late:
            return None
        if snapshot.is_armed and not self.is_flown:
            return None
        push_m_s2 = vectors.length_xy(vectors.horizontal(self._wind.push_enu_m_s2))
        return ReckonedPosition(self.position_enu_m, push_m_s2=push_m_s2)

    def _px4_vertical(self, snapshot: Snapshot, now_ns: int) -> VerticalMotion | None:
        """Return PX4's height and vertical speed in the fleet frame; None if not known."""
        if not self.vehicle.mocap_required:
            return self._local_frame.vertical(snapshot, now_ns)

        motion = self.px4_check.motion(now_ns)
        if motion is None:
            return None
        _, _, height_m = motion.position_enu_m
        _, _, climbing_m_s = motion.velocity_enu_m_s
        return VerticalMotion(height_m=height_m, climbing_m_s=climbing_m_s)

    def to_px4(self, setpoint: AttitudeSetpoint) -> AttitudeSetpoint:
        """Convert an attitude setpoint from the fleet frame to PX4's heading."""
        quaternion_wxyz = turned_about_up(setpoint.quaternion_wxyz, -self.heading_offset_rad)
        return AttitudeSetpoint(quaternion_wxyz, setpoint.thrust_frac)

    @property
    def displaced_m(self) -> float:
        """Distance from the take-off spot at a restart that has lost its place [m]; else 0.

        Only a vehicle without a mocap in a fleet without an origin on Earth can lose its place.
        """
        return self._local_frame.displaced_m

    @property
    def jumps(self) -> int:
        """Number of impossible samples in a row."""
        if self._memory is None:
            return self.validator.jumps
        return max(self.validator.jumps, self._memory.rejected_count)

    @property
    def jumped_to_enu_m(self) -> Xyz | None:
        """Position of the newest impossible sample; valid only while :attr:`jumps` is not 0."""
        if self.validator.jumped_to_enu_m is not None:
            return self.validator.jumped_to_enu_m
        return self._rejected_enu_m

    @property
    def age_s(self) -> float:
        """Age of the newest used sample, as of the last update; inf before the first sample."""
        if self._memory is None:
            return math.inf
        return self._memory.last_age_s

    @property
    def is_dead_reckoned(self) -> bool:
        """Whether this agent flies the vehicle by dead reckoning."""
        return self._reckoning.is_on and self.is_flown

    @property
    def position_enu_m(self) -> Xyz:
        """Estimated position as of the last update; zero before the first sample."""
        if self._memory is None:
            return _ZERO
        return self._memory.position_enu_m

    @property
    def velocity_enu_m_s(self) -> Xyz:
        """Estimated velocity as of the last update; zero before the first sample."""
        if self._memory is None:
            return _ZERO
        return self._memory.velocity_enu_m_s

    @property
    def wind_enu_m_s(self) -> tuple[float, float]:
        """Mean velocity of the air, east and north; NaN while it is not known."""
        return wind.wind_enu_m_s(self._wind, self.vehicle.drag_1_s)

    @property
    def gust_m_s2(self) -> float:
        """Standard deviation of the present gusts as an acceleration, per axis."""
        return wind.gust_std_m_s2(self._wind)

    @property
    def gust_m_s(self) -> float:
        """Standard deviation of the present gusts as a velocity; NaN while no wind is known."""
        east_m_s, _ = self.wind_enu_m_s
        if math.isnan(east_m_s):
            return math.nan
        return self.gust_m_s2 / self.vehicle.drag_1_s

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the filter's position per axis [m], including during dead
        reckoning.

        Infinite before the first sample.
        """
        state = self._state(is_dead_reckoned=False)
        if state is None:
            return math.inf
        return state.position_std_m

    def _state(self, *, is_dead_reckoned: bool) -> State | None:
        """Return the estimate as of the last update; None before the first sample."""
        if self._memory is None:
            return None

        state = kalman.state(self._memory, self._yaw_rad, *self._least_std)
        state = wind.widened(state, self._wind, self._params.gust_time_s)
        position_std_m = state.position_std_m
        velocity_std_m_s = state.velocity_std_m_s
        if is_dead_reckoned:
            position_std_m, velocity_std_m_s = self._reckoning.std

        return state._replace(
            position_std_m=min(position_std_m, LARGEST_POSITION_STD_M),
            velocity_std_m_s=min(velocity_std_m_s, LARGEST_VELOCITY_STD_M_S),
        )


def _with_past_height(
    memory: kalman.KalmanMemory, position_enu_m: vectors.Vec3, age_s: float
) -> vectors.Vec3:
    """Return a late position with the height that the vehicle had when it was measured.

    Only the horizontal part of a late position is late, because PX4 measures the height with a
    barometer.
    """
    now_m = kalman.position_at(memory, age_s).z
    then_m = kalman.position_at(memory, age_s + LATE_BY_S).z
    return vectors.Vec3(position_enu_m.x, position_enu_m.y, position_enu_m.z + then_m - now_m)


def normalised(pose: MocapPose) -> MocapPose:
    """Return a mocap pose with a unit quaternion.

    Programs of others may round the quaternions that they publish. A quaternion that is too far
    from a unit quaternion is left as it is, and :meth:`OwnState.add_pose` refuses the pose.
    """
    norm = math.hypot(*pose.quaternion_enu_flu_wxyz)
    is_unit = abs(norm - 1.0) < _UNIT_NORM
    if is_unit or not _is_nearly_unit(norm):
        return pose
    w, x, y, z = pose.quaternion_enu_flu_wxyz
    return replace(pose, quaternion_enu_flu_wxyz=(w / norm, x / norm, y / norm, z / norm))


def _is_nearly_unit(norm: float) -> bool:
    return 0.9 < norm < 1.1


def _heading_gate_rad(vehicle: Vehicle) -> float:
    """Return the largest difference of a camera's heading that PX4 fuses; its own state is exact.

    Source: PX4, ev_yaw_control.cpp of v1.16 and v1.18.
    """
    noise_rad = vehicle.px4_params.get("EKF2_EVA_NOISE", HEADING_NOISE_RAD)
    if vehicle.px4_version in _TAKING_NOISE_AS_VARIANCE:
        noise_rad = math.sqrt(max(noise_rad, 0.0))
    return _HEADING_GATE_SIGMAS * max(noise_rad, _LEAST_HEADING_NOISE_RAD)


def _is_usable(pose: MocapPose) -> bool:
    """Whether a pose has a possible position and a quaternion that is nearly a unit quaternion."""
    return (
        is_finite(pose.position_enu_m, pose.quaternion_enu_flu_wxyz)
        and max(map(abs, pose.position_enu_m)) < _MAX_POSITION_M
        and _is_nearly_unit(math.hypot(*pose.quaternion_enu_flu_wxyz))
    )
