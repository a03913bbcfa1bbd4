"""Decides which vehicles pass above others in a move, and how high: ``law.passing_heights = 2``.

Every second vehicle of the fleet file rises between the ends of a level leg, so only half of the
vehicles meet on each level. All vehicles know this rule from the fleet file, so it needs no
messages. A vehicle stays on its level in a fleet with obstacles or fences, because their heights
are not considered here, and under a law that ignores heights. The profile of the rise is in
:mod:`onboard.control.trajectory`.
"""

from __future__ import annotations

from onboard.config.fleet import FleetConfig

# On top of the vertical separation: the height over which the law begins to keep a distance, and
# the errors of two vehicles with motion capture.
_SPARE_M = 0.3
_BELOW_CEILING_M = 0.5  # an overshoot of the rise stays inside the fence


def rise_m(fleet: FleetConfig, vehicle_name: str) -> float:
    """Return the height [m] by which a vehicle rises in level legs; 0: it stays on its level.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
    """
    vertical_m = fleet.fleet.vertical_separation_m
    if fleet.law.passing_heights == 1 or vertical_m is None:
        return 0.0
    if fleet.law.built_in != "covey" or fleet.obstacles or fleet.fences:
        return 0.0

    is_second = list(fleet.vehicles).index(vehicle_name) % 2 == 1
    if is_second:
        return float(vertical_m) + _SPARE_M
    return 0.0


def highest_m(fleet: FleetConfig) -> float:
    """Return the greatest height [m], fleet ENU, to which a vehicle rises.

    Args:
        fleet: the fleet file.
    """
    _, ceiling_m = fleet.fleet.geofence_m.z
    return float(ceiling_m) - _BELOW_CEILING_M


def top_m(fleet: FleetConfig, vehicle_name: str, height_m: float) -> float:
    """Return the greatest height [m] that a vehicle reaches in moves on a level.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        height_m: height of the level, fleet ENU.
    """
    risen_m = height_m + rise_m(fleet, vehicle_name)
    if risen_m > highest_m(fleet):  # then the vehicle does not rise
        return height_m
    return risen_m
