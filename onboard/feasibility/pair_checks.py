"""Findings about pairs of vehicles under the law. Pure.

They cover margin, range, delay, the inequality, lag, the gains kappa_1 and kappa_2 ("kappas"), and
braking.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from onboard.avoidance.heights import HEIGHT_SIGMAS
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config import areas
from onboard.config.fleet import FleetConfig, Vehicle, parking_distance_m
from onboard.config.flight_space import flight_space_of
from onboard.estimation.accuracies import Accuracy
from onboard.feasibility import bounds
from onboard.feasibility.finding import Finding, at_least, at_most, rounded_down, rounded_up, worst
from onboard.feasibility.inequality import inequality_finding
from onboard.feasibility.vehicle_checks import (
    GUST_M_S2,
    available_m_s2,
    largest_growth_1_s,
    response_of,
)
from onboard.types import TICK_S

# least gap between two bodies at the safety distance, for downwash and a turned body
_BODY_GAP_M = 0.10

# A smaller gain is a warning. In 30 flights of swap16 the smallest distance was 0.853 m with a gain
# of 0.85, 0.847 m with 0.5, 0.824 m with 0.25 and 0.805 m with 0.
_MIN_SHORTFALL_GAIN = 0.5

# In the simulated scenarios form3 and swap8, vehicles came too close in 0 of 24 flights with a lag
# of 0.36 s, and in 2 of 24 flights with 0.41 s.
_LONG_LAG_S = 0.35  # a longer lag is a warning
_LONGEST_LAG_S = 0.40  # a longer lag is refused

# growth rate of an oscillation between two vehicles
_SLOW_GROWTH_1_S = 0.0  # a faster growth is a warning
_FAST_GROWTH_1_S = 1.5  # a faster growth is refused

# Overshoot of the paper's law is refused only if motions decay more slowly than at this rate.
_QUICK_DECAY_1_S = -0.5

_USEFUL_NEIGHBOURS = 6  # fewer rows cost separation in a crowd; more rows gain nothing

# thresholds, as shares of the margin that the estimates' errors require
_MARGIN_SHARE = 0.8  # a smaller margin is refused: vehicles have come too close in simulation
_MARGIN_WARNING_SHARE = 0.95  # a smaller margin is a warning

_BRAKING_WARNING_SHARE = 0.8  # more than this share of the available braking is a warning
_NEVER_REFUSED = math.inf


def pair_findings(fleet: FleetConfig, vehicles: list[Vehicle], accuracy: Accuracy) -> list[Finding]:
    """Return the findings that matter only with more than one vehicle.

    Args:
        fleet: the fleet file.
        vehicles: one vehicle of each kind.
        accuracy: accuracy of their estimates.
    """
    findings = [_body_gap(fleet)]

    if fleet.law.built_in == "off":
        findings.append(_no_law(fleet))
        return findings

    findings.append(_margin(fleet, accuracy))
    if fleet.law.built_in == "covey":
        findings.append(_shortfall(fleet))
    findings.append(_message_age(fleet, accuracy))

    margin_m = effective_margin_m(fleet, accuracy)
    findings.append(worst(_range(fleet, vehicle, margin_m) for vehicle in vehicles))
    findings.append(worst(braking(fleet, vehicle, margin_m) for vehicle in vehicles))

    if fleet.law.built_in == "covey":
        findings.append(worst(_inequality(fleet, vehicle, accuracy) for vehicle in vehicles))
        findings.append(worst(_lag(vehicle) for vehicle in vehicles))
    findings.append(worst(_kappas(fleet, vehicle) for vehicle in vehicles))

    return findings


def _no_law(fleet: FleetConfig) -> Finding:
    """Return the warning that no law keeps the vehicles apart."""
    remedy = "Set law.name = 'covey', unless you want to fly without avoidance, in simulation."
    sentence = (
        f"law.name is 'off', so nothing keeps the {len(fleet.enabled_names)} vehicles apart. "
        f"{remedy}"
    )
    return Finding(
        name="law",
        status="warning",
        value=0.0,
        bound=1.0,
        unit="",
        relation="at least",
        sentence=sentence,
        remedy=remedy,
    )


def _margin(fleet: FleetConfig, accuracy: Accuracy) -> Finding:
    """Check that the margin in flight covers the estimates' errors."""
    kappa_1, kappa_2 = kappa_values(fleet)
    required_m = bounds.required_margin_m(accuracy, kappa_1, kappa_2)
    refuse_below_m = _MARGIN_SHARE * required_m

    if fleet.law.built_in == "covey":
        of_law = ""
        if fleet.law.margin == "fixed":
            subject = "law.design_margin_m is <value>"
        else:
            subject = "In flight the margin will be <value>"
    else:
        of_law = " of law covey"
        subject = "The paper's law keeps a margin of <value> (law.paper_margin_m)"
        # the paper's law is only for comparison, so the accuracy of a mocap is enough
        if accuracy.name == "mocap":
            refuse_below_m = 0.0

    advised_m = rounded_up(required_m, 2)
    # 0.10 m beyond the design distance, as in parking_distance_m
    apart_m = rounded_up(fleet.fleet.safety_distance_m + advised_m + 0.10, 2)

    return at_least(
        name="margin",
        value=effective_margin_m(fleet, accuracy),
        bound=required_m,
        unit="m",
        sentence=(
            f"{subject}; estimates as accurate as '{accuracy.name}' (position "
            f"{accuracy.position_std_m:g} m, velocity {accuracy.velocity_std_m_s:g} m/s per axis) "
            "need <relation> <bound>"
        ),
        remedy=(
            f"Set law.design_margin_m = {advised_m:.2f}{of_law} and park vehicles {apart_m:.2f} m "
            "apart or more, or fly on a better position."
        ),
        warn_below=_MARGIN_WARNING_SHARE * required_m,
        refuse_below=refuse_below_m,
    )


