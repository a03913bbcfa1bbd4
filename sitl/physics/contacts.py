"""The world of all vehicles: wind, downwash on a vehicle below another, and collisions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.physics.jit import Records, compiled
from sitl.physics.vehicle import STEP_S, Commands, VehicleProfile, Vehicles
from sitl.physics.wind import Wind, WindSettings

# Two vehicles touch when their discs overlap and their centres are closer in height than this part
# of a diameter.
HEIGHT_OF_DIAMETER = 0.5
_MOST_COLLISIONS = 64  # collisions reported in one step
# Beyond three of its radii, less than 0.02 % of a jet is left. This is three squared.
_JET_REACH_SQUARE = 9.0


class SpawnError(ValueError):
    """Vehicles cannot start at the given positions; the message is a sentence."""


@dataclass(frozen=True, slots=True)
class Collision:
    """A contact of two vehicles."""

    first: int  # index of the first vehicle
    second: int  # index of the second vehicle
    time_s: float
    distance_m: float  # horizontal distance between the centres


@dataclass(frozen=True, slots=True)
class Downwash:
    """Push on a vehicle below another, a jet that widens and slows down.

    With a gap h in height, a horizontal offset r and a body diameter D the lower one is pushed down
    by ``push_m_s2 L (D / (D + h))^2 exp(-(r / (D / 2 + spread h))^2)``, where L is the upper one's
    lift over its weight. The push sets in over the first half diameter of height.

    The default values match reports for small quadrotors, a push of 8 % of the weight one diameter
    below. They were not measured on a vehicle of this project.
    """

    push_m_s2: float = 3.0
    spread: float = 0.2


class World:
    """Vehicles on one floor.

    Args:
        profiles: profile of each vehicle.
        start_enu_m: (n, 3) start positions in the fleet frame [m].
        body_diameter_m: horizontal distance between centres below which two vehicles touch.
        seed: seed of every random number of the physics.
        wind: settings of the wind; without them the air is calm.
        downwash: downwash of each vehicle.
        names: names of the vehicles for the sentence when two start inside each other.
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
        self.collided: set[int] = set()  # vehicles that have touched another
        own_gusts_m_s2 = [profile.gust_std_m_s2 for profile in profiles]
        self.wind = Wind(n, wind or WindSettings(), seed=seed, own_gust_std_m_s2=own_gusts_m_s2)
        self._downwash = downwash or Downwash()
        self._body_diameter_m = body_diameter_m
        self._touched: NDArray[np.bool_] = np.zeros((n, n), dtype=np.bool_)
        self._pairs = np.zeros((_MOST_COLLISIONS, 2), dtype=np.int64)

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

        count = meet(
            self.vehicles.motion,
            self._touched,
            self._body_diameter_m,
            self._downwash.push_m_s2,
            self._downwash.spread,
            self.vehicles.push_ned_m_s2,
            self._pairs,
        )

        collisions: list[Collision] = []
        for first, second in self._pairs[: min(count, _MOST_COLLISIONS)].tolist():
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


@compiled
def pushed_down_m_s2(
    square_m2: float, gap_m: float, diameter_m: float, wash_m_s2: float, wash_spread: float
) -> float:
    """Return the acceleration downwards of a vehicle below one that hovers, see :class:`Downwash`.

    Args:
        square_m2: square of the horizontal offset.
        gap_m: height of the upper one above the lower one.
        diameter_m: diameter of a body.
        wash_m_s2: `Downwash.push_m_s2`.
        wash_spread: `Downwash.spread`.
    """
    radius = 0.5 * diameter_m + wash_spread * gap_m
    if gap_m <= 0.0 or square_m2 > _JET_REACH_SQUARE * radius * radius:
        return 0.0

    onset = min(1.0, gap_m / (HEIGHT_OF_DIAMETER * diameter_m))
    fade = diameter_m / (diameter_m + gap_m)
    return wash_m_s2 * onset * fade * fade * math.exp(-square_m2 / (radius * radius))


@compiled
def pushed_down_each(
    position_ned_m: Array, diameter_m: float, wash_m_s2: float, wash_spread: float
) -> Array:
    """Return the accelerations downwards (F, N) of the vehicles of many flights, which all hover.

    Args:
        position_ned_m: positions (F, N, 3) of N vehicles in each of F flights.
        diameter_m: diameter of a body.
        wash_m_s2: `Downwash.push_m_s2`.
        wash_spread: `Downwash.spread`.
    """
    flights, count = position_ned_m.shape[:2]
    push = np.zeros((flights, count))
    for f in range(flights):
        for i in range(count):
            for j in range(count):
                # positive where j flies above i
                north, east, gap = position_ned_m[f, i] - position_ned_m[f, j]
                square = north * north + east * east
                push[f, i] += pushed_down_m_s2(square, gap, diameter_m, wash_m_s2, wash_spread)
    return push


@compiled
def meet(
    motion: Records,
    touched: NDArray[np.bool_],
    diameter_m: float,
    wash_m_s2: float,
    wash_spread: float,
    push: Array,
    pairs: NDArray[np.int64],
) -> int:
    """Find the collisions and the downwash of all pairs.

    Args:
        motion: records MOTION (n,).
        touched: whether each pair has met (n, n), updated.
        diameter_m: diameter of a body.
        wash_m_s2: `Downwash.push_m_s2`.
        wash_spread: `Downwash.spread`.
        push: acceleration by the downwash (n, 3), written.
        pairs: indices of the vehicles of new collisions (m, 2), written.

    Returns:
        number of new collisions.
    """
    n = motion.shape[0]
    height_m = HEIGHT_OF_DIAMETER * diameter_m
    count = 0
    push[:] = 0.0

    for i in range(n):
        for j in range(i + 1, n):
            a = motion[i]
            b = motion[j]
            if a.on_ground and b.on_ground:
                continue

            north = a.position[0] - b.position[0]
            east = a.position[1] - b.position[1]
            down = a.position[2] - b.position[2]
            square = north * north + east * east

            meets = square < diameter_m * diameter_m and abs(down) < height_m
            if meets and not touched[i, j]:
                touched[i, j] = True
                if count < pairs.shape[0]:
                    pairs[count, 0] = i
                    pairs[count, 1] = j
                count += 1

            if down < 0.0:
                upper = i
                lower = j
                gap = -down
            else:
                upper = j
                lower = i
                gap = down
            lift_share = motion[upper].lift_share
            if lift_share != 0.0:
                push[lower, 2] += lift_share * pushed_down_m_s2(
                    square, gap, diameter_m, wash_m_s2, wash_spread
                )
    return count


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
