"""Fleets of any size for measurements and tests: a square of vehicles, a mission that moves it."""

from __future__ import annotations

import math
from typing import Any

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import FleetConfig, fleet_from_mapping

_SPACING_M = 1.7
_HEIGHT_M = 1.0
# never opened in lockstep
_AGENT_PORT = 20_000
_PX4_PORT = 30_000

# PX4's own simulated quadrotor
_SIH = {
    "mass_kg": 1.0,
    "hover_thrust_frac": 0.49,
    "attitude_delay_s": 0.04,
    "attitude_wn_rad_s": 11.0,
    "attitude_zeta": 0.6,
    "drag_1_s": 1.0,
    "max_tilt_deg": 30.0,
    "max_speed_m_s": 1.0,
    "mocap_required": True,
}


def square_fleet(count: int) -> FleetConfig:
    """``count`` equal vehicles in rows; their formation ``block`` is as they stand."""
    side = math.ceil(math.sqrt(count))
    half = 0.5 * _SPACING_M * (side - 1)
    names = [f"mav{place}" for place in range(count)]
    spots = [
        (_SPACING_M * (place % side) - half, _SPACING_M * (place // side) - half)
        for place in range(count)
    ]
    fence = half + 3.0
    data: dict[str, Any] = {
        "schema": 1,
        "fleet": {
            "name": f"square{count}",
            "geofence_m": {"x": [-fence, fence], "y": [-fence, fence], "z": [0.0, 3.0]},
        },
        "types": {"sih": _SIH},
        "defaults": {"type": "sih"},
        "formations": {
            "block": {name: [x, y, 0.0] for name, (x, y) in zip(names, spots, strict=True)}
        },
        "vehicles": {
            name: {
                "system_id": place + 1,
                "start_enu_m": [x, y, 0.0],
                "agent": f"tcp/127.0.0.1:{_AGENT_PORT + place}",
                "autopilot": f"udpin://127.0.0.1:{_PX4_PORT + place}",
            }
            for place, (name, (x, y)) in enumerate(zip(names, spots, strict=True))
        },
    }
    return fleet_from_mapping(data)


def block_mission(fleet: FleetConfig) -> Mission:
    """Up, the whole square a metre aside and back, down."""
    steps = [
        {"do": "takeoff", "height_m": _HEIGHT_M},
        {"do": "formation", "name": "block", "position_enu_m": [1.0, 0.5, _HEIGHT_M]},
        {"do": "formation", "name": "block", "position_enu_m": [0.0, 0.0, _HEIGHT_M]},
        {"do": "land"},
    ]
    expect = {"min_separation_m": fleet.fleet.safety_distance_m, "all_landed": True}
    return mission_from_mapping(
        {"schema": 1, "step": steps, "expect": expect}, path=f"{fleet.fleet.name}.toml", fleet=fleet
    )
