"""Checks whether PX4's positions fit the vehicle's motion, and detects late receivers. Pure.

Attitude and throttle give the acceleration of the vehicle ("driven" below). If a receiver's
positions are late, they contradict the driven acceleration whenever the velocity changes. A vehicle
that uses late positions overshoots, and circles around its goal. There are two measures.

* The lateness: PX4's velocity gives the measured acceleration. It is compared with the present
  driven acceleration (error e_now), and with the driven acceleration 0.36 s ago (error e_then). If
  positions are late, e_then is smaller. The lateness is e_now^2 - e_then^2, integrated over some
  seconds. Mean accelerations are subtracted first, so neither wind nor a wrong thrust counts.
* The miss: the root mean square of the filter's horizontal innovations over a second.

Positions that drift slowly fit any motion, so they are not detected. A wrong heading is not
detected either, because PX4 rotates its integrated accelerations by the same error. PX4 corrects
its heading by itself.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from onboard.vectors import ZERO_3, Vec3, add_scaled, bounded, scaled, subtract

# Late positions are assumed to be this old, and the filter remembers its states for this time. If
# they are newer than this, the vehicle flies well. If they are older, it continues to circle.
LATE_BY_S = 0.5
# Positions are late if the lateness is larger than this. In simulated flights, it stayed below 3.4
# with punctual positions, and with positions half a second late it exceeded this after 2 s.
LATE_M2_S3 = 6.0

_LAG_TICKS = 18  # from the past driven acceleration to the present one: 0.36 s
_MISS_S = 1.0  # averaging time of the miss
_LATENESS_S = 5.0  # time constant for forgetting the lateness
_MEAN_S = 2.0  # averaging time of the mean accelerations
_LONGEST_GAP_S = 0.1  # a velocity change over a longer gap is not used
_LARGEST_M_S2 = 10.0  # bound of each axis; a larger acceleration is a jump of PX4's estimate


def _zero_accelerations() -> deque[Vec3]:
    return deque([ZERO_3] * (_LAG_TICKS + 1), maxlen=_LAG_TICKS + 1)


@dataclass(slots=True)
class MotionFit:
    """Fit of one vehicle. Call :meth:`drive` at each tick, and :meth:`step` with each position."""

    drag_1_s: float = 0.0  # linear drag of the vehicle
    is_late: bool = False  # whether positions have been found late since the take-off
    lateness_m2_s3: float = 0.0
    _mean_square_m2: float = 0.0  # mean squared horizontal innovation

    # driven accelerations of the last ticks, oldest first
    _driven_enu_m_s2: deque[Vec3] = field(default_factory=_zero_accelerations)
    _stamp_ns: int = 0  # time of the last position
    _velocity_enu_m_s: Vec3 = ZERO_3  # velocity that came with the last position
    _measured_mean_m_s2: Vec3 = ZERO_3  # mean acceleration from PX4's velocity
    _driven_mean_m_s2: Vec3 = ZERO_3
    _time_s: float = 0.0  # time of flight

    @property
    def miss_m(self) -> float:
        """Root mean square of the horizontal innovations over the last second [m]."""
        return math.sqrt(self._mean_square_m2)

    def drive(self, acceleration_enu_m_s2: Vec3) -> None:
        """Append a tick's acceleration from attitude and throttle, without drag [m/s^2], ENU."""
        self._driven_enu_m_s2.append(acceleration_enu_m_s2)

    def step(
        self,
        innovation_m: Vec3,
        velocity_enu_m_s: Vec3,
        stamp_ns: int,
        is_on_ground: bool,
    ) -> None:
        """Take the next position.

        Args:
            innovation_m: measured minus expected position [m], ENU.
            velocity_enu_m_s: measured velocity [m/s], ENU.
            stamp_ns: time of the position.
            is_on_ground: whether the vehicle stands on the ground; the memory is then reset.
        """
        dt_s = max(0.0, (stamp_ns - self._stamp_ns) * 1e-9)
        change_m_s = subtract(velocity_enu_m_s, self._velocity_enu_m_s)
        self._stamp_ns = stamp_ns
        self._velocity_enu_m_s = velocity_enu_m_s
        if is_on_ground:
            self.is_late = False
            self.lateness_m2_s3 = 0.0
            self._mean_square_m2 = 0.0
            self._time_s = 0.0
            return

        weight = 1.0 - math.exp(-dt_s / _MISS_S)
        self._mean_square_m2 += weight * (_horizontal_square(innovation_m) - self._mean_square_m2)

        if 0.0 < dt_s < _LONGEST_GAP_S:
            measured_m_s2 = bounded(scaled(1.0 / dt_s, change_m_s), _LARGEST_M_S2)
            without_drag_m_s2 = add_scaled(measured_m_s2, self.drag_1_s, velocity_enu_m_s)
            self._compare(without_drag_m_s2, dt_s)

    def _compare(self, measured_m_s2: Vec3, dt_s: float) -> None:
        """Update the lateness with a measured acceleration."""
        now_m_s2 = self._driven_enu_m_s2[-1]
        then_m_s2 = self._driven_enu_m_s2[0]

        self._time_s += dt_s
        share = dt_s / min(self._time_s, _MEAN_S)
        self._measured_mean_m_s2 = _moved(self._measured_mean_m_s2, measured_m_s2, share)
        self._driven_mean_m_s2 = _moved(self._driven_mean_m_s2, now_m_s2, share)

        # subtract the means, so that wind does not count
        changed_m_s2 = subtract(measured_m_s2, self._measured_mean_m_s2)
        by_now_m_s2 = subtract(now_m_s2, self._driven_mean_m_s2)
        by_then_m_s2 = subtract(then_m_s2, self._driven_mean_m_s2)
        error_of_now_m2_s4 = _horizontal_square(subtract(changed_m_s2, by_now_m_s2))
        error_of_then_m2_s4 = _horizontal_square(subtract(changed_m_s2, by_then_m_s2))

        kept_m2_s3 = (1.0 - dt_s / _LATENESS_S) * self.lateness_m2_s3
        added_m2_s3 = dt_s * (error_of_now_m2_s4 - error_of_then_m2_s4)
        self.lateness_m2_s3 = max(0.0, kept_m2_s3 + added_m2_s3)
        self.is_late = self.is_late or self.lateness_m2_s3 > LATE_M2_S3


def _moved(mean: Vec3, value: Vec3, share: float) -> Vec3:
    """Return a mean, moved by a share towards a value."""
    return add_scaled(mean, share, subtract(value, mean))


def _horizontal_square(vector: Vec3) -> float:
    return vector.x * vector.x + vector.y * vector.y
