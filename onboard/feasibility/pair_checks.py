"""Findings about pairs of vehicles under the law: margin, range, delay, kappas against lag,
braking, crowding. Pure.
"""

from __future__ import annotations

import math
from dataclasses import replace

from onboard.avoidance.heights import HEIGHT_SIGMAS
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import FleetConfig, Vehicle, parking_distance_m
from onboard.estimation.accuracies import Accuracy
from onboard.feasibility import bounds
from onboard.feasibility.bounds import Response
from onboard.feasibility.finding import Finding, at_least, at_most, worst
from onboard.feasibility.vehicle_checks import GUST_M_S2, available_m_s2
from onboard.types import TICK_S

_BODY_GAP_M = 0.10
# form3 and swap8: 0 of 24 flights violate at 0.36 s, 2 of 24 at 0.41 s
_LONG_LAG_S, _LONGEST_LAG_S = 0.35, 0.40
_SLOW_GROWTH_1_S, _FAST_GROWTH_1_S = 0.0, 1.5
_USEFUL_NEIGHBOURS = 6  # fewer rows than this cost separation in a crowd, more gain nothing
_MARGIN_SHARE = 0.8  # of the fitted margin, below which vehicles have come too close in simulation


def response_of(vehicle: Vehicle) -> Response:
    """Return the response from a command to the acceleration.

    Args:
        vehicle: as configured.
    Returns:
        its response.
    """
    return Response(vehicle.attitude_delay_s, vehicle.attitude_wn_rad_s, vehicle.attitude_zeta)


def pair_findings(fleet: FleetConfig, vehicles: list[Vehicle], accuracy: Accuracy) -> list[Finding]:
    """Check everything that matters only with more than one vehicle.

    Args:
        fleet: the fleet file.
        vehicles: one of each kind.
        accuracy: of their estimates.
    Returns:
        the findings.
    """
    findings = [_body_gap(fleet)]
    if fleet.law.built_in == "off":
        sentence = (
            f"law.name is 'off', so nothing keeps the {len(fleet.enabled_names)} vehicles apart."
        )
        remedy = "Set law.name = 'covey', unless you want to fly without avoidance, in simulation."
        findings.append(
            Finding("law", "warning", 0.0, 1.0, "", "at least", f"{sentence} {remedy}", remedy)
        )
        return findings
    findings.append(_margin(fleet, accuracy))
    if fleet.law.built_in == "covey":
        findings.append(_shortfall(fleet))
    margin_m = effective_margin_m(fleet, accuracy)
    findings.append(_message_age(fleet, accuracy))
    for judge in (_range, braking):
        findings.append(worst(judge(fleet, vehicle, margin_m) for vehicle in vehicles))
    if fleet.law.built_in == "covey":
        findings.append(worst(_lag(vehicle) for vehicle in vehicles))
    findings.append(worst(_kappas(fleet, vehicle) for vehicle in vehicles))
    return findings


def _margin(fleet: FleetConfig, accuracy: Accuracy) -> Finding:
    kappa_1, kappa_2 = _kappa_values(fleet)
    needed_m = bounds.required_margin_m(accuracy, kappa_1, kappa_2)
    is_covey = fleet.law.built_in == "covey"
    subject = {
        "fixed": "law.design_margin_m is {value}",
        "accuracy": "In flight the margin will be {value}",
    }[fleet.law.margin]
    subject = subject if is_covey else "The paper's law has no margin ({value})"
    apart_m = fleet.fleet.safety_distance_m + needed_m + 0.10
    return at_least(
        "margin",
        effective_margin_m(fleet, accuracy),
        needed_m,
        "m",
        f"{subject}; estimates as accurate as '{accuracy.name}' (position {accuracy.position_std_m:g} m, velocity "
        f"{accuracy.velocity_std_m_s:g} m/s per axis) need {{relation}} {{bound}}",
        f"Set law.design_margin_m = {math.ceil(100.0 * needed_m) / 100.0:.2f}{'' if is_covey else ' of law covey'} and "
        f"park vehicles {apart_m:.2f} m apart or more, or fly on a better position.",
        # the paper's law is flown for comparison only; with a mocap its sensors are good enough for
        # that
        warn_below=0.95 * needed_m,
        refuse_below=_MARGIN_SHARE * needed_m if is_covey or accuracy.name != "mocap" else 0.0,
    )


