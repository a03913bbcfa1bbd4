"""Checks whether a fleet can fly as configured, and returns the findings. Pure.

:func:`fleet_findings` checks the fleet file. :func:`spot_findings` checks one constellation:
take-off spots, the goals of a mission's step, or the positions of vehicles. ``covey check`` prints
the findings, and the preflight check uses them to refuse a take-off.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import msgspec

from onboard.config.fleet import (
    FleetConfig,
    OwnLaw,
    Vehicle,
    above_words,
    parking_distance_m,
    parking_height_share,
)
from onboard.config.flight_space import flight_space_of
from onboard.config.pair_separation import separation_m
from onboard.estimation.accuracies import ACCURACIES, Accuracy
from onboard.feasibility import bounds, law_map
from onboard.feasibility.blind_descent import blind_descent_findings
from onboard.feasibility.fence_checks import braking_in_wind
from onboard.feasibility.finding import (
    Finding,
    at_least,
    at_most,
    rounded_up,
    warning_of,
    worst,
    worst_first,
)
from onboard.feasibility.pair_checks import (
    crowding,
    effective_margin_m,
    height_accuracy_m,
    kappa_values,
    least_margin_m,
    pair_findings,
    parking_m,
    too_few_neighbours,
)
from onboard.feasibility.vehicle_checks import (
    attitude_response,
    available_m_s2,
    battery,
    beside_people,
    dead_time,
    gust_reserve,
    height_at_tilt,
    own_failsafes,
    silence,
    thrust_reserve,
    wind,
)
from onboard.plain_text import capitalised, listed
from onboard.safety.limits import LARGEST_PX4_ACCURACY_M
from onboard.tuples import Xyz
from onboard.types import TICK_S

ErrorClass = Literal["mocap", "vision", "gps"]

OWN_LAW = "own law"  # name of the finding about a user's own law

_CHECKS_OF_A_VEHICLE = (
    height_at_tilt,
    thrust_reserve,
    gust_reserve,
    attitude_response,
    dead_time,
    wind,
    battery,
    silence,
    own_failsafes,
)

_MIN_FENCE_M = 0.15  # a spot nearer to the fence is refused


def fleet_findings(fleet: FleetConfig, *, errors: ErrorClass | None = None) -> tuple[Finding, ...]:
    """Return all findings about a fleet file, the worst first.

    Args:
        fleet: the fleet file.
        errors: accuracy class of the vehicles' positions; None: the result of :func:`error_class`.
    """
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    if not vehicles:
        return (_nobody(fleet),)

    kinds = distinct(vehicles)
    starts = {vehicle.name: vehicle.start_enu_m for vehicle in vehicles}
    if errors is None:
        errors = error_class(fleet)
    accuracy = ACCURACIES[errors]

    findings = []
    if fleet.own_law is not None:
        findings.append(_own_law(fleet, fleet.own_law))

    by_spot = [vehicle.name for vehicle in vehicles if fleet.begins_on_its_spot(vehicle)]
    if by_spot:
        has_origin = fleet.fleet.global_origin is not None
        findings.append(_no_place_on_earth(by_spot, has_origin=has_origin))

    by_satellites = [vehicle.name for vehicle in vehicles if vehicle.flies_by_satellites]
    if by_satellites and fleet.fleet.height_share > 0.0:
        findings.append(_heights_by_satellites(fleet, by_satellites))

    if len(vehicles) > 1:
        findings += pair_findings(fleet, kinds, accuracy)
        findings.append(start_finding(fleet, starts, accuracy))
        findings += _formation_findings(fleet, accuracy)
        findings += too_few_neighbours(fleet, vehicles)
        findings.append(crowding(fleet, vehicles))
        if fleet.law.name == "covey":
            findings.append(law_map.map_finding(fleet, accuracy, law_map.shipped()))

    findings.append(fence_finding(fleet, starts, "take-off spots"))
    if fleet.obstacles and fleet.law.built_in != "off":
        findings.append(_obstacle_margin(fleet, accuracy))
    if fleet.law.built_in == "covey":
        findings.append(_speed_limit(fleet))
    for check in _CHECKS_OF_A_VEHICLE:
        findings.append(worst(check(fleet, vehicle) for vehicle in kinds))
    if fleet.people:
        findings.append(worst(beside_people(fleet, vehicle) for vehicle in kinds))
    if fleet.fences:
        findings.append(worst(braking_in_wind(fleet, vehicle) for vehicle in kinds))

    return worst_first(findings)


def _nobody(fleet: FleetConfig) -> Finding:
    """Return the refusal of a fleet without vehicles."""
    remedy = "Set enabled = true for the vehicles that shall fly."
    return Finding(
        name="vehicles",
        status="refused",
        value=0.0,
        bound=1.0,
        unit="",
        relation="at least",
        sentence=f"No vehicle of the fleet '{fleet.fleet.name}' is enabled. {remedy}",
        remedy=remedy,
    )


def _own_law(fleet: FleetConfig, law: OwnLaw) -> Finding:
    """Return the warning that the code of a law in the fleet file will be executed."""
    source = law.source
    if not source:
        source = "an installed module"
    on_real_vehicles = "does not take off"
    if fleet.law.allow_own_law_on_real_vehicles:
        on_real_vehicles = "may fly"

    remedy = "Read its source before you run it."
    sentence = (
        f"The law '{law.name}' is code that this fleet file names: "
        f"{source} (source {law.source_hash}). It runs with the "
        "rights of every agent and simulation that flies it. On real vehicles it "
        f"{on_real_vehicles}. Preview and these findings are of Covey's law, which takes over "
        "where it fails. "
        f"{remedy}"
    )
    return warning_of(name=OWN_LAW, sentence=sentence, remedy=remedy)


def _no_place_on_earth(names: Sequence[str], *, has_origin: bool) -> Finding:
    """Return the warning that vehicles have no frame in common but their take-off spots.

    Args:
        names: the vehicles.
        has_origin: whether the fleet has an origin on Earth. Then these vehicles fly by vision.
    """
    cause = "by PX4's own position, and the fleet has no origin on Earth"
    remedy = "Outdoors, give the fleet an origin, and fly by satellites."
    if has_origin:
        cause = "by vision, so that PX4 does not know where on Earth its local frame begins"
        remedy = "Outdoors, fly by satellites."
    sentence = (
        f"Without a mocap, {listed(names)} {_fly(names)} {cause}: each must stand on its take-off "
        "spot when PX4 and its agent start, and has no position after a restart elsewhere. "
        f"{remedy}"
    )
    return warning_of(name="no place on Earth", sentence=sentence, remedy=remedy)


def _fly(names: Sequence[str]) -> str:
    return "flies" if len(names) == 1 else "fly"


def _heights_by_satellites(fleet: FleetConfig, names: Sequence[str]) -> Finding:
    """Return the warning that heights by satellites are hardly good enough to pass above others."""
    remedy = "Leave out vertical_separation_m, or fly with RTK."
    sentence = (
        f"{listed(names)} {_fly(names)} by satellites, whose heights err by metres, and the fleet "
        f"passes above each other at {fleet.fleet.vertical_separation_m:g} m: each takes off only "
        f"while PX4 says that its height errs by {LARGEST_PX4_ACCURACY_M:.1f} m at most, and lands "
        f"when it errs by more. {remedy}"
    )
    return warning_of(name="heights by satellites", sentence=sentence, remedy=remedy)


def _formation_findings(fleet: FleetConfig, accuracy: Accuracy) -> list[Finding]:
    """Return the spacing finding of each formation with at least two enabled vehicles."""
    findings = []
    for name, slots in fleet.formations.items():
        flown = {vehicle: slot for vehicle, slot in slots.items() if vehicle in fleet.enabled_names}
        if len(flown) > 1:
            findings.append(spacing_finding(fleet, flown, f"formation '{name}'", accuracy))
    return findings


def distinct(vehicles: Iterable[Vehicle]) -> list[Vehicle]:
    """Return the first vehicle of each kind, because equal vehicles are checked only once.

    Args:
        vehicles: any vehicles.
    """
    kinds: dict[bytes, Vehicle] = {}  # encoded values of a kind -> its first vehicle
    for vehicle in vehicles:
        # no check uses these values, and they differ between vehicles of one kind
        kind = msgspec.structs.replace(
            vehicle,
            name="",
            index=0,
            system_id=0,
            start_enu_m=(0.0, 0.0, 0.0),
            agent="",
            autopilot="",
            direct=None,
            mocap_body=None,
        )
        kinds.setdefault(msgspec.json.encode(kind), vehicle)
    return list(kinds.values())


def spot_findings(
    fleet: FleetConfig, spots: Mapping[str, Xyz], label: str, *, errors: ErrorClass | None = None
) -> tuple[Finding, ...]:
    """Return all findings about the spacing and the surroundings of one constellation.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentences, for instance "take-off spots".
        errors: accuracy class of the vehicles' positions; None: the result of :func:`error_class`.
    Returns:
        The findings, the worst first.
    """
    findings = []

    if spots:
        findings.append(fence_finding(fleet, spots, label))
    if spots and fleet.obstacles:
        findings.append(obstacle_finding(fleet, spots, label))
    if len(spots) > 1:
        if errors is None:
            errors = error_class(fleet)
        findings.append(spacing_finding(fleet, spots, label, ACCURACIES[errors]))
    findings += blind_descent_findings(fleet, spots, label)

    return worst_first(findings)


def error_class(fleet: FleetConfig) -> ErrorClass:
    """Return the accuracy class of a fleet: that of its least accurate enabled vehicle.

    A vehicle's class is ``mocap`` with ``mocap_required``, and otherwise its ``px4_position``.

    Args:
        fleet: the fleet file.
    """
    sources = set()
    for name in fleet.enabled_names:
        vehicle = fleet.vehicles[name]
        if vehicle.mocap_required:
            sources.add("mocap")
        else:
            sources.add(vehicle.px4_position)

    if "gps" in sources:
        return "gps"
    if "vision" in sources:
        return "vision"
    return "mocap"


def start_finding(fleet: FleetConfig, spots: Mapping[str, Xyz], accuracy: Accuracy) -> Finding:
    """Check the initial conditions of the law for vehicles at rest.

    The paper's Proposition 1 has three conditions at t = 0:

    1. d^2 >= d_inf^2;
    2. the rate of d^2 is at least -kappa_1 (d^2 - d_inf^2);
    3. phi_perp >= d_inf v_perp - kappa_3 (d^2 - d_inf^2).

    At rest, the rate and phi_perp are 0. Then conditions 1 and 2 require d >= d_inf, and h_1 <= 0
    holds in the paper's (20). Condition 3 requires d >= sqrt(d_inf^2 + d_inf v_perp / kappa_3), and
    h_2 <= 0 holds in (21). Covey's distance rows require only the design distance of vehicles at
    rest. Its rotation rows act only together with a distance row.

    Args:
        fleet: the fleet file.
        spots: vehicle -> take-off spot [m], fleet ENU; at least two.
        accuracy: accuracy of the vehicles' estimates.
    """
    # a difference in height does not count, because all vehicles climb from their spots
    spacing_m, pair = _closest(spots, 0.0)

    safety_distance_m = fleet.fleet.safety_distance_m
    if fleet.law.built_in == "paper":
        bound_m = parking_distance_m(fleet)
        reason = "(8) of the paper at rest"
    elif fleet.law.built_in == "covey":
        margin_m = max(effective_margin_m(fleet, accuracy), least_margin_m(fleet, accuracy))
        bound_m = safety_distance_m + margin_m
        reason = f"the design distance for '{accuracy.name}'"
    else:
        bound_m = safety_distance_m
        reason = "the safety distance"

    return at_least(
        name="initial conditions",
        value=spacing_m,
        bound=parking_m(fleet, accuracy),
        unit="m",
        sentence=(
            f"Take-off spots: {pair} stand <value> apart. The law's initial conditions require "
            f"{bound_m:.2f} m ({reason}), and hovering side by side requires <bound>"
        ),
        remedy=f"Move the spots of {pair} apart by <difference>.",
        refuse_below=bound_m,
    )


def spacing_finding(
    fleet: FleetConfig, spots: Mapping[str, Xyz], label: str, accuracy: Accuracy
) -> Finding:
    """Check that the closest pair of a constellation can hover side by side.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU; at least two.
        label: name of the constellation in the sentences.
        accuracy: accuracy of the vehicles' estimates.
    """
    height_share = parking_height_share(fleet, height_accuracy_m(accuracy))
    spacing_m, pair = _closest(spots, height_share)
    bound_m = parking_m(fleet, accuracy)

    return at_least(
        name="spacing",
        where=label,
        value=spacing_m,
        bound=bound_m,
        unit="m",
        sentence=(
            f"{capitalised(label)}: {pair} are <value> apart; the law '{fleet.law.name}' can "
            f"park vehicles, with estimates as accurate as '{accuracy.name}', <relation> "
            f"<bound> apart{above_words(bound_m, height_share)}"
        ),
        remedy="Move the spots <difference> farther apart, or fly with a more accurate position.",
    )


def fence_finding(fleet: FleetConfig, spots: Mapping[str, Xyz], label: str) -> Finding:
    """Check that each spot is far enough from the geofence to stop from full speed.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentences, for instance "take-off spots".
    """
    return worst(_fence_finding(fleet, name, spot, label) for name, spot in spots.items())


def _fence_finding(fleet: FleetConfig, name: str, spot: Xyz, label: str) -> Finding:
    """Return the finding about one vehicle's spot."""
    vehicle = fleet.vehicles[name]
    fence = fleet.fleet.geofence_m

    # the floor of the fence does not count, because vehicles stop on the ground
    x, y, z = spot
    west, east = fence.x
    south, north = fence.y
    _, top = fence.z
    room_m = min(x - west, east - x, y - south, north - y, top - z)
    limit_words = "the fence"
    remedy = "Move the spot inwards, widen fleet.geofence_m, or lower max_speed_m_s."
    to_area_m, area_name = flight_space_of(fleet).room_m(spot)
    if to_area_m < room_m:
        room_m = to_area_m
        limit_words = f"the buffer of the fence '{area_name}'"
        remedy = f"Move the spot away from it, correct '{area_name}', or lower max_speed_m_s."

    margin_m = fleet.law.fence_margin_m
    if room_m < margin_m and fleet.law.built_in != "off":
        return at_least(
            name="fence",
            where=label,
            value=room_m,
            bound=margin_m,
            unit="m",
            sentence=(
                f"{capitalised(label)}: {name} is <value> from {limit_words}, and "
                "law.fence_margin_m keeps vehicles <bound> away from it"
            ),
            remedy="Lower law.fence_margin_m, or move the spot away from the fence.",
        )

    stop_m = bounds.stopping_distance_m(
        speed_m_s=vehicle.max_speed_m_s,
        acceleration_m_s2=available_m_s2(vehicle),
        reaction_s=vehicle.lag_s + TICK_S,
    )

    return at_least(
        name="fence",
        where=label,
        value=room_m,
        bound=stop_m,
        unit="m",
        sentence=(
            f"{capitalised(label)}: {name} is <value> from {limit_words}, stopping from "
            f"{vehicle.max_speed_m_s:g} m/s takes <bound>"
        ),
        remedy=remedy,
        refuse_below=_MIN_FENCE_M,
    )


