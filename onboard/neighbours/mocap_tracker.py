"""Position and velocity of a silent neighbour from its mocap poses, by a simple filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose, Vec3

_POSITION_SHARE, _VELOCITY_SHARE = 0.5, 0.15  # of the innovation, for samples at 50 Hz
_JUMP_M = 0.5
_GAP_S = 0.3
_LARGEST_M = 1e4
_FUTURE_NS = 5_000_000
POSITION_STD_M, VELOCITY_STD_M_S = 0.01, 0.1


@dataclass(slots=True)
class BodyTracker:
    """Motion of one body in fleet ENU."""

    position_enu_m: Vec3 = (0.0, 0.0, 0.0)
    velocity_enu_m_s: Vec3 = (0.0, 0.0, 0.0)
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
        (x, y, z), (vx, vy, vz) = self.position_enu_m, self.velocity_enu_m_s
        if gap_s < _GAP_S:
            x, y, z = x + gap_s * vx, y + gap_s * vy, z + gap_s * vz
            dx, dy, dz = position[0] - x, position[1] - y, position[2] - z
            if math.hypot(dx, dy, dz) < _JUMP_M:
                a, b = _POSITION_SHARE, _VELOCITY_SHARE / max(gap_s, 0.005)
                self.position_enu_m = (x + a * dx, y + a * dy, z + a * dz)
                self.velocity_enu_m_s = (vx + b * dx, vy + b * dy, vz + b * dz)
                return True
        self.position_enu_m = position  # the first sample, or one after a gap or a jump: only the position counts
        return True
