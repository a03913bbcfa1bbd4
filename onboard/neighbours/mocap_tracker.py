"""Position and velocity of a silent neighbour from its mocap poses, by a simple filter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

from onboard.arrays import Array
from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose, Vec3

# of the innovation, for samples at 50 Hz; chosen on the campaign lost8@dead, seeds 0 to 199
_POSITION_SHARE, _VELOCITY_SHARE, _ACCELERATION_SHARE = 0.35, 0.12, 0.02
_JUMP_M = 0.5
_GAP_S = 0.3
_LEAST_GAP_S = 0.01  # samples that come faster count less each
_LARGEST_M = 1e4
_FUTURE_NS = 5_000_000
POSITION_STD_M, VELOCITY_STD_M_S = 0.01, 0.1

_Axis = TypeVar("_Axis", float, Array)


def corrected(
    position_m: _Axis, velocity_m_s: _Axis, acceleration_m_s2: _Axis, sample_m: _Axis, gap_s: float
) -> tuple[_Axis, _Axis, _Axis]:
    """Return position [m], velocity [m/s] and acceleration [m/s^2] along one axis, or along
    several, after a sample.

    Args:
        position_m, velocity_m_s, acceleration_m_s2: after the sample before.
        sample_m: position that the motion capture sees.
        gap_s: time between the samples.
    """
    moved = gap_s * (velocity_m_s + 0.5 * gap_s * acceleration_m_s2)
    error, counted_s = sample_m - (position_m + moved), max(gap_s, _LEAST_GAP_S)
    return (
        position_m + moved + _POSITION_SHARE * error,
        velocity_m_s + gap_s * acceleration_m_s2 + _VELOCITY_SHARE / counted_s * error,
        acceleration_m_s2 + _ACCELERATION_SHARE / (counted_s * counted_s) * error,
    )


@dataclass(slots=True)
class BodyTracker:
    """Motion of one body in fleet ENU."""

    position_enu_m: Vec3 = (0.0, 0.0, 0.0)
    velocity_enu_m_s: Vec3 = (0.0, 0.0, 0.0)
    acceleration_enu_m_s2: Vec3 = (0.0, 0.0, 0.0)
    stamp_ns: int = 0  # of this motion; 0 before the first sample
    _last_enu_m: Vec3 | None = None

    def hear(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a sample; False for one that is not usable, older, or the same again."""
        position, stamp_ns = pose.position_enu_m, pose.stamp_ns
        if not (pose.is_tracked and is_finite(position) and max(map(abs, position)) < _LARGEST_M):
            return False
        if position == self._last_enu_m:
            return False  # a tracked body always has noise: this one is lost
        self._last_enu_m = position
        if not self.stamp_ns < stamp_ns <= received_ns + _FUTURE_NS:
            return False
        gap_s = (stamp_ns - self.stamp_ns) * 1e-9
        self.stamp_ns = stamp_ns
        motion = self.position_enu_m, self.velocity_enu_m_s, self.acceleration_enu_m_s2
        if gap_s < _GAP_S and math.dist(position, self._expected(gap_s)) < _JUMP_M:
            (x, vx, ax), (y, vy, ay), (z, vz, az) = (
                corrected(*axis, gap_s) for axis in zip(*motion, position, strict=True)
            )
            self.position_enu_m = (x, y, z)
            self.velocity_enu_m_s, self.acceleration_enu_m_s2 = (vx, vy, vz), (ax, ay, az)
            return True
        self.acceleration_enu_m_s2 = (0.0, 0.0, 0.0)
        # the first sample, or one after a gap or a jump: only the position counts
        self.position_enu_m = position
        return True

    def _expected(self, gap_s: float) -> Vec3:
        (x, y, z), (vx, vy, vz) = self.position_enu_m, self.velocity_enu_m_s
        return x + gap_s * vx, y + gap_s * vy, z + gap_s * vz
