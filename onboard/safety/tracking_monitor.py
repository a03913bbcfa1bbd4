"""Detects an attitude that does not follow its setpoints, and thrust at its limit. Pure.

The commanded tilt passes a lag with the vehicle's own time constant. The difference between the
measured tilt and this lagged tilt is low-passed. This difference stays small if the vehicle
responds late or with a static error. It grows if the vehicle does not respond. At the first look
the measured tilt is taken for the commanded one, so that a loss before it is found up to 0.3 s
later.

The lag consists of three first-order lags, each with a third of the time constant. An attitude
responds after a dead time, and then as a second-order system. With a command that changes between
25 degrees to both sides, one first-order lag differs by up to 11 degrees from the responses that
fleet files accept, and three differ by up to 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from onboard.tuples import Wxyz

# the attitude does not follow if the low-passed difference is larger than 9 degrees
_LOW_PASS_S = 0.3  # time constant
_MISS_SIN = math.sin(math.radians(9.0))
_MISS_FOR_S = 0.2  # for longer than this

# the vehicle is upset if its tilt is larger than 60 degrees
_UPSET_COS = math.cos(math.radians(60.0))
_UPSET_FOR_S = 0.1  # for longer than this

# the thrust is saturated at this share of the largest throttle
_FULL_SHARE = 0.99
_FULL_FOR_S = 0.5  # for longer than this

# the vehicle does not climb if, with full thrust, it is more than _BELOW_M below its trajectory and
# climbs more slowly than _CLIMB_M_S
_BELOW_M = 0.15
_CLIMB_M_S = 0.05
_SINKING_FOR_S = 1.0  # for longer than this

_LAGS = 3  # number of first-order lags that follow one another
_SHORTEST_LAG_S = 0.02  # a shorter configured lag is raised to this


@dataclass(slots=True)
class TrackingMonitor:
    """Memory of one vehicle.

    Call :meth:`update` at every tick under the law, and :meth:`reset` otherwise.
    """

    lag_s: float  # from attitude setpoint to attitude
    largest_frac: float  # throttle at which thrust is saturated

    is_attitude_lost: bool = False  # the attitude does not follow, or the vehicle is upset
    is_upset: bool = False  # it is tilted so far that no other sign is needed
    missed_s: float = 0.0  # how long the attitude has not followed
    is_saturated: bool = False
    is_sinking: bool = False  # it does not climb although the thrust is full

    # horizontal part (east, north) of the direction of thrust; as commanded, after each lag
    _commanded_x: list[float] = field(default_factory=list)  # empty before the first tick
    _commanded_y: list[float] = field(default_factory=list)
    _miss_x: float = 0.0  # measured minus commanded, low-passed
    _miss_y: float = 0.0

    # how long each sign has lasted
    _upset_s: float = 0.0
    _full_s: float = 0.0
    _sinking_s: float = 0.0

    def reset(self) -> None:
        """Start again, because no setpoints are sent."""
        self._commanded_x = []
        self._commanded_y = []
        self._miss_x = 0.0
        self._miss_y = 0.0
        self.missed_s = 0.0
        self._upset_s = 0.0
        self._full_s = 0.0
        self._sinking_s = 0.0
        self.is_attitude_lost = False
        self.is_upset = False
        self.is_saturated = False
        self.is_sinking = False

    def update(
        self,
        commanded_wxyz: Wxyz,
        measured_wxyz: Wxyz,
        thrust_frac: float,
        *,
        below_m: float,
        climb_m_s: float,
        dt_s: float,
    ) -> None:
        """Take one tick in flight.

        Args:
            commanded_wxyz: attitude setpoint sent last, FLU to ENU.
            measured_wxyz: attitude measured, FLU to ENU.
            thrust_frac: throttle sent last.
            below_m: how far the vehicle is below its trajectory.
            climb_m_s: vertical velocity, up.
            dt_s: time since the last call.
        """
        # measured direction of thrust (last column of the rotation); at first it is the right one
        w, x, y, z = measured_wxyz
        measured_x = 2.0 * (x * z + w * y)
        measured_y = 2.0 * (y * z - w * x)
        cos_tilt = 1.0 - 2.0 * (x * x + y * y)
        if not self._commanded_x:
            self._commanded_x = [measured_x] * _LAGS
            self._commanded_y = [measured_y] * _LAGS

        # commanded direction of thrust, after the lag
        w, x, y, z = commanded_wxyz
        keep = math.exp(-dt_s * _LAGS / max(self.lag_s, _SHORTEST_LAG_S))
        lagged_x = _pass_lags(self._commanded_x, 2.0 * (x * z + w * y), keep)
        lagged_y = _pass_lags(self._commanded_y, 2.0 * (y * z - w * x), keep)

        # their difference, low-passed
        miss_x = measured_x - lagged_x
        miss_y = measured_y - lagged_y
        share = dt_s / (_LOW_PASS_S + dt_s)
        self._miss_x += share * (miss_x - self._miss_x)
        self._miss_y += share * (miss_y - self._miss_y)
        squared_miss = self._miss_x * self._miss_x + self._miss_y * self._miss_y

        is_full = thrust_frac >= _FULL_SHARE * self.largest_frac
        is_sinking = is_full and below_m > _BELOW_M and climb_m_s < _CLIMB_M_S
        has_missed = squared_miss > _MISS_SIN * _MISS_SIN
        self.missed_s = self.missed_s + dt_s if has_missed else 0.0
        self._upset_s = self._upset_s + dt_s if cos_tilt < _UPSET_COS else 0.0
        self._full_s = self._full_s + dt_s if is_full else 0.0
        self._sinking_s = self._sinking_s + dt_s if is_sinking else 0.0

        self.is_upset = self._upset_s > _UPSET_FOR_S
        self.is_attitude_lost = self.missed_s > _MISS_FOR_S or self.is_upset
        self.is_saturated = self._full_s > _FULL_FOR_S
        self.is_sinking = self._sinking_s > _SINKING_FOR_S


def _pass_lags(lagged: list[float], value: float, keep: float) -> float:
    """Pass a value through first-order lags, and return what comes out of the last one.

    Args:
        lagged: output of each lag; it is changed.
        value: value of this tick.
        keep: share of its output that a lag keeps in this tick.
    """
    for index, before in enumerate(lagged):
        value += keep * (before - value)
        lagged[index] = value
    return value