def _shortfall(fleet: FleetConfig) -> Finding:
    return at_most(
        "shortfall gain",
        fleet.law.shortfall_gain,
        0.95,
        "",
        "law.shortfall_gain is {value}; at {relation} {bound} the reactions of two vehicles to each other die out",
        "Set law.shortfall_gain = 0.85.",
        refuse_above=1.0,
    )


def _body_gap(fleet: FleetConfig) -> Finding:
    section = fleet.fleet
    return at_least(
        "body",
        section.safety_distance_m - section.body_diameter_m,
        _BODY_GAP_M,
        "m",
        f"At fleet.safety_distance_m = {section.safety_distance_m:g} m {{value}} of air are left between bodies of "
        f"{section.body_diameter_m:g} m; downwash and a turned body need {{relation}} {{bound}}",
        "Raise fleet.safety_distance_m by {difference}.",
    )


def _range(fleet: FleetConfig, vehicle: Vehicle, margin_m: float) -> Finding:
    kappa_1, kappa_2 = _kappa_values(fleet)
    closing = 2.0 * fleet.law.avoid_speed_frac * vehicle.max_speed_m_s
    range_m = bounds.row_range_m(
        closing, fleet.fleet.safety_distance_m + margin_m, kappa_1, kappa_2
    )
    range_m += closing * (
        message_age_s(fleet) + (vehicle.lag_s if fleet.law.built_in == "covey" else 0.0)
    )
    return at_least(
        "sensing range",
        fleet.law.range_m,
        range_m,
        "m",
        f"law.range_m is {{value}}; two vehicles like {vehicle.name} that approach each other with {closing:.1f} "
        "m/s must know of each other {bound} apart",
        "Raise law.range_m by {difference}, or lower max_speed_m_s.",
    )


def _message_age(fleet: FleetConfig, accuracy: Accuracy) -> Finding:
    radio, age_s, margin_m = (
        fleet.expected_radio,
        message_age_s(fleet),
        effective_margin_m(fleet, accuracy),
    )
    spare_m = max(0.0, margin_m - bounds.required_margin_m(accuracy, *_kappa_values(fleet)))
    tolerated_s = bounds.USUAL_AGE_S + spare_m / bounds.AGE_MARGIN_M_S
    return at_most(
        "bus delay",
        age_s,
        tolerated_s,
        "s",
        f"A neighbour's state is up to {{value}} old ({1e3 * radio.expected_delay_s:g} ms of delay, "
        f"{100.0 * radio.expected_loss_frac:g} % lost); a margin of {margin_m:.2f} m with estimates as accurate as "
        f"'{accuracy.name}' tolerates {{relation}} {{bound}}",
        f"Set law.design_margin_m = {margin_for_age_m(fleet, accuracy):.2f}, or correct radio.expected_delay_s and "
        "expected_loss_frac.",
        # the paper's law has no margin at all; the finding "margin" says so
        refuse_above=math.inf if fleet.law.built_in == "paper" else tolerated_s,
    )


