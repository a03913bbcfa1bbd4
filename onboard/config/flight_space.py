"""The space that a fleet may fly in: the box, and the allowed and forbidden areas. Pure.

All of them apply at the same time. A vehicle breaches the space when it crosses an edge. Goals and
flights also keep each area's buffer from its edge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

from onboard.config import areas, fences
from onboard.config.areas import Area, Point
from onboard.config.earth import Origin
from onboard.config.fleet_config import FleetConfig, Geofence, Vehicle
from onboard.config.ground import least_height_m, touchable_ground_at_m
from onboard.tuples import Xyz

_ROUNDS = 8  # largest number of rounds in which a point is moved into all areas
_AS_GOOD_AS_M = 1e-6  # the rounds end when the point moves by less
_ROUND_CORNERS = 48  # number of corners of a circle in a picture


class Outline(NamedTuple):
    """An area or an obstacle as pictures show it."""

    name: str
    keeps_in: bool
    corners_enu_m: tuple[Point, ...]  # corners; for a circle, points on it
    low_m: float  # both heights are clipped to the box
    high_m: float


class FlightSpace(NamedTuple):
    """The space that a fleet may fly in."""

    box: Geofence
    areas: tuple[Area, ...]

    def contains(self, position_enu_m: Xyz) -> bool:
        """Whether a position is inside the box, and allowed by every area.

        Args:
            position_enu_m: position of a vehicle.
        """
        if not self.box.contains(position_enu_m):
            return False
        return all(areas.is_allowed(area, position_enu_m) for area in self.areas)

    def refusal(self, position_enu_m: Xyz) -> str:
        """Return how a goal violates an area or its buffer, for instance "outside the fence 'a'".

        The result is empty for a goal that violates none. The caller checks the box.

        Args:
            position_enu_m: position of the goal.
        """
        for area in self.areas:
            words = _refusal(area, position_enu_m)
            if words:
                return words
        return ""

    def nearest_inside(self, position_enu_m: Xyz, inside_m: float) -> Xyz:
        """Return a point near a position that keeps a distance from every wall and every buffer.

        If only one edge is in the way, the result is the nearest such point. If areas and buffers
        leave no space, it is the last point that was tried.

        Args:
            position_enu_m: any point.
            inside_m: distance to walls and buffers [m].
        """
        point = self.box.nearest_inside(position_enu_m, inside_m)
        if not self.areas or not math.isfinite(sum(point)):
            return point

        for _ in range(_ROUNDS):
            moved = point
            for area in self.areas:
                moved = _moved_inside(area, moved, inside_m)
            moved = self.box.nearest_inside(moved, inside_m)
            if math.dist(moved, point) < _AS_GOOD_AS_M:
                break
            point = moved
        return point

    def outlines(self) -> tuple[Outline, ...]:
        """Return the areas for a picture, clipped to the heights of the box."""
        floor_m, top_m = self.box.z
        outlines = []
        for area in self.areas:
            corners = area.corners_enu_m
            if not corners:
                corners = _on_circle(area.center_enu_m, area.radius_m)
            outline = Outline(
                name=area.name,
                keeps_in=area.keeps_in,
                corners_enu_m=corners,
                low_m=min(max(area.low_m, floor_m), top_m),
                high_m=max(min(area.high_m, top_m), floor_m),
            )
            outlines.append(outline)
        return tuple(outlines)

    def room_m(self, position_enu_m: Xyz) -> tuple[float, str]:
        """Return the distance [m] to the nearest buffer, and the area's name.

        The distance is infinite without areas.

        Args:
            position_enu_m: position of a spot.
        """
        least_m = math.inf
        name = ""
        for area in self.areas:
            room_m = _room_m(area, position_enu_m)
            if room_m < least_m:
                least_m = room_m
                name = area.name
        return least_m, name


def outlines_of(fleet: FleetConfig) -> tuple[Outline, ...]:
    """Return the areas and the obstacles of a fleet for a picture.

    Args:
        fleet: the fleet file.
    """
    floor_m, top_m = fleet.fleet.geofence_m.z
    obstacles = []
    for obstacle in fleet.obstacles:
        corners: tuple[Point, ...] = ()
        if obstacle.polygon_enu_m is not None:
            corners = obstacle.polygon_enu_m
        elif obstacle.circle is not None:
            corners = _on_circle(obstacle.circle.center_enu_m, obstacle.circle.radius_m)
        outline = Outline(
            name=obstacle.name,
            keeps_in=False,
            corners_enu_m=corners,
            low_m=floor_m,
            high_m=top_m,
        )
        obstacles.append(outline)
    return (*flight_space_of(fleet).outlines(), *obstacles)


def flight_space_of(fleet: FleetConfig) -> FlightSpace:
    """Return the space that a fleet may fly in.

    Args:
        fleet: the fleet file.
    """
    if not fleet.fences:
        return FlightSpace(fleet.fleet.geofence_m, ())
    return _flight_space_of(fleet.fleet.geofence_m, fleet.fences, fleet.fleet.global_origin)


@lru_cache(maxsize=16)
def _flight_space_of(
    box: Geofence, written: Sequence[fences.Fence], origin: Origin | None
) -> FlightSpace:
    return FlightSpace(box, tuple(fences.area_of(fence, origin) for fence in written))


def _on_circle(center_enu_m: Point, radius_m: float) -> tuple[Point, ...]:
    """Return points on a circle, in order."""
    x, y = center_enu_m
    angles = [2.0 * math.pi * corner / _ROUND_CORNERS for corner in range(_ROUND_CORNERS)]
    return tuple(
        (x + radius_m * math.cos(angle), y + radius_m * math.sin(angle)) for angle in angles
    )


def _room_m(area: Area, position_enu_m: Xyz) -> float:
    """Return the distance [m] to an area's buffer; negative inside the buffer or beyond it."""
    x, y, z = position_enu_m
    room_m = areas.nearest(area, x, y).room_m - area.buffer_m
    if area.keeps_in:
        # The ceiling has no buffer. The floor does not count, because the ground is there.
        return min(room_m, area.high_m - z)

    above_m = z - area.high_m - area.buffer_m
    below_m = area.low_m - area.buffer_m - z
    return max(room_m, above_m, below_m)


