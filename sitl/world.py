"""The room that the vehicles share: who touches whom falls. Also where ground truth is read, and never written."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl import rotation
from sitl.rotation import Array
from sitl.vehicle import STEP_S, Commands, VehicleProfile, Vehicles

# Two vehicles touch when their discs overlap and their centres are closer in height than this part of a diameter.
_HEIGHT_OF_DIAMETER = 0.5


@dataclass(frozen=True, slots=True)
class Collision:
    """Two vehicles met: their indices, when, and how far their centres were apart horizontally."""

    first: int
    second: int
    time_s: float
    distance_m: float


class World:
    """Vehicles on one floor.

    Args:
        profiles: one per vehicle.
        start_enu_m: (n, 3) start positions in the fleet frame [m].
        body_diameter_m: below this horizontal distance between centres two vehicles touch.
        seed: of every random number of the physics.
    """

    def __init__(
        self, profiles: list[VehicleProfile], start_enu_m: Array, *, body_diameter_m: float = 0.5, seed: int = 0
    ) -> None:
        n = len(profiles)
        # Body x along fleet x, which is east: a quarter turn in PX4's north-based heading.
        yaw_rad = np.full(n, 0.5 * np.pi)
        self.vehicles = Vehicles(profiles, rotation.swap_enu_ned(start_enu_m), yaw_rad, seed=seed)
        self.commands = Commands.level(yaw_rad)
        self.collisions: list[Collision] = []
        self._body_diameter_m = body_diameter_m
        self._pairs = np.triu_indices(n, k=1)
        self._touched: NDArray[np.bool_] = np.zeros(self._pairs[0].shape[0], dtype=np.bool_)

    @property
    def time_s(self) -> float:
        """Time since the start of the world [s]."""
        return self.vehicles.steps * STEP_S

    def step(self) -> list[Collision]:
        """Advance by one physics step; returns the collisions that happened in it."""
        self.vehicles.step(self.commands)
        return self._collide()

    def truth_enu(self) -> tuple[Array, Array, Array]:
        """Positions (n, 3) [m], velocities (n, 3) [m/s] and attitudes ENU <- FLU (n, 4) as they really are."""
        s = self.vehicles.states
        return (
            rotation.swap_enu_ned(s.position_ned_m),
            rotation.swap_enu_ned(s.velocity_ned_m_s),
            rotation.enu_flu_from_ned_frd(s.attitude),
        )

    def _collide(self) -> list[Collision]:
        s = self.vehicles.states
        i, j = self._pairs
        if i.size == 0 or s.on_ground.all():
            return []
        offset = s.position_ned_m[i] - s.position_ned_m[j]
        distance = np.hypot(offset[:, 0], offset[:, 1])
        touching = (
            (distance < self._body_diameter_m)
            & (np.abs(offset[:, 2]) < _HEIGHT_OF_DIAMETER * self._body_diameter_m)
            & ~(s.on_ground[i] & s.on_ground[j])
            & ~self._touched
        )
        if not touching.any():
            return []
        found = [
            Collision(int(i[k]), int(j[k]), self.time_s, float(distance[k])) for k in np.flatnonzero(touching).tolist()
        ]
        self._touched |= touching
        for collision in found:
            s.motors_dead[[collision.first, collision.second]] = True
        self.collisions.extend(found)
        return found
