"""What deserves the operator's eye: one table, condition -> severity, sentence. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from groundstation.fleet import FleetState, VehicleView
from groundstation.tui.look import clean
from onboard.config import FleetConfig

CRITICAL, WARNING, NOTE = 2, 1, 0


@dataclass(frozen=True, slots=True)
class Alarm:
    """A condition that holds now; ``sentence`` says what it is and what to do."""

    severity: int
    sentence: str


def alarms(state: FleetState, fleet: FleetConfig, now_ns: int) -> list[Alarm]:
    """All that hold, the worst first."""
    found = list(_of_fleet(state, fleet, now_ns))
    found.extend(alarm for view in state.vehicles.values() for alarm in _of_vehicle(view, fleet, now_ns))
    return sorted(found, key=lambda alarm: -alarm.severity)


def _of_vehicle(view: VehicleView, fleet: FleetConfig, now_ns: int) -> Iterator[Alarm]:
    told, name = view.telemetry, view.name
    if told is None:
        return
    if not view.is_fresh(now_ns):
        if told.is_airborne:
            yield Alarm(CRITICAL, f"{name} flies and is silent for {view.age_s(now_ns):.1f} s. Keep clear; RC ready.")
        else:
            yield Alarm(WARNING, f"{name} is silent for {view.age_s(now_ns):.0f} s. Is its agent running?")
        return
    if told.state == "failed":
        yield Alarm(CRITICAL, f"{name} failed: {clean(told.reason, 120) or 'it does not say why'}")
    if told.is_airborne and not told.is_position_valid:
        yield Alarm(CRITICAL, f"{name} flies without a position. Land it.")
    elif told.is_airborne and not fleet.fleet.geofence_m.contains(told.position_enu_m):
        yield Alarm(CRITICAL, f"{name} is outside the fence. Land or move it back.")
    percent = told.battery_frac * 100.0
    if math.isfinite(percent) and told.is_airborne and percent <= fleet.fleet.battery_land_pct:
        yield Alarm(CRITICAL, f"{name}: battery {percent:.0f} %. It has to land now.")
    elif math.isfinite(percent) and 0.0 <= percent <= fleet.fleet.battery_warning_pct:
        yield Alarm(WARNING, f"{name}: battery {percent:.0f} %. Plan its landing.")
    if told.law_status.lower() in ("relaxed", "infeasible") and told.is_airborne:
        yield Alarm(WARNING, f"{name}: the law cannot keep every limit at once ({told.law_status.lower()}).")


def _of_fleet(state: FleetState, fleet: FleetConfig, now_ns: int) -> Iterator[Alarm]:
    pair = state.closest(now_ns)
    limit_m = fleet.fleet.safety_distance_m
    if pair is not None and state.airborne_names and pair.distance_m < limit_m:
        yield Alarm(
            CRITICAL,
            f"{pair.first} and {pair.second} are {pair.distance_m:.2f} m apart, below {limit_m:.2f} m. Hold or land.",
        )
    silent = [name for name, view in state.vehicles.items() if view.telemetry is None]
    if silent:
        yield Alarm(NOTE, f"Waiting for {_listed(silent)}: start the agents, or `covey demo`.")
    hashes = {view.telemetry.config_hash for view in state.vehicles.values() if view.telemetry is not None}
    if len(hashes) > 1:
        yield Alarm(WARNING, "The vehicles read different fleet files. Give all the same one and restart the agents.")


def _listed(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