def _speed_limit(fleet: FleetConfig) -> Finding:
    """Check that the law brakes vehicles that fly faster than their limit."""
    return at_most(
        name="speed limit",
        value=fleet.law.avoid_speed_frac,
        bound=1.0,
        unit="",
        sentence=(
            "law.avoid_speed_frac is <value>: the law brakes a vehicle only from this share of "
            "max_speed_m_s on, which must be <relation> <bound>"
        ),
        remedy="Set law.avoid_speed_frac = 0.97.",
    )


def _obstacle_margin(fleet: FleetConfig, accuracy: Accuracy) -> Finding:
    """Check that the distance kept from obstacles covers the errors of the estimate."""
    kappa_1, kappa_2 = kappa_values(fleet)
    required_m = bounds.required_obstacle_margin_m(accuracy, kappa_1, kappa_2)
    advised_m = rounded_up(required_m, 2)

    return at_least(
        name="obstacle margin",
        value=fleet.law.obstacle_margin_m,
        bound=required_m,
        unit="m",
        sentence=(
            f"law.obstacle_margin_m is <value>; with estimates as accurate as '{accuracy.name}' "
            "it needs <relation> <bound>, or a vehicle touches an obstacle"
        ),
        remedy=f"Set law.obstacle_margin_m = {advised_m:.2f}, or fly on a better position.",
        refuse_below=-math.inf,  # how near obstacles are flown is not known here
    )


