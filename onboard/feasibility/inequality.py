"""The inequality: a condition that makes two vehicles keep the safety distance. Pure.

The condition follows from the law's equations, without simulated flights. A row of the law that is
computed from the true motion keeps two vehicles at least the design distance apart. But what a
vehicle knows differs from the true motion in two ways. The margin between the safety distance and
the design distance must cover both:

* the errors of both vehicles' estimates, which the row filters;
* the motion of a neighbour that cannot be known yet. The neighbour's newest state is old, a tick
  passes before it is used, and the vehicle knows its own lag only with an error. In that time T,
  each of the two vehicles may change its acceleration by b, the largest braking that the rows
  require. So the distance may be wrong by half of 2 b T^2.

A vehicle must also receive the neighbour's states in time, and be able to brake. Other findings
check that (:mod:`onboard.feasibility.pair_checks`). docs/inequality.md derives the condition and
compares it with the map of the law.
"""

from __future__ import annotations

from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.estimation.accuracies import Accuracy
from onboard.feasibility import bounds
from onboard.feasibility.finding import Finding, Status, rounded_up
from onboard.types import TICK_S


def unknown_s(age_s: float) -> float:
    """Return the time T [s] in which a neighbour's motion cannot be known yet.

    Args:
        age_s: largest age of a neighbour's newest state.
    """
    return age_s + TICK_S + LAG_ERROR_S


def margin_for_unknown_m(braking_m_s2: float, age_s: float) -> float:
    """Return the margin b T^2 [m] for the motion that cannot be known yet.

    Args:
        braking_m_s2: largest braking that a row requires of each vehicle.
        age_s: largest age of a neighbour's newest state.
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
    """Return the finding about whether the inequality holds for two equal vehicles.

    The two approach each other at the law's top speed. The status is ok or a note, never a refusal,
    because the map of the law decides if the inequality does not hold.

    Args:
        fleet: the fleet file.
        vehicle: one of the two vehicles.
        accuracy: accuracy of their estimates.
        margin_m: margin between safety distance and design distance, in flight.
        age_s: largest age of a neighbour's newest state.
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
        remedy = f"A margin of {rounded_up(required_m, 2):.2f} m would promise it without flights."
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
