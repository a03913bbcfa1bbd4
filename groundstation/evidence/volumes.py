"""Flight geography, contingency volume and ground risk buffer, computed from flown flights. Pure.

Each of the three is a convex outline, seen from above, with a height.

* The **flight geography** surrounds all planned positions of the mission and all positions in the
  air in undisturbed flights, in the given wind, widened by half a vehicle.
* The **contingency volume** is the flight geography, widened on all sides by the greatest distance
  that any vehicle came outside of it when something failed. Its height is that of the highest
  vehicle.
* The **ground risk buffer** is the contingency volume, widened by the greatest distance that a
  vehicle without thrust can fall, from the greatest height to the lowest ground of the fleet file
  and at the greatest speed flown, with the wind.

The distance of a fall is an upper bound. Drag lengthens the time of the fall but does not slow the
vehicle horizontally, where its greatest speed and the wind with gusts add up.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from onboard.config.earth import Origin, latitude_longitude_deg
from onboard.config.fleet import FleetConfig
from onboard.config.ground import lowest_ground_in_fence_m

Point = tuple[float, float]  # east, north [m]
Outline = tuple[Point, ...]  # counter-clockwise; the first point is not repeated at the end

GUST_OF_MEAN = 1.25  # wind with gusts over mean wind, as in wind limits (docs/wind.md)
GRAVITY_M_S2 = 9.81
_CORNERS_OF_CIRCLE = 32
_STEP_S = 0.005  # step of the integration of a fall
_LONGEST_FALL_S = 600.0


class Volumes(NamedTuple):
    """The three outlines, and the figures that they come from."""

    geography: Outline
    geography_height_m: float
    contingency: Outline
    contingency_height_m: float
    buffer: Outline
    excursion_m: float  # greatest horizontal distance outside of the geography
    rise_m: float  # greatest height above the geography
    fastest_m_s: float  # greatest horizontal speed
    fall_s: float  # time of a fall from the greatest height to the lowest ground
    fall_reach_m: float  # width that the buffer adds
    wind_m_s: float
    ground_m: float = 0.0  # height of the lowest ground

    @property
    def geography_above_ground_m(self) -> float:
        """Height of the flight geography above the lowest ground [m]."""
        return self.geography_height_m - self.ground_m

    @property
    def contingency_above_ground_m(self) -> float:
        """Height of the contingency volume above the lowest ground [m]."""
        return self.contingency_height_m - self.ground_m


def volumes(
    *,
    planned: Iterable[tuple[float, float, float]],
    undisturbed: Iterable[Point],
    undisturbed_height_m: float,
    flown: Sequence[Point],
    highest_m: float,
    fastest_m_s: float,
    wind_m_s: float,
    fleet: FleetConfig,
) -> Volumes:
    """Return the three volumes.

    Args:
        planned: planned positions of the mission, east, north and up [m].
        undisturbed: positions in the air in undisturbed flights.
        undisturbed_height_m: greatest height in undisturbed flights.
        flown: positions in the air in all flights, with and without failures.
        highest_m: greatest height in all flights.
        fastest_m_s: greatest horizontal speed in all flights.
        wind_m_s: mean wind.
        fleet: the fleet file.
    """
    planned_m = list(planned)
    half_body_m = 0.5 * fleet.fleet.body_diameter_m
    planned_points = [(east_m, north_m) for east_m, north_m, _ in planned_m]
    geography = widened(convex_hull([*planned_points, *undisturbed]), half_body_m)
    planned_height_m = max((up for _, _, up in planned_m), default=0.0)
    geography_height_m = max(planned_height_m, undisturbed_height_m) + half_body_m

    excursion_m = max((distance_outside_m(geography, point) for point in flown), default=0.0)
    excursion_m += half_body_m
    contingency = widened(geography, excursion_m)
    contingency_height_m = max(geography_height_m, highest_m + half_body_m)

    most_drag_1_s = max(fleet.vehicles[name].drag_1_s for name in fleet.enabled_names)
    ground_m = lowest_ground_in_fence_m(fleet)
    fall_s = fall_time_s(contingency_height_m - ground_m, most_drag_1_s)
    reach_m = (fastest_m_s + GUST_OF_MEAN * wind_m_s) * fall_s + half_body_m
    return Volumes(
        geography=geography,
        geography_height_m=geography_height_m,
        contingency=contingency,
        contingency_height_m=contingency_height_m,
        buffer=widened(contingency, reach_m),
        excursion_m=excursion_m,
        rise_m=contingency_height_m - geography_height_m,
        fastest_m_s=fastest_m_s,
        fall_s=fall_s,
        fall_reach_m=reach_m,
        wind_m_s=wind_m_s,
        ground_m=ground_m,
    )


def convex_hull(points: Iterable[Point]) -> Outline:
    """Return the convex hull of points, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted(set(points))
    if len(ordered) <= 2:
        return tuple(ordered)

    lower = _half_hull(ordered)
    upper = _half_hull(ordered[::-1])
    return tuple(lower[:-1] + upper[:-1])


