"""Wind: a mean vector and gusts about it.

Gusts are an Ornstein-Uhlenbeck process per axis, which is Dryden's longitudinal spectrum with L / V
as correlation time; the second pole of Dryden's other two spectra is left out. The air pushes by
the vehicle's linear drag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.physics.frames import Array
from sitl.physics.step import STEP_S

_VERTICAL_SHARE = 0.5
_BLOCK = 64


@dataclass(frozen=True, slots=True)
class WindSettings:
    """The weather."""

    mean_enu_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)  # steady velocity of the air
    # standard deviation of gusts per horizontal axis; half of it vertically
    gust_std_m_s: float = 0.0
    gust_time_s: float = 1.0  # correlation time of gusts
    # one gust for all vehicles (a hall's ventilation) or one for each (outdoors, far apart)
    is_common: bool = False


class Wind:
    """Velocity of the air at each vehicle, one sample per physics step.

    is_calm: whether the air does not move.
    """

    def __init__(self, count: int, settings: WindSettings, *, seed: int) -> None:
        self._rng = np.random.default_rng([seed, 4])
        self._gust = np.zeros((1 if settings.is_common else count, 3))
        self._draws = np.zeros((_BLOCK, *self._gust.shape))
        self._block_row = 0
        self._count = count
        east, north, up = settings.mean_enu_m_s
        self._mean_ned = np.array([north, east, -up])
        self._keep = math.exp(-STEP_S / max(settings.gust_time_s, STEP_S))
        std = settings.gust_std_m_s * np.array([1.0, 1.0, _VERTICAL_SHARE])
        self._spread = std * math.sqrt(1.0 - self._keep**2)
        # read at every step of the physics
        self.is_calm = settings.gust_std_m_s == 0.0 and not self._mean_ned.any()

    def step(self) -> Array:
        """Velocity of the air (n, 3) NED [m/s], one physics step later."""
        if self._block_row == 0:
            self._rng.standard_normal(out=self._draws)
        self._gust = self._keep * self._gust + self._spread * self._draws[self._block_row]
        self._block_row = (self._block_row + 1) % _BLOCK
        return np.broadcast_to(self._mean_ned + self._gust, (self._count, 3))
