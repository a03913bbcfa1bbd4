"""Goals in latitude and longitude, as metres of the fleet frame. Pure."""

from __future__ import annotations

import math

from onboard.config.earth import east_north_m, is_on_earth
from onboard.config.fences import FARTHEST_M
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.tuples import Xyz


def goal_enu_m(
    fleet: FleetConfig, latitude_deg: float, longitude_deg: float, height_m: float
) -> Xyz:
    """Return a goal in the fleet frame.

    Args:
        fleet: the fleet file, with the origin of the fleet frame.
        latitude_deg: latitude of the goal.
        longitude_deg: longitude of the goal.
        height_m: height in the fleet frame, like the third coordinate of every goal [m].

    Raises:
        ConfigError: the file has no origin, or the goal is far from the origin.
    """
    origin = fleet.fleet.global_origin
    if origin is None:
        raise ConfigError(
            f"{fleet.path}: goals in latitude and longitude need fleet.origin, which this file "
            "does not have. Add it, or give metres."
        )
    if not (is_on_earth(latitude_deg, longitude_deg) and math.isfinite(height_m)):
        raise ConfigError(
            f"[{latitude_deg:g}, {longitude_deg:g}, {height_m:g}] is no goal: write [latitude, "
            "longitude, height], within -90 to 90 and -180 to 180 degrees."
        )

    east_m, north_m = east_north_m(origin, latitude_deg, longitude_deg)
    distance_m = math.hypot(east_m, north_m)
    if distance_m > FARTHEST_M:
        raise ConfigError(
            f"The goal [{latitude_deg:g}, {longitude_deg:g}] lies {distance_m / 1000.0:.0f} km "
            "from the fleet's origin. Write [latitude, longitude, height] in this order."
        )
    return (east_m, north_m, height_m)
