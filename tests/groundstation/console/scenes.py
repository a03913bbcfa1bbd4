"""Scenes for pictures and snapshots: fleets of any size with a clock that stands still."""

from __future__ import annotations

import math

import msgspec

from groundstation.console.app import ConsoleApp
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from tests.groundstation.console.fake import FakeClient

START_NS = 1_000_000_000_000


class SteadyClient(FakeClient):
    """Its clock moves only when a test moves it."""

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(fleet)
        self.clock_ns = START_NS

    def now_ns(self) -> int:
        return self.clock_ns + self.skew_ns


def crowd(count: int, name: str = "v{:03d}", side_m: float = 30.0) -> FleetConfig:
    """A fleet of ``count`` vehicles in a square with a pillar and a wall."""
    across = max(1, math.ceil(math.sqrt(count)))
    half = side_m / 2.0
    step_m = 1.0
    if across > 1:
        step_m = (side_m - 4.0) / (across - 1)
    return fleet_from_mapping(
        {
            "schema": 1,
            "fleet": {
                "name": "crowd",
                "geofence_m": {"x": [-half, half], "y": [-half, half], "z": [0.0, 6.0]},
            },
            "defaults": {"type": "quad"},
            "types": {"quad": {}},
            "obstacles": [
                {
                    "name": "pillar",
                    "circle": {
                        "center_enu_m": [0.25 * step_m, 0.5 * step_m],
                        "radius_m": 0.08 * step_m,
                    },
                },
                {
                    "name": "wall",
                    "polygon_enu_m": [
                        [-half + 0.1, half - 1.0],
                        [0.0, half - 1.0],
                        [0.0, half - 0.5],
                        [-half + 0.1, half - 0.5],
                    ],
                },
            ],
            "vehicles": {
                name.format(index): {
                    "system_id": index % 255 + 1,
                    "start_enu_m": [
                        2.0 - half + step_m * (index % across),
                        2.0 - half + step_m * (index // across),
                        0.0,
                    ],
                    "agent": f"tcp/127.0.0.1:{7000 + index}",
                    "autopilot": f"udpin://127.0.0.1:{14000 + index}",
                }
                for index in range(count)
            },
        }
    )


def named_by_numbers(fleet: FleetConfig) -> FleetConfig:
    """The fleet's three vehicles under the names 2, 1 and 0, which are not their numbers."""
    vehicles = {
        name: msgspec.structs.replace(vehicle, name=name)
        for name, vehicle in zip(("2", "1", "0"), fleet.vehicles.values(), strict=True)
    }
    return msgspec.structs.replace(fleet, vehicles=vehicles, formations={})


def fly(client: FakeClient, time_s: float) -> None:
    """Let every vehicle circle about its start; neighbours come close now and then."""
    fleet = client.fleet
    names = fleet.enabled_names
    for index, name in enumerate(names):
        start = fleet.vehicles[name].start_enu_m
        angle = 0.4 * time_s + 1.7 * index
        x_m = start[0] + 0.9 * math.cos(angle)
        y_m = start[1] + 0.9 * math.sin(angle)
        gap_m = 1.2 + 0.8 * math.sin(0.3 * time_s + index)
        client.hear(
            name,
            boot_id=7,
            position_enu_m=(x_m, y_m, 1.0 + 4.0 * (index % 10) / 10.0),
            velocity_enu_m_s=(-0.36 * math.sin(angle), 0.36 * math.cos(angle), 0.0),
            goal_position_enu_m=(start[0], start[1] + 1.5, 1.0),
            setpoint_position_enu_m=(x_m - 0.3, y_m, 1.0),
            nearest_vehicle=names[(index + 1) % len(names)],
            nearest_distance_m=gap_m,
            order_kind="move",
            order_phase="under way",
            law_status="saturated" if gap_m < 1.0 else "inactive",
            avoids=names[(index + 1) % len(names)] if gap_m < 1.0 else "",
            state="flying",
            intervention_m_s2=max(0.0, 1.3 - gap_m) * 3,
            battery_frac=0.95 - 0.007 * index - 0.0006 * time_s,
            system_id=index % 255 + 1,
            loop_period_p99_ms=20.5 + (index * 7 + int(3 * time_s)) % 5,
            neighbour_age_s=0.02 + 0.01 * ((index + int(time_s)) % 4),
        )


def ground_and_sky(client: FakeClient) -> None:
    """One of each: flying, silent, not ready, failed, never heard."""
    names = client.fleet.enabled_names
    fly(client, 40.0)
    client.hear(
        names[1],
        boot_id=7,
        is_airborne=False,
        is_armed=False,
        state="waiting",
        mode="POSCTL",
        not_ready=("No mocap pose for 2.3 s: is its body tracked?", "Battery at 18 %."),
        battery_frac=0.18,
        position_enu_m=(*client.fleet.vehicles[names[1]].start_enu_m,),
        order_kind="",
        velocity_enu_m_s=(0.0, 0.0, 0.0),
    )
    client.hear(
        names[2],
        boot_id=7,
        is_airborne=False,
        is_armed=False,
        state="failed",
        mode="HOLD",
        reason="PX4 refused to arm: high throttle.",
        battery_frac=0.29,
        autopilot_age_s=0.7,
        order_kind="arm",
        order_phase="failed",
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        position_enu_m=(*client.fleet.vehicles[names[2]].start_enu_m,),
    )


def without(fleet: FleetConfig, *names: str) -> FleetConfig:
    """The same fleet less some vehicles."""
    kept = {name: vehicle for name, vehicle in fleet.vehicles.items() if name not in names}
    return msgspec.structs.replace(fleet, vehicles=kept)


async def warm(
    app: ConsoleApp, client: SteadyClient, seconds: float = 60.0, step_s: float = 0.5
) -> None:
    """Let a flight pass: trails, chart, batteries and sparks fill."""
    for step in range(int(seconds / step_s)):
        client.clock_ns = START_NS + int(step * step_s * 1e9)
        fly(client, step * step_s)
        app.history.add(client.state, client.now_ns())
