"""Findings about each vehicle alone: thrust, tilt, battery, and what PX4 does when the agent is silent. Pure."""

from __future__ import annotations

import math

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.feasibility import bounds
from onboard.feasibility.finding import Finding, least, most
from onboard.types import GRAVITY_M_S2

GUST_M_S2 = 0.3  # gusts for which the disturbance observer has been measured to hold
_CLIMB_M_S2 = 1.0
# PX4's own: at the critical level it takes the vehicle out of OFFBOARD, whatever setpoints arrive
_PX4_CRITICAL_FRAC, _BATTERY_GAP_PCT = 0.07, 3.0


def available_m_s2(vehicle: Vehicle) -> float:
    """Horizontal acceleration that tilt and thrust leave while height is kept."""
    return max(0.05, bounds.available_acceleration_m_s2(vehicle.max_tilt_deg, vehicle.hover_thrust_frac))


def height_at_tilt(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Whether the height is kept at the largest tilt."""
    lift = 0.97 / vehicle.hover_thrust_frac * math.cos(math.radians(vehicle.max_tilt_deg))
    allowed_deg = math.degrees(math.acos(min(1.0, vehicle.hover_thrust_frac / 0.97)))
    return least(
        "height at full tilt",
        lift,
        1.05,
        "",
        f"{vehicle.name} at its max_tilt_deg = {vehicle.max_tilt_deg:g} and full throttle lifts {{value}} of its "
        "weight, {relation} {bound} keeps the height",
        f"Lower max_tilt_deg below {allowed_deg:.0f}, or make the vehicle lighter.",
        refuse_below=1.0,
    )


def thrust_reserve(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """What full throttle leaves upwards."""
    return least(
        "thrust reserve",
        (0.97 / vehicle.hover_thrust_frac - 1.0) * GRAVITY_M_S2,
        _CLIMB_M_S2,
        "m/s^2",
        f"{vehicle.name} hovers at {vehicle.hover_thrust_frac:.2f} of its throttle, which leaves {{value}} upwards, "
        "{relation} {bound} is needed to climb and to catch gusts",
        "Make the vehicle lighter, or use stronger motors and a fresh battery.",
    )


def gust_reserve(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """What is left horizontally beside trajectories and drag."""
    drag = vehicle.drag_1_s * vehicle.max_speed_m_s
    return least(
        "gust reserve",
        available_m_s2(vehicle) - vehicle.max_acceleration_m_s2 - drag,
        GUST_M_S2,
        "m/s^2",
        f"{vehicle.name}: tilt and thrust leave {{value}} beside trajectories of {vehicle.max_acceleration_m_s2:g} "
        f"m/s^2 and drag at full speed, {{relation}} {{bound}} is needed for gusts",
        "Lower max_acceleration_m_s2 or max_speed_m_s, or raise max_tilt_deg.",
    )


def battery(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Our landing level against the one at which PX4 takes over."""
    critical_pct = 100.0 * float(vehicle.px4_params.get("BAT_CRIT_THR", _PX4_CRITICAL_FRAC))
    return least(
        "battery",
        fleet.fleet.battery_land_pct,
        critical_pct + _BATTERY_GAP_PCT,
        "%",
        f"fleet.battery_land_pct is {{value}}; PX4 takes {vehicle.name} out of OFFBOARD at {critical_pct:.0f} %, so "
        "landing has to begin at {bound} or above",
        f"Set fleet.battery_land_pct = {critical_pct + _BATTERY_GAP_PCT + 5.0:.0f} or more, or lower BAT_CRIT_THR.",
        refuse_below=critical_pct + 0.5,
    )


def silence(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """How long PX4 flies on without an agent."""
    return most(
        "silence",
        float(vehicle.px4_params.get("COM_OF_LOSS_T", 0.3)),
        0.5,
        "s",
        f"PX4 waits {{value}} (COM_OF_LOSS_T) before it acts on {vehicle.name}'s hung agent, {{relation}} {{bound}} "
        "keeps it from drifting into the others with its last tilt",
        "Set px4_params.COM_OF_LOSS_T = 0.3.",
        refuse_above=1.0,
    )