def obstacle_finding(fleet: FleetConfig, spots: Mapping[str, Xyz], label: str) -> Finding:
    """Check that no spot is nearer to an obstacle than the law allows.

    Args:
        fleet: the fleet file.
        spots: vehicle -> position [m], fleet ENU.
        label: name of the constellation in the sentences, for instance "take-off spots".
    """
    gaps = []
    for vehicle, spot in spots.items():
        for obstacle in fleet.obstacles:
            gaps.append((obstacle.distance_m(spot), vehicle, obstacle.name))
    gap_m, vehicle, obstacle_name = min(gaps)
    half_body_m = 0.5 * fleet.fleet.body_diameter_m

    return at_least(
        name="obstacles",
        where=label,
        value=gap_m,
        bound=half_body_m + fleet.law.obstacle_margin_m,
        unit="m",
        sentence=(
            f"{capitalised(label)}: {vehicle} is <value> from obstacle '{obstacle_name}'; half "
            "a body and law.obstacle_margin_m require <bound>"
        ),
        remedy="Move the spot away by <difference>.",
    )


def _closest(spots: Mapping[str, Xyz], height_share: float) -> tuple[float, str]:
    """Return the smallest separation [m] of any two spots, and the names of the two vehicles."""
    separations = []
    for a, b in itertools.combinations(spots, 2):
        distance_m = separation_m(spots[a], spots[b], height_share)
        separations.append((distance_m, f"{a} and {b}"))
    return min(separations)
