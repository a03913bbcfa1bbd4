"""Neighbours that are about to touch the ground.

A vehicle that comes down without poses may still slide when it touches the ground, and friction
stops it within centimetres. No vehicle in flight can brake like that, so one that follows it must
not count on its motion. From shortly before a touchdown, the law therefore gets the neighbour's
motion without the part that leads away from our own vehicle.
"""

from __future__ import annotations

import math

from onboard.arrays import Array
from onboard.bus.schema import Telemetry
from onboard.neighbours.state_arrays import SCALAR_COLUMN, VECTOR_COLUMNS
from onboard.neighbours.table import NeighbourTable
from onboard.safety.limits import NEIGHBOUR_BLIND_S
from onboard.tuples import Xyz

_SINKING_M_S = 0.3  # slower than this, a vehicle does not count as coming down
_BEFORE_S = 0.6  # long enough for a vehicle behind it to brake
_HEIGHT_ERROR_M = 0.15  # without poses the neighbour's height is PX4's

# columns of vectors, of which the first two are horizontal
_MOTIONS = tuple(
    VECTOR_COLUMNS[name].start
    for name in (
        "velocity_enu_m_s",
        "acceleration_enu_m_s2",
        "predicted_velocity_enu_m_s",
        "commanded_acceleration_enu_m_s2",
    )
)
_HEIGHT = VECTOR_COLUMNS["position_enu_m"].start + 2
_CLIMB = VECTOR_COLUMNS["velocity_enu_m_s"].start + 2
_COOPERATES = SCALAR_COLUMN["is_cooperative"]
_TABLE_INDEX = SCALAR_COLUMN["table_index"]


def stop_at_touchdown(rows: Array, own_enu_m: Xyz, table: NeighbourTable) -> None:
    """Remove what leads away from us from the horizontal motion of neighbours that touch down soon.

    Args:
        rows: (N, fields of a Neighbour) numbers of the neighbours; changed in place.
        own_enu_m: our position [m].
        table: the neighbours, with their telemetry.
    """
    sink_m_s = -rows[:, _CLIMB]
    height_m = rows[:, _HEIGHT] - table.lowest_ground_m
    is_near_ground = height_m < _BEFORE_S * sink_m_s + _HEIGHT_ERROR_M
    touches_soon = is_near_ground & (sink_m_s > _SINKING_M_S)
    if not touches_soon.any():
        return

    telemetries = table.telemetries()
    for index in touches_soon.nonzero()[0]:
        row = rows[index]
        name = table.names[int(row[_TABLE_INDEX])]
        is_cooperative = row[_COOPERATES] != 0.0
        if not (is_cooperative and _flies_on(telemetries.get(name))):
            _remove_motion_away(row, own_enu_m)


def _flies_on(telemetry: Telemetry | None) -> bool:
    """Return whether a vehicle flies an order by its poses, so that it does not touch down."""
    if telemetry is None:
        return False
    is_down_soon = telemetry.state in ("landing", "failed")
    return not is_down_soon and telemetry.state_age_s <= NEIGHBOUR_BLIND_S


def _remove_motion_away(row: Array, own_enu_m: Xyz) -> None:
    """Remove the part of a neighbour's horizontal motion that leads away from us."""
    east_m = row[0] - own_enu_m[0]
    north_m = row[1] - own_enu_m[1]
    distance_m = max(math.hypot(east_m, north_m), 1e-6)  # no division by zero
    east = east_m / distance_m
    north = north_m / distance_m
    for column in _MOTIONS:
        away = max(0.0, east * row[column] + north * row[column + 1])
        row[column] -= away * east
        row[column + 1] -= away * north