def _half_hull(ordered: Sequence[Point]) -> list[Point]:
    chain: list[Point] = []
    for point in ordered:
        while len(chain) >= 2 and _turn(chain[-2], chain[-1], point) <= 0.0:
            chain.pop()
        chain.append(point)
    return chain


def _turn(first: Point, second: Point, third: Point) -> float:
    """Return a number that is positive if three points turn to the left, negative to the right."""
    # the cross product of the two offsets from the first point
    left_part = (second[0] - first[0]) * (third[1] - first[1])
    right_part = (second[1] - first[1]) * (third[0] - first[0])
    return left_part - right_part


def widened(outline: Outline, by_m: float) -> Outline:
    """Return a convex outline that is wider by a distance on all sides; corners become round."""
    # Each corner becomes a polygon that surrounds the true circle, so that the result is nowhere
    # too narrow.
    radius_m = by_m / math.cos(math.pi / _CORNERS_OF_CIRCLE)
    moved = []
    for east, north in outline:
        for corner in range(_CORNERS_OF_CIRCLE):
            angle = 2.0 * math.pi * (corner + 0.5) / _CORNERS_OF_CIRCLE
            moved.append((east + radius_m * math.cos(angle), north + radius_m * math.sin(angle)))
    return convex_hull(moved)


def distance_outside_m(outline: Outline, point: Point) -> float:
    """Return the distance of a point from a convex outline; 0 inside of it."""
    ends = (*outline[1:], outline[0])
    edges = list(zip(outline, ends, strict=True))
    if len(outline) >= 3 and all(_turn(begin, end, point) >= 0.0 for begin, end in edges):
        return 0.0
    return min(_distance_to_edge_m(begin, end, point) for begin, end in edges)


def _distance_to_edge_m(begin: Point, end: Point, point: Point) -> float:
    edge = (end[0] - begin[0], end[1] - begin[1])
    squared_length_m2 = edge[0] ** 2 + edge[1] ** 2
    edge_share = 0.0
    if squared_length_m2 > 0.0:
        projected = (point[0] - begin[0]) * edge[0] + (point[1] - begin[1]) * edge[1]
        edge_share = projected / squared_length_m2
        edge_share = min(max(edge_share, 0.0), 1.0)
    nearest = (begin[0] + edge_share * edge[0], begin[1] + edge_share * edge[1])
    return math.dist(nearest, point)


def fall_time_s(height_m: float, drag_1_s: float) -> float:
    """Return how long a body without thrust falls from rest, with a drag linear in its speed.

    Args:
        height_m: height of the fall.
        drag_1_s: deceleration for each m/s.
    """
    fallen_m = 0.0
    speed_m_s = 0.0
    time_s = 0.0
    while fallen_m < height_m and time_s < _LONGEST_FALL_S:
        speed_m_s += (GRAVITY_M_S2 - drag_1_s * speed_m_s) * _STEP_S
        fallen_m += speed_m_s * _STEP_S
        time_s += _STEP_S
    return time_s


# -- GeoJSON ---------------------------------------------------------------------------------------


def geojson(shapes: Volumes, fleet: FleetConfig) -> dict[str, Any]:
    """Return the volumes as a GeoJSON feature collection.

    Coordinates are longitude and latitude if the fleet has an origin on Earth. Otherwise they are
    metres east and north in the fleet's frame, and a member ``note`` says so.
    """
    origin = fleet.fleet.global_origin
    features = [
        _feature("flight geography", shapes.geography, shapes.geography_height_m, origin),
        _feature("contingency volume", shapes.contingency, shapes.contingency_height_m, origin),
        _feature("ground risk buffer", shapes.buffer, 0.0, origin),
    ]
    collection: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if origin is None:
        collection["note"] = (
            "The fleet file gives no origin on Earth: coordinates are metres east and north of the"
            " fleet's frame, not longitudes and latitudes."
        )
    return collection


def _feature(name: str, outline: Outline, height_m: float, origin: Origin | None) -> dict[str, Any]:
    properties: dict[str, Any] = {"name": name, "height_m": round(height_m, 2)}
    if origin is not None:
        properties["top_above_sea_m"] = round(origin.altitude_m + height_m, 2)

    ring = []
    for east_m, north_m in (*outline, outline[0]):
        if origin is None:
            ring.append([round(east_m, 3), round(north_m, 3)])
        else:
            latitude_deg, longitude_deg = latitude_longitude_deg(origin, east_m, north_m)
            ring.append([round(longitude_deg, 8), round(latitude_deg, 8)])
    geometry = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}
