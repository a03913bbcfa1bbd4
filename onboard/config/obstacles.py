"""``[[obstacles]]`` of a fleet file: static circles and polygons of unlimited height."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import msgspec

Capsule = tuple[float, float, float, float, float]  # x1, y1, x2, y2, radius [m]: a thick segment
_LARGEST_M = 1e4  # largest coordinate or radius


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
    corners = obstacle.polygon_enu_m
    if (obstacle.circle is None) == (corners is None):
        return (
            f"'{key}' ({obstacle.name}) needs exactly one shape. Write either circle = "
            "{ center_enu_m = [x, y], radius_m = r } or "
            "polygon_enu_m = [[x, y], [x, y], [x, y]]."
        )

    if corners is not None and len(corners) < 3:
        return (
            f"'{key}.polygon_enu_m' has {len(corners)} corners; a polygon has at least 3. Add the "
            "others."
        )
    if obstacle.circle is not None and not 0.0 <= obstacle.circle.radius_m <= _LARGEST_M:
        return (
            f"'{key}.circle.radius_m' is {obstacle.circle.radius_m}; it must lie between 0 and "
            f"{_LARGEST_M:g}."
        )

    for capsule in obstacle.capsules_enu_m:
        for value in capsule:
            if not abs(value) <= _LARGEST_M:  # also True for NaN
                return (
                    f"'{key}' ({obstacle.name}) has a coordinate beyond {_LARGEST_M:g} m, or not "
                    "finite. Correct it."
                )
    return None
