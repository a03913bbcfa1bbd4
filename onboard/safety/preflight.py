"""Go or no-go: every reason why a vehicle must not take off, each as a sentence with the remedy. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from onboard.config import FleetConfig, Vehicle

AUTOPILOT_SILENT_S = 0.3
HEARTBEAT_SILENT_S = 3.0
POSITION_STALE_S = 0.2


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known before take-off; ages in seconds, inf = never heard.

    missing_neighbours: enabled vehicles of the fleet file that are not heard now. other_hashes: vehicle -> its
    configuration hash, where it differs from ours. param_problems: sentences; None while not read yet.
    """

    autopilot_age_s: float
    heartbeat_age_s: float
    position_age_s: float
    position_enu_m: tuple[float, float, float]
    battery_frac: float
    missing_neighbours: tuple[str, ...]
    other_hashes: dict[str, str]
    config_hash: str
    param_problems: tuple[str, ...] | None
    is_law_warm: bool
    is_airborne: bool


def reasons(facts: Facts, fleet: FleetConfig, vehicle: Vehicle) -> tuple[str, ...]:
    """Sentences, the most important one first; empty when the vehicle may take off."""
    found: list[str] = []
    if not facts.autopilot_age_s < AUTOPILOT_SILENT_S or not facts.heartbeat_age_s < HEARTBEAT_SILENT_S:
        found.append(f"Nothing is heard from PX4 at {vehicle.autopilot}: start it, or check cable and port.")
    elif facts.param_problems is None:
        found.append("PX4's parameters are not read yet: wait a moment.")
    else:
        found.extend(facts.param_problems)
    if not facts.position_age_s < POSITION_STALE_S:
        source = f"mocap body '{vehicle.body}'" if vehicle.mocap_required else "PX4's local position"
        found.append(f"No fresh position from {source}: check that it is tracked and published.")
    elif not fleet.fleet.geofence_m.contains(facts.position_enu_m):
        where = ", ".join(f"{value:.2f}" for value in facts.position_enu_m)
        found.append(f"Position ({where}) m lies outside the geofence: carry the vehicle inside.")
    if math.isfinite(facts.battery_frac) and 100.0 * facts.battery_frac < fleet.fleet.battery_warning_pct:
        found.append(
            f"Battery at {100.0 * facts.battery_frac:.0f} %, take-off needs {fleet.fleet.battery_warning_pct:.0f} %: "
            "charge or change it."
        )
    for name in facts.missing_neighbours:
        found.append(f"{name} is not heard on the bus: start its agent, or set enabled = false in the fleet file.")
    for name, other in facts.other_hashes.items():
        found.append(
            f"{name} flies with another fleet file ({other}, here {facts.config_hash}): restart both with the same one."
        )
    if not facts.is_law_warm:
        found.append("The control pipeline is still warming up: wait a moment.")
    return tuple(found)
