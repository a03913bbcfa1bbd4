"""The inequality: when two vehicles keep the safety distance, without a flight that shows it. Pure.

A row of the law keeps the distance r of two vehicles above the design distance, as long as it holds
for what is true (the paper's equation for h, with both gains). What a vehicle knows differs from
that in two ways, and the margin between the design distance and the safety distance has to cover
both of them:

* the errors of both estimates, as the row's own filter passes them on;
* what a neighbour flies before anybody can know of it. Its newest state is old, a tick passes
  until it is used, and the lag of the own reaction is known up to an error. In that time T each of
  the two may change its acceleration by the braking b that the rows ask for at most, so that the
  distance may be wrong by half of 2 b T^2.

It also has to see the other in time, and to be able to brake: these are findings of their own
(:mod:`onboard.feasibility.pair_checks`). docs/inequality.md derives it and holds it against the map
of the law.
"""

from __future__ import annotations

from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.estimation.accuracies import Accuracy
from onboard.feasibility import bounds
from onboard.feasibility.finding import Finding, Status
from onboard.types import TICK_S


def unknown_s(age_s: float) -> float:
    """Return the time in which a neighbour flies what nobody else can know yet.

    Args:
        age_s: that a neighbour's newest state reaches.
    Returns:
        time T [s].
    """
    return age_s + TICK_S + LAG_ERROR_S


def margin_for_unknown_m(braking_m_s2: float, age_s: float) -> float:
    """Return the margin that what is not known yet requires.

    Args:
        braking_m_s2: that a row asks of each vehicle at most.
        age_s: that a neighbour's newest state reaches.
    Returns:
        margin b T^2 [m].
    """
    return braking_m_s2 * unknown_s(age_s) ** 2


def inequality_finding(
    fleet: FleetConfig,
    vehicle: Vehicle,
    accuracy: Accuracy,
    *,
    margin_m: float,
    age_s: float,
) -> Finding:
    """Return whether the margin covers all that two such vehicles cannot know.

    It refuses nothing: where it promises nothing, the map of flights decides.

    Args:
        fleet: the fleet file.
        vehicle: one of it; two like it approach each other head-on with the top speed of the law.
        accuracy: of their estimates.
        margin_m: between safety distance and design distance, in flight.
        age_s: that a neighbour's newest state reaches.
    Returns:
        the finding, ok or a note.
    """
    kappa_1 = fleet.law.kappa_1_1_s
    kappa_2 = fleet.law.kappa_2_1_s
    distance_m = fleet.fleet.safety_distance_m + margin_m
    closing_speed_m_s = 2.0 * fleet.law.avoid_speed_frac * vehicle.max_speed_m_s

    for_errors_m = bounds.required_margin_m(accuracy, kappa_1, kappa_2)
    braking_m_s2 = bounds.braking_m_s2(closing_speed_m_s, distance_m, kappa_1, kappa_2)
    for_unknown_m = margin_for_unknown_m(braking_m_s2, age_s)
    required_m = for_errors_m + for_unknown_m

    parts = (
        f"{for_errors_m:.3f} m for the errors of estimates as accurate as '{accuracy.name}' and "
        f"{for_unknown_m:.3f} m for what {vehicle.name} and one like it may do in "
        f"{unknown_s(age_s):.2f} s that nobody knows yet (braking of {braking_m_s2:.1f} m/s^2)"
    )
    status: Status = "ok"
    remedy = ""
    sentence = f"The inequality holds: the margin of {margin_m:.3f} m covers {parts}."
    if margin_m < required_m:
        status = "note"
        remedy = f"A margin of {required_m:.2f} m would promise it without flights."
        sentence = (
            f"The inequality promises nothing, the map of the law decides: the margin is "
            f"{margin_m:.3f} m, and it takes {parts}. {remedy}"
        )
    return Finding(
        name="inequality",
        status=status,
        value=margin_m,
        bound=required_m,
        unit="m",
        relation="at least",
        sentence=sentence,
        remedy=remedy,
    )