def _shortfall(fleet: FleetConfig) -> Finding:
    """Check that a vehicle takes over what its neighbour omits, and that mutual reactions decay."""
    if fleet.law.shortfall_gain < _MIN_SHORTFALL_GAIN:
        return at_least(
            name="shortfall gain",
            value=fleet.law.shortfall_gain,
            bound=_MIN_SHORTFALL_GAIN,
            unit="",
            sentence=(
                "law.shortfall_gain is <value>; a vehicle that omits its half of a correction "
                "needs another one that takes over <relation> <bound> of it"
            ),
            remedy="Set law.shortfall_gain = 0.85.",
            refuse_below=-math.inf,
        )
    return at_most(
        name="shortfall gain",
        value=fleet.law.shortfall_gain,
        bound=0.95,
        unit="",
        sentence=(
            "law.shortfall_gain is <value>; with <relation> <bound> the reactions of two vehicles "
            "to each other die out"
        ),
        remedy="Set law.shortfall_gain = 0.85.",
        refuse_above=1.0,
    )


def _body_gap(fleet: FleetConfig) -> Finding:
    """Check the gap between two bodies at the safety distance."""
    safety_distance_m = fleet.fleet.safety_distance_m
    body_diameter_m = fleet.fleet.body_diameter_m

    return at_least(
        name="body",
        value=safety_distance_m - body_diameter_m,
        bound=_BODY_GAP_M,
        unit="m",
        sentence=(
            f"At fleet.safety_distance_m = {safety_distance_m:g} m <value> of air are left "
            f"between bodies of {body_diameter_m:g} m; downwash and a turned body need "
            "<relation> <bound>"
        ),
        remedy="Raise fleet.safety_distance_m by <difference>.",
    )


def _range(fleet: FleetConfig, vehicle: Vehicle, margin_m: float) -> Finding:
    """Check that the law considers a neighbour early enough to brake."""
    kappa_1, kappa_2 = kappa_values(fleet)
    design_distance_m = fleet.fleet.safety_distance_m + margin_m
    closing_speed_m_s = 2.0 * fleet.law.avoid_speed_frac * vehicle.max_speed_m_s

    # Covey's law predicts over the lag; the paper's law uses the present state
    predicted_s = 0.0
    if fleet.law.built_in == "covey":
        predicted_s = vehicle.lag_s

    range_m = bounds.row_range_m(closing_speed_m_s, design_distance_m, kappa_1, kappa_2)
    range_m += closing_speed_m_s * (message_age_s(fleet) + predicted_s)

    return at_least(
        name="sensing range",
        value=fleet.law.range_m,
        bound=range_m,
        unit="m",
        sentence=(
            f"law.range_m is <value>; two vehicles like {vehicle.name} that approach each other "
            f"with {closing_speed_m_s:.1f} m/s must know of each other <bound> apart"
        ),
        remedy="Raise law.range_m by <difference>, or lower max_speed_m_s.",
    )


