"""The random numbers of flights. Each flight has its own seed, so it is the same alone and in a
batch.

Streams of a flight: ``[seed, 1]`` constants, ``[seed, 2]`` noise of every tick, ``[seed, 3]`` the
radio links, ``[seed, 4]`` errors of the measured acceleration. No stream depends on what the
vehicles do, so two laws meet the same noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from onboard.arrays import Array, IntArray

_BLOCK_TICKS = 50  # ticks whose numbers are drawn at once

# Numbers of each vehicle, and what uses them.
_UNIFORM = 8  # differences from its type: lag, gain, drag, hover (4), tilt bias (2), unused (2)
_NORMAL = 6  # initial error of the estimate: position (3), velocity (3)
_PER_TICK = 9  # position error (3), velocity error (3), gust (2), thrust (1)


class FlightNoise:
    """Noise of F flights of N vehicles, tick by tick."""

    def __init__(self, seeds: Sequence[int], count: int, *, has_links: bool) -> None:
        """Draw the constants.

        Args:
            seeds: seeds (F,) of the flights.
            count: number N of vehicles.
            has_links: whether numbers for the radio links are drawn.
        """
        self.count = count

        constants = [np.random.default_rng([seed, 1]) for seed in seeds]
        # (F, N, 8) in [-1, 1), and (F, N, 6); each flight draws the uniform ones first
        self.uniform = np.stack([rng.uniform(-1.0, 1.0, (count, _UNIFORM)) for rng in constants])
        self.normal = np.stack([rng.standard_normal((count, _NORMAL)) for rng in constants])

        accelerations = [np.random.default_rng([seed, 4]) for seed in seeds]
        self.acceleration = np.stack([rng.standard_normal((count, 3)) for rng in accelerations])

        self._generators = [np.random.default_rng([seed, 2]) for seed in seeds]
        self._links: list[np.random.Generator] = []
        if has_links:
            self._links = [np.random.default_rng([seed, 3]) for seed in seeds]

        # next tick of the block; at first it is past the end, so the first call draws a block
        self._tick = _BLOCK_TICKS
        self._block = np.empty(0)  # (F, ticks, N, 9)
        self._link_draws = np.empty(0, np.float32)  # (F, ticks, N, N)

    def next(self) -> tuple[Array, Array]:
        """Return the random numbers of the next tick.

        Returns:
            Standard normal numbers (F, N, 9), and a uniform number in [0, 1) for each link (F,
            receiver, sender), or an empty array without links. No link uses the numbers on the
            diagonal; they are free for other purposes.
        """
        if self._tick == _BLOCK_TICKS:
            self._draw_block()
        tick = self._tick
        self._tick += 1

        if self._links:
            link_draws = self._link_draws[:, tick]
        else:
            link_draws = np.empty((len(self._generators), 0, 0), np.float32)
        return self._block[:, tick], np.asarray(link_draws, dtype=np.float64)

    def _draw_block(self) -> None:
        shape = (_BLOCK_TICKS, self.count, _PER_TICK)
        self._block = np.stack([rng.standard_normal(shape) for rng in self._generators])

        if self._links:
            links_shape = (_BLOCK_TICKS, self.count, self.count)
            self._link_draws = np.stack(
                [rng.random(links_shape, dtype=np.float32) for rng in self._links]
            )
        self._tick = 0

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self.uniform = self.uniform[flights]
        self.normal = self.normal[flights]
        self.acceleration = self.acceleration[flights]
        self._generators = [self._generators[k] for k in flights]
        self._block = self._block[flights]
        if self._links:
            self._links = [self._links[k] for k in flights]
            self._link_draws = self._link_draws[flights]
