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

_VERTICAL_SHARE = 0.5  # of the horizontal gusts
_BLOCK = 64  # random numbers are drawn for so many steps at once


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

    Args:
        count: of vehicles.
        settings: the weather.
        seed: of the gusts.

    Attributes:
        is_calm: whether the air does not move.
    """

    def __init__(self, count: int, settings: WindSettings, *, seed: int) -> None:
        gusts = 1 if settings.is_common else count
        self._rng = np.random.default_rng([seed, 4])
        self._gust = np.zeros((gusts, 3))
        self._draws = np.zeros((_BLOCK, gusts, 3))
        self._block_row = 0
        self._count = count

        east, north, up = settings.mean_enu_m_s
        self._mean_ned = np.array([north, east, -up])

        # of the Ornstein-Uhlenbeck process: part that is kept over a step, and size of what is new
        self._keep = math.exp(-STEP_S / max(settings.gust_time_s, STEP_S))
        std_m_s = settings.gust_std_m_s * np.array([1.0, 1.0, _VERTICAL_SHARE])
        self._spread = std_m_s * math.sqrt(1.0 - self._keep**2)

        # read at every step of the physics
        self.is_calm = settings.gust_std_m_s == 0.0 and not self._mean_ned.any()

    def step(self) -> Array:
        """Return the velocity of the air (n, 3) NED [m/s], one physics step later."""
        if self._block_row == 0:
            self._rng.standard_normal(out=self._draws)
        self._gust = self._keep * self._gust + self._spread * self._draws[self._block_row]
        self._block_row = (self._block_row + 1) % _BLOCK
        return np.broadcast_to(self._mean_ned + self._gust, (self._count, 3))
