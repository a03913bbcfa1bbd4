"""Detects a battery that will not last until the vehicle has landed, from PX4's reports. Pure.

The supervision calls it in flight. If the battery is falling, the vehicle lands at once.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

_WINDOW_S = 10.0  # time over which the battery's trend is measured
_MIN_S = 1.0  # the trend is not judged until the window spans this time
_MIN_FALL_FRAC = 0.03  # a smaller loss within the window may be one step of PX4's percentage
_RESERVE_S = 15.0  # time in the air that must be left after the descent
_SAG_SHARE = 0.12  # a loss of this share of the voltage within the window is a fall, too
_MIN_VOLTAGE_V = 1.0  # a lower voltage is not a measurement
_LANDING_SHARE = 0.5  # share of the landing level that must be left after descent and reserve


class _BatterySample(NamedTuple):
    time_s: float
    remaining_frac: float  # NaN while PX4 does not report it
    voltage_v: float  # NaN while PX4 does not report it


@dataclass(slots=True)
class BatteryMonitor:
    """Memory of one battery.

    Call :meth:`update` a few times a second in flight, and :meth:`reset` before it.

    The battery counts as falling if, at the present rate, less than half of the landing level would
    be left after the descent and a reserve. PX4's simulated battery falls fast, but only down to a
    floor, so that charge always remains.
    """

    is_falling: bool = False  # once True, it stays True until the reset
    _past: deque[_BatterySample] = field(default_factory=deque)  # of the window, the oldest first

    def reset(self) -> None:
        """Forget the flight. Samples from the ground, with another load, do not count."""
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
            time_s: present time, on any clock.
            remaining_frac: remaining charge, 0 to 1; NaN while PX4 does not report it.
            voltage_v: voltage; NaN while PX4 does not report it.
            land_frac: landing level, the charge at which the vehicle lands in any case.
            descent_s: duration of a landing from here.
            floor_frac: charge at which a simulated battery stops emptying (PX4's SIM_BAT_MIN_PCT);
                0 for a real one.
        """
        past = self._past
        past.append(_BatterySample(time_s, remaining_frac, voltage_v))
        oldest = past[0]
        while time_s - oldest.time_s > _WINDOW_S:
            past.popleft()
            oldest = past[0]

        over_s = time_s - oldest.time_s
        if over_s < _MIN_S:
            return

        # over a short window, one step of a percentage would look like a steep fall
        fallen_frac = oldest.remaining_frac - remaining_frac
        rate_1_s = fallen_frac / max(over_s, 0.5 * _WINDOW_S)
        left_frac = remaining_frac - rate_1_s * (descent_s + _RESERVE_S)
        if remaining_frac >= floor_frac:
            left_frac = max(left_frac, floor_frac)

        # comparisons with NaN are False, so an unreported charge does not run out
        runs_out = left_frac < _LANDING_SHARE * land_frac and fallen_frac > _MIN_FALL_FRAC
        if runs_out or _sags(oldest.voltage_v, voltage_v):
            self.is_falling = True


def _sags(before_v: float, now_v: float) -> bool:
    """Return whether the voltage has fallen by a large share."""
    is_measured = math.isfinite(before_v) and before_v > _MIN_VOLTAGE_V
    return is_measured and now_v < (1.0 - _SAG_SHARE) * before_v
