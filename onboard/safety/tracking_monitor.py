"""Does the vehicle do what it is told: does its attitude follow, has its thrust something left? Pure.

The commanded tilt goes through a first-order lag of the vehicle's own time; what the attitude flown differs from that,
low-passed, stays small for a vehicle that answers late or with a static error, and grows for one that does not answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Vec4 = tuple[float, float, float, float]

_MISS_TIME_S = 0.3
_MISS_SIN = math.sin(math.radians(9.0))
_MISS_FOR_S = 0.2
_UPSET_COS = math.cos(math.radians(60.0))
_UPSET_FOR_S = 0.1
_FULL_SHARE = 0.99  # of the largest throttle that is ever sent
_FULL_FOR_S, _SINKING_FOR_S = 0.5, 1.0
_BELOW_M, _CLIMB_M_S = 0.15, 0.05


@dataclass(slots=True)
class TrackingMonitor:
    """Call :meth:`look` every tick under the law, :meth:`rest` otherwise.

    lag_s: time of the attitude's answer. largest_frac: throttle at which thrust is saturated.
    """

    lag_s: float
    largest_frac: float
    is_attitude_lost: bool = False
    is_saturated: bool = False
    is_sinking: bool = False
    _asked_x: float = 0.0
    _asked_y: float = 0.0
    _miss_x: float = 0.0
    _miss_y: float = 0.0
    _missed_s: float = 0.0
    _upset_s: float = 0.0
    _full_s: float = 0.0
    _sinking_s: float = 0.0

    def rest(self) -> None:
        """Nothing is asked of the vehicle."""
        self._asked_x = self._asked_y = self._miss_x = self._miss_y = 0.0
        self._missed_s = self._upset_s = self._full_s = self._sinking_s = 0.0
        self.is_attitude_lost = self.is_saturated = self.is_sinking = False

    def look(
        self, asked_wxyz: Vec4, flown_wxyz: Vec4, thrust_frac: float, *, below_m: float, climb_m_s: float, dt_s: float
    ) -> None:
        """One tick in flight.

        Args:
            asked_wxyz, flown_wxyz: attitude setpoint sent last and attitude measured, in one frame. thrust_frac: sent
                last.
            below_m: how far it is below its trajectory. climb_m_s: vertical velocity.
        """
        w, x, y, z = asked_wxyz
        keep = math.exp(-dt_s / max(self.lag_s, 0.02))
        ux, uy = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
        self._asked_x, self._asked_y = ux + keep * (self._asked_x - ux), uy + keep * (self._asked_y - uy)
        w, x, y, z = flown_wxyz
        up = 1.0 - 2.0 * (x * x + y * y)
        miss_x, miss_y = 2.0 * (x * z + w * y) - self._asked_x, 2.0 * (y * z - w * x) - self._asked_y
        share = dt_s / (_MISS_TIME_S + dt_s)
        self._miss_x += share * (miss_x - self._miss_x)
        self._miss_y += share * (miss_y - self._miss_y)
        has_missed = self._miss_x * self._miss_x + self._miss_y * self._miss_y > _MISS_SIN * _MISS_SIN
        self._missed_s = self._missed_s + dt_s if has_missed else 0.0
        self._upset_s = self._upset_s + dt_s if up < _UPSET_COS else 0.0
        is_full = thrust_frac >= _FULL_SHARE * self.largest_frac
        self._full_s = self._full_s + dt_s if is_full else 0.0
        is_sinking = is_full and below_m > _BELOW_M and climb_m_s < _CLIMB_M_S
        self._sinking_s = self._sinking_s + dt_s if is_sinking else 0.0
        self.is_attitude_lost = self._missed_s > _MISS_FOR_S or self._upset_s > _UPSET_FOR_S
        self.is_saturated = self._full_s > _FULL_FOR_S
        self.is_sinking = self._sinking_s > _SINKING_FOR_S
