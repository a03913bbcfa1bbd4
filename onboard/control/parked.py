"""Parked vehicles as things to fly around, for a vehicle that they keep from its goal. Pure.

The law turns a vehicle about each neighbour by itself. Several parked ones, nearer together than
two distances to keep, are a wall for it, and where its goal lies straight behind it stands before
them. Once it has stood for a while, its ways lead around them as around pillars.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from onboard.avoidance.pairs import design_distance, margin_2
from onboard.avoidance.params import Capsule, Spacing
from onboard.control.route_map import CORNERS_PER_END
from onboard.types import Neighbour, State
from onboard.vectors import Vec2, horizontal, length_2

STANDING_S = 8.0  # a vehicle does not get on when it has stood for this time
STANDING_M_S = 0.3  # whoever is slower stands
AWAY_M = 0.4  # a vehicle nearer to its goal has no reason to go on

_PARKED_M_S = 0.2  # whoever is slower, and intends to be, is parked
_TOUCHING_M = 0.5  # one that is farther away than it must be by more holds nobody back
_NEAR_M = 5.0  # only parked vehicles within this distance count
_MOST = 8  # only so many of the nearest parked vehicles count

# A map that is computed in flight may take some milliseconds only, so it has at most so many tests
# (see route_map.MOST_TESTS).
_MOST_TESTS = 60_000


def is_standing_away(state: State, goal: Vec2) -> bool:
    """Return whether a vehicle stands, and its goal is elsewhere.

    Args:
        state: own estimate.
        goal: the goal, horizontally.
    """
    speed_m_s = length_2(horizontal(state.velocity_enu_m_s))
    here = horizontal(state.position_enu_m)
    return speed_m_s < STANDING_M_S and math.dist(here, goal) > AWAY_M


def pillars(state: State, neighbours: Sequence[Neighbour], spacing: Spacing) -> tuple[Capsule, ...]:
    """Return the parked vehicles around this one as pillars, nearest first.

    Args:
        state: own estimate.
        neighbours: the known neighbours.
        spacing: distances to keep.
    Returns:
        Pillars whose outline plus the clearance is the distance to keep; none, if all are too far
        away to hold this vehicle back.
    """
    here = horizontal(state.position_enu_m)
    own_margin_2_m2 = margin_2(state.position_std_m, state.velocity_std_m_s, spacing)

    found = []
    is_held = False
    for neighbour in neighbours:
        if not _is_parked(neighbour):
            continue
        there = horizontal(neighbour.position_enu_m)
        away_m = math.dist(here, there)
        keep_m = design_distance(own_margin_2_m2, neighbour, spacing)
        if away_m < _NEAR_M:
            found.append((away_m, Capsule(there, there, keep_m - spacing.clearance_m)))
            is_held = is_held or away_m < keep_m + _TOUCHING_M

    if not is_held:
        return ()
    return tuple(pillar for _, pillar in sorted(found)[:_MOST])


def most_pillars(corner_count: int, thing_count: int) -> int:
    """Return how many pillars a map may have beside what stands still, to be computed in flight.

    Args:
        corner_count: corners around the static things.
        thing_count: number of these things.
    """
    for count in range(_MOST, 0, -1):
        corners = corner_count + CORNERS_PER_END * count  # a pillar has one end
        if corners * corners * (thing_count + count) <= _MOST_TESTS:
            return count
    return 0


def _is_parked(neighbour: Neighbour) -> bool:
    """Whether a neighbour stands, and intends to stand."""
    speed_m_s = length_2(horizontal(neighbour.velocity_enu_m_s))
    intended_m_s = length_2(horizontal(neighbour.intent_enu_m_s))
    return speed_m_s < _PARKED_M_S and intended_m_s < _PARKED_M_S