def goal_refusal(fleet: FleetConfig, vehicle: Vehicle, goal_enu_m: Xyz) -> str:
    """Return why a vehicle may not have a goal, and what to do; empty if it may.

    A goal must lie inside the box and in the areas, and high enough above the ground. The words
    follow the goal in a sentence, and lack the last full stop.

    Args:
        fleet: the fleet file.
        vehicle: the vehicle.
        goal_enu_m: its goal [m], ENU.
    """
    box = fleet.fleet.geofence_m
    if not box.contains(goal_enu_m):
        return (
            f"lies outside the geofence x {list(box.x)}, y {list(box.y)}, z {list(box.z)} m. "
            "Choose one inside, above the ground"
        )

    area_words = flight_space_of(fleet).refusal(goal_enu_m)
    if area_words:
        return f"lies {area_words}. Choose another one"

    x, y, height_m = goal_enu_m
    ground_m = float(touchable_ground_at_m(fleet, x, y))
    least_m = least_height_m(vehicle)
    if height_m < ground_m + least_m:
        why = ""
        if not vehicle.mocap_required:
            why = " (its height is PX4's own, which errs by that much)"
        return (
            f"is less than {least_m:g} m above the ground at {ground_m:g} m{why}. "
            "Choose a higher goal, or order land"
        )
    return ""


def _refusal(area: Area, position_enu_m: Xyz) -> str:
    """Return how a goal violates one area or its buffer; empty if it does not."""
    x, y, z = position_enu_m
    room_m = areas.nearest(area, x, y).room_m
    if area.keeps_in:
        if room_m < 0.0:
            return f"outside the fence '{area.name}'"
        if z > area.high_m:
            return f"above the fence '{area.name}', which ends at {area.high_m:g} m"
        if z < area.low_m - areas.BELOW_FLOOR_M:
            return f"below the fence '{area.name}', which begins at {area.low_m:g} m"
        if room_m < area.buffer_m:
            return _too_near(area, room_m)
        return ""

    if not areas.counts_at(area, z, z):  # above or below the area and its buffer
        return ""
    if room_m < 0.0:
        if area.low_m <= z <= area.high_m:
            return f"inside the fence '{area.name}', which is to stay out of"
        above_or_below_m = max(z - area.high_m, area.low_m - z)
        return _too_near(area, above_or_below_m)
    if room_m < area.buffer_m:
        return _too_near(area, room_m)
    return ""


def _too_near(area: Area, room_m: float) -> str:
    return (
        f"{room_m:.2f} m from the edge of the fence '{area.name}', whose buffer is "
        f"{area.buffer_m:g} m"
    )


def _moved_inside(area: Area, position_enu_m: Xyz, inside_m: float) -> Xyz:
    """Return a position, moved until it is at a distance inside one area and its buffer."""
    x, y, z = position_enu_m
    highest_m = area.high_m - inside_m
    has_height = highest_m > area.low_m  # False: the ceiling is too low to keep this distance
    if area.keeps_in and has_height:
        z = min(max(z, area.low_m), highest_m)
    elif not areas.counts_at(area, z, z):  # above or below the area and its buffer
        return position_enu_m

    nearest = areas.nearest(area, x, y)
    needed_m = area.buffer_m + inside_m  # distance of the moved position from the edge
    if nearest.room_m >= needed_m:
        return x, y, z
    return (nearest.x + needed_m * nearest.normal_x, nearest.y + needed_m * nearest.normal_y, z)
