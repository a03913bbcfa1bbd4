"""Treats parked vehicles as things to fly around, for a vehicle that they keep from its goal. Pure.

The avoidance law leads a vehicle around each single neighbour. Several parked vehicles with gaps
that are too narrow act as a wall. If the goal lies straight behind them, the vehicle stops in front
of them. Once it has stood there for a while, its route treats them as pillars and leads around
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from onboard.avoidance.pairs import design_distance, margin_2
from onboard.avoidance.params import Capsule, Spacing
from onboard.control.route_map import CORNERS_PER_END
from onboard.types import Neighbour, State
from onboard.vectors import Vec2, horizontal, length_xy

STANDING_S = 8.0  # a vehicle that has stood for this time makes no progress
STANDING_M_S = 0.3  # a slower vehicle counts as standing
AWAY_M = 0.4  # a vehicle that stands nearer to its goal than this is not held back

_PARKED_M_S = 0.2  # a neighbour is parked if its speed and its intended speed are below this
# a parked vehicle holds this one back if the gap beyond the distance to keep is smaller than this
_TOUCHING_M = 0.5
_NEAR_M = 5.0  # only parked vehicles within this distance count
_MAX_PILLARS = 8  # number of parked vehicles that count: the nearest

# A map that is computed in flight may take only some milliseconds. So it has at most this number of
# tests (see route_map.MAX_TESTS).
_MAX_TESTS = 60_000


def is_standing_away(state: State, goal: Vec2) -> bool:
    """Return whether a vehicle stands away from its goal.

    Args:
        state: own estimate.
        goal: the goal; only its horizontal position counts.
    """
    speed_m_s = length_xy(horizontal(state.velocity_enu_m_s))
    here = horizontal(state.position_enu_m)
    return speed_m_s < STANDING_M_S and math.dist(here, goal) > AWAY_M


def pillars(state: State, neighbours: Sequence[Neighbour], spacing: Spacing) -> tuple[Capsule, ...]:
    """Return the parked vehicles around this one as pillars, nearest first.

    Args:
        state: own estimate.
        neighbours: the known neighbours.
        spacing: distances to keep.
    Returns:
        Pillars whose outline plus the clearance is the distance to keep. Empty if all parked
        vehicles are too far away to hold this vehicle back.
    """
    here = horizontal(state.position_enu_m)
    own_margin_2_m2 = margin_2(state.position_std_m, state.velocity_std_m_s, spacing)

    pillars_by_distance = []
    is_held = False
    for neighbour in neighbours:
        if not _is_parked(neighbour):
            continue
        there = horizontal(neighbour.position_enu_m)
        away_m = math.dist(here, there)
        keep_m = design_distance(own_margin_2_m2, neighbour, spacing)
        if away_m < _NEAR_M:
            pillar = Capsule(there, there, keep_m - spacing.clearance_m)
            pillars_by_distance.append((away_m, pillar))
            if away_m < keep_m + _TOUCHING_M:
                is_held = True

    if not is_held:
        return ()
    nearest = sorted(pillars_by_distance)[:_MAX_PILLARS]
    return tuple(pillar for _, pillar in nearest)


def most_pillars(corner_count: int, thing_count: int) -> int:
    """Return how many pillars a map of static things may also have if it is computed in flight.

    Args:
        corner_count: corners around the static things.
        thing_count: number of these things.
    """
    for count in range(_MAX_PILLARS, 0, -1):
        corners = corner_count + CORNERS_PER_END * count  # a pillar has one end
        if corners * corners * (thing_count + count) <= _MAX_TESTS:
            return count
    return 0


def _is_parked(neighbour: Neighbour) -> bool:
    """Whether a neighbour stands, and intends to stand."""
    speed_m_s = length_xy(horizontal(neighbour.velocity_enu_m_s))
    intended_m_s = length_xy(horizontal(neighbour.intent_enu_m_s))
    return speed_m_s < _PARKED_M_S and intended_m_s < _PARKED_M_S
