"""Whether a body's stream of poses is believable: jumps, repetitions, lateness, clocks that jump.
Pure.

The estimator has a gate of its own, wide enough for a stalled process. This validator is narrower:
between two samples a vehicle moves only as far as it can accelerate. A rejected sample reaches
neither the estimate nor PX4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from operator import mul

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]

_LATE_SHARE = 0.2  # of a new sample in the low-passed delay: five samples
_ON_PATH_M, _ON_PATH_S = 0.3, 0.5  # a single wild sample must not cost the good ones after it
_NOISE_SHARE = 0.05
_VELOCITY_SHARE = 0.3
_NOISE_RAD = 0.3


class PoseVerdict(IntEnum):
    """Judgement of one sample."""

    ACCEPTED = 0
    JUMPED = 1  # farther than the vehicle can have moved
    FROZEN = 2  # the same numbers again and again


@dataclass(frozen=True, slots=True)
class PoseBounds:
    """Bounds of a believable body."""

    max_speed_m_s: float = 6.0  # of a vehicle, with reserve for gusts and knocks
    max_acceleration_m_s2: float = 15.0  # of a vehicle, with reserve for gusts and knocks
    noise_m: float = 0.01  # least noise of a sample; more is learned
    max_turn_rad_s: float = 12.0  # of the attitude
    # for so long bit-identical samples may come; a tracked body always has noise
    frozen_after_s: float = 0.075
    late_after_s: float = 0.09  # mean delay above which samples are late
    clock_jump_s: float = 0.25  # change of the delay that shows a jump of a clock, if it lasts
    # samples that are only late, as on a busy machine, are soon in time again
    clock_jump_lasts_s: float = 0.3


@dataclass(slots=True)
class PoseValidator:
    """Memory of one body; :meth:`judge` every usable sample in the order of their stamps."""

    bounds: PoseBounds = field(default_factory=PoseBounds)
    jumps: int = 0  # samples in a row that were no possible movement
    jumped_to_enu_m: Vec3 | None = None  # position of the last of them
    frozen_s: float = 0.0  # for so long the same numbers have come
    delay_s: float = 0.0  # mean time from measurement to arrival
    clock_jump_ns: int = 0  # when the delay changed so much that a clock must have jumped; 0 never
    _position: Vec3 = (0.0, 0.0, 0.0)  # of the last accepted sample
    _velocity: Vec3 = (0.0, 0.0, 0.0)
    _quaternion: Vec4 = (1.0, 0.0, 0.0, 0.0)
    _stamp_ns: int = 0  # of the last accepted sample; 0 without one
    _last: tuple[Vec3, Vec4] | None = None  # newest sample, accepted or not
    _same_since_ns: int = 0
    _usual_delay_s: float = 0.0
    _unusual_since_ns: int = 0
    _noise_m: float = 0.0

    @property
    def is_frozen(self) -> bool:
        """Whether the newest samples are repetitions."""
        return self.frozen_s > self.bounds.frozen_after_s

    @property
    def is_late(self) -> bool:
        """Whether samples come later than they should."""
        return self.delay_s > self.bounds.late_after_s

    def judge(
        self,
        position_enu_m: Vec3,
        quaternion_wxyz: Vec4,
        stamp_ns: int,
        received_ns: int,
        *,
        is_contradicted: bool = False,
    ) -> PoseVerdict:
        """Judge one sample; a rejected one does not change the expected motion.

        The reach grows with the time since the last accepted sample, so that a body that really is
        elsewhere after a gap is accepted again; after a jump only if PX4's own position does not
        contradict it (``is_contradicted``).
        """
        if self._is_repetition(position_enu_m, quaternion_wxyz, stamp_ns, received_ns):
            return PoseVerdict.FROZEN
        gap_s = (stamp_ns - self._stamp_ns) * 1e-9
        if self._stamp_ns and gap_s <= 0.0:
            self._stamp_ns = 0  # another clock from here on: the expected motion is void
        if not self._stamp_ns:
            self._velocity = (0.0, 0.0, 0.0)
        elif not self._is_possible(position_enu_m, quaternion_wxyz, gap_s, is_contradicted):
            self.jumps += 1
            self.jumped_to_enu_m = position_enu_m
            return PoseVerdict.JUMPED
        self._position, self._quaternion, self._stamp_ns = position_enu_m, quaternion_wxyz, stamp_ns
        self.jumps, self.jumped_to_enu_m = 0, None
        return PoseVerdict.ACCEPTED

    def _is_repetition(
        self, position: Vec3, quaternion: Vec4, stamp_ns: int, received_ns: int
    ) -> bool:
        """Whether the same numbers have come for too long; follows the delay, too."""
        delay_s = (received_ns - stamp_ns) * 1e-9
        if self._last is None:
            self._same_since_ns, self.delay_s, self._usual_delay_s = stamp_ns, delay_s, delay_s
        self._follow_clock(delay_s, received_ns)
        self.delay_s += _LATE_SHARE * (delay_s - self.delay_s)
        if (position, quaternion) != self._last:
            self._same_since_ns = stamp_ns
        self._last = position, quaternion
        self.frozen_s = (stamp_ns - self._same_since_ns) * 1e-9
        return self.is_frozen

    def _is_possible(
        self, position: Vec3, quaternion: Vec4, gap_s: float, is_contradicted: bool
    ) -> bool:
        """Whether the vehicle can have moved so within ``gap_s``; learns velocity and noise if so."""
        bounds = self.bounds
        x, y, z = position
        (px, py, pz), (vx, vy, vz) = self._position, self._velocity
        dx, dy, dz = x - px, y - py, z - pz
        speed_2 = vx * vx + vy * vy + vz * vz
        along = (dx * vx + dy * vy + dz * vz) / (gap_s * speed_2) if speed_2 > 0.01 else 1.0
        # a vehicle that hits something stops at once: any point on the expected path is as possible
        # as its end
        flown_s = gap_s * min(max(along, 0.0), 1.0)
        miss_m = math.hypot(dx - flown_s * vx, dy - flown_s * vy, dz - flown_s * vz)
        noise_m = max(bounds.noise_m, self._noise_m)
        reach_m = (
            6.0 * noise_m
            + min(0.5 * bounds.max_acceleration_m_s2 * gap_s, bounds.max_speed_m_s) * gap_s
        )
        cosine = abs(sum(map(mul, quaternion, self._quaternion)))  # of half the angle between both
        turn_rad = min(_NOISE_RAD + bounds.max_turn_rad_s * gap_s, math.pi)
        is_on_path = miss_m < _ON_PATH_M and gap_s < _ON_PATH_S
        is_doubted = self.jumps > 0 and is_contradicted and not is_on_path
        if is_doubted or miss_m > reach_m or cosine < math.cos(0.5 * turn_rad):
            return False
        self._noise_m += _NOISE_SHARE * (miss_m - self._noise_m)
        k = _VELOCITY_SHARE
        self._velocity = (
            vx + k * (dx / gap_s - vx),
            vy + k * (dy / gap_s - vy),
            vz + k * (dz / gap_s - vz),
        )
        return True

    def _follow_clock(self, delay_s: float, received_ns: int) -> None:
        if abs(delay_s - self._usual_delay_s) <= self.bounds.clock_jump_s:
            self._usual_delay_s, self._unusual_since_ns = delay_s, 0
            return
        self._unusual_since_ns = self._unusual_since_ns or received_ns
        if received_ns - self._unusual_since_ns >= self.bounds.clock_jump_lasts_s * 1e9:
            self.clock_jump_ns, self._usual_delay_s, self._unusual_since_ns = (
                received_ns,
                delay_s,
                0,
            )
