"""Detects a battery that will not last until the vehicle is down, from the trend of PX4's reports.

Pure.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

_OVER_S = 10.0
_LEAST_S = 1.0
_RESERVE_S = 15.0
_SAG_SHARE = 0.12  # of the voltage, lost within the window


@dataclass(slots=True)
class BatteryMonitor:
    """Memory of one battery; call :meth:`update` some times a second in flight, :meth:`reset` on
    the ground.

    A percentage falls by about 0.2 % a second in ordinary flight. The battery is falling when, at
    the present rate, less than half of the landing level would be left after the descent and a
    reserve. PX4's simulated battery loses 1.7 % a second, but only down to a level of its own, and
    counts by that until less is left.
    """

    is_falling: bool = False
    _past: deque[tuple[float, float, float]] = field(default_factory=deque)  # time, share, voltage

    def reset(self) -> None:
        """Begin anew; on the ground loads come and go."""
        self._past.clear()
        self.is_falling = False

    def update(
        self,
        time_s: float,
        remaining_frac: float,
        voltage_v: float,
        *,
        land_frac: float,
        descent_s: float,
        floor_frac: float = 0.0,
    ) -> None:
        """Take one sample in flight.

        Args:
            time_s: now, on any clock.
            remaining_frac: share left; NaN while PX4 does not report it.
            voltage_v: NaN while PX4 does not report it.
            land_frac: level at which the vehicle lands in any case.
            descent_s: time that a landing takes from here.
            floor_frac: charge at which a simulated battery stops emptying (PX4's SIM_BAT_MIN_PCT);
                0 for a real one.
        """
        past = self._past
        past.append((time_s, remaining_frac, voltage_v))
        while time_s - past[0][0] > _OVER_S:
            past.popleft()
        begin_s, frac, voltage = past[0]
        over_s = time_s - begin_s
        if over_s < _LEAST_S:
            return
        # over a short window one step of a percentage would look like a steep fall
        rate_1_s = (frac - remaining_frac) / max(over_s, 0.5 * _OVER_S)
        left_frac = remaining_frac - rate_1_s * (descent_s + _RESERVE_S)
        if remaining_frac >= floor_frac:
            left_frac = max(left_frac, floor_frac)
        runs_out = left_frac < 0.5 * land_frac
        sags = math.isfinite(voltage) and voltage > 1.0 and voltage_v < (1.0 - _SAG_SHARE) * voltage
        if (runs_out and frac - remaining_frac > 0.03) or sags:
            self.is_falling = True