def _inequality(fleet: FleetConfig, vehicle: Vehicle, accuracy: Accuracy) -> Finding:
    """Return the finding of :mod:`onboard.feasibility.inequality`."""
    return inequality_finding(
        fleet,
        vehicle,
        accuracy,
        margin_m=effective_margin_m(fleet, accuracy),
        age_s=message_age_s(fleet),
    )


def _message_age(fleet: FleetConfig, accuracy: Accuracy) -> Finding:
    """Check that the margin covers the age of the neighbours' states."""
    kappa_1, kappa_2 = kappa_values(fleet)
    radio = fleet.expected_radio

    margin_m = effective_margin_m(fleet, accuracy)
    spare_m = max(0.0, margin_m - bounds.required_margin_m(accuracy, kappa_1, kappa_2))
    tolerated_s = bounds.USUAL_AGE_S + spare_m / bounds.AGE_MARGIN_M_S

    # the paper's law has hardly a margin; the finding "margin" already reports this
    refuse_above_s = tolerated_s
    if fleet.law.built_in == "paper":
        refuse_above_s = _NEVER_REFUSED

    return at_most(
        name="bus delay",
        value=message_age_s(fleet),
        bound=tolerated_s,
        unit="s",
        sentence=(
            f"A neighbour's state is up to <value> old ({1e3 * radio.expected_delay_s:g} ms of "
            f"delay, {100.0 * radio.expected_loss_frac:g} % lost); a margin of {margin_m:.2f} m "
            f"with estimates as accurate as '{accuracy.name}' tolerates <relation> <bound>"
        ),
        remedy=(
            f"Set law.design_margin_m = {margin_for_age_m(fleet, accuracy):.2f}, or correct "
            "radio.expected_delay_s and expected_loss_frac."
        ),
        refuse_above=refuse_above_s,
    )


def margin_for_age_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the margin [m] for the estimates' errors and the states' age, rounded up to 1 cm.

    Args:
        fleet: the fleet file.
        accuracy: accuracy of the vehicles' estimates.
    """
    kappa_1, kappa_2 = kappa_values(fleet)
    for_errors_m = bounds.required_margin_m(accuracy, kappa_1, kappa_2)
    for_age_m = bounds.delay_margin_m(message_age_s(fleet))
    return rounded_up(for_errors_m + for_age_m, 2)


def message_age_s(fleet: FleetConfig) -> float:
    """Return the largest age [s] of a neighbour's state with the fleet file's expected radio.

    Args:
        fleet: the fleet file.
    """
    return fleet.expected_radio.state_age_s(fleet.state_ticks * TICK_S)


def _lag(vehicle: Vehicle) -> Finding:
    """Check that the lag is short enough for the law's prediction."""
    return at_most(
        name="lag",
        value=vehicle.lag_s,
        bound=_LONG_LAG_S,
        unit="s",
        sentence=(
            f"{vehicle.name} follows a command <value> later; the law's prediction is good "
            "enough for a crowd with a lag of <relation> <bound>, and beyond "
            f"{_LONGEST_LAG_S:.2g} s vehicles have come too close in simulation"
        ),
        remedy=(
            "Tune its attitude control to be faster "
            "(attitude_delay_s + 2 attitude_zeta / attitude_wn_rad_s)."
        ),
        refuse_above=_LONGEST_LAG_S,
    )


