"""Is a body's stream of poses believable? Jumps, repetitions, lateness and clocks that jump. Pure, no clock of its own.

The estimator has a gate of its own, wide enough for a stalled process. This watch is narrower: between two samples a
vehicle moves only as far as it can accelerate. What it does not believe never reaches the estimate, nor PX4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from operator import mul

Vec3 = tuple[float, float, float]
Vec4 = tuple[float, float, float, float]

_LATE_SHARE = 0.2  # of a new sample in the low-passed delay: five samples
_ON_ITS_WAY_M, _ON_ITS_WAY_S = 0.3, 0.5  # a single wild sample must not cost the good ones after it
_NOISE_SHARE = 0.05
_VELOCITY_SHARE = 0.3
_NOISE_RAD = 0.3


class PoseVerdict(IntEnum):
    """What is wrong with a sample."""

    ACCEPTED = 0
    JUMPED = 1  # farther than the vehicle can have moved
    FROZEN = 2  # the same numbers again and again


@dataclass(frozen=True, slots=True)
class PoseBounds:
    """Bounds of a believable body.

    max_speed_m_s, max_acceleration_m_s2: what a vehicle can do, with reserve for gusts and knocks. max_turn_rad_s: of
    the attitude. noise_m: least noise of a sample; more is learned. frozen_after_s: for so long may bit-identical
    samples come; a tracked body always has noise. late_after_s: mean delay from which on samples are late.
    clock_jump_s: change of the delay that lasts for clock_jump_lasts_s: what only came late, as on a machine that is
    too busy, is soon in time again.
    """

    max_speed_m_s: float = 6.0
    max_acceleration_m_s2: float = 15.0
    noise_m: float = 0.01
    max_turn_rad_s: float = 12.0
    frozen_after_s: float = 0.075
    late_after_s: float = 0.09
    clock_jump_s: float = 0.25
    clock_jump_lasts_s: float = 0.3


@dataclass(slots=True)
class PoseValidator:
    """Follows one body; ``hear`` every usable sample in the order of their stamps.

    jumps: samples in a row that were no possible movement; jumped_to_enu_m: where the last of them lay. frozen_s: how
    long the same numbers have come. delay_s: mean time from measurement to arrival. clock_jump_ns: when the delay
    changed so much that a clock must have jumped; 0 never.
    """

    bounds: PoseBounds = field(default_factory=PoseBounds)
    jumps: int = 0
    jumped_to_enu_m: Vec3 | None = None
    frozen_s: float = 0.0
    delay_s: float = 0.0
    clock_jump_ns: int = 0
    _position: Vec3 = (0.0, 0.0, 0.0)
    _velocity: Vec3 = (0.0, 0.0, 0.0)
    _quaternion: Vec4 = (1.0, 0.0, 0.0, 0.0)
    _stamp_ns: int = 0
    _last: tuple[Vec3, Vec4] | None = None
    _same_since_ns: int = 0
    _usual_delay_s: float = 0.0
    _unusual_since_ns: int = 0
    _noise_m: float = 0.0

    @property
    def is_frozen(self) -> bool:
        """Whether the newest samples say nothing."""
        return self.frozen_s > self.bounds.frozen_after_s

    @property
    def is_late(self) -> bool:
        """Whether samples come later than they should."""
        return self.delay_s > self.bounds.late_after_s

    def hear(
        self,
        position_enu_m: Vec3,
        quaternion_wxyz: Vec4,
        stamp_ns: int,
        received_ns: int,
        *,
        is_contradicted: bool = False,
    ) -> PoseVerdict:
        """Judge one sample; a faulty one does not move the expectation.

        The reach grows with the time since the last believed sample, so that a body that really is elsewhere after a
        gap is believed again; after a jump only when no other source contradicts.
        """
        bounds = self.bounds
        delay_s = (received_ns - stamp_ns) * 1e-9
        sample = (position_enu_m, quaternion_wxyz)
        if self._last is None:
            self._same_since_ns, self.delay_s, self._usual_delay_s = stamp_ns, delay_s, delay_s
        self._follow_clock(delay_s, received_ns)
        self.delay_s += _LATE_SHARE * (delay_s - self.delay_s)
        if sample != self._last:
            self._same_since_ns = stamp_ns
        self._last = sample
        self.frozen_s = (stamp_ns - self._same_since_ns) * 1e-9
        if self.is_frozen:
            return PoseVerdict.FROZEN
        gap_s = (stamp_ns - self._stamp_ns) * 1e-9
        if self._stamp_ns and gap_s <= 0.0:
            self._stamp_ns = 0  # another clock from here on: what was expected means nothing
        if self._stamp_ns:
            x, y, z = position_enu_m
            (px, py, pz), (vx, vy, vz) = self._position, self._velocity
            dx, dy, dz = x - px, y - py, z - pz
            speed_2 = vx * vx + vy * vy + vz * vz
            along = (dx * vx + dy * vy + dz * vz) / (gap_s * speed_2) if speed_2 > 0.01 else 1.0
            # who hits something stops at once: anywhere on the way is as possible as its end
            gone_s = gap_s * min(max(along, 0.0), 1.0)
            miss_m = math.hypot(dx - gone_s * vx, dy - gone_s * vy, dz - gone_s * vz)
            noise_m = max(bounds.noise_m, self._noise_m)
            reach_m = 6.0 * noise_m + min(0.5 * bounds.max_acceleration_m_s2 * gap_s, bounds.max_speed_m_s) * gap_s
            cosine = abs(sum(map(mul, quaternion_wxyz, self._quaternion)))  # of half the angle between both
            turn_rad = min(_NOISE_RAD + bounds.max_turn_rad_s * gap_s, math.pi)
            is_on_its_way = miss_m < _ON_ITS_WAY_M and gap_s < _ON_ITS_WAY_S
            is_doubted = self.jumps > 0 and is_contradicted and not is_on_its_way
            if is_doubted or miss_m > reach_m or cosine < math.cos(0.5 * turn_rad):
                self.jumps += 1
                self.jumped_to_enu_m = position_enu_m
                return PoseVerdict.JUMPED
            self._noise_m += _NOISE_SHARE * (miss_m - self._noise_m)
            k = _VELOCITY_SHARE
            self._velocity = (vx + k * (dx / gap_s - vx), vy + k * (dy / gap_s - vy), vz + k * (dz / gap_s - vz))
        else:
            self._velocity = (0.0, 0.0, 0.0)
        self._position, self._quaternion, self._stamp_ns = position_enu_m, quaternion_wxyz, stamp_ns
        self.jumps, self.jumped_to_enu_m = 0, None
        return PoseVerdict.ACCEPTED

    def _follow_clock(self, delay_s: float, received_ns: int) -> None:
        if abs(delay_s - self._usual_delay_s) <= self.bounds.clock_jump_s:
            self._usual_delay_s, self._unusual_since_ns = delay_s, 0
            return
        self._unusual_since_ns = self._unusual_since_ns or received_ns
        if received_ns - self._unusual_since_ns >= self.bounds.clock_jump_lasts_s * 1e9:
            self.clock_jump_ns, self._usual_delay_s, self._unusual_since_ns = received_ns, delay_s, 0
