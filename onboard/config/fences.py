"""Fences of a fleet file: polygons and circles that vehicles must stay inside or outside.

They lie in the box ``fleet.geofence_m``, which is the outer limit. All of them apply at the same
time. Points are in metres of the fleet frame, or in latitude and longitude if the file has an
origin. A fleet's hash contains the points as they are written, because two computers may round a
projection differently.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import msgspec

from onboard.config import areas
from onboard.config.areas import Area, Point
from onboard.config.earth import Origin, east_north_m, is_on_earth
from onboard.tuples import Xyz

FARTHEST_M = 1e4  # largest distance of a point from 0, 0
_SAME_POINT_M = 0.01  # corners nearer to each other than this are the same point
MAX_CORNERS = 200
MAX_FENCES = 50
_MAX_BUFFER_M = 100.0


class FenceCircle(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A round area."""

    radius_m: float  # of the area
    center_enu_m: tuple[float, float] | None = None  # east, north
    # or latitude, longitude
    center_deg: tuple[float, float] | None = None


class Fence(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[[fences]]``: an area that vehicles must stay inside or outside."""

    name: str  # for messages
    keep: Literal["in", "out"]  # in: vehicles stay in it; out: they stay out of it
    # its corners in order: [[x, y], [x, y], [x, y]]
    polygon_enu_m: tuple[tuple[float, float], ...] | None = None
    # or as [latitude, longitude] each; the file then has an origin
    polygon_deg: tuple[tuple[float, float], ...] | None = None
    # or { center_enu_m = [x, y], radius_m = r }, or with center_deg = [latitude, longitude]
    circle: FenceCircle | None = None
    # [low, high], heights in metres; in: vehicles stay between them; out: it counts only between
    # them
    height_m: tuple[float, float] | None = None
    # distance that goals and flights keep from its edge; the law brakes vehicles before they come
    # nearer
    buffer_m: float = 0.0


def area_of(fence: Fence, origin: Origin | None) -> Area:
    """Return a fence's area in the fleet frame.

    Args:
        fence: checked, see :func:`problems`.
        origin: origin of the fleet frame on Earth, if the file has one.
    """
    keeps_in = fence.keep == "in"
    low_m = -math.inf
    high_m = math.inf
    if fence.height_m is not None:
        low_m, high_m = fence.height_m

    corners: tuple[Point, ...] = ()
    center: Point = (0.0, 0.0)
    radius_m = 0.0
    if fence.circle is not None:
        center = _center(fence.circle, origin)
        radius_m = float(fence.circle.radius_m)
    else:
        corners = _corners(fence, origin)
        # the allowed side lies on the left of each edge
        is_counterclockwise = areas.area_m2(corners) > 0.0
        if is_counterclockwise != keeps_in:
            corners = corners[::-1]

    return Area(
        name=fence.name,
        keeps_in=keeps_in,
        corners_enu_m=corners,
        center_enu_m=center,
        radius_m=radius_m,
        low_m=float(low_m),
        high_m=float(high_m),
        buffer_m=float(fence.buffer_m),
    )


def problems(
    fences: Sequence[Fence],
    origin: Origin | None,
    starts_enu_m: Mapping[str, Xyz],
    margin_m: float,
) -> Iterator[str]:
    """Check a fleet's fences.

    Args:
        fences: fences of the fleet file.
        origin: origin of the fleet frame on Earth, if the file has one.
        starts_enu_m: vehicle -> its take-off spot.
        margin_m: least distance from a spot to a fence's buffer.
    Yields:
        a sentence for each mistake.
    """
    if len(fences) > MAX_FENCES:
        yield f"'fences' has {len(fences)} entries; {MAX_FENCES} are the most. Join some."

    names: set[str] = set()
    for index, fence in enumerate(fences):
        key = f"fences[{index}]"
        if not fence.name.strip() or fence.name in names:
            yield f"'{key}.name' is {fence.name!r}. Give each fence a name of its own."
        names.add(fence.name)

        fault = fence_fault(fence, origin, key)
        if fault is not None:
            yield fault
            continue

        area = area_of(fence, origin)
        for vehicle, start_enu_m in starts_enu_m.items():
            yield from _start_problems(area, vehicle, start_enu_m, margin_m)


def fence_fault(fence: Fence, origin: Origin | None, key: str) -> str | None:
    """Return a sentence about the mistake in a fence, or None if there is none.

    Args:
        fence: any fence.
        origin: origin of the fleet frame on Earth, if there is one.
        key: key of the fence, for the sentence.
    """
    label = f"'{key}' ({fence.name[:40]})"
    shapes = [fence.polygon_enu_m, fence.polygon_deg, fence.circle]
    if sum(shape is not None for shape in shapes) != 1:
        return (
            f"{label} needs exactly one shape. Write polygon_enu_m = [[x, y], [x, y], [x, y]], "
            "polygon_deg with latitudes and longitudes, or circle = { center_enu_m = [x, y], "
            "radius_m = r }."
        )

    fault = _number_fault(fence, label)
    if fault is None:
        fault = _degree_fault(fence, origin, label)
    if fault is not None:
        return fault

    if fence.circle is not None:
        return _circle_fault(fence.circle, origin, label)
    return polygon_fault(_corners(fence, origin), label)


def _number_fault(fence: Fence, label: str) -> str | None:
    """Return what is wrong with buffer, heights or the number of corners in degrees, or None."""
    if not 0.0 <= fence.buffer_m <= _MAX_BUFFER_M:  # also True for NaN
        return (
            f"{label}: buffer_m is {fence.buffer_m:g}; it must lie between 0 and "
            f"{_MAX_BUFFER_M:g} m."
        )
    if fence.height_m is not None:
        low_m, high_m = fence.height_m
        if not (math.isfinite(low_m) and math.isfinite(high_m) and low_m < high_m):
            return (
                f"{label}: height_m is [{low_m:g}, {high_m:g}]; give [low, high] with low < high."
            )
    if fence.polygon_deg is not None:
        return _count_fault(len(fence.polygon_deg), label)
    return None


def _count_fault(corner_count: int, label: str) -> str | None:
    """Return a sentence about a wrong number of corners, or None."""
    if 3 <= corner_count <= MAX_CORNERS:
        return None
    return (
        f"{label} has {corner_count} corners; a polygon has 3 to {MAX_CORNERS}. Add the others, "
        "or leave out what a straight edge can join."
    )


def _degree_fault(fence: Fence, origin: Origin | None, label: str) -> str | None:
    """Return what is wrong with latitudes and longitudes, or None."""
    degrees = fence.polygon_deg
    if fence.circle is not None and fence.circle.center_deg is not None:
        degrees = (fence.circle.center_deg,)
    if degrees is None:
        return None

    if origin is None:
        return (
            f"{label} is in latitude and longitude, and the fleet file has no origin. Write "
            "origin = { latitude_deg = ..., longitude_deg = ..., altitude_m = ... } in [fleet], or "
            "give metres."
        )
    for number, (latitude_deg, longitude_deg) in enumerate(degrees, 1):
        if not is_on_earth(latitude_deg, longitude_deg):
            return (
                f"{label}: point {number} is [{latitude_deg:g}, {longitude_deg:g}]; write "
                "[latitude, longitude], within -90 to 90 and -180 to 180 degrees."
            )
        distance_m = math.hypot(*east_north_m(origin, latitude_deg, longitude_deg))
        if distance_m > FARTHEST_M:
            return (
                f"{label}: point {number} at [{latitude_deg:g}, {longitude_deg:g}] lies "
                f"{distance_m / 1000.0:.0f} km from the fleet's origin; {FARTHEST_M / 1000.0:g} km "
                "are the most. Write [latitude, longitude] in this order, and fleet.origin of the "
                "same place."
            )
    return None


def _circle_fault(circle: FenceCircle, origin: Origin | None, label: str) -> str | None:
    if (circle.center_enu_m is None) == (circle.center_deg is None):
        return (
            f"{label}: its circle needs one centre. Write center_enu_m = [x, y], or "
            "center_deg = [latitude, longitude]."
        )
    if not 0.0 < circle.radius_m <= FARTHEST_M:  # also True for NaN
        return (
            f"{label}: its circle's radius_m is {circle.radius_m:g}; it must lie above 0 and up to "
            f"{FARTHEST_M:g} m."
        )
    if not all(abs(value) <= FARTHEST_M for value in _center(circle, origin)):
        return f"{label} has a coordinate beyond {FARTHEST_M:g} m, or not finite. Correct it."
    return None


def polygon_fault(corners: Sequence[Point], label: str) -> str | None:
    """Return a sentence about the mistake in a polygon, or None if there is none.

    Args:
        corners: in order, in metres of the fleet frame.
        label: what has the polygon, for the sentence.
    """
    count_fault = _count_fault(len(corners), label)
    if count_fault is not None:
        return count_fault
    if not all(abs(value) <= FARTHEST_M for corner in corners for value in corner):
        return f"{label} has a coordinate beyond {FARTHEST_M:g} m, or not finite. Correct it."

    for number, (begin, end) in enumerate(areas.edges_of(corners), 1):
        if math.dist(begin, end) < _SAME_POINT_M:
            following = number % len(corners) + 1
            return (
                f"{label}: corners {number} and {following} are the same point. Leave one out; the "
                "last corner is joined to the first by itself."
            )

    crossing = areas.self_crossing(corners)
    if crossing is not None:
        first, second = crossing
        return (
            f"{label} crosses itself: the edge after corner {first + 1} meets the edge after "
            f"corner {second + 1}. Give the corners in the order in which one walks around it."
        )
    return None


def _start_problems(area: Area, vehicle: str, start_enu_m: Xyz, margin_m: float) -> Iterator[str]:
    key = f"vehicles.{vehicle}.start_enu_m"
    x, y, z = start_enu_m
    if not math.isfinite(x + y + z):
        return

    if area.keeps_in and not area.low_m - areas.START_BELOW_FLOOR_M <= z <= area.high_m:
        yield (
            f"'{key}' lies at the height {z:g} m, and fence '{area.name}' reaches from "
            f"{area.low_m:g} to {area.high_m:g} m. Vehicles start in the fences that they stay in: "
            "correct its height_m."
        )
        return
    if not areas.counts_at(area, z, z):
        return

    room_m = areas.nearest(area, x, y).room_m
    least_m = area.buffer_m + margin_m
    if room_m < 0.0:
        side = "outside" if area.keeps_in else "inside"
        yield f"'{key}' lies {side} the fence '{area.name}'. Move the start, or correct the fence."
    elif room_m < least_m:
        yield (
            f"'{key}' is {room_m:.2f} m from the edge of the fence '{area.name}'; its buffer_m and "
            f"law.fence_margin_m need {least_m:.2f} m. Move the start, or correct the fence."
        )


def _corners(fence: Fence, origin: Origin | None) -> tuple[Point, ...]:
    """Return a polygon's corners in metres."""
    if fence.polygon_enu_m is not None:
        return tuple((float(x), float(y)) for x, y in fence.polygon_enu_m)
    assert origin is not None  # checked
    assert fence.polygon_deg is not None
    return tuple(east_north_m(origin, *corner) for corner in fence.polygon_deg)


def _center(circle: FenceCircle, origin: Origin | None) -> Point:
    """Return a circle's centre in metres."""
    if circle.center_enu_m is not None:
        x, y = circle.center_enu_m
        return float(x), float(y)
    assert origin is not None  # checked
    assert circle.center_deg is not None
    return east_north_m(origin, *circle.center_deg)
