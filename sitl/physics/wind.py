"""Wind: a mean vector and gusts about it, the same in emulator, lockstep and campaigns.

A gust is an Ornstein-Uhlenbeck process per axis, which is Dryden's longitudinal spectrum with L / V
as correlation time. The second pole of Dryden's other two spectra is left out. The air pushes a
vehicle through its linear drag. Where only the acceleration by gusts is known, and not the drag, a
vehicle has its own gusts, an acceleration that follows the same process.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sitl.physics.frames import Array
from sitl.physics.random_streams import Stream
from sitl.physics.step import STEP_S

GUST_TIME_S = 1.0  # default correlation time of gusts

_VERTICAL_SHARE = 0.5  # standard deviation of vertical gusts over that of horizontal ones
_BLOCK = 64  # random numbers are drawn for this many steps at a time


@dataclass(frozen=True, slots=True)
class WindSettings:
    """Mean and gusts of the wind."""

    mean_enu_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)  # steady velocity of the air
    # Standard deviation of gusts per horizontal axis. Vertically it is half of this.
    gust_std_m_s: float = 0.0
    gust_time_s: float = GUST_TIME_S  # correlation time of gusts
    # Whether the same gusts act on all vehicles, like ventilation in a hall. Otherwise each vehicle
    # has different gusts, as vehicles far apart outdoors do.
    is_common: bool = False


def wandered(value: Array, std: Array | float, time_s: float, dt_s: float, normals: Array) -> Array:
    """Return an Ornstein-Uhlenbeck process one step later.

    Args:
        value: value of the process.
        std: stationary standard deviation of the process.
        time_s: correlation time of the process; 0: white noise.
        dt_s: length of the step.
        normals: standard normal numbers of the shape of the value.
    """
    correlation = 0.0  # of the values before and after the step
    if time_s > 0.0:
        correlation = math.exp(-dt_s / time_s)
    return correlation * value + std * math.sqrt(1.0 - correlation * correlation) * normals


class Wind:
    """Velocity of the air at each vehicle, one sample per step.

    Args:
        count: number of vehicles.
        settings: mean and gusts of the wind.
        seed: seed of the gusts.
        own_gust_std_m_s2: standard deviation of each vehicle's own gusts, which push it in addition
            to the air; empty: no vehicle has own gusts.
        step_s: time from one sample to the next.

    Attributes:
        settings: wind at the start.
        is_calm: whether the air does not move.
        has_own_gusts: whether a vehicle has its own gusts.
        push_ned_m_s2: acceleration (n, 3) from the vehicles' own gusts in the last step.
    """

    def __init__(
        self,
        count: int,
        settings: WindSettings,
        *,
        seed: int,
        own_gust_std_m_s2: Sequence[float] = (),
        step_s: float = STEP_S,
    ) -> None:
        gust_count = count
        if settings.is_common:
            gust_count = 1
        self.settings = settings
        self._step_s = step_s
        self._rng = np.random.default_rng([seed, Stream.AIR])
        self._gust = np.zeros((gust_count, 3))
        self._draws = np.zeros((_BLOCK, gust_count, 3))
        self._block_row = 0
        self._count = count

        self._mean_ned = _ned(settings.mean_enu_m_s)
        self.change_gusts(settings.gust_std_m_s)

        self._ramp_ned = np.zeros(3)  # change of the mean per step during a ramp
        self._ramp_steps = 0  # steps until the end of the ramp

        self._own_rng = np.random.default_rng([seed, Stream.OWN_GUSTS])
        self._own_std_m_s2 = np.zeros((count, 3))
        if own_gust_std_m_s2:
            self._own_std_m_s2[:, :2] = np.array(own_gust_std_m_s2)[:, None]
        self.push_ned_m_s2 = np.zeros((count, 3))

        # Plain attributes, because every step of the physics reads them.
        self.is_calm = settings.gust_std_m_s == 0.0 and not self._mean_ned.any()
        self.has_own_gusts = bool(self._own_std_m_s2.any())

    def change_mean(self, mean_enu_m_s: tuple[float, float, float], over_s: float) -> None:
        """Change the mean linearly to another value within a time."""
        self._ramp_steps = max(1, round(over_s / self._step_s))
        self._ramp_ned = (_ned(mean_enu_m_s) - self._mean_ned) / self._ramp_steps
        self.is_calm = False

    def change_gusts(self, gust_std_m_s: float) -> None:
        """Change the standard deviation of the gusts per horizontal axis."""
        self._gust_std_m_s = gust_std_m_s * np.array([1.0, 1.0, _VERTICAL_SHARE])
        self.is_calm = False

    @property
    def mean_enu_m_s(self) -> tuple[float, float, float]:
        """Present mean velocity of the air."""
        north, east, down = self._mean_ned.tolist()
        return (east, north, -down)

    def step(self) -> Array:
        """Return the velocity of the air (n, 3) NED [m/s], one step later."""
        if self._ramp_steps:
            self._mean_ned = self._mean_ned + self._ramp_ned
            self._ramp_steps -= 1

        if self._block_row == 0:
            self._rng.standard_normal(out=self._draws)
        self._gust = wandered(
            self._gust,
            self._gust_std_m_s,
            self.settings.gust_time_s,
            self._step_s,
            self._draws[self._block_row],
        )
        self._block_row = (self._block_row + 1) % _BLOCK
        return np.broadcast_to(self._mean_ned + self._gust, (self._count, 3))

    def step_own_gusts(self) -> Array:
        """Return the acceleration (n, 3) from the vehicles' own gusts, NED, one step later."""
        normals = self._own_rng.standard_normal((self._count, 3))
        self.push_ned_m_s2 = wandered(
            self.push_ned_m_s2, self._own_std_m_s2, GUST_TIME_S, self._step_s, normals
        )
        return self.push_ned_m_s2


def _ned(enu_m_s: tuple[float, float, float]) -> Array:
    east, north, up = enu_m_s
    return np.array([north, east, -up])