def _kappas(fleet: FleetConfig, vehicle: Vehicle) -> Finding:
    """Check that an oscillation between two equal vehicles decays."""
    kappa_1, kappa_2 = kappa_values(fleet)
    if fleet.law.built_in == "paper":
        return _paper_kappas(vehicle, max(kappa_1, kappa_2))

    # the largest share of both kappas, in steps of 5 %, at which every motion decays
    stable_share = 0.05
    for twentieths in range(20, 0, -1):
        share = twentieths / 20.0
        if _largest_growth_1_s(fleet, vehicle, share) <= _SLOW_GROWTH_1_S:
            stable_share = share
            break

    return at_most(
        name="kappas",
        value=_largest_growth_1_s(fleet, vehicle, 1.0),
        bound=_SLOW_GROWTH_1_S,
        unit="1/s",
        sentence=(
            f"With law.kappa_1_1_s = {kappa_1:g} and kappa_2_1_s = {kappa_2:g} an oscillation "
            f"between two vehicles like {vehicle.name} (lag {vehicle.lag_s:.2f} s, known to "
            f"{1e3 * LAG_ERROR_S:.0f} ms) grows with <value>; it dies out with "
            "<relation> <bound>"
        ),
        remedy=(
            f"Use kappas up to {rounded_down(stable_share * kappa_1, 1):.1f} and "
            f"{rounded_down(stable_share * kappa_2, 1):.1f} 1/s, or a vehicle with less lag."
        ),
        refuse_above=_FAST_GROWTH_1_S,
    )


def _largest_growth_1_s(fleet: FleetConfig, vehicle: Vehicle, share: float) -> float:
    """Return the growth rate for a share of the kappas and the worst error of the configured
    lag.
    """
    kappa_1, kappa_2 = kappa_values(fleet)
    is_predicted = fleet.law.prediction == "lag"
    return largest_growth_1_s(vehicle, share * kappa_1, share * kappa_2, is_predicted=is_predicted)


def _paper_kappas(vehicle: Vehicle, kappa: float) -> Finding:
    """Check that the larger kappa of the paper's law does not overshoot."""
    response = response_of(vehicle)
    largest = bounds.largest_equal_kappa_1_s(response.lag_s)
    growth_1_s = bounds.loop_growth_1_s(response, kappa, kappa, is_predicted=False)

    # motions that decay quickly overshoot only a little, so there is no need to refuse
    refuse_above = _NEVER_REFUSED
    if growth_1_s > _QUICK_DECAY_1_S:
        refuse_above = largest

    return at_most(
        name="kappas",
        value=kappa,
        bound=largest,
        unit="1/s",
        sentence=(
            f"law.paper_kappa_1_1_s and _2 are up to <value>; with {vehicle.name}'s lag of "
            f"{response.lag_s:.2f} s, which the paper's law does not predict, <relation> "
            "<bound> does not overshoot"
        ),
        remedy=(
            f"Lower them to {rounded_down(largest, 2):.2f}, or set law.name = 'covey', which "
            "predicts over the lag."
        ),
        refuse_above=refuse_above,
    )


def braking(fleet: FleetConfig, vehicle: Vehicle, margin_m: float) -> Finding:
    """Check that two vehicles that meet head-on can brake as hard as the rows require.

    Args:
        fleet: the fleet file.
        vehicle: one of the two equal vehicles.
        margin_m: margin in flight.
    """
    kappa_1, kappa_2 = kappa_values(fleet)
    design_distance_m = fleet.fleet.safety_distance_m + margin_m
    closing_speed_m_s = 2.0 * vehicle.max_speed_m_s
    required_m_s2 = bounds.braking_m_s2(closing_speed_m_s, design_distance_m, kappa_1, kappa_2)

    drag_m_s2 = vehicle.drag_1_s * vehicle.max_speed_m_s
    left_m_s2 = max(0.0, available_m_s2(vehicle) - drag_m_s2 - GUST_M_S2)

    return at_most(
        name="braking",
        value=required_m_s2,
        bound=left_m_s2,
        unit="m/s^2",
        sentence=(
            f"Two vehicles like {vehicle.name} that meet head-on with {closing_speed_m_s:.1f} m/s "
            "must brake with <value> each; tilt and thrust leave <bound> beside drag and gusts"
        ),
        remedy="Lower max_speed_m_s or the kappas, or raise max_tilt_deg.",
        warn_above=_BRAKING_WARNING_SHARE * left_m_s2,
    )


def too_few_neighbours(fleet: FleetConfig, vehicles: list[Vehicle]) -> Iterator[Finding]:
    """Yield a finding if the law considers too few neighbours in a crowd.

    Args:
        fleet: the fleet file.
        vehicles: all enabled vehicles.
    """
    count = len(vehicles)
    useful = min(count - 1, _USEFUL_NEIGHBOURS)
    if fleet.law.built_in != "covey" or fleet.law.max_neighbours >= useful:
        return

    yield at_least(
        name="neighbours",
        value=float(fleet.law.max_neighbours),
        bound=float(useful),
        unit="",
        sentence=f"law.max_neighbours is <value>; in a crowd of {count} the nearest <bound> matter",
        remedy=f"Set law.max_neighbours = {useful} or more.",
    )


