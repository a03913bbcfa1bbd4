"""The room that the vehicles share: wind, the air that a vehicle pushes down on another, and
collisions.

Also where ground truth is read, and never written.
"""

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
_MOST_AT_ONCE = 64  # collisions reported in one step


class SpawnError(ValueError):
    """Vehicles cannot start at the given positions: a sentence for people."""


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

    With a gap h in height, a horizontal offset r and a body diameter D the lower one is pushed down
    by ``push_m_s2 L (D / (D + h))^2 exp(-(r / (D / 2 + spread h))^2)``, L the upper one's lift over
    its weight; the push sets in over the first half diameter of height. The values are of the size
    that is reported for small quadrotors, 8 % of the weight one diameter below; they are not
    measured on any of ours.
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
        self._pairs = np.zeros((_MOST_AT_ONCE, 2), dtype=np.int64)

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
        """Positions (n, 3) [m], velocities (n, 3) [m/s] and attitudes ENU <- FLU (n, 4) as they
        really are.
        """
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
        count = meet(
            self.vehicles.motion,
            self._touched,
            self._body_diameter_m,
            self._downwash.push_m_s2,
            self._downwash.spread,
            self.vehicles.push_ned_m_s2,
            self._pairs,
        )
        if count == 0:
            return []
        collisions = []
        for first, second in self._pairs[: min(count, _MOST_AT_ONCE)].tolist():
            offset = s.position_ned_m[first] - s.position_ned_m[second]
            collisions.append(
                Collision(first, second, self.time_s, math.hypot(offset[0], offset[1]))
            )
            s.motors_dead[[first, second]] = True
        self.collisions.extend(collisions)
        return collisions


@compiled
def pushed_down_m_s2(
    square_m2: float, gap_m: float, diameter_m: float, wash_m_s2: float, wash_spread: float
) -> float:
    """Acceleration downwards of a vehicle below one that hovers, see :class:`Downwash`.

    Args:
        square_m2: of the horizontal offset. gap_m: height of the upper one above the lower one.
            diameter_m: of a body.
        wash_m_s2, wash_spread: see :class:`Downwash`.
    """
    radius = 0.5 * diameter_m + wash_spread * gap_m
    if gap_m <= 0.0 or square_m2 > 9.0 * radius * radius:
        return 0.0
    onset = min(1.0, gap_m / (HEIGHT_OF_DIAMETER * diameter_m))
    fade = diameter_m / (diameter_m + gap_m)
    return wash_m_s2 * onset * fade * fade * math.exp(-square_m2 / (radius * radius))


@compiled
def pushed_down_each(
    place_ned_m: Array, diameter_m: float, wash_m_s2: float, wash_spread: float
) -> Array:
    """Accelerations downwards (F, N) of all vehicles of many flights by those above them, all of
    which hover.

    Args:
        place_ned_m: (F, N, 3). diameter_m: of a body.
        wash_m_s2, wash_spread: see :class:`Downwash`.
    """
    flights, count = place_ned_m.shape[:2]
    push = np.zeros((flights, count))
    for f in range(flights):
        for i in range(count):
            for j in range(count):
                north, east, gap = place_ned_m[f, i] - place_ned_m[f, j]
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
    """Collisions and downwash of all pairs.

    Args:
        motion: (n,) records MOTION. touched: (n, n), updated: pairs that have met. diameter_m: of a
            body.
        wash_m_s2, wash_spread: see :class:`Downwash`.
        push: (n, 3) acceleration, written. pairs: (m, 2) indices of new collisions, written.
    Returns:
        number of new collisions.
    """
    n, count, half_height_m = motion.shape[0], 0, HEIGHT_OF_DIAMETER * diameter_m
    push[:] = 0.0
    for i in range(n):
        for j in range(i + 1, n):
            a, b = motion[i], motion[j]
            if a.on_ground and b.on_ground:
                continue
            dn, de = a.position[0] - b.position[0], a.position[1] - b.position[1]
            dd = a.position[2] - b.position[2]
            square = dn * dn + de * de
            if square < diameter_m * diameter_m and abs(dd) < half_height_m and not touched[i, j]:
                touched[i, j] = True
                if count < pairs.shape[0]:
                    pairs[count, 0], pairs[count, 1] = i, j
                count += 1
            upper, lower, gap = (i, j, -dd) if dd < 0.0 else (j, i, dd)
            lift_share = motion[upper].lift_share
            if lift_share != 0.0:
                push[lower, 2] += lift_share * pushed_down_m_s2(
                    square, gap, diameter_m, wash_m_s2, wash_spread
                )
    return count


def _check_spawn(start_enu_m: Array, body_diameter_m: float, names: Sequence[str]) -> None:
    for (i, first), (j, second) in itertools.combinations(enumerate(names), 2):
        a, b = start_enu_m[i], start_enu_m[j]
        distance_m, height_m = math.hypot(a[0] - b[0], a[1] - b[1]), abs(float(a[2] - b[2]))
        if distance_m < body_diameter_m and height_m < HEIGHT_OF_DIAMETER * body_diameter_m:
            raise SpawnError(
                f"{first} and {second} would start inside each other: {distance_m:.2f} m between centres, and a body "
                f"measures {body_diameter_m:.2f} m. Move one of their starts (start_enu_m)."
            )
