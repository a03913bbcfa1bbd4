"""Whether a fleet can fly as configured: findings with value, bound, sentence and remedy. Pure.

:func:`fleet_findings` judges the file alone; :func:`spot_findings` judges one constellation:
take-off spots, the goals of a mission's step, or the positions of vehicles. ``covey check`` prints
the findings, preflight refuses by them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Literal

import msgspec

from onboard.config.fleet import (
    FleetConfig,
    OwnLaw,
    Vec3,
    Vehicle,
    above_words,
    parking_distance_m,
    parking_height_share,
)
from onboard.config.pair_separation import separation_m
from onboard.estimation.accuracies import ACCURACIES, Accuracy
from onboard.feasibility import bounds, law_map
from onboard.feasibility.finding import Finding, at_least, worst, worst_first
from onboard.feasibility.pair_checks import (
    crowding,
    effective_margin_m,
    height_accuracy_m,
    least_margin_m,
    pair_findings,
    parking_m,
)
from onboard.feasibility.vehicle_checks import (
    available_m_s2,
    battery,
    gust_reserve,
    height_at_tilt,
    silence,
    thrust_reserve,
)
from onboard.types import TICK_S

ErrorClass = Literal["mocap", "vision", "gps"]

_FENCE_M = 0.15


def fleet_findings(fleet: FleetConfig, *, errors: ErrorClass | None = None) -> tuple[Finding, ...]:
    """Judge a fleet file.

    Args:
        fleet: the fleet file.
        errors: accuracy of the vehicles' positions; by default that of :func:`error_class`.
    Returns:
        all findings, the worst first.
    """
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    if not vehicles:
        remedy = "Set enabled = true for the vehicles that shall fly."
        sentence = f"No vehicle of the fleet '{fleet.fleet.name}' is enabled. {remedy}"
        return (Finding("vehicles", "refused", 0.0, 1.0, "", "at least", sentence, remedy),)
    kinds = distinct(vehicles)
    accuracy = ACCURACIES[errors or error_class(fleet)]
    findings = [] if fleet.own_law is None else [_own_law(fleet, fleet.own_law)]
    if len(vehicles) > 1:
        findings += pair_findings(fleet, kinds, accuracy)
        starts = {vehicle.name: vehicle.start_enu_m for vehicle in vehicles}
        findings.append(start_finding(fleet, starts, accuracy))
        for name, slots in fleet.formations.items():
            flown = {vehicle: slot for vehicle, slot in slots.items() if vehicle in starts}
            if len(flown) > 1:
                findings.append(spacing_finding(fleet, flown, f"formation '{name}'", accuracy))
        findings.append(crowding(fleet, vehicles))
        if fleet.law.name == "covey":
            findings.append(law_map.map_finding(fleet, accuracy, law_map.shipped()))
    findings.append(
        fence_finding(
            fleet, {vehicle.name: vehicle.start_enu_m for vehicle in vehicles}, "take-off spots"
        )
    )
    for judge in (height_at_tilt, thrust_reserve, gust_reserve, battery, silence):
        findings.append(worst(judge(fleet, vehicle) for vehicle in kinds))
    return worst_first(findings)


def _own_law(fleet: FleetConfig, law: OwnLaw) -> Finding:
    """Return the warning that a fleet file brings code along."""
    real = "may fly" if fleet.law.allow_own_law_on_real_vehicles else "does not take off"
    remedy = "Read its source before you run it."
    sentence = (
        f"The law '{law.name}' (source {law.source_hash}) is code of {law.source} that this fleet file names: it runs "
        f"in every agent and here, with your rights. On real vehicles it {real}. Preview and these findings are of "
        f"Covey's law, which takes over where it fails. {remedy}"
    )
    return Finding("own law", "warning", 1.0, 0.0, "", "at most", sentence, remedy)


def distinct(vehicles: Iterable[Vehicle]) -> list[Vehicle]:
    """Return one vehicle of each kind, so that vehicles without a relevant difference are judged
    once.

    Args:
        vehicles: any.
    Returns:
        the first of each kind.
    """
    kinds: dict[object, Vehicle] = {}
    for vehicle in vehicles:
        own = {
            "name": "",
            "index": 0,
            "system_id": 0,
            "start_enu_m": (0.0, 0.0, 0.0),
            "agent": "",
            "autopilot": "",
        }
        alike = msgspec.structs.replace(vehicle, **own, direct=None, mocap_body=None)
        kinds.setdefault(msgspec.json.encode(alike), vehicle)
    return list(kinds.values())


def spot_findings(
    fleet: FleetConfig, spots: Mapping[str, Vec3], label: str, *, errors: ErrorClass | None = None
) -> tuple[Finding, ...]:
    """Judge spacing and room of one constellation.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentences, for instance "take-off spots".
        errors: accuracy of the vehicles' positions; by default that of :func:`error_class`.
    Returns:
        all findings, the worst first.
    """
    findings = [fence_finding(fleet, spots, label)] if spots else []
    if spots and fleet.obstacles:
        findings.append(obstacle_finding(fleet, spots, label))
    if len(spots) > 1:
        findings.append(
            spacing_finding(fleet, spots, label, ACCURACIES[errors or error_class(fleet)])
        )
    return worst_first(findings)


def error_class(fleet: FleetConfig) -> ErrorClass:
    """Return the accuracy class of a fleet.

    Args:
        fleet: the fleet file.
    Returns:
        the least accurate of the vehicles that take part: ``mocap`` with ``mocap_required``, else
            ``px4_position``.
    """
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    sources = {"mocap" if vehicle.mocap_required else vehicle.px4_position for vehicle in vehicles}
    return "gps" if "gps" in sources else "vision" if "vision" in sources else "mocap"


def start_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], accuracy: Accuracy) -> Finding:
    """Check the initial conditions of the law, for vehicles at rest.

    Proposition 1 requires at t = 0 d^2 >= d_inf^2, its rate >= -kappa_1 (d^2 - d_inf^2) and
    phi_perp >= d_inf v_perp - kappa_3 (d^2 - d_inf^2). At rest rate and phi_perp are 0: the first
    two require d >= d_inf, which makes h_1 <= 0 of (20); the third requires d >= sqrt(d_inf^2 +
    d_inf v_perp / kappa_3), which makes h_2 <= 0 of (21). Covey's rows demand nothing of vehicles
    at rest from the design distance on, and rotation rows act only where a distance row does.

    Args:
        fleet: the fleet file.
        spots: vehicle -> take-off spot [m], fleet ENU; at least two.
        accuracy: of the vehicles' estimates.
    Returns:
        the finding.
    """
    spacing_m, pair = _closest(spots, 0.0)  # all of them take off from below
    if fleet.law.built_in == "paper":
        bound_m, reason = parking_distance_m(fleet), "(8) of the paper at rest"
    elif fleet.law.built_in == "covey":
        bound_m = fleet.fleet.safety_distance_m + max(
            effective_margin_m(fleet, accuracy), least_margin_m(fleet, accuracy)
        )
        reason = f"the design distance for '{accuracy.name}'"
    else:
        bound_m, reason = fleet.fleet.safety_distance_m, "the safety distance"
    return at_least(
        "initial conditions",
        spacing_m,
        parking_m(fleet, accuracy),
        "m",
        f"Take-off spots: {pair} stand {{value}} apart. The law's initial conditions require {bound_m:.2f} m "
        f"({reason}), and hovering side by side requires {{bound}}",
        f"Move the spots of {pair} apart by {{difference}}.",
        refuse_below=bound_m,
    )


def spacing_finding(
    fleet: FleetConfig, spots: Mapping[str, Vec3], label: str, accuracy: Accuracy
) -> Finding:
    """Check the closest pair of a constellation against the distance at which two vehicles can
    hover side by side.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU; at least two.
        label: name of the constellation in the sentences.
        accuracy: of the vehicles' estimates.
    Returns:
        the finding.
    """
    spacing_m, pair = _closest(spots, parking_height_share(fleet, height_accuracy_m(accuracy)))
    return at_least(
        f"spacing, {label}",
        spacing_m,
        parking_m(fleet, accuracy),
        "m",
        f"{label[0].upper()}{label[1:]}: {pair} are {{value}} apart; the law '{fleet.law.name}' can park "
        f"vehicles, with estimates as accurate as '{accuracy.name}', {{relation}} {{bound}} apart{above_words(fleet)}",
        "Move the spots {difference} farther apart, or fly with a more accurate position.",
    )


def fence_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], label: str) -> Finding:
    """Check the distance between the spots and the geofence: enough to stop from full speed.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentences, for instance "take-off spots".
    Returns:
        the finding.
    """

    def _judge(name: str) -> Finding:
        vehicle, fence = fleet.vehicles[name], fleet.fleet.geofence_m
        x, y, z = spots[name]
        room_m = min(x - fence.x[0], fence.x[1] - x, y - fence.y[0], fence.y[1] - y, fence.z[1] - z)
        stop_m = bounds.stopping_distance_m(
            vehicle.max_speed_m_s, available_m_s2(vehicle), vehicle.lag_s + TICK_S
        )
        return at_least(
            f"fence, {label}",
            room_m,
            stop_m,
            "m",
            f"{label[0].upper()}{label[1:]}: {name} is {{value}} from the fence, stopping from "
            f"{vehicle.max_speed_m_s:g} m/s takes {{bound}}",
            "Move the spot inwards, widen fleet.geofence_m, or lower max_speed_m_s.",
            refuse_below=_FENCE_M,
        )

    return worst(_judge(name) for name in spots)


def obstacle_finding(fleet: FleetConfig, spots: Mapping[str, Vec3], label: str) -> Finding:
    """Check the distance between the spots and the nearest obstacle: the law does not let a vehicle
    go nearer.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentences, for instance "take-off spots".
    Returns:
        the finding.
    """
    gap_m, name, obstacle = min(
        (obstacle.distance_m(spot), name, obstacle.name)
        for name, spot in spots.items()
        for obstacle in fleet.obstacles
    )
    return at_least(
        f"obstacles, {label}",
        gap_m,
        0.5 * fleet.fleet.body_diameter_m + fleet.law.obstacle_margin_m,
        "m",
        f"{label[0].upper()}{label[1:]}: {name} is {{value}} from obstacle '{obstacle}'; half a body and "
        "law.obstacle_margin_m require {bound}",
        "Move the spot away by {difference}.",
    )


def _closest(spots: Mapping[str, Vec3], height_share: float) -> tuple[float, str]:
    """Return the smallest separation of any two, and their names."""
    pairs = itertools.combinations(spots, 2)
    return min((separation_m(spots[a], spots[b], height_share), f"{a} and {b}") for a, b in pairs)
