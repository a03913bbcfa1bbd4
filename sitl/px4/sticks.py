"""Sticks of a joystick or a radio control (MANUAL_CONTROL).

The emulator uses the positions of the sticks, the time of the newest sample, and whether the pilot
moves a stick.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

# Pitch, roll, throttle, yaw. The throttle is in [0, 1], centred at 0.5. The others are in [-1, 1].
Axes = tuple[float, float, float, float]
CENTRED: Axes = (0.0, 0.0, 0.5, 0.0)

_FILTER_S = 0.05  # time constant of the low-pass on the speed of a stick
# Number of samples in one direction that make a movement. Noise and a single step have fewer.
_MIN_SAMPLES = 3


@dataclass(slots=True)
class _StickAxis:
    position: float = math.nan  # NaN before the first sample
    speed_1_s: float = 0.0  # filtered
    direction: int = 0  # direction of the newest movement: -1, 0 or 1
    samples: int = 0  # number of consecutive samples in that direction

    def take(self, position: float, dt_s: float) -> None:
        """Update the filtered speed of the stick with a new sample."""
        speed_1_s = (position - self.position) / dt_s
        self.position = position
        if math.isnan(speed_1_s):
            return

        self.speed_1_s += dt_s / (dt_s + _FILTER_S) * (speed_1_s - self.speed_1_s)

        direction = 0
        if speed_1_s > 0.0:
            direction = 1
        elif speed_1_s < 0.0:
            direction = -1

        if direction == self.direction:
            self.samples += 1
        else:
            self.samples = 1
        self.direction = direction

    def is_moving(self, faster_than_1_s: float) -> bool:
        """Return whether the stick moves faster than a speed, for several samples."""
        is_fast = abs(self.speed_1_s) > faster_than_1_s
        is_steady = self.samples >= _MIN_SAMPLES and self.direction != 0
        return is_fast and is_steady


@dataclass(slots=True)
class Sticks:
    """The sticks of one pilot."""

    time_s: float = -math.inf  # time of the newest sample
    _axes: tuple[_StickAxis, ...] = field(
        default_factory=lambda: tuple(_StickAxis() for _ in range(4))
    )

    @property
    def positions(self) -> Axes:
        """Positions of the newest sample; centred before the first sample."""
        if math.isinf(self.time_s):
            return CENTRED
        pitch, roll, throttle, yaw = (axis.position for axis in self._axes)
        return pitch, roll, throttle, yaw

    def take(self, now_s: float, positions: Axes) -> None:
        """Update all sticks with a new sample."""
        # bounded, because the first sample has no predecessor and two may have the same time
        dt_s = min(1.0, max(1e-3, now_s - self.time_s))
        self.time_s = now_s
        for axis, position in zip(self._axes, positions, strict=True):
            axis.take(position, dt_s)

    def is_moving(self, faster_than_1_s: float) -> bool:
        """Return whether a stick moves faster than a speed; False for a negative speed."""
        if faster_than_1_s < 0.0:
            return False
        return any(axis.is_moving(faster_than_1_s) for axis in self._axes)
