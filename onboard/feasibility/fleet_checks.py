"""Whether a fleet can fly as configured, before anybody flies: findings with value, bound, sentence and remedy. Pure.

:func:`fleet_findings` judges the file alone; :func:`spot_findings` judges one constellation (take-off spots, the goals
of a mission's step, where vehicles really stand). ``covey check`` prints them; a preflight may call the same functions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from typing import Literal

import msgspec

from onboard.config.fleet import FleetConfig, Vec3, Vehicle, parking_distance_m
from onboard.feasibility import bounds
from onboard.feasibility.bounds import ACCURACIES, Accuracy
from onboard.feasibility.finding import Finding, least, worst, worst_first
from onboard.feasibility.pair_checks import crowding, effective_margin_m, least_margin_m, pair_findings, parking_m
from onboard.feasibility.vehicle_checks import (
    available_m_s2,
    battery,
    gust_reserve,
    height_at_tilt,
    silence,
    thrust_reserve,
)

ErrorClass = Literal["mocap", "vision", "gps"]

_FENCE_M = 0.15


def fleet_findings(fleet: FleetConfig, *, errors: ErrorClass | None = None) -> tuple[Finding, ...]:
    """All findings of a fleet file, the worst first; ``errors`` overrides :func:`error_class`."""
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    if not vehicles:
        remedy = "Set enabled = true for those who shall fly."
        sentence = f"No vehicle of the fleet '{fleet.fleet.name}' is enabled: nobody flies. {remedy}"
        return (Finding("vehicles", "refused", 0.0, 1.0, "", "at least", sentence, remedy),)
    kinds = distinct(vehicles)
    accuracy = ACCURACIES[errors or error_class(fleet)]
    found: list[Finding] = []
    if len(vehicles) > 1:
        found += pair_findings(fleet, kinds, accuracy)
        starts = {vehicle.name: vehicle.start_enu_m for vehicle in vehicles}
        found.append(start_finding(fleet, starts, accuracy))
        for name, slots in fleet.formations.items():
            flown = {vehicle: slot for vehicle, slot in slots.items() if vehicle in starts}
            if len(flown) > 1:
                found.append(spacing_finding(fleet, flown, f"formation '{name}'", accuracy))
        found.append(crowding(fleet, vehicles))
    found.append(fence_finding(fleet, {vehicle.name: vehicle.start_enu_m for vehicle in vehicles}, "take-off spots"))
    for judge in (height_at_tilt, thrust_reserve, gust_reserve, battery, silence):
        found.append(worst(judge(fleet, vehicle) for vehicle in kinds))
    return worst_first(found)


def distinct(vehicles: Iterable[Vehicle]) -> list[Vehicle]:
    """The first vehicle of each kind: those that differ in nothing that a finding looks at are judged once."""
    kinds: dict[object, Vehicle] = {}
    for vehicle in vehicles:
        own = {"name": "", "index": 0, "system_id": 0, "start_enu_m": (0.0, 0.0, 0.0), "agent": "", "autopilot": ""}
        alike = msgspec.structs.replace(vehicle, **own, direct=None, mocap_body=None)
        kinds.setdefault(msgspec.json.encode(alike), vehicle)
    return list(kinds.values())


def spot_findings(
    fleet: FleetConfig, spots: Mapping[str, Vec3], where: str, *, errors: ErrorClass | None = None
) -> tuple[Finding, ...]:
    """Spacing and room of one constellation: vehicle -> position in fleet ENU; ``where`` names it in the sentences."""
    found = [fence_finding(fleet, spots, where)] if spots else []
    if spots and fleet.obstacles:
        found.append(obstacle_finding(fleet, spots, where))
    if len(spots) > 1:
        found.append(spacing_finding(fleet, spots, where, ACCURACIES[errors or error_class(fleet)]))
    return worst_first(found)


def error_class(fleet: FleetConfig) -> ErrorClass:
    """``mocap`` when every vehicle that takes part flies on a mocap, else PX4's own estimate as with GPS."""
    return "mocap" if all(fleet.vehicles[name].mocap_required for name in fleet.enabled_names) else "gps"


