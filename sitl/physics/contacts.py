"""The room that the vehicles share: wind, the air that a vehicle pushes down on another, and who touches whom falls.

Also where ground truth is read, and never written.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames, kernels
from sitl.physics.frames import Array
from sitl.physics.vehicle import STEP_S, Commands, VehicleProfile, Vehicles
from sitl.physics.wind import Wind, WindSettings

# Two vehicles touch when their discs overlap and their centres are closer in height than this part of a diameter.
_HEIGHT_OF_DIAMETER = 0.5
_MOST_AT_ONCE = 64  # collisions reported in one step


class SpawnError(ValueError):
    """Vehicles cannot start where they were told to: a sentence for people."""


@dataclass(frozen=True, slots=True)
class Collision:
    """Two vehicles met: their indices, when, and how far their centres were apart horizontally."""

    first: int
    second: int
    time_s: float
    distance_m: float


@dataclass(frozen=True, slots=True)
class Downwash:
    """Push on a vehicle below another, a jet that widens and slows down.

    With a gap h in height, a horizontal offset r and a body diameter D the lower one is pushed down by
    ``push_m_s2 L (D / (D + h))^2 exp(-(r / (D / 2 + spread h))^2)``, L the upper one's lift over its weight; the push
    sets in over the first half diameter of height. The values are of the size that is reported for small quadrotors,
    8 % of the weight one diameter below; they are not measured on any of ours.
    """

    push_m_s2: float = 3.0
    spread: float = 0.2


class World:
    """Vehicles on one floor.

    Args:
        profiles: one per vehicle.
        start_enu_m: (n, 3) start positions in the fleet frame [m].
        body_diameter_m: below this horizontal distance between centres two vehicles touch.
        seed: of every random number of the physics.
        wind, downwash: what the air does.
        names: for the sentence when two start inside each other.
    """

    def __init__(
        self,
        profiles: list[VehicleProfile],
        start_enu_m: Array,
        *,
        body_diameter_m: float = 0.5,
        seed: int = 0,
        wind: WindSettings | None = None,
        downwash: Downwash | None = None,
        names: Sequence[str] = (),
    ) -> None:
        n = len(profiles)
        _check_spawn(start_enu_m, body_diameter_m, names or [f"vehicle {i}" for i in range(n)])
        # Body x along fleet x, which is east: a quarter turn in PX4's north-based heading.
        yaw_rad = np.full(n, 0.5 * np.pi)
        self.vehicles = Vehicles(profiles, frames.swap_enu_ned(start_enu_m), yaw_rad, seed=seed)
        self.commands = Commands.level(yaw_rad)
        self.collisions: list[Collision] = []
        self.wind = Wind(n, wind or WindSettings(), seed=seed)
        self._downwash = downwash or Downwash()
        self._body_diameter_m = body_diameter_m
        self._touched: NDArray[np.bool_] = np.zeros((n, n), dtype=np.bool_)
        self._found = np.zeros((_MOST_AT_ONCE, 2), dtype=np.int64)
        self._meet = kernels.meet if kernels.HAS_NUMBA else meet

    @property
    def time_s(self) -> float:
        """Time since the start of the world [s]."""
        return self.vehicles.steps * STEP_S

    def step(self) -> list[Collision]:
        """Advance by one physics step; returns the collisions that happened in it."""
        if not self.wind.is_calm:
            self.vehicles.air_ned_m_s[:] = self.wind.step()
        self.vehicles.step(self.commands)
        return self._interact()

    def truth_enu(self) -> tuple[Array, Array, Array]:
        """Positions (n, 3) [m], velocities (n, 3) [m/s] and attitudes ENU <- FLU (n, 4) as they really are."""
        s = self.vehicles.states
        return (
            frames.swap_enu_ned(s.position_ned_m),
            frames.swap_enu_ned(s.velocity_ned_m_s),
            frames.enu_flu_from_ned_frd(s.attitude),
        )

    def _interact(self) -> list[Collision]:
        s = self.vehicles.states
        if s.on_ground.shape[0] < 2 or s.on_ground.all():
            return []
        count = self._meet(
            s.position_ned_m,
            self.vehicles.lift_share,
            s.on_ground,
            self._touched,
            self._body_diameter_m,
            _HEIGHT_OF_DIAMETER * self._body_diameter_m,
            self._downwash.push_m_s2,
            self._downwash.spread,
            self.vehicles.push_ned_m_s2,
            self._found,
        )
        if count == 0:
            return []
        found = []
        for first, second in self._found[: min(count, _MOST_AT_ONCE)].tolist():
            offset = s.position_ned_m[first] - s.position_ned_m[second]
            found.append(Collision(first, second, self.time_s, math.hypot(offset[0], offset[1])))
            s.motors_dead[[first, second]] = True
        self.collisions.extend(found)
        return found


def meet(
    position: Array,
    lift_share: Array,
    on_ground: NDArray[np.bool_],
    touched: NDArray[np.bool_],
    diameter_m: float,
    half_height_m: float,
    wash_m_s2: float,
    wash_spread: float,
    push: Array,
    found: NDArray[np.int64],
) -> int:
    """Collisions and downwash of all pairs.

    Args:
        position: (n, 3) NED. lift_share: (n,) lift over weight. on_ground: (n,). touched: (n, n), updated: pairs that
            have met. diameter_m, half_height_m: size of a body. wash_m_s2, wash_spread: see :class:`Downwash`.
        push: (n, 3) acceleration, written. found: (m, 2) indices of new collisions, written.
    Returns:
        how many new collisions there are.
    """
    offset = position[:, None] - position[None]
    square = offset[..., 0] ** 2 + offset[..., 1] ** 2
    is_free = ~(on_ground[:, None] & on_ground[None])
    meets = (square < diameter_m**2) & (np.abs(offset[..., 2]) < half_height_m) & is_free & ~touched
    meets = np.triu(meets, k=1)
    touched |= meets
    pairs = np.argwhere(meets)
    found[: pairs.shape[0]] = pairs[: found.shape[0]]
    gap = np.maximum(offset[..., 2], 0.0)  # of the row below the column
    radius = 0.5 * diameter_m + wash_spread * gap
    fade = np.minimum(1.0, gap / half_height_m) * (diameter_m / (diameter_m + gap)) ** 2
    reaches = is_free & (square <= 9.0 * radius**2)
    push[:] = 0.0
    push[:, 2] = np.where(reaches, wash_m_s2 * lift_share[None] * fade * np.exp(-square / radius**2), 0.0).sum(axis=1)
    return int(pairs.shape[0])


def _check_spawn(start_enu_m: Array, body_diameter_m: float, names: Sequence[str]) -> None:
    for (i, first), (j, second) in itertools.combinations(enumerate(names), 2):
        a, b = start_enu_m[i], start_enu_m[j]
        distance_m, height_m = math.hypot(a[0] - b[0], a[1] - b[1]), abs(float(a[2] - b[2]))
        if distance_m < body_diameter_m and height_m < _HEIGHT_OF_DIAMETER * body_diameter_m:
            raise SpawnError(
                f"{first} and {second} would start inside each other: {distance_m:.2f} m between centres, and a body "
                f"measures {body_diameter_m:.2f} m. Move one of their starts (start_enu_m)."
            )
