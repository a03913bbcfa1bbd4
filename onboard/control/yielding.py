"""Decides which of two vehicles gives way if they meet and cannot pass, and where it waits. Pure.

If two vehicles meet in a passage that is wide enough for only one, both stop, because neither can
turn about the other, and neither flies away from its goal. One of them must fly back to a refuge, a
point beside the other vehicle's route. Both vehicles know the same two positions and two intents,
so both reach the same decision: the vehicle further west goes back. If it finds no refuge or uses
another law, it does not go back, and the other vehicle does so after a while. Each vehicle calls
the other its opponent.

Only static things and parked vehicles make such passages. In open space, the law's rotation rows
are enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from onboard.avoidance.pairs import design_distance, margin_2
from onboard.avoidance.params import Spacing
from onboard.control.route_map import RouteMap
from onboard.types import Neighbour, State
from onboard.vectors import Vec2, dot_xy, horizontal, length_xy

MEETING_S = 4.0  # two vehicles have met when they have stood face to face for this time
REFUSED_S = 12.0  # after this time the vehicle further east goes back

_SLOW_M_S = 0.2  # a vehicle that intends to fly faster is on its way
# A vehicle that is slower may stand face to face with another one. Their speed is not zero: with
# late messages the two push each other to and fro.
_STANDING_M_S = 0.5
_NEAR_M = 0.4  # vehicles are face to face if the gap beyond the distance to keep is at most this
_FACING = 0.3  # least cosine of the angle between an intent and the direction to the other vehicle
_AHEAD_M = 6.0  # length of the opponent's route that is kept free
_BESIDE_M = 0.15  # a refuge is this much farther from that route than necessary
_ASIDE_M = (0.0, 0.5, 1.0)  # distances from a corner at which a refuge is tried
# A route to a refuge passes the opponent only with this much more than the distance to keep.
_PASSING_SPARE_M = 0.1

_REJOIN_M = 2.5  # length of its own route that must be free before the vehicle continues
_REJOIN_SPARE_M = 0.3  # other vehicles must be this much farther from that length than necessary

# West, turned by 20 degrees. In a passage across this direction, neither vehicle would be further
# west. Few passages run that way.
_WEST = Vec2(-math.cos(math.radians(20.0)), -math.sin(math.radians(20.0)))


class Opponent(NamedTuple):
    """A neighbour that stands face to face with this vehicle."""

    position_m: Vec2
    direction: Vec2  # unit vector of its intended flight
    distance_m: float  # distance that the two vehicles keep
    table_index: int  # index of the neighbour


def opponent_of(
    state: State, direction: Vec2, neighbours: Sequence[Neighbour], spacing: Spacing
) -> Opponent | None:
    """Return the nearest vehicle that stands face to face with this one, if there is one.

    Args:
        state: own estimate.
        direction: unit vector of our own route.
        neighbours: the known neighbours.
        spacing: distances to keep.
    """
    if length_xy(horizontal(state.velocity_enu_m_s)) > _STANDING_M_S:
        return None

    own_margin_2_m2 = margin_2(state.position_std_m, state.velocity_std_m_s, spacing)
    here = horizontal(state.position_enu_m)
    nearest: Opponent | None = None
    nearest_m = math.inf
    for neighbour in neighbours:
        there = horizontal(neighbour.position_enu_m)
        towards = Vec2(there.x - here.x, there.y - here.y)
        away_m = length_xy(towards)
        keep_m = design_distance(own_margin_2_m2, neighbour, spacing)
        intent = horizontal(neighbour.intent_enu_m_s)
        intent_m_s = length_xy(intent)

        is_standing = length_xy(horizontal(neighbour.velocity_enu_m_s)) <= _STANDING_M_S
        is_waiting = is_standing and intent_m_s > _SLOW_M_S
        is_ahead = dot_xy(direction, towards) > _FACING * away_m
        is_coming = -dot_xy(intent, towards) > _FACING * away_m * intent_m_s
        is_facing = neighbour.is_cooperative and is_waiting and is_ahead and is_coming
        if is_facing and away_m < min(nearest_m, keep_m + _NEAR_M):
            nearest_m = away_m
            unit = Vec2(intent.x / intent_m_s, intent.y / intent_m_s)
            nearest = Opponent(there, unit, keep_m, neighbour.table_index)
    return nearest


def is_to_yield(here: Vec2, other: Vec2, met_s: float) -> bool:
    """Return whether this vehicle goes back.

    The vehicle further west goes back after MEETING_S, the other vehicle after REFUSED_S.

    Args:
        here: our own position.
        other: position of the vehicle that it has met.
        met_s: how long ago they met.
    """
    from_other = Vec2(here.x - other.x, here.y - other.y)
    is_west = dot_xy(from_other, _WEST) > 0.0
    if is_west:
        return met_s >= MEETING_S
    return met_s >= REFUSED_S


def nearest_refuge(here: Vec2, opponent: Opponent, route_map: RouteMap) -> Vec2 | None:
    """Return the nearest reachable refuge beside the opponent's route, if there is one.

    Args:
        here: our own position.
        opponent: the vehicle that stands face to face with this one, and blocks its routes.
        route_map: map of the static things.
    """
    corners = route_map.corners
    passing_m = opponent.distance_m + _PASSING_SPARE_M
    lengths_m = route_map.lengths_past(here, opponent.position_m, passing_m)

    best: Vec2 | None = None
    best_m = math.inf
    for to_corner_m, corner in sorted(zip(lengths_m, corners, strict=True)):
        if to_corner_m >= best_m:  # also if both are infinite: no route leads there
            break
        refuge = _refuge_beside(corner, opponent, route_map)
        if refuge is None:
            continue
        route_m = to_corner_m + math.dist(corner, refuge)
        if route_m < best_m:
            best = refuge
            best_m = route_m
    return best


def is_route_free(route: Sequence[Vec2], neighbours: Sequence[Neighbour], spacing: Spacing) -> bool:
    """Return whether the first metres of a route are free of vehicles that intend to move.

    Args:
        route: points of the route, from the vehicle on.
        neighbours: the known neighbours.
        spacing: distances to keep.
    """
    least_m = spacing.safety_distance_m + spacing.margin_m + _REJOIN_SPARE_M
    unchecked_m = _REJOIN_M
    for begin, end in pairwise(route):
        piece = Vec2(end.x - begin.x, end.y - begin.y)
        piece_m = length_xy(piece)
        share = min(1.0, unchecked_m / max(piece_m, 1e-6))  # 1e-6: no division by zero
        until = Vec2(begin.x + share * piece.x, begin.y + share * piece.y)
        for neighbour in neighbours:
            is_going = length_xy(horizontal(neighbour.intent_enu_m_s)) > _SLOW_M_S
            away_m = _piece_distance_m(horizontal(neighbour.position_enu_m), begin, until)
            if is_going and away_m < least_m:
                return False
        unchecked_m -= piece_m
        if unchecked_m <= 0.0:
            break
    return True


def _refuge_beside(corner: Vec2, opponent: Opponent, route_map: RouteMap) -> Vec2 | None:
    """Return the point nearest to a corner that is far enough from the opponent's route."""
    left = Vec2(-opponent.direction.y, opponent.direction.x)
    offset = Vec2(corner.x - opponent.position_m.x, corner.y - opponent.position_m.y)
    side = 1.0 if dot_xy(offset, left) >= 0.0 else -1.0
    needed_m = opponent.distance_m + _BESIDE_M

    for aside_m in _ASIDE_M:
        refuge = Vec2(corner.x + side * aside_m * left.x, corner.y + side * aside_m * left.y)
        if _route_distance_m(refuge, opponent) >= needed_m and route_map.is_free(corner, refuge):
            return refuge
    return None


def _route_distance_m(point: Vec2, opponent: Opponent) -> float:
    """Return the distance of a point from the first _AHEAD_M of the opponent's route."""
    begin = opponent.position_m
    direction = opponent.direction
    end = Vec2(begin.x + _AHEAD_M * direction.x, begin.y + _AHEAD_M * direction.y)
    return _piece_distance_m(point, begin, end)


def _piece_distance_m(point: Vec2, begin: Vec2, end: Vec2) -> float:
    """Return the distance of a point from a straight piece."""
    along = Vec2(end.x - begin.x, end.y - begin.y)
    offset = Vec2(point.x - begin.x, point.y - begin.y)
    share = min(max(dot_xy(offset, along) / max(dot_xy(along, along), 1e-12), 0.0), 1.0)
    return length_xy(Vec2(offset.x - share * along.x, offset.y - share * along.y))