def margin_for_age_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the margin that the errors of the estimates and the age of the states require.

    Args:
        fleet: the fleet file.
        accuracy: of the vehicles' estimates.
    Returns:
        margin [m], rounded up to a centimetre.
    """
    margin_m = bounds.required_margin_m(accuracy, *_kappa_values(fleet)) + bounds.delay_margin_m(
        message_age_s(fleet)
    )
    return math.ceil(100.0 * margin_m - 1e-9) / 100.0


def message_age_s(fleet: FleetConfig) -> float:
    """Return the age that a neighbour's state reaches, by the delay and the loss that the fleet
    file expects.

    Args:
        fleet: the fleet file.
    Returns:
        age [s].
    """
    return fleet.expected_radio.state_age_s(fleet.state_ticks * TICK_S)


def _lag(vehicle: Vehicle) -> Finding:
    return at_most(
        "lag",
        vehicle.lag_s,
        _LONG_LAG_S,
        "s",
        f"{vehicle.name} follows a command {{value}} later; the law's prediction is good enough for a crowd with a lag "
        f"of {{relation}} {{bound}}, and beyond {_LONGEST_LAG_S:.2g} s vehicles have come too close in simulation",
        "Tune its attitude control to be faster (attitude_delay_s + 2 attitude_zeta / attitude_wn_rad_s).",
        refuse_above=_LONGEST_LAG_S,
    )


def _kappas(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    kappa_1, kappa_2 = _kappa_values(fleet)
    response = response_of(vehicle)
    if fleet.law.built_in == "paper":
        return _paper_kappas(vehicle, response, max(kappa_1, kappa_2))

    def _growth(scale: float) -> float:
        return max(
            bounds.loop_growth_1_s(
                response,
                scale * kappa_1,
                scale * kappa_2,
                lag_error_s=error_s,
                is_predicted=fleet.law.prediction == "lag",
            )
            for error_s in (-LAG_ERROR_S, 0.0, LAG_ERROR_S)
        )

    stable = next(
        (step / 20.0 for step in range(20, 0, -1) if _growth(step / 20.0) <= _SLOW_GROWTH_1_S), 0.05
    )
    return at_most(
        "kappas",
        _growth(1.0),
        _SLOW_GROWTH_1_S,
        "1/s",
        f"With law.kappa_1_1_s = {kappa_1:g} and kappa_2_1_s = {kappa_2:g} an oscillation between two vehicles like "
        f"{vehicle.name} (lag {vehicle.lag_s:.2f} s, known to {1e3 * LAG_ERROR_S:.0f} ms) grows with {{value}}; it "
        "dies out with {relation} {bound}",
        f"Use kappas up to {stable * kappa_1:.1f} and {stable * kappa_2:.1f} 1/s, or a vehicle with less lag.",
        refuse_above=_FAST_GROWTH_1_S,
    )


def _paper_kappas(vehicle: Vehicle, response: Response, kappa: float) -> Finding:
    bound = bounds.largest_equal_kappa_1_s(response.lag_s)
    growth = bounds.loop_growth_1_s(response, kappa, kappa, is_predicted=False)
    return at_most(
        "kappas",
        kappa,
        bound,
        "1/s",
        f"law.paper_kappa_1_1_s and _2 are up to {{value}}; with {vehicle.name}'s lag of {response.lag_s:.2f} s, "
        "which the paper's law does not predict, {relation} {bound} does not overshoot",
        f"Lower them to {bound:.2f}, or set law.name = 'covey', which predicts over the lag.",
        refuse_above=bound if growth > -0.5 else math.inf,
    )


def braking(fleet: FleetConfig, vehicle: Vehicle, margin_m: float) -> Finding:
    """Check that two vehicles that meet head-on can brake as the rows ask.

    Args:
        fleet: the fleet file.
        vehicle: of both.
        margin_m: in flight.
    Returns:
        the finding.
    """
    kappa_1, kappa_2 = _kappa_values(fleet)
    closing = 2.0 * vehicle.max_speed_m_s
    required = bounds.braking_m_s2(
        closing, fleet.fleet.safety_distance_m + margin_m, kappa_1, kappa_2
    )
    left = max(0.0, available_m_s2(vehicle) - vehicle.drag_1_s * vehicle.max_speed_m_s - GUST_M_S2)
    return at_most(
        "braking",
        required,
        left,
        "m/s^2",
        f"Two vehicles like {vehicle.name} that meet head-on with {closing:.1f} m/s must brake with {{value}} each; "
        "tilt and thrust leave {bound} beside drag and gusts",
        "Lower max_speed_m_s or the kappas, or raise max_tilt_deg.",
        warn_above=0.8 * left,
    )


def crowding(fleet: FleetConfig, vehicles: list[Vehicle]) -> Finding:
    """Check how full the geofence is, and that the law considers enough neighbours.

    Args:
        fleet: the fleet file.
        vehicles: all that take part.
    Returns:
        the finding.
    """
    law, fence = fleet.law, fleet.fleet.geofence_m
    useful = min(len(vehicles) - 1, _USEFUL_NEIGHBOURS)
    if law.built_in == "covey" and law.max_neighbours < useful:
        return at_least(
            "neighbours",
            float(law.max_neighbours),
            float(useful),
            "",
            f"law.max_neighbours is {{value}}; in a crowd of {len(vehicles)} the nearest {{bound}} matter",
            f"Set law.max_neighbours = {useful} or more.",
        )
    area_m2 = (fence.x[1] - fence.x[0]) * (fence.y[1] - fence.y[0])
    share = len(vehicles) * math.sqrt(0.75) * parking_distance_m(fleet) ** 2 / area_m2
    return at_most(
        "crowding",
        100.0 * share,
        30.0,
        "%",
        f"{len(vehicles)} vehicles at their parking distance take {{value}} of the geofence's area; to "
        "fly around each other they need {relation} {bound}",
        "Widen fleet.geofence_m, or fly fewer vehicles.",
        refuse_above=60.0,
    )


def effective_margin_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the margin that the law keeps above the safety distance in flight.

    Args:
        fleet: the fleet file.
        accuracy: of the vehicles' estimates.
    Returns:
        the configured margin [m], or more by the policy ``law.margin``.
    """
    law = fleet.law
    if law.built_in != "covey":
        return 0.0
    if law.margin == "fixed":
        return _configured_margin_m(fleet)
    time_s = law.accuracy_time_s  # the law does not know an error's own correlation time
    known = replace(
        accuracy, position_time_s=time_s, velocity_time_s=time_s, acceleration_std_m_s2=0.0
    )
    return max(_configured_margin_m(fleet), bounds.required_margin_m(known, *_kappa_values(fleet)))


