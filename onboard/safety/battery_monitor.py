"""Will the battery last until the vehicle is down? From the trend of what PX4 tells of it. Pure."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

_OVER_S = 10.0
_LEAST_S = 1.0
_RESERVE_S = 15.0
_SINK_SPEED_M_S = 0.4
_SAG_SHARE = 0.12  # of the voltage, lost within the window


@dataclass(slots=True)
class BatteryMonitor:
    """Call :meth:`look` some times a second; on the ground and after it begins anew.

    A percentage falls by about 0.2 % a second in ordinary flight. What matters is whether, at the present rate, more
    than half of the landing level is left when the vehicle is down and a reserve has passed.
    """

    is_falling: bool = False
    _past: deque[tuple[float, float, float]] = field(default_factory=deque)

    def rest(self) -> None:
        """On the ground: loads come and go."""
        self._past.clear()
        self.is_falling = False

    def look(
        self, time_s: float, remaining_frac: float, voltage_v: float, *, land_frac: float, height_m: float
    ) -> None:
        """One look in flight; ``remaining_frac`` and ``voltage_v`` may be NaN when PX4 does not tell."""
        past = self._past
        past.append((time_s, remaining_frac, voltage_v))
        while time_s - past[0][0] > _OVER_S:
            past.popleft()
        begin_s, frac, voltage = past[0]
        over_s = time_s - begin_s
        if over_s < _LEAST_S:
            return
        down_s = max(height_m, 0.0) / _SINK_SPEED_M_S + _RESERVE_S
        # over a short window one step of a percentage would look like a steep fall
        rate_1_s = (frac - remaining_frac) / max(over_s, 0.5 * _OVER_S)
        runs_out = remaining_frac - rate_1_s * down_s < 0.5 * land_frac
        sags = math.isfinite(voltage) and voltage > 1.0 and voltage_v < (1.0 - _SAG_SHARE) * voltage
        if (runs_out and frac - remaining_frac > 0.03) or sags:
            self.is_falling = True
