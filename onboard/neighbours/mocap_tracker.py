"""Estimates the motion of a neighbour from its mocap poses, by an alpha-beta-gamma filter.

The estimate is used for overdue and watched neighbours. Three constants give the shares of the
innovation that correct position, velocity and acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

from onboard.arrays import Array
from onboard.bus.codec import is_finite
from onboard.bus.schema import MocapPose
from onboard.tuples import Xyz

POSITION_STD_M = 0.01
VELOCITY_STD_M_S = 0.1

# for samples at 50 Hz; chosen by a Monte Carlo campaign (lost8@dead, seeds 0 to 199)
_POSITION_SHARE = 0.35
_VELOCITY_SHARE = 0.12
_ACCELERATION_SHARE = 0.02

_JUMP_M = 0.5  # a sample farther from the expected position is a jump
_GAP_S = 0.3  # after a longer gap, the filter restarts
# A shorter gap counts as this. Velocity and acceleration are corrected by the innovation divided by
# the gap, so the noise of faster samples would change them too much.
_MIN_GAP_S = 0.01
_LARGEST_M = 1e4
_FUTURE_NS = 5_000_000  # a stamp may be ahead of our clock by this time

_Axis = TypeVar("_Axis", float, Array)


def corrected(
    position_m: _Axis, velocity_m_s: _Axis, acceleration_m_s2: _Axis, sample_m: _Axis, gap_s: float
) -> tuple[_Axis, _Axis, _Axis]:
    """Return the motion after a sample, along one axis or along several.

    Args:
        position_m, velocity_m_s, acceleration_m_s2: motion after the previous sample.
        sample_m: position of the new sample.
        gap_s: time between the two samples.
    Returns:
        Position [m], velocity [m/s] and acceleration [m/s^2] after the new sample.
    """
    moved_m = gap_s * (velocity_m_s + 0.5 * gap_s * acceleration_m_s2)
    innovation_m = sample_m - (position_m + moved_m)
    divisor_s = max(gap_s, _MIN_GAP_S)
    return (
        position_m + moved_m + _POSITION_SHARE * innovation_m,
        velocity_m_s + gap_s * acceleration_m_s2 + _VELOCITY_SHARE / divisor_s * innovation_m,
        acceleration_m_s2 + _ACCELERATION_SHARE / (divisor_s * divisor_s) * innovation_m,
    )


@dataclass(slots=True)
class BodyTracker:
    """Motion of one body in fleet ENU."""

    position_enu_m: Xyz = (0.0, 0.0, 0.0)
    velocity_enu_m_s: Xyz = (0.0, 0.0, 0.0)
    acceleration_enu_m_s2: Xyz = (0.0, 0.0, 0.0)
    stamp_ns: int = 0  # stamp of this motion; 0 before the first sample
    has_velocity: bool = False  # whether the velocity comes from two samples, or from a message
    _last_enu_m: Xyz | None = None  # newest sample, usable or not

    def hear(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a sample; return False if it is not usable, not newer, or an exact repetition."""
        position_enu_m = pose.position_enu_m
        if not pose.is_tracked or not is_finite(position_enu_m):
            return False
        if not max(map(abs, position_enu_m)) < _LARGEST_M:
            return False

        # a tracked body always has noise, so an exact repetition means that the body is lost
        if position_enu_m == self._last_enu_m:
            return False
        self._last_enu_m = position_enu_m

        if not self.stamp_ns < pose.stamp_ns <= received_ns + _FUTURE_NS:
            return False
        gap_s = (pose.stamp_ns - self.stamp_ns) * 1e-9
        self.stamp_ns = pose.stamp_ns

        is_next = gap_s < _GAP_S and math.dist(position_enu_m, self._expected(gap_s)) < _JUMP_M
        if is_next and self.has_velocity:
            self._correct(position_enu_m, gap_s)
        elif is_next:
            self._begin_motion(position_enu_m, gap_s)
        else:
            # At the first sample, and after a gap or a jump, the filter restarts at the sample. The
            # last velocity is still the best guess.
            self.position_enu_m = position_enu_m
            self.acceleration_enu_m_s2 = (0.0, 0.0, 0.0)
        return True

    def _begin_motion(self, sample_enu_m: Xyz, gap_s: float) -> None:
        """Take the velocity from the first two samples.

        The filter would need a third of a second to find it, and overshoot.
        """
        x, y, z = self.position_enu_m
        new_x, new_y, new_z = sample_enu_m
        divisor_s = max(gap_s, _MIN_GAP_S)
        self.velocity_enu_m_s = (
            (new_x - x) / divisor_s,
            (new_y - y) / divisor_s,
            (new_z - z) / divisor_s,
        )
        self.position_enu_m = sample_enu_m
        self.has_velocity = True

    def _correct(self, sample_enu_m: Xyz, gap_s: float) -> None:
        """Correct the motion along each axis with a sample."""
        axes = zip(
            self.position_enu_m,
            self.velocity_enu_m_s,
            self.acceleration_enu_m_s2,
            sample_enu_m,
            strict=True,
        )
        (x, vx, ax), (y, vy, ay), (z, vz, az) = (corrected(*axis, gap_s) for axis in axes)

        self.position_enu_m = (x, y, z)
        self.velocity_enu_m_s = (vx, vy, vz)
        self.acceleration_enu_m_s2 = (ax, ay, az)

    def _expected(self, gap_s: float) -> Xyz:
        """Return where the body would be at constant velocity."""
        x, y, z = self.position_enu_m
        vx, vy, vz = self.velocity_enu_m_s
        return x + gap_s * vx, y + gap_s * vy, z + gap_s * vz
