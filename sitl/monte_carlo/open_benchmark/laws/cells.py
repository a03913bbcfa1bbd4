"""Buffered Voronoi cells: each vehicle stays in the part of the plane that is nearer to it.

Zhou, Wang, Bandyopadhyay, Schwager: Fast, On-line Collision Avoidance for Dynamic Vehicles Using
Buffered Voronoi Cells, RA-L 2017. The turn to the right is one of their ways out of deadlocks.
"""

from __future__ import annotations

from typing import Any

from onboard.avoidance.own_law import LawInputs
from onboard.types import Thrust
from onboard.vectors import Vec2
from sitl.monte_carlo.open_benchmark.laws.around import (
    Body,
    HalfPlane,
    bodies,
    nearest,
    preferred_velocity,
    steered,
)

_HORIZON_S = 0.5  # time ahead of the point that the vehicle flies to


def law(memory: Any, inputs: LawInputs) -> tuple[Any, Thrust]:
    """Return the thrust towards the point of the vehicle's cell nearest to the preferred point."""
    around = bodies(inputs)
    preferred = preferred_velocity(inputs, around)
    target_m = Vec2(_HORIZON_S * preferred.x, _HORIZON_S * preferred.y)

    point_m = nearest(target_m, [cell_row(body) for body in around])
    return None, steered(inputs, Vec2(point_m.x / _HORIZON_S, point_m.y / _HORIZON_S))


def cell_row(body: Body) -> HalfPlane:
    """Return the edge of the buffered cell towards a body, relative to this vehicle.

    Between two vehicles the edge lies in the middle, moved back by half of the distance to keep.
    An obstacle has no cell, so there the edge lies at the distance to keep from the obstacle.
    """
    return HalfPlane(body.unit, body.share * (body.d_m - body.distance_m))
