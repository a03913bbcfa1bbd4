"""Refusals of a takeover, in which an agent starts to fly a vehicle that is in the air. Pure.

A vehicle may be in the air when its agent starts, or the agent may have lost it to PX4. A pilot may
be flying it, so the agent sends nothing until an operator orders hold. It then takes over, but only
from PX4's own hold. The flight continues from the present position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from onboard.autopilot import Landed
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.flight_space import flight_space_of
from onboard.config.ground import ground_at_m
from onboard.flight.types import FlightView
from onboard.safety.limits import DOWN_HEIGHT_M

HOLD = "HOLD"  # name of PX4's mode

# The preflight rules that also apply to a takeover in the air. The other rules are about a vehicle
# on the ground.
RULES = (
    "px4",
    "link",
    "alone",
    "health",
    "parameters",
    "position",
    "clock",
    "agreement",
    "neighbours",
    "configuration",
    "loop",
)
MOVING_M_S = 0.5  # a faster vehicle is not taken over
_MAY_STAND_M = 0.5  # without a mocap, a lower vehicle may stand: PX4's height has an error


def refusal(
    view: FlightView,
    not_ready: tuple[str, ...],
    distances_m: Mapping[str, float],
    fleet: FleetConfig,
    vehicle: Vehicle,
) -> str | None:
    """Return the reason why the vehicle cannot be taken over now, or None.

    Args:
        view: what the flight sees at this tick.
        not_ready: reasons of the rules in RULES that are not passed.
        distances_m: separation from each other vehicle.
        fleet: the fleet file.
        vehicle: this vehicle in it.
    """
    snapshot = view.snapshot
    if not snapshot.is_armed or snapshot.landed is Landed.ON_GROUND:
        return "The vehicle does not fly: there is nothing to take over."

    if snapshot.mode != HOLD:
        return (
            f"PX4 flies by itself (mode {snapshot.mode or 'unknown'}) and is taken over from its "
            "hold only: switch it to hold with the transmitter and order hold again, or let it "
            "land."
        )

    if not_ready:
        return not_ready[0]

    if not view.has_position or not flight_space_of(fleet).contains(view.position_enu_m):
        return (
            "Its position is not known, or lies outside the geofence: land it with the transmitter."
        )

    x_m, y_m, z_m = view.position_enu_m
    height_m = z_m - float(ground_at_m(fleet, x_m, y_m))
    may_stand_below_m = DOWN_HEIGHT_M if vehicle.mocap_required else _MAY_STAND_M
    if height_m < may_stand_below_m:  # PX4 may hold before it has noticed the ground
        return (
            f"It may stand on the ground, by its height of {height_m:.2f} m: land it, or let its "
            "pilot climb and switch to hold, and order hold again."
        )

    speed_m_s = math.hypot(*view.velocity_enu_m_s)
    if speed_m_s > MOVING_M_S:
        return f"It still moves at {speed_m_s:.1f} m/s: wait until PX4's hold has stopped it."

    for name, distance_m in distances_m.items():
        if distance_m < fleet.fleet.safety_distance_m:
            return f"{name} is only {distance_m:.2f} m away: move {name} away first."

    return None
