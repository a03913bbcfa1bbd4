"""Converts latitude and longitude to metres of the fleet frame, and back.

The projection is azimuthal equidistant on PX4's sphere, as PX4 uses it for its local positions
(``MapProjection`` of its ``lib/geo``). So the result agrees with the positions that vehicles use.
"""

from __future__ import annotations

import math

import msgspec

EARTH_RADIUS_M = 6_371_000.0  # radius of PX4's sphere
ALTITUDES_M = (-1000.0, 10_000.0)  # above the sea, of places where vehicles fly
_SAME_RAD = 1e-7  # an angle below this equals its sine


class Origin(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Global origin of the fleet frame outdoors."""

    latitude_deg: float  # of the point 0, 0 of the fleet frame
    longitude_deg: float  # of the same point
    altitude_m: float  # of height 0, above the sea


def is_on_earth(latitude_deg: float, longitude_deg: float) -> bool:
    """Return whether two numbers are a latitude and a longitude; False for NaN."""
    return abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0


def east_north_m(origin: Origin, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Return east and north [m] of a place on Earth from the fleet's origin.

    Args:
        origin: origin of the fleet.
        latitude_deg: latitude of the place.
        longitude_deg: longitude of the place; it may lie beyond the date line.
    """
    origin_latitude = math.radians(origin.latitude_deg)
    latitude = math.radians(latitude_deg)
    turn = math.radians(longitude_deg - origin.longitude_deg)

    # angle between the two places, seen from the centre of the Earth
    cosine = math.sin(origin_latitude) * math.sin(latitude) + math.cos(origin_latitude) * math.cos(
        latitude
    ) * math.cos(turn)
    angle = math.acos(min(1.0, max(-1.0, cosine)))

    stretch = 1.0  # the angle divided by its sine
    if angle > _SAME_RAD:
        stretch = angle / math.sin(angle)
    scale_m = EARTH_RADIUS_M * stretch

    east_m = scale_m * math.cos(latitude) * math.sin(turn)
    north_m = scale_m * (
        math.cos(origin_latitude) * math.sin(latitude)
        - math.sin(origin_latitude) * math.cos(latitude) * math.cos(turn)
    )
    return east_m, north_m


def latitude_longitude_deg(origin: Origin, east_m: float, north_m: float) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a point of the fleet frame.

    Args:
        origin: origin of the fleet frame on Earth.
        east_m: distance of the point to the east.
        north_m: distance of the point to the north.
    """
    origin_latitude = math.radians(origin.latitude_deg)
    distance_m = math.hypot(east_m, north_m)
    angle = distance_m / EARTH_RADIUS_M
    if angle < 1e-12:  # the point is the origin, and has no direction from it
        return origin.latitude_deg, origin.longitude_deg

    north_share = north_m / distance_m
    east_share = east_m / distance_m
    sine = math.cos(angle) * math.sin(origin_latitude)
    sine += math.sin(angle) * math.cos(origin_latitude) * north_share
    latitude = math.asin(min(1.0, max(-1.0, sine)))

    # the point in units of the radius: to the east, and away from the Earth's axis
    to_east = math.sin(angle) * east_share
    from_axis = math.cos(origin_latitude) * math.cos(angle)
    from_axis -= math.sin(origin_latitude) * math.sin(angle) * north_share
    longitude_deg = origin.longitude_deg + math.degrees(math.atan2(to_east, from_axis))
    return math.degrees(latitude), math.remainder(longitude_deg, 360.0)
