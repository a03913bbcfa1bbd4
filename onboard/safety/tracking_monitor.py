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

PX4 limits the rate at which a vehicle turns, so a swing by 70 degrees takes longer than the lag.
The limit may be set higher. So the commanded tilt passes the lag twice, with its rate limited
before and as it is, and the smaller difference counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from onboard.frames import body_up
from onboard.tuples import Wxyz
from onboard.vectors import Vec3

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

_LARGEST_RATE_RAD_S = 3.84  # MC_ROLLRATE_MAX and MC_PITCHRATE_MAX by default: 220 deg/s
_UNLIMITED_RAD_S = 1e9
_LAGS = 3  # number of first-order lags that follow one another
_SHORTEST_LAG_S = 0.02  # a shorter configured lag is raised to this


@dataclass(slots=True)
class _Response:
    """Expected response of the direction of thrust, and what is measured beside it."""

    largest_rate_rad_s: float
    # horizontal part (east, north) of the commanded direction, after the limit of its rate and
    # after each lag; empty before the first tick
    _expected_x: list[float] = field(default_factory=list)
    _expected_y: list[float] = field(default_factory=list)
    _miss_x: float = 0.0  # measured minus expected, low-passed
    _miss_y: float = 0.0

    def reset(self) -> None:
        """Start again at the next tick."""
        self._expected_x = []
        self._expected_y = []
        self._miss_x = 0.0
        self._miss_y = 0.0

    def squared_miss(self, commanded: Vec3, measured: Vec3, lag_s: float, dt_s: float) -> float:
        """Take one tick and return the square of the low-passed difference.

        Args:
            commanded: commanded direction of thrust.
            measured: measured direction of thrust; in the first tick it is the right one.
            lag_s: time constant of all lags together.
            dt_s: time since the last tick.
        """
        if not self._expected_x:
            self._expected_x = [measured.x] * (1 + _LAGS)
            self._expected_y = [measured.y] * (1 + _LAGS)

        most = self.largest_rate_rad_s * dt_s
        keep = math.exp(-dt_s * _LAGS / lag_s)
        miss_x = measured.x - _followed(self._expected_x, commanded.x, most, keep)
        miss_y = measured.y - _followed(self._expected_y, commanded.y, most, keep)

        share = dt_s / (_LOW_PASS_S + dt_s)
        self._miss_x += share * (miss_x - self._miss_x)
        self._miss_y += share * (miss_y - self._miss_y)
        return self._miss_x * self._miss_x + self._miss_y * self._miss_y


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

    _at_once: _Response = field(default_factory=lambda: _Response(_UNLIMITED_RAD_S))
    _at_limited_rate: _Response = field(default_factory=lambda: _Response(_LARGEST_RATE_RAD_S))

    # how long each sign has lasted
    _upset_s: float = 0.0
    _full_s: float = 0.0
    _sinking_s: float = 0.0

    def reset(self) -> None:
        """Start again, because no setpoints are sent."""
        self._at_once.reset()
        self._at_limited_rate.reset()
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
        commanded = body_up(commanded_wxyz)
        measured = body_up(measured_wxyz)
        lag_s = max(self.lag_s, _SHORTEST_LAG_S)
        squared_miss = min(
            self._at_once.squared_miss(commanded, measured, lag_s, dt_s),
            self._at_limited_rate.squared_miss(commanded, measured, lag_s, dt_s),
        )

        is_full = thrust_frac >= _FULL_SHARE * self.largest_frac
        is_sinking = is_full and below_m > _BELOW_M and climb_m_s < _CLIMB_M_S
        has_missed = squared_miss > _MISS_SIN * _MISS_SIN
        self.missed_s = self.missed_s + dt_s if has_missed else 0.0
        self._upset_s = self._upset_s + dt_s if measured.z < _UPSET_COS else 0.0
        self._full_s = self._full_s + dt_s if is_full else 0.0
        self._sinking_s = self._sinking_s + dt_s if is_sinking else 0.0

        self.is_upset = self._upset_s > _UPSET_FOR_S
        self.is_attitude_lost = self.missed_s > _MISS_FOR_S or self.is_upset
        self.is_saturated = self._full_s > _FULL_FOR_S
        self.is_sinking = self._sinking_s > _SINKING_FOR_S


def _followed(stages: list[float], value: float, most: float, keep: float) -> float:
    """Pass a value through a limit of its rate and first-order lags, and return what comes out.

    Args:
        stages: output of the limit and of each lag; it is changed.
        value: value of this tick.
        most: largest change by the limit in this tick.
        keep: share of its output that a lag keeps in this tick.
    """
    change = value - stages[0]
    value = stages[0] + min(max(change, -most), most)
    stages[0] = value

    for index in range(1, len(stages)):
        value += keep * (stages[index] - value)
        stages[index] = value
    return value