def least_margin_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the margin below which vehicles have come too close in simulation.

    Args:
        fleet: the fleet file.
        accuracy: of the vehicles' estimates.
    Returns:
        margin [m].
    """
    return _MARGIN_SHARE * bounds.required_margin_m(accuracy, *_kappa_values(fleet))


def height_accuracy_m(accuracy: Accuracy) -> float:
    """Return by how much the law widens the vertical separation.

    Args:
        accuracy: of the vehicles' estimates.
    Returns:
        height [m].
    """
    return HEIGHT_SIGMAS * math.sqrt(2.0) * accuracy.position_std_m


def parking_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the distance at which vehicles can park, with the larger margin that the accuracy may
    require.

    Args:
        fleet: the fleet file.
        accuracy: of the vehicles' estimates.
    Returns:
        distance between centres [m].
    """
    configured_m = parking_distance_m(fleet)
    if fleet.law.built_in != "covey":
        return configured_m
    margin_m = max(effective_margin_m(fleet, accuracy), least_margin_m(fleet, accuracy))
    return configured_m + margin_m - _configured_margin_m(fleet)


def _configured_margin_m(fleet: FleetConfig) -> float:
    """Return the margin of the slowest vehicle, which is the largest one."""
    return fleet.law.margin_m(
        max((vehicle.lag_s for vehicle in fleet.vehicles.values()), default=0.0)
    )


def _kappa_values(fleet: FleetConfig) -> tuple[float, float]:
    law = fleet.law
    if law.built_in == "paper":
        return law.paper_kappa_1_1_s, law.paper_kappa_2_1_s
    return law.kappa_1_1_s, law.kappa_2_1_s
