"""Says whether the raised ground of a take-off spot is in the way of a flight. Pure.

A spot may be on a roof or a table, from which vehicles also fly to lower goals beside it. On a
flight to a goal the height changes evenly, on the straight line or up to the first corner of the
route around fences and obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.ground import (
    ground_at_m,
    highest_spot_m,
    is_level,
    least_height_m,
    lowest_ground_m,
)
from onboard.control.router import Surroundings, route_between
from onboard.tuples import Xyz
from onboard.vectors import Vec2

# Clearances of a flight above raised ground, as shares of the least height of goals there. A
# vehicle that is not where a mission or an order expected it still passes the later check.
CLEARANCE_IN_MISSION = 1.0
CLEARANCE_IN_ORDER = 0.75
CLEARANCE_ON_VEHICLE = 0.5
_CLEARANCE_CHOSEN = 1.5  # of a goal whose height is chosen
_CLEARANCE_ADVISED = 1.25  # of a height that is advised

# Over the ground on which it began, a flight may be lower than that, but not this much lower than
# its begin.
_SINKS_M = 0.05
# A flight that begins below raised ground, as beside a table, may lead this far aside below it.
_ASIDE_M = 0.3
_STEP_M = 0.05  # distance between two checked points


class _Profile(NamedTuple):
    """Points of a flight."""

    shares: Array  # (n,) of the change of height
    heights_m: Array  # (n,)
    # (n,) least height at which it passes there; minus infinity where the ground is not raised
    passing_m: Array

    @property
    def touches(self) -> BoolArray:
        """Whether the flight would touch raised ground at each point."""
        return self.heights_m < self.passing_m


def ground_refusal(
    fleet: FleetConfig,
    vehicle: Vehicle,
    around: Surroundings,
    begin_enu_m: Xyz,
    goal_enu_m: Xyz,
    clearance_share: float,
) -> str:
    """Return why a flight would touch raised ground, and what to do first; empty if it would not.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        around: static things around it.
        begin_enu_m, goal_enu_m: its position, and the goal [m], ENU.
        clearance_share: one of the clearances above.
    """
    begin_x, begin_y, begin_z = begin_enu_m
    _, _, goal_z = goal_enu_m
    clearance_m = clearance_share * least_height_m(vehicle)
    if is_level(fleet) or min(begin_z, goal_z) >= highest_spot_m(fleet) + clearance_m:
        return ""

    profile = _profile(fleet, around, begin_enu_m, goal_enu_m, clearance_m)
    if not profile.touches.any():
        return ""

    highest_m = float(profile.passing_m[profile.touches].max())
    spare_m = (_CLEARANCE_ADVISED - clearance_share) * least_height_m(vehicle)
    over_m = max(begin_z, math.ceil(10.0 * (highest_m + spare_m)) / 10.0)
    above = (begin_x, begin_y, over_m)
    from_above = _profile(fleet, around, above, goal_enu_m, clearance_m)
    if not from_above.touches.any():
        first = f"climb to {over_m:.2f} m"
    elif over_m == begin_z:
        first = f"fly at {over_m:.2f} m to a point beside it"
    else:
        first = f"climb to {over_m:.2f} m and fly past it at that height"
    return (
        f"cannot be reached from ({begin_x:.2f}, {begin_y:.2f}, {begin_z:.2f}): the raised ground "
        f"of a take-off spot is in the way; first {first}"
    )


def height_over_ground_m(
    fleet: FleetConfig,
    vehicle: Vehicle,
    around: Surroundings,
    begins_enu_m: Iterable[Xyz],
    goal_enu_m: Xyz,
) -> float:
    """Return a height of a goal to which a flight passes over raised ground [m].

    It is the goal's own height if that is enough, and otherwise as low as possible.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        around: static things around it.
        begins_enu_m: positions from which the flight may begin [m], ENU.
        goal_enu_m: the goal [m], ENU.
    """
    _, _, height_m = goal_enu_m
    if is_level(fleet):
        return height_m

    clearance_m = _CLEARANCE_CHOSEN * least_height_m(vehicle)
    for begin_enu_m in begins_enu_m:
        _, _, begin_z = begin_enu_m
        profile = _profile(fleet, around, begin_enu_m, goal_enu_m, clearance_m)
        touches = profile.touches
        climbs_m = (profile.passing_m[touches] - begin_z) / profile.shares[touches]
        height_m = max(height_m, begin_z + float(climbs_m.max(initial=-math.inf)))
    return height_m


def _profile(
    fleet: FleetConfig,
    around: Surroundings,
    begin_enu_m: Xyz,
    goal_enu_m: Xyz,
    clearance_m: float,
) -> _Profile:
    """Return points of a flight that passes at this clearance above raised ground."""
    begin_x, begin_y, begin_z = begin_enu_m
    _, _, goal_z = goal_enu_m
    x_m, y_m, shares = _sampled(route_between(around, begin_enu_m, goal_enu_m))
    grounds_m = ground_at_m(fleet, x_m, y_m)
    from_begin_m = np.hypot(x_m - begin_x, y_m - begin_y)

    is_over_first = _is_over_first_ground(grounds_m, from_begin_m, begin_z)
    passing_m = grounds_m + clearance_m
    passing_m = np.where(is_over_first, np.minimum(passing_m, begin_z - _SINKS_M), passing_m)
    return _Profile(
        shares=shares,
        heights_m=begin_z + shares * (goal_z - begin_z),
        passing_m=np.where(grounds_m > lowest_ground_m(fleet), passing_m, -np.inf),
    )


def _sampled(route: Sequence[Vec2]) -> tuple[Array, Array, Array]:
    """Return points on a route: x and y [m], and the share of the change of height made there.

    The height changes up to the first corner.
    """
    xs = []
    ys = []
    shares = []
    first_share = 0.0
    for here, there in pairwise(route):
        count = 2 + math.ceil(math.dist(here, there) / _STEP_M)
        xs.append(np.linspace(here.x, there.x, count))
        ys.append(np.linspace(here.y, there.y, count))
        shares.append(np.linspace(first_share, 1.0, count))
        first_share = 1.0
    return np.concatenate(xs), np.concatenate(ys), np.concatenate(shares)


def _is_over_first_ground(grounds_m: Array, from_begin_m: Array, begin_z: float) -> BoolArray:
    """Return whether each point is still over the ground over which the flight began.

    A flight that begins below that ground, as beside a table, is over it only near its begin.
    """
    is_no_higher = grounds_m <= grounds_m[0]
    is_over = np.logical_and.accumulate(is_no_higher)
    if begin_z < grounds_m[0]:
        is_over &= from_begin_m <= _ASIDE_M
    return is_over
