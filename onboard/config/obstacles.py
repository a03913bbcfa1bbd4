"""Static obstacles of a fleet file: circles and polygons that stand still, of any height. A leaf,
like config.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import msgspec

Capsule = tuple[float, float, float, float, float]
_LARGEST_M = 1e4


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
        """The outline as segments (x1, y1, x2, y2) with a radius; of a circle one without length."""
        if self.circle is not None:
            x, y = self.circle.center_enu_m
            return ((x, y, x, y, self.circle.radius_m),)
        corners = self.polygon_enu_m or ()
        ends = (*corners[1:], *corners[:1])
        return tuple((*begin, *end, 0.0) for begin, end in zip(corners, ends, strict=True))

    def distance_m(self, position_enu_m: Sequence[float]) -> float:
        """Distance from a position to the outline.

        Args:
            position_enu_m: at least x and y.
        Returns:
            horizontal distance [m]; negative inside.
        """
        x, y = position_enu_m[0], position_enu_m[1]
        nearest, is_inside = math.inf, False
        for x1, y1, x2, y2, radius in self.capsules_enu_m:
            length_2 = (x2 - x1) ** 2 + (y2 - y1) ** 2
            share = (
                ((x - x1) * (x2 - x1) + (y - y1) * (y2 - y1)) / length_2 if length_2 > 0.0 else 0.0
            )
            share = min(1.0, max(0.0, share))
            nearest = min(
                nearest, math.hypot(x - x1 - share * (x2 - x1), y - y1 - share * (y2 - y1)) - radius
            )
            if (y1 > y) != (y2 > y) and x < x1 + (y - y1) / (y2 - y1) * (x2 - x1):
                is_inside = not is_inside  # the ray to the east crosses this edge
        return -nearest if is_inside else nearest


def problems(
    obstacles: Sequence[Obstacle], starts_enu_m: Mapping[str, Sequence[float]], clearance_m: float
) -> Iterator[str]:
    """Check a fleet's obstacles.

    Args:
        obstacles: of the fleet file.
        starts_enu_m: vehicle -> its take-off spot.
        clearance_m: least distance from a spot to an obstacle.
    Yields:
        a sentence for each mistake.
    """
    names: set[str] = set()
    for index, obstacle in enumerate(obstacles):
        key, corners = f"obstacles[{index}]", obstacle.polygon_enu_m
        if not obstacle.name or obstacle.name in names:
            yield f"'{key}.name' is {obstacle.name!r}. Give each obstacle a name of its own."
        names.add(obstacle.name)
        if (obstacle.circle is None) == (corners is None):
            yield (
                f"'{key}' ({obstacle.name}) needs exactly one shape. Write either circle = {{ center_enu_m = [x, y], "
                "radius_m = r } or polygon_enu_m = [[x, y], [x, y], [x, y]]."
            )
        elif corners is not None and len(corners) < 3:
            yield f"'{key}.polygon_enu_m' has {len(corners)} corners; a polygon has at least 3. Add the others."
        elif obstacle.circle is not None and not 0.0 <= obstacle.circle.radius_m <= _LARGEST_M:
            yield f"'{key}.circle.radius_m' is {obstacle.circle.radius_m}; it must lie between 0 and {_LARGEST_M:g}."
        elif not all(
            abs(value) <= _LARGEST_M for capsule in obstacle.capsules_enu_m for value in capsule
        ):
            yield f"'{key}' ({obstacle.name}) has a coordinate beyond {_LARGEST_M:g} m, or not finite. Correct it."
        else:
            for vehicle, start in starts_enu_m.items():
                if (gap := obstacle.distance_m(start)) < clearance_m:
                    yield (
                        f"'vehicles.{vehicle}.start_enu_m' is {gap:.2f} m from obstacle '{obstacle.name}'; half a body "
                        f"and law.obstacle_margin_m need {clearance_m:.2f} m. Move the start."
                    )
