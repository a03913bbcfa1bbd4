"""Checks the mocap poses of a body before they are used. Pure.

The validator detects jumps, repetitions, late samples, clocks that jump, and old samples after an
outage. It also detects a heading that PX4's attitude does not explain: a body whose markers form
a symmetric pattern may be seen turned. The Kalman filter also has a gate for jumps, but it is wide
because a process may stall. The validator is stricter. It allows only the distance that the
vehicle's acceleration permits between two samples. A rejected sample reaches neither the estimate
nor PX4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from operator import mul
from typing import NamedTuple

from onboard.frames import turn_about_up_rad
from onboard.tuples import Wxyz, Xyz

# weights of a new sample in low-passed values
_DELAY_WEIGHT = 0.2
_NOISE_WEIGHT = 0.05
_VELOCITY_WEIGHT = 0.3

# After a jump, a sample may continue the path from before the jump: it is within _ON_PATH_M of that
# path, and comes within _ON_PATH_S after the last accepted sample. It is accepted even if PX4
# contradicts it, because a single wrong sample must not exclude the good samples after it.
_ON_PATH_M = 0.3
_ON_PATH_S = 0.5

_NOISE_RAD = 0.3  # noise of the attitude
_NOISES = 6.0  # largest distance from the expected path, in multiples of the noise
_MIN_SPEED_2_M2_S2 = 0.01  # square of 0.1 m/s; a slower velocity has no clear direction

# After an outage, the first sample may be an old one with a new stamp, and the vehicle may have
# moved anywhere. So samples are accepted only once this many in a row agree with each other.
_CONFIRMED_BY = 2
_CONFIRMED_AGAINST_PX4_BY = 25  # the same if PX4's position contradicts them: half a second
# After an outage shorter than this, PX4's position is still right, and samples that it contradicts
# are not accepted.
_SHORT_OUTAGE_S = 1.0
_STEP_M = 0.5  # no vehicle that people carry moves so far between two samples


class PoseVerdict(IntEnum):
    """Result of the check of one sample."""

    ACCEPTED = 0
    JUMPED = 1  # farther away than the vehicle can have moved
    FROZEN = 2  # the same numbers for too long
    UNCONFIRMED = 3  # one of the first samples after an outage


class Px4Evidence(NamedTuple):
    """Evidence of PX4's own estimate about a sample."""

    # whether PX4's position is somewhere else; None: PX4's position is not known
    is_contradicted: bool | None = None
    is_after_landing: bool = False  # whether the vehicle stands on the ground, and has flown
    # change of the heading since the last accepted sample minus that of PX4's heading
    heading_jump_rad: float = 0.0


_NO_EVIDENCE = Px4Evidence()


@dataclass(frozen=True, slots=True)
class PoseBounds:
    """Bounds of possible motions and of usual samples."""

    max_speed_m_s: float = 6.0  # includes a reserve for gusts and collisions
    max_acceleration_m_s2: float = 15.0  # includes a reserve for gusts and collisions
    noise_m: float = 0.01  # least noise of a sample; a larger noise is learned
    max_turn_rad_s: float = 12.0  # largest angular rate
    # largest turn that PX4's attitude does not explain, and its growth in an outage, in which PX4's
    # heading may drift
    max_heading_jump_rad: float = math.radians(20.0)
    heading_drift_rad_s: float = math.radians(1.0)
    outage_s: float = 0.2  # after this time without an accepted sample, samples must be confirmed
    # after this time, identical samples mean a lost body, because a tracked body always has noise
    frozen_after_s: float = 0.075
    late_after_s: float = 0.09  # samples are late if their mean delay exceeds this
    # A clock has jumped if the delay changes by more than clock_jump_s for at least
    # clock_jump_lasts_s. On a busy machine, samples are late only briefly.
    clock_jump_s: float = 0.25
    clock_jump_lasts_s: float = 0.3


