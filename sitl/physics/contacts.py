"""Collisions of vehicles, and the downwash on a vehicle below another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.physics.frames import Array
from sitl.physics.jit import Records, compiled

# Two vehicles touch when their discs overlap and their centres are closer in height than this part
# of a diameter.
HEIGHT_OF_DIAMETER = 0.5
# Beyond three of its radii, less than 0.02 % of a jet is left. This is three squared.
_JET_REACH_SQUARE = 9.0


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
def find_collisions_and_downwash(
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