def crowding(fleet: FleetConfig, vehicles: list[Vehicle]) -> Finding:
    """Check how full the geofence is.

    Args:
        fleet: the fleet file.
        vehicles: all enabled vehicles.
    """
    count = len(vehicles)

    # in the densest packing, a circle takes sqrt(3)/2 = sqrt(0.75) times its squared diameter
    west, east = fleet.fleet.geofence_m.x
    south, north = fleet.fleet.geofence_m.y
    area_m2 = (east - west) * (north - south)
    for area in flight_space_of(fleet).areas:
        if area.keeps_in:
            area_m2 = min(area_m2, areas.size_m2(area))
    parked_share = count * math.sqrt(0.75) * parking_distance_m(fleet) ** 2 / area_m2

    return at_most(
        name="crowding",
        value=100.0 * parked_share,
        bound=30.0,
        unit="%",
        sentence=(
            f"{count} vehicles at their parking distance take <value> of the geofence's area; "
            "to fly around each other they need <relation> <bound>"
        ),
        remedy="Widen fleet.geofence_m, or fly fewer vehicles.",
        refuse_above=60.0,
    )


def effective_margin_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the margin [m] that the law keeps above the safety distance in flight.

    It is the configured margin, or more if the policy ``law.margin`` says so.

    Args:
        fleet: the fleet file.
        accuracy: accuracy of the vehicles' estimates.
    """
    law = fleet.law
    if law.built_in == "paper":
        return law.paper_margin_m
    if law.built_in == "off":
        return 0.0

    configured_m = _configured_margin_m(fleet)
    if law.margin == "fixed":
        return configured_m

    # the law uses accuracy_time_s, because it does not know the errors' correlation times
    known = replace(
        accuracy,
        position_time_s=law.accuracy_time_s,
        velocity_time_s=law.accuracy_time_s,
        acceleration_std_m_s2=0.0,
    )
    kappa_1, kappa_2 = kappa_values(fleet)
    return max(configured_m, bounds.required_margin_m(known, kappa_1, kappa_2))


def least_margin_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the margin [m] below which vehicles have come too close in simulation.

    Args:
        fleet: the fleet file.
        accuracy: accuracy of the vehicles' estimates.
    """
    kappa_1, kappa_2 = kappa_values(fleet)
    return _MARGIN_SHARE * bounds.required_margin_m(accuracy, kappa_1, kappa_2)


def height_accuracy_m(accuracy: Accuracy) -> float:
    """Return the height [m] by which the law widens the vertical separation.

    Args:
        accuracy: accuracy of the vehicles' estimates.
    """
    return HEIGHT_SIGMAS * math.sqrt(2.0) * accuracy.position_std_m


def parking_m(fleet: FleetConfig, accuracy: Accuracy) -> float:
    """Return the distance between centres [m] at which vehicles with this accuracy can hover.

    Args:
        fleet: the fleet file.
        accuracy: accuracy of the vehicles' estimates.
    """
    configured_m = parking_distance_m(fleet)
    if fleet.law.built_in != "covey":
        return configured_m

    margin_m = max(effective_margin_m(fleet, accuracy), least_margin_m(fleet, accuracy))
    return configured_m + margin_m - _configured_margin_m(fleet)


def _configured_margin_m(fleet: FleetConfig) -> float:
    """Return the largest margin, which is that of the vehicle with the longest lag."""
    longest_lag_s = max((vehicle.lag_s for vehicle in fleet.vehicles.values()), default=0.0)
    return fleet.law.margin_m(longest_lag_s)


def kappa_values(fleet: FleetConfig) -> tuple[float, float]:
    """Return kappa_1 and kappa_2 of the law that flies [1/s].

    Args:
        fleet: the fleet file.
    """
    law = fleet.law
    if law.built_in == "paper":
        return law.paper_kappa_1_1_s, law.paper_kappa_2_1_s
    return law.kappa_1_1_s, law.kappa_2_1_s
