"""Dead reckoning of the own motion while no pose comes.

Horizontally the estimate goes on by attitude and throttle alone. PX4's own horizontal estimate is
worth less: real ones were wrong by 1 to 2.3 m three to four seconds after their last pose, this one
by 0.09 m after two seconds and by 0.35 m after three (medians).

Height and vertical speed follow PX4's, which measures them by accelerometers and a barometer. The
throttle does not suffice for them: the throttle that hovers may not be learned yet, as in a climb,
and 4 % of error in it make a descent slower by 0.3 m/s.

The acceleration that attitude and throttle do not explain (the bias) is taken to be its mean over
the last seconds. Its newest value would not do: noise takes it up to 1.3 m/s^2, which cost 1.5 m/s
after two seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from onboard.estimation.kalman import KalmanMemory
from onboard.safety.limits import POSITION_STALE_S
from onboard.vectors import ZERO_3, Vec3, add_scaled, bounded, subtract

_MEAN_TIME_S = 2.0  # time constant of the mean bias
# largest difference that counts for the mean: what is larger comes from a jump of the poses
_LARGEST_MISS_M_S2 = 0.8
_HEIGHT_RAD_S = 3.0  # bandwidth of following PX4's height
_CLIMB_RAD_S = 6.0  # and its vertical speed

# By how much the published standard deviation of the position grows: steadily, up to a bound that
# was flown with real PX4s and did no harm.
_STD_M_S = 0.05
_LARGEST_STD_M = 0.04  # the bound at the last sample
_LARGEST_STD_M_S = 0.03  # and by how much it grows


class VerticalMotion(NamedTuple):
    """Height and vertical speed in the fleet frame, by PX4."""

    height_m: float
    climbing_m_s: float


@dataclass(slots=True)
class DeadReckoning:
    """Memory of one vehicle; :meth:`step` after the samples of each tick."""

    is_on: bool = False  # no sample for so long that the estimate rests on dead reckoning

    # Standard deviations of position [m] and velocity [m/s] for the others. They are those of the
    # last sample; from there the position's grows steadily. Without growth, vehicles that lost
    # their poses at 2.5 m came nearer to each other. With a growth as fast as the error's, the law
    # commanded 10 m/s^2, which did more harm than the error.
    std: tuple[float, float] = (0.0, 0.0)

    _mean_bias_m_s2: Vec3 = ZERO_3
    _age_s: float = math.inf  # of the newest sample at the last tick

    def step(
        self,
        memory: KalmanMemory,
        vertical: VerticalMotion | None,
        dt_s: float,
        is_on_ground: bool,
    ) -> KalmanMemory:
        """Return the filter's memory, corrected where there have been no samples for long.

        Args:
            memory: driven to now.
            vertical: by PX4, in the fleet frame; None while it tells none.
            dt_s: length of the tick.
            is_on_ground: whether the vehicle stands.
        """
        mean_bias = self._mean_bias_m_s2
        age_s = memory.last_age_s

        has_new_sample = age_s <= self._age_s
        if has_new_sample:
            miss = bounded(subtract(memory.bias_enu_m_s2, mean_bias), _LARGEST_MISS_M_S2)
            self._mean_bias_m_s2 = add_scaled(mean_bias, dt_s / _MEAN_TIME_S, miss)
            self.std = (math.sqrt(memory.covariance.pp), math.sqrt(memory.covariance.vv))
        self._age_s = age_s

        if age_s <= POSITION_STALE_S:
            self.is_on = False
            return memory
        self.std = (self._grown_std_m(age_s, dt_s), self.std[1])

        position = memory.position_enu_m
        velocity = memory.velocity_enu_m_s

        # At the begin: as if the mean had acted since the last sample, in place of the newest bias.
        if not self.is_on:
            self.is_on = True
            change = subtract(mean_bias, memory.bias_enu_m_s2)
            position = add_scaled(position, 0.5 * age_s * age_s, change)
            velocity = add_scaled(velocity, age_s, change)

        # The gains of the height alone, twice the bandwidth and its square, are those of a
        # critically damped filter; the vertical speed comes on top.
        if vertical is not None:
            lift_m = _HEIGHT_RAD_S * dt_s * (vertical.height_m - position.z)
            faster_m_s = _CLIMB_RAD_S * dt_s * (vertical.climbing_m_s - velocity.z)

            climbing_m_s = velocity.z + _HEIGHT_RAD_S * lift_m + faster_m_s
            position = Vec3(position.x, position.y, position.z + 2.0 * lift_m)
            velocity = Vec3(velocity.x, velocity.y, climbing_m_s)

        if is_on_ground:
            velocity = ZERO_3

        return memory._replace(
            position_enu_m=position, velocity_enu_m_s=velocity, bias_enu_m_s2=mean_bias
        )

    def _grown_std_m(self, age_s: float, dt_s: float) -> float:
        """Return the standard deviation of the position that is published after a tick."""
        before_m = self.std[0]
        largest_m = max(before_m, _LARGEST_STD_M + _LARGEST_STD_M_S * age_s)
        return min(before_m + _STD_M_S * dt_s, largest_m)
