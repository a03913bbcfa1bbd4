"""Neighbours that are about to touch the ground.

A vehicle that comes down without poses may still slide when it touches the ground, and friction
stops it within centimetres. No vehicle in flight can brake like that, so one that follows it must
not count on its motion. From shortly before a touchdown, the law therefore gets the neighbour's
motion without the part that leads away from our own vehicle.
"""

from __future__ import annotations

import numpy as np

from onboard.arrays import Array
from onboard.neighbours.state_arrays import VECTOR_COLUMNS
from onboard.tuples import Xyz

_SINKING_M_S = 0.3  # slower than this, a vehicle does not count as coming down
_BEFORE_S = 0.6  # long enough for a vehicle behind it to brake
_HEIGHT_ERROR_M = 0.15  # without poses the neighbour's height is PX4's

_MOTIONS = (
    "velocity_enu_m_s",
    "acceleration_enu_m_s2",
    "predicted_velocity_enu_m_s",
    "commanded_acceleration_enu_m_s2",
)
_MOTION_COLUMNS = [
    slice(VECTOR_COLUMNS[name].start, VECTOR_COLUMNS[name].start + 2) for name in _MOTIONS
]
_UP_POSITION = VECTOR_COLUMNS["position_enu_m"].start + 2
_UP_VELOCITY = VECTOR_COLUMNS["velocity_enu_m_s"].start + 2


def stop_at_touchdown(rows: Array, own_enu_m: Xyz, floor_m: float) -> None:
    """Remove what leads away from us from the horizontal motion of neighbours that touch down soon.

    Args:
        rows: (N, fields of a Neighbour) numbers of the neighbours; changed in place.
        own_enu_m: our position [m].
        floor_m: height of the ground [m].
    """
    sink_m_s = -rows[:, _UP_VELOCITY]
    height_m = rows[:, _UP_POSITION] - floor_m
    is_near_ground = height_m < _BEFORE_S * sink_m_s + _HEIGHT_ERROR_M
    touches_soon = is_near_ground & (sink_m_s > _SINKING_M_S)
    if not touches_soon.any():
        return

    away = rows[touches_soon, :2] - np.array(own_enu_m[:2])
    distance_m = np.hypot(away[:, 0], away[:, 1])
    away /= np.maximum(distance_m, 1e-6)[:, None]
    for columns in _MOTION_COLUMNS:
        motion = rows[touches_soon, columns]
        leads_away = np.maximum(0.0, (motion * away).sum(axis=1))
        rows[touches_soon, columns] = motion - leads_away[:, None] * away
