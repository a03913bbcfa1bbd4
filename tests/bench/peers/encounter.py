"""Inputs of every avoidance method, and the right-hand rule that those without a turn rule of their
own get.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Encounter:
    """M vehicles with K neighbours each, in the plane, at the time when a command of now takes
    effect.

    wanted_m_s2 (M, 2): net acceleration that the baseline asks for. velocity_m_s (M, 2): own. gap_m
    and closing_m_s (M, K, 2): own minus neighbour's position and velocity. is_on (M, K): who
    counts. reach_m_s2 (M,): largest horizontal acceleration. d_m (M, K): design distances.
    speed_m_s: top speed. age_s (M, K): of the neighbours' messages.
    """

    wanted_m_s2: Array
    velocity_m_s: Array
    gap_m: Array
    closing_m_s: Array
    is_on: BoolArray
    reach_m_s2: Array
    d_m: Array
    speed_m_s: float
    age_s: Array

    @property
    def distance_m(self) -> Array:
        """Distance of each neighbour (M, K); those that do not count are far away."""
        distance = np.sqrt(np.einsum("mkc,mkc->mk", self.gap_m, self.gap_m))
        return np.where(self.is_on, np.maximum(distance, 1e-6), 1e6)


class Step(Protocol):
    """A method: the acceleration (M, 2) [m/s^2] to command instead of the baseline's."""

    def __call__(self, encounter: Encounter, values: Mapping[str, float]) -> Array: ...


def preferred_velocity(encounter: Encounter, gain_1_s: float) -> Array:
    """Velocity (M, 2) that the baseline's acceleration steers for, within the top speed."""
    wish = encounter.velocity_m_s + encounter.wanted_m_s2 / gain_1_s
    return into_disc(wish, np.full(len(wish), encounter.speed_m_s))


def keep_right(encounter: Encounter) -> Encounter:
    """The baseline's wish turned 60 degrees to the right for a vehicle that stands still before
    somebody.

    ORCA, Voronoi cells, certificates and potentials stop for ever when the wish points exactly at a
    neighbour; their authors break the tie by noise or by such a rule.
    """
    wanted = encounter.wanted_m_s2
    gap = encounter.gap_m
    ahead = -np.einsum("mkc,mc->mk", gap, wanted) / encounter.distance_m
    is_blocked = encounter.is_on & (encounter.distance_m < 1.3 * encounter.d_m)
    is_blocked &= ahead > 0.2 * length(wanted)[:, None]
    is_stuck = (length(encounter.velocity_m_s) < 0.12) & (length(wanted) > 0.3) & is_blocked.any(-1)
    cos = 0.5
    sin = -np.sqrt(0.75)
    turned = np.stack(
        [cos * wanted[:, 0] - sin * wanted[:, 1], sin * wanted[:, 0] + cos * wanted[:, 1]], axis=-1
    )
    return replace(encounter, wanted_m_s2=np.where(is_stuck[:, None], turned, wanted))


def into_disc(vector: Array, radius: Array) -> Array:
    """The vectors (M, 2) shortened to at most ``radius`` (M,)."""
    size = length(vector)
    return np.asarray(vector * np.minimum(1.0, radius / np.maximum(size, 1e-12))[:, None])


def length(vector: Array) -> Array:
    """Euclidean length over the last axis."""
    return np.asarray(np.sqrt(np.einsum("...c,...c->...", vector, vector)))
