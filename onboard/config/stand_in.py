"""Checks whether a spare vehicle can stand in for another one. Pure.

The spare takes over the other vehicle's take-off spot, slots and paths. So it must stand on that
spot, and have the same source of positions. It must also have at least the same speed, thrust and
endurance, because missions were checked with the other vehicle's limits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from onboard.config.fleet_config import FleetConfig, Vehicle
from onboard.config.wind_limit import wind_limit_m_s

# largest horizontal distance from the middle of the spot
BY_MOCAP_M = 0.5  # the same as in the preflight check
BY_SATELLITES_M = 1.5  # a satellite position itself has an error of a metre
_SAME_HEIGHT_M = 0.1  # largest difference of the heights of two spots at the same height


def stand_in_refusal(
    fleet: FleetConfig, spare: str, replaced: str, position_enu_m: Sequence[float] | None
) -> str:
    """Return why a vehicle cannot stand in for another one; empty if it can.

    Args:
        fleet: the fleet file.
        spare: name of the vehicle that stands in.
        replaced: name of the vehicle that it replaces; the same name ends a stand-in.
        position_enu_m: position of the spare [m]; None: not known.
    """
    if replaced not in fleet.vehicles:
        names = ", ".join(fleet.enabled_names)
        return f"{replaced[:40]} is not a vehicle of fleet '{fleet.fleet.name}': it has {names}."

    difference = ""
    if spare != replaced:
        difference = _difference(fleet, fleet.vehicles[spare], fleet.vehicles[replaced])
    if difference:
        return f"{spare} cannot stand in for {replaced}: {difference}."
    if position_enu_m is None:
        return f"{spare} does not report where it stands, so nobody knows that it is on the spot."

    spot_enu_m = fleet.vehicles[replaced].start_enu_m
    off_m = math.dist(position_enu_m[:2], spot_enu_m[:2])
    tolerance_m = _tolerance_m(fleet, spare)
    if off_m > tolerance_m:
        east_m, north_m, _ = spot_enu_m
        spot_words = f"the spot of {replaced}"
        if spare == replaced:
            spot_words = "its own spot"
        return (
            f"{spare} stands {off_m:.1f} m from {spot_words}, ({east_m:g}, {north_m:g}); "
            f"{tolerance_m:.1f} m are allowed. Put it there, then order again."
        )
    return ""


def _tolerance_m(fleet: FleetConfig, spare: str) -> float:
    """Return the largest distance [m] of a vehicle from its spot."""
    if fleet.vehicles[spare].mocap_required:
        return BY_MOCAP_M
    return BY_SATELLITES_M


def _difference(fleet: FleetConfig, spare: Vehicle, other: Vehicle) -> str:
    """Return in words which requirement of the other vehicle the spare does not meet.

    The result is empty if it meets all of them.
    """
    if spare.mocap_required != other.mocap_required:
        return "one flies by the mocap, and the other one does not"
    if fleet.begins_on_its_spot(spare):
        return (
            "its frame begins where the fleet file says that it stands. Write the spot there: "
            f"vehicles.{spare.name}.start_enu_m"
        )

    _, _, own_spot_m = spare.start_enu_m
    _, _, other_spot_m = other.start_enu_m
    has_other_height = abs(own_spot_m - other_spot_m) > _SAME_HEIGHT_M
    if has_other_height and not spare.mocap_required:
        return (
            f"its heights count from its own spot, which the fleet file puts at {own_spot_m:g} m, "
            f"and the spot of {other.name} lies at {other_spot_m:g} m. Write that height there: "
            f"vehicles.{spare.name}.start_enu_m"
        )

    # key, the spare's value, the other vehicle's value (the minimum), and the unit
    limits: list[tuple[str, float, float, str]] = [
        ("max_speed_m_s", spare.max_speed_m_s, other.max_speed_m_s, "m/s"),
        ("max_acceleration_m_s2", spare.max_acceleration_m_s2, other.max_acceleration_m_s2, "m/s²"),
        ("max_tilt_deg", spare.max_tilt_deg, other.max_tilt_deg, "°"),
        ("wind limit", wind_limit_m_s(fleet, spare), wind_limit_m_s(fleet, other), "m/s"),
    ]
    if spare.hover_time_s is not None and other.hover_time_s is not None:
        limits.append(("hover_time_s", spare.hover_time_s, other.hover_time_s, "s"))

    for key, own, least, unit in limits:
        if own < least:
            return f"its {key} is {own:g} {unit}, and the mission was checked with {least:g} {unit}"
    return ""
