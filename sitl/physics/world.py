"""The world of all vehicles: their motion, wind, downwash and collisions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames
from sitl.physics.contacts import (
    HEIGHT_OF_DIAMETER,
    Collision,
    Downwash,
    find_collisions_and_downwash,
)
from sitl.physics.frames import Array
from sitl.physics.step import Ground
from sitl.physics.vehicle import STEP_S, Commands, VehicleProfile, Vehicles
from sitl.physics.wind import Wind, WindSettings

_MAX_COLLISIONS = 64  # collisions reported in one step
# Least radius of the platform around a take-off spot. A vehicle by satellites lands up to 0.6 m
# beside its spot.
_PLATFORM_RADIUS_M = 1.0


class SpawnError(ValueError):
    """Vehicles cannot start at the given positions; the message is a sentence."""


class World:
    """Vehicles above level ground, with a platform around each take-off spot.

    The ground is as high as the lowest spot, or 0 if all spots are higher, as on tables.

    Args:
        profiles: profile of each vehicle.
        start_enu_m: (n, 3) start positions in the fleet frame [m].
        body_diameter_m: horizontal distance between centres below which two vehicles touch.
        seed: seed of every random number of the physics.
        wind: settings of the wind; without them the air is calm.
        downwash: downwash of each vehicle.
        names: names of the vehicles for the sentence when two start inside each other.
        spots_enu_m: take-off spots (k, 3), which tell the ground; None: it is level, at height 0.
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
        spots_enu_m: Array | None = None,
    ) -> None:
        n = len(profiles)
        _check_spawn(start_enu_m, body_diameter_m, names or [f"vehicle {i}" for i in range(n)])

        # Body x along fleet x, which is east: a quarter turn in PX4's north-based heading.
        yaw_rad = np.full(n, 0.5 * np.pi)
        start_ned_m = frames.swap_enu_ned(start_enu_m)
        ground = None
        if spots_enu_m is not None:
            ground = _ground(spots_enu_m, max(body_diameter_m, _PLATFORM_RADIUS_M))
        self.vehicles = Vehicles(profiles, start_ned_m, yaw_rad, seed=seed, ground=ground)
        self.commands = Commands.level(yaw_rad)

        self.collisions: list[Collision] = []
        self.collided: set[int] = set()  # vehicles that have touched another
        own_gusts_m_s2 = [profile.gust_std_m_s2 for profile in profiles]
        self.wind = Wind(n, wind or WindSettings(), seed=seed, own_gust_std_m_s2=own_gusts_m_s2)
        self._downwash = downwash or Downwash()
        self._body_diameter_m = body_diameter_m
        self._touched: NDArray[np.bool_] = np.zeros((n, n), dtype=np.bool_)
        self._pairs = np.zeros((_MAX_COLLISIONS, 2), dtype=np.int64)

    @property
    def time_s(self) -> float:
        """Time since the start of the world [s]."""
        return self.vehicles.steps * STEP_S

    def step(self) -> list[Collision]:
        """Advance by one physics step; return the collisions that happened in it."""
        if not self.wind.is_calm:
            self.vehicles.air_ned_m_s[:] = self.wind.step()
        self.vehicles.step(self.commands)
        if self.wind.has_own_gusts:
            # _interact writes the push only if vehicles can meet; the gusts below would add up
            self.vehicles.push_ned_m_s2[:] = 0.0

        collisions = self._interact()
        if self.wind.has_own_gusts:
            self.vehicles.push_ned_m_s2 += self.wind.step_own_gusts()
        return collisions

    def truth_enu(self) -> tuple[Array, Array, Array]:
        """Return true positions (n, 3), velocities (n, 3) and attitudes ENU <- FLU (n, 4)."""
        states = self.vehicles.states
        return (
            frames.swap_enu_ned(states.position_ned_m),
            frames.swap_enu_ned(states.velocity_ned_m_s),
            frames.enu_flu_from_ned_frd(states.attitude),
        )

    def _interact(self) -> list[Collision]:
        """Find collisions and downwash; stop the motors of vehicles that have collided."""
        states = self.vehicles.states
        if states.on_ground.shape[0] < 2 or states.on_ground.all():
            return []

        count = find_collisions_and_downwash(
            self.vehicles.motion,
            self._touched,
            self._body_diameter_m,
            self._downwash.push_m_s2,
            self._downwash.spread,
            self.vehicles.push_ned_m_s2,
            self._pairs,
        )

        collisions: list[Collision] = []
        for first, second in self._pairs[: min(count, _MAX_COLLISIONS)].tolist():
            offset = states.position_ned_m[first] - states.position_ned_m[second]
            collision = Collision(
                first=first,
                second=second,
                time_s=self.time_s,
                distance_m=math.hypot(offset[0], offset[1]),
            )
            collisions.append(collision)
            states.motors_dead[[first, second]] = True
            self.collided |= {first, second}
        self.collisions.extend(collisions)
        return collisions


def _ground(spots_enu_m: Array, radius_m: float) -> Ground:
    """Return the ground that the take-off spots (k, 3) tell, with platforms of this radius."""
    ground_m = float(spots_enu_m[:, 2].min(initial=0.0))
    platforms_enu_m = spots_enu_m
    if not (spots_enu_m[:, 2] > ground_m).any():
        platforms_enu_m = spots_enu_m[:0]  # level
    return Ground(
        down=0.0 - ground_m,  # 0, and not -0, for the height 0
        spots=0.0 + frames.swap_enu_ned(platforms_enu_m),
        radius=radius_m,
    )


def _check_spawn(start_enu_m: Array, body_diameter_m: float, names: Sequence[str]) -> None:
    """Raise SpawnError when two vehicles would start inside each other."""
    for (i, first), (j, second) in itertools.combinations(enumerate(names), 2):
        east, north, up = (start_enu_m[i] - start_enu_m[j]).tolist()
        distance_m = math.hypot(east, north)
        if distance_m < body_diameter_m and abs(up) < HEIGHT_OF_DIAMETER * body_diameter_m:
            raise SpawnError(
                f"{first} and {second} would start inside each other: "
                f"{distance_m:.2f} m between centres, and a body measures "
                f"{body_diameter_m:.2f} m. Move one of their starts (start_enu_m)."
            )