def start_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], accuracy: Accuracy) -> Finding:
    """Initial conditions at rest.

    Proposition 1 asks at t = 0 for d^2 >= d_inf^2, its rate >= -kappa_1 (d^2 - d_inf^2) and
    phi_perp >= d_inf v_perp - kappa_3 (d^2 - d_inf^2). At rest rate and phi_perp are 0: the first two ask for
    d >= d_inf, which makes h_1 <= 0 of (20); the third, which makes h_2 <= 0 of (21), for
    d >= sqrt(d_inf^2 + d_inf v_perp / kappa_3). Covey's rows ask nothing of vehicles at rest (need <= 0) from the
    design distance on, and turning rows act only where a distance row does.
    """
    spacing_m, pair = _closest(spots)
    if fleet.law.name == "paper":
        bound_m, why = parking_distance_m(fleet), "(8) of the paper at rest"
    elif fleet.law.name == "covey":
        bound_m = fleet.fleet.safety_distance_m + max(
            effective_margin_m(fleet, accuracy), least_margin_m(fleet, accuracy)
        )
        why = f"the design distance for '{accuracy.name}', where rows ask nothing of vehicles at rest"
    else:
        bound_m, why = fleet.fleet.safety_distance_m, "the safety distance"
    return least(
        "initial conditions",
        spacing_m,
        parking_m(fleet, accuracy),
        "m",
        f"Take-off spots: {pair} stand {{value}} apart; Proposition 1 holds at rest from {bound_m:.2f} m on ({why}), "
        "and to hover side by side takes {bound}",
        f"Move the spots of {pair} apart by {{lack}}.",
        refuse_below=bound_m,
    )


def spacing_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], where: str, accuracy: Accuracy) -> Finding:
    """The closest pair of a constellation against the distance at which two vehicles can hover side by side."""
    spacing_m, pair = _closest(spots)
    return least(
        f"spacing, {where}",
        spacing_m,
        parking_m(fleet, accuracy),
        "m",
        f"{where[0].upper()}{where[1:]}: {pair} are {{value}} apart; the law '{fleet.law.name}' can park "
        f"vehicles, with estimates as accurate as '{accuracy.name}', {{relation}} {{bound}} apart",
        "Spread the places by {lack}, or fly on a better position if it is the accuracy that asks for so much.",
    )


def fence_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], where: str) -> Finding:
    """Room between the places and the fence: the goal's own, and enough to stop in from full speed."""

    def judge(name: str) -> Finding:
        vehicle, fence = fleet.vehicles[name], fleet.fleet.geofence_m
        x, y, z = spots[name]
        room_m = min(x - fence.x[0], fence.x[1] - x, y - fence.y[0], fence.y[1] - y, fence.z[1] - z)
        need_m = bounds.stopping_distance_m(
            vehicle.max_speed_m_s, available_m_s2(vehicle), vehicle.lag_s + bounds.TICK_S
        )
        return least(
            f"fence, {where}",
            room_m,
            need_m,
            "m",
            f"{where[0].upper()}{where[1:]}: {name} is {{value}} from the fence, stopping from "
            f"{vehicle.max_speed_m_s:g} m/s takes {{bound}}",
            "Move the place inwards, widen fleet.geofence_m, or lower max_speed_m_s.",
            refuse_below=_FENCE_M,
        )

    return worst(judge(name) for name in spots)


def obstacle_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], where: str) -> Finding:
    """Room between the places and the nearest of the fleet's obstacles, which its rows will not let a vehicle leave."""
    gap_m, name, obstacle = min(
        (obstacle.distance_m(spot), name, obstacle.name) for name, spot in spots.items() for obstacle in fleet.obstacles
    )
    return least(
        f"obstacles, {where}",
        gap_m,
        0.5 * fleet.fleet.body_diameter_m + fleet.law.obstacle_margin_m,
        "m",
        f"{where[0].upper()}{where[1:]}: {name} is {{value}} from obstacle '{obstacle}'; half a body and "
        "law.obstacle_margin_m take {bound}",
        "Move the place away by {lack}.",
    )


def _closest(spots: Mapping[str, Vec3]) -> tuple[float, str]:
    """Smallest horizontal distance of any two, and who they are."""
    pairs = itertools.combinations(spots, 2)
    return min((math.dist(spots[a][:2], spots[b][:2]), f"{a} and {b}") for a, b in pairs)