@dataclass(slots=True)
class PoseValidator:
    """Validator of one body. Call :meth:`judge` with each usable sample, in order of stamps."""

    bounds: PoseBounds = field(default_factory=PoseBounds)

    jumps: int = 0  # number of impossible samples in a row
    jumped_to_enu_m: Xyz | None = None  # position of the newest impossible sample; None: no jump
    # whether the newest samples are not accepted because PX4's position is somewhere else
    is_contradicted: bool = False
    frozen_s: float = 0.0  # how long the same numbers have been arriving
    delay_s: float = 0.0  # mean time from measurement to arrival
    clock_jump_ns: int = 0  # time of the last jump of a clock; 0: never
    # how often a sample was accepted that may be of another body, or of a source with another frame
    doubts: int = 0

    # the last accepted sample; the stamp is 0 without one, and after a jump back of the stamps
    _position: Xyz | None = None
    _velocity: Xyz = (0.0, 0.0, 0.0)
    _quaternion: Wxyz = (1.0, 0.0, 0.0, 0.0)
    _stamp_ns: int = 0

    # the newest sample that was not frozen, and how many samples in a row up to this one agree with
    # each other; needed after an outage
    _candidate: Xyz = (0.0, 0.0, 0.0)
    _candidate_ns: int = 0
    _agreeing: int = 0
    _agreeing_since_ns: int = 0  # stamp of the first of them

    _last: tuple[Xyz, Wxyz] | None = None  # position and attitude of the newest sample of all
    _same_since_ns: int = 0  # stamp of the first sample with these numbers
    _usual_delay_s: float = 0.0
    _unusual_since_ns: int = 0  # since when the delay is unusual; 0: it is usual
    _noise_m: float = 0.0  # learned noise of a position

    @property
    def is_frozen(self) -> bool:
        """Whether the same numbers have been arriving for too long."""
        return self.frozen_s > self.bounds.frozen_after_s

    @property
    def is_late(self) -> bool:
        """Whether the mean delay of samples is too long."""
        return self.delay_s > self.bounds.late_after_s

    def judge(
        self,
        position_enu_m: Xyz,
        quaternion_wxyz: Wxyz,
        stamp_ns: int,
        received_ns: int,
        *,
        evidence: Px4Evidence = _NO_EVIDENCE,
    ) -> PoseVerdict:
        """Return the verdict on one sample. A rejected sample does not change the expected path.

        The allowed distance grows with the time since the last accepted sample, so a body that
        moved in a gap is accepted again. After a jump or a short outage, this is so only if PX4's
        own position does not contradict the sample.
        """
        self._update_delay(stamp_ns, received_ns)
        self._update_repetitions(position_enu_m, quaternion_wxyz, stamp_ns)
        if self.is_frozen:
            return PoseVerdict.FROZEN

        gap_s = (stamp_ns - self._stamp_ns) * 1e-9
        if self._stamp_ns and gap_s <= 0.0:
            self._stamp_ns = 0  # the source's clock has changed, so the expected path is not valid

        silence_s = (stamp_ns - self._candidate_ns) * 1e-9
        if evidence.is_after_landing and silence_s > _SHORT_OUTAGE_S:
            self.jumps = 0  # people may have carried it, and covered its markers

        agreeing = self._count_agreeing(position_enu_m, stamp_ns)
        outage_s = max(0.0, (self._agreeing_since_ns - self._stamp_ns) * 1e-9)
        # a gap during jumps is not an outage, because samples arrived and were rejected
        is_after_outage = gap_s > self.bounds.outage_s and self.jumps == 0
        if self._stamp_ns and is_after_outage:
            needed = _CONFIRMED_BY
            if evidence.is_contradicted:
                needed = _CONFIRMED_AGAINST_PX4_BY
                if outage_s < _SHORT_OUTAGE_S:
                    self.is_contradicted = True
                    return PoseVerdict.UNCONFIRMED
            if agreeing < needed:
                return PoseVerdict.UNCONFIRMED

        if not self._stamp_ns:
            self._velocity = (0.0, 0.0, 0.0)
        elif not self._is_possible(position_enu_m, quaternion_wxyz, gap_s, outage_s, evidence):
            self.jumps += 1
            self.jumped_to_enu_m = position_enu_m
            return PoseVerdict.JUMPED

        if self._is_doubtful(position_enu_m, evidence, is_after_outage=is_after_outage):
            self.doubts += 1
        self._position = position_enu_m
        self._quaternion = quaternion_wxyz
        self._stamp_ns = stamp_ns
        self.jumps = 0
        self.jumped_to_enu_m = None
        self.is_contradicted = False
        return PoseVerdict.ACCEPTED

    def _update_delay(self, stamp_ns: int, received_ns: int) -> None:
        """Update the mean delay of the samples, and detect a jump of a clock."""
        delay_s = (received_ns - stamp_ns) * 1e-9
        if self._last is None:
            self.delay_s = delay_s
            self._usual_delay_s = delay_s

        self._notice_clock_jump(delay_s, received_ns)
        self.delay_s += _DELAY_WEIGHT * (delay_s - self.delay_s)

    def _notice_clock_jump(self, delay_s: float, received_ns: int) -> None:
        """Record a jump of a clock once the delay has been unusual for long enough."""
        if abs(delay_s - self._usual_delay_s) <= self.bounds.clock_jump_s:
            self._usual_delay_s = delay_s
            self._unusual_since_ns = 0
            return

        if self._unusual_since_ns == 0:
            self._unusual_since_ns = received_ns
        if received_ns - self._unusual_since_ns >= self.bounds.clock_jump_lasts_s * 1e9:
            self.clock_jump_ns = received_ns
            self._usual_delay_s = delay_s
            self._unusual_since_ns = 0

    def _update_repetitions(self, position: Xyz, quaternion: Wxyz, stamp_ns: int) -> None:
        """Update how long the same pose has been arriving."""
        sample = (position, quaternion)
        if sample != self._last:
            self._same_since_ns = stamp_ns
        self._last = sample
        self.frozen_s = (stamp_ns - self._same_since_ns) * 1e-9

    def _count_agreeing(self, position: Xyz, stamp_ns: int) -> int:
        """Return the number of samples in a row that agree with each other, including this one."""
        gap_s = (stamp_ns - self._candidate_ns) * 1e-9
        noise_m = max(self.bounds.noise_m, self._noise_m)
        reach_m = _NOISES * noise_m + self.bounds.max_speed_m_s * max(0.0, gap_s)
        if gap_s < self.bounds.outage_s and math.dist(position, self._candidate) < reach_m:
            self._agreeing += 1
        else:
            self._agreeing = 1
            self._agreeing_since_ns = stamp_ns
        self._candidate = position
        self._candidate_ns = stamp_ns
        return self._agreeing

    def _is_doubtful(self, position: Xyz, evidence: Px4Evidence, *, is_after_outage: bool) -> bool:
        """Return whether an accepted sample may be of another body, or in another frame."""
        if self._position is None:
            return False
        if evidence.is_contradicted is not None:
            return is_after_outage and evidence.is_contradicted
        return math.dist(position, self._position) > _STEP_M

    def _is_possible(
        self,
        position: Xyz,
        quaternion: Wxyz,
        gap_s: float,
        outage_s: float,
        evidence: Px4Evidence,
    ) -> bool:
        """Whether the vehicle can have moved to this pose since the last accepted one.

        If it can, the velocity and the noise are updated.

        Args:
            position: position of the sample.
            quaternion: its attitude.
            gap_s: time since the last accepted sample.
            outage_s: part of that time in which no sample arrived.
            evidence: PX4's own estimate.
        """
        assert self._position is not None
        bounds = self.bounds
        x, y, z = position
        last_x, last_y, last_z = self._position
        vx, vy, vz = self._velocity
        dx = x - last_x
        dy = y - last_y
        dz = z - last_z

        # The expected path continues with the last velocity. The miss is the distance to the
        # nearest point of the path, not to its end, because a vehicle that hits something stops at
        # once.
        squared_speed_m2_s2 = vx * vx + vy * vy + vz * vz
        share_of_path = 1.0
        if squared_speed_m2_s2 > _MIN_SPEED_2_M2_S2:
            share_of_path = (dx * vx + dy * vy + dz * vz) / (gap_s * squared_speed_m2_s2)
        flown_s = gap_s * min(max(share_of_path, 0.0), 1.0)
        miss_m = math.hypot(dx - flown_s * vx, dy - flown_s * vy, dz - flown_s * vz)

        noise_m = max(bounds.noise_m, self._noise_m)
        gained_m_s = min(0.5 * bounds.max_acceleration_m_s2 * gap_s, bounds.max_speed_m_s)
        reach_m = _NOISES * noise_m + gained_m_s * gap_s
        if miss_m > reach_m:
            return False

        # the scalar product of two unit quaternions is the cosine of half the angle between them
        half_turn_cosine = abs(sum(map(mul, quaternion, self._quaternion)))
        reach_rad = min(_NOISE_RAD + bounds.max_turn_rad_s * gap_s, math.pi)
        if half_turn_cosine < math.cos(0.5 * reach_rad):
            return False

        largest_jump_rad = bounds.max_heading_jump_rad + bounds.heading_drift_rad_s * outage_s
        if abs(evidence.heading_jump_rad) > largest_jump_rad:
            turned_rad = turn_about_up_rad(quaternion, self._quaternion)
            if abs(turned_rad) > largest_jump_rad:  # otherwise PX4's heading has jumped
                return False

        # After a jump, a sample within reach may still be wrong. It is rejected if PX4 contradicts
        # it, unless it continues the path from before the jump. A vehicle that stands after a
        # landing must be where it stood.
        is_on_path = miss_m < _ON_PATH_M and gap_s < _ON_PATH_S
        if self.jumps > 0 and evidence.is_contradicted and not is_on_path:
            return False
        is_where_it_stood = math.hypot(dx, dy, dz) < _ON_PATH_M
        if self.jumps > 0 and evidence.is_after_landing and not is_where_it_stood:
            return False

        self._noise_m += _NOISE_WEIGHT * (miss_m - self._noise_m)
        self._velocity = (
            vx + _VELOCITY_WEIGHT * (dx / gap_s - vx),
            vy + _VELOCITY_WEIGHT * (dy / gap_s - vy),
            vz + _VELOCITY_WEIGHT * (dz / gap_s - vz),
        )
        return True
