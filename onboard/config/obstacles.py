"""``[[obstacles]]`` of a fleet file: static circles and polygons of unlimited height."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import msgspec

from onboard.config.fences import FARTHEST_M, polygon_fault

Capsule = tuple[float, float, float, float, float]  # x1, y1, x2, y2, radius [m]: a thick segment
_MAX_CAPSULES = 1000  # of all obstacles; with them a flight begins some seconds later


class Circle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Outline of a round obstacle, ENU."""

    center_enu_m: tuple[float, float]  # east, north
    radius_m: float  # of the outline


class Obstacle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[obstacles]]``: a circle, or a polygon given by its corners in order."""

    name: str  # for messages
    circle: Circle | None = None  # a round one: { center_enu_m = [x, y], radius_m = r }
    # or its corners in order: [[x, y], [x, y], [x, y]]
    polygon_enu_m: tuple[tuple[float, float], ...] | None = None

    @property
    def capsules_enu_m(self) -> tuple[Capsule, ...]:
        """The outline as capsules; the segment of a circle has no length."""
        if self.circle is not None:
            x, y = self.circle.center_enu_m
            return ((x, y, x, y, self.circle.radius_m),)

        corners: tuple[tuple[float, float], ...] = ()
        if self.polygon_enu_m is not None:
            corners = self.polygon_enu_m
        ends = (*corners[1:], *corners[:1])
        return tuple((*begin, *end, 0.0) for begin, end in zip(corners, ends, strict=True))

    def distance_m(self, position_enu_m: Sequence[float]) -> float:
        """Return the horizontal distance [m] from a position to the outline; negative inside.

        Args:
            position_enu_m: position, at least x and y.
        """
        x, y, *_ = position_enu_m
        nearest_m = math.inf
        is_inside = False

        for x1, y1, x2, y2, radius_m in self.capsules_enu_m:
            along_x = x2 - x1
            along_y = y2 - y1

            # nearest point of the segment, as a share of its length
            length_squared = along_x**2 + along_y**2
            segment_share = 0.0
            if length_squared > 0.0:
                segment_share = ((x - x1) * along_x + (y - y1) * along_y) / length_squared
            segment_share = min(1.0, max(0.0, segment_share))

            to_east_m = x - x1 - segment_share * along_x
            to_north_m = y - y1 - segment_share * along_y
            nearest_m = min(nearest_m, math.hypot(to_east_m, to_north_m) - radius_m)

            # A position is inside if a ray from it to the east crosses the outline an odd number of
            # times.
            has_ends_on_both_sides = (y1 > y) != (y2 > y)
            if has_ends_on_both_sides:
                crossing_x = x1 + (y - y1) / along_y * along_x
                if x < crossing_x:
                    is_inside = not is_inside

        if is_inside:
            return -nearest_m
        return nearest_m


def problems(
    obstacles: Sequence[Obstacle], starts_enu_m: Mapping[str, Sequence[float]], clearance_m: float
) -> Iterator[str]:
    """Check a fleet's obstacles.

    Args:
        obstacles: obstacles of the fleet file.
        starts_enu_m: vehicle -> its take-off spot.
        clearance_m: least distance from a spot to an obstacle.
    Yields:
        a sentence for each mistake.
    """
    capsule_count = sum(len(obstacle.capsules_enu_m) for obstacle in obstacles)
    if capsule_count > _MAX_CAPSULES:
        yield (
            f"'obstacles' have {capsule_count} corners and circles; {_MAX_CAPSULES} are the most. "
            "Leave out corners, or join obstacles."
        )

    names: set[str] = set()
    for index, obstacle in enumerate(obstacles):
        key = f"obstacles[{index}]"
        if not obstacle.name or obstacle.name in names:
            yield f"'{key}.name' is {obstacle.name!r}. Give each obstacle a name of its own."
        names.add(obstacle.name)

        fault = _shape_fault(obstacle, key)
        if fault is not None:
            yield fault
            continue

        for vehicle, start_enu_m in starts_enu_m.items():
            distance_m = obstacle.distance_m(start_enu_m)
            if distance_m < clearance_m:
                yield (
                    f"'vehicles.{vehicle}.start_enu_m' is {distance_m:.2f} m from obstacle "
                    f"'{obstacle.name}'; half a body and law.obstacle_margin_m need "
                    f"{clearance_m:.2f} m. Move the start."
                )


def _shape_fault(obstacle: Obstacle, key: str) -> str | None:
    """Return a sentence about an obstacle without a usable shape; None if its shape is usable."""
    label = f"'{key}' ({obstacle.name[:40]})"
    if (obstacle.circle is None) == (obstacle.polygon_enu_m is None):
        return (
            f"{label} needs exactly one shape. Write either circle = "
            "{ center_enu_m = [x, y], radius_m = r } or "
            "polygon_enu_m = [[x, y], [x, y], [x, y]]."
        )

    if obstacle.polygon_enu_m is not None:
        return polygon_fault(obstacle.polygon_enu_m, label)

    circle = obstacle.circle
    assert circle is not None  # checked
    if not 0.0 <= circle.radius_m <= FARTHEST_M:
        return (
            f"'{key}.circle.radius_m' is {circle.radius_m}; it must lie between 0 and "
            f"{FARTHEST_M:g}."
        )
    if not all(abs(value) <= FARTHEST_M for value in circle.center_enu_m):  # also True for NaN
        return f"{label} has a coordinate beyond {FARTHEST_M:g} m, or not finite. Correct it."
    return None
