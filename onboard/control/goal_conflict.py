"""Decides where a vehicle waits if its goal is too near to another vehicle's goal. Pure.

If two goals are nearer to each other than the distance that their vehicles keep, only one vehicle
can arrive at a time. Without a decision both circle about each other beside their goals. One of
them must wait at a point away from both goals until the other has arrived or has got a new goal.
The same rule as in a passage decides who waits (:func:`onboard.control.yielding.is_to_yield`).
A vehicle computes another one's goal from its published position and intent.

The ground refuses such goals in one order. They may still come from two orders, for instance if a
vehicle gets its next goal before another vehicle has left that place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from onboard.avoidance.heights import INTENT_S
from onboard.avoidance.pairs import design_distance, margin_2
from onboard.avoidance.params import Spacing
from onboard.control.pipeline import INTENT_1_S
from onboard.control.route_map import RouteMap
from onboard.types import Neighbour, State
from onboard.vectors import Vec2, Vec3, horizontal

ARRIVED_M = 0.1  # a vehicle nearer to its goal has arrived
_NEAR_GOAL_FRAC = 1.5  # a vehicle is near its goal within this multiple of the safety distance

_BESIDE_M = 0.5  # a waiting point is this much farther from the other goal than necessary
# directions in which a waiting point is tried, from the direction away from the other goal
_TURNS_DEG = (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0)


class Rival(NamedTuple):
    """A neighbour on its way to a goal that is too near to the goal of this vehicle."""

    position_m: Vec2
    goal_m: Vec2
    distance_m: float  # distance that the two vehicles keep
    table_index: int  # index of the neighbour


def is_short_of_goal(state: State, goal_enu_m: Vec3, spacing: Spacing) -> bool:
    """Return whether a vehicle is near its goal, but has not arrived.

    Args:
        state: own estimate.
        goal_enu_m: its goal [m], ENU; only the horizontal position counts.
        spacing: distances to keep.
    """
    away_m = math.dist(horizontal(state.position_enu_m), horizontal(goal_enu_m))
    return ARRIVED_M < away_m <= near_goal_m(spacing)


def near_goal_m(spacing: Spacing) -> float:
    """Return the distance [m] within which a vehicle is near its goal."""
    return _NEAR_GOAL_FRAC * spacing.safety_distance_m


def rival_of(
    state: State, goal_enu_m: Vec3, neighbours: Sequence[Neighbour], spacing: Spacing
) -> Rival | None:
    """Return the rival whose goal is nearest to the goal of this vehicle, if there is one.

    Args:
        state: own estimate.
        goal_enu_m: our own goal [m], ENU.
        neighbours: the known neighbours.
        spacing: distances to keep.
    """
    own_goal = horizontal(goal_enu_m)
    own_margin_2_m2 = margin_2(state.position_std_m, state.velocity_std_m_s, spacing)

    nearest: Rival | None = None
    nearest_m = math.inf
    for neighbour in neighbours:
        if not neighbour.is_cooperative:
            continue
        position = neighbour.predicted_position_enu_m
        their_goal = _goal_of(neighbour)
        to_their_goal_m = math.dist(horizontal(position), horizontal(their_goal))
        apart_m = math.dist(own_goal, horizontal(their_goal))
        keep_m = design_distance(own_margin_2_m2, neighbour, spacing)

        are_at_one_height = (
            abs(goal_enu_m.z - their_goal.z) < spacing.vertical_separation_m
            and abs(state.position_enu_m.z - position.z) < spacing.vertical_separation_m
        )
        is_short_of_goal = ARRIVED_M < to_their_goal_m <= keep_m
        are_goals_near = apart_m < min(keep_m, near_goal_m(spacing))
        is_rival = are_at_one_height and is_short_of_goal and are_goals_near
        if is_rival and apart_m < nearest_m:
            nearest_m = apart_m
            nearest = Rival(
                position_m=horizontal(position),
                goal_m=horizontal(their_goal),
                distance_m=keep_m,
                table_index=neighbour.table_index,
            )
    return nearest


def waiting_point(
    here: Vec2, rival: Rival, neighbours: Sequence[Neighbour], route_map: RouteMap
) -> Vec2 | None:
    """Return a point at which the rival does not need to avoid this vehicle, if there is one.

    Args:
        here: our own position.
        rival: the vehicle that goes first.
        neighbours: the known neighbours; the point is away from all of them.
        route_map: map of the static things.
    """
    away = math.atan2(here.y - rival.goal_m.y, here.x - rival.goal_m.x)
    radius_m = rival.distance_m + _BESIDE_M
    for turn_deg in _TURNS_DEG:
        angle = away + math.radians(turn_deg)
        point = Vec2(
            rival.goal_m.x + radius_m * math.cos(angle),
            rival.goal_m.y + radius_m * math.sin(angle),
        )
        is_clear = all(
            math.dist(point, horizontal(neighbour.position_enu_m)) >= rival.distance_m
            for neighbour in neighbours
        )
        if is_clear and route_map.is_free(here, point):
            return point
    return None


def _goal_of(neighbour: Neighbour) -> Vec3:
    """Return a neighbour's goal, or a point on its way there if the goal is far away."""
    position = neighbour.predicted_position_enu_m
    intent = neighbour.intent_enu_m_s
    return Vec3(
        position.x + intent.x / INTENT_1_S,
        position.y + intent.y / INTENT_1_S,
        position.z + INTENT_S * intent.z,
    )
