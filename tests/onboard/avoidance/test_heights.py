"""How much of a distance counts by the heights of a pair."""

import math
from typing import Any

import numpy as np
import pytest

from onboard.avoidance import heights
from onboard.avoidance.heights import Climb, share_of
from onboard.config.fleet import ConfigError, fleet_from_mapping
from onboard.rollout.closed_loop import Scenario, fleet_model, fly
from onboard.types import LawStatus
from onboard.vectors import ZERO_3, Vec3
from tests.onboard.avoidance.law_cases import (
    law_of,
    neighbour_of,
    random_case,
    random_neighbour,
    run,
)

APART_M = 1.2
LEAD_S = 0.15
LAW = law_of({"vertical_separation_m": APART_M})
HOVERING = {"intent_enu_m_s": ZERO_3}


def share(height_m, *, climb=0.0, intended_climb_m=0.0, std_m=0.0, **changes):
    """Return the share for a vehicle so far above a neighbour that hovers at 1 m."""
    own = Climb(
        height_m=1.0 + height_m,
        ahead_m=1.0 + height_m,
        velocity_m_s=climb,
        intended_climb_m=intended_climb_m,
        position_std_m=std_m,
    )
    neighbour = neighbour_of((0.3, 0.0, 1.0), **{**HOVERING, **changes})
    return share_of(own, neighbour, LEAD_S, LAW.spacing)


def test_a_pair_counts_in_full_up_to_the_vertical_separation_and_not_at_all_a_little_beyond():
    assert [share(sign * h) for sign in (1.0, -1.0) for h in (0.0, 0.7, APART_M)] == pytest.approx(
        [1.0] * 6
    )
    assert share(APART_M + heights.TRANSITION_M) == pytest.approx(0.0, abs=1e-9) == share(-9.0)
    between = [share(h) for h in np.linspace(APART_M, APART_M + heights.TRANSITION_M, 9)]
    assert between == sorted(between, reverse=True)
    assert max(-np.diff(between)) < 0.2


def test_without_a_vertical_separation_every_height_counts():
    own = Climb(
        height_m=9.0,
        ahead_m=9.0,
        velocity_m_s=0.0,
        intended_climb_m=0.0,
        position_std_m=0.0,
    )
    assert share_of(own, neighbour_of((0.3, 0.0, 1.0)), LEAD_S, law_of().spacing) == 1.0


@pytest.mark.parametrize("who", ["own descent", "its climb", "own intent", "its intent"])
def test_a_climb_or_descent_towards_the_other_counts_before_the_heights_are_near(who):
    changes: dict[str, dict[str, Any]] = {
        "own descent": {"climb": -1.5},
        "its climb": {"predicted_velocity_enu_m_s": Vec3(0.0, 0.0, 1.5)},
        "own intent": {"intended_climb_m": -2.0},
        "its intent": {"intent_enu_m_s": Vec3(0.0, 0.0, 1.0)},
    }
    assert share(1.6) == 0.0 < share(1.6, **changes[who])
    assert share(1.6, climb=1.5, intended_climb_m=2.0) == 0.0  # away from it


def test_an_intent_that_ends_far_enough_away_does_not_count():
    up = Vec3(0.0, 0.0, 0.3)  # 0.6 m to its goal
    assert share(2.1, intent_enu_m_s=up) == 0.0 < share(1.9, intent_enu_m_s=up)


def test_who_does_not_cooperate_claims_all_below_itself():
    gone = {"is_cooperative": False}
    assert share(-8.0, **gone) == 1.0
    assert share(8.0, **gone) == 0.0
    assert share(8.0, **gone, age_s=0.29) == 1.0  # and everything while it is silent
    assert share(2.0, **gone, velocity=Vec3(0.0, 0.0, 1.0)) == 1.0  # and what it climbs into


def test_both_accuracies_widen_the_vertical_separation():
    assert share(2.0) == 0.0 < share(2.0, std_m=0.2, position_std_m=0.2)
    assert share(APART_M + 0.2 + 1.3, std_m=0.2, position_std_m=0.2) == 0.0


@pytest.mark.parametrize(
    "field", ["position_enu_m", "predicted_position_enu_m", "predicted_velocity_enu_m_s"]
)
def test_unknown_heights_count_in_full(field):
    assert share(3.0, **{field: Vec3(0.3, 0.0, math.nan)}) == 1.0
    assert share(3.0, intent_enu_m_s=Vec3(math.nan, math.nan, math.nan)) == 1.0
    assert share(math.nan) == 1.0
    assert share(3.0, climb=math.nan) == 1.0
    assert share(3.0, intended_climb_m=math.nan) == 1.0


def test_vehicles_exactly_above_each_other_are_no_case_of_coinciding_ones():
    above = neighbour_of((0.0, 0.0, 3.0), **HOVERING)
    output = run((0.0, 0.0, 1.0), ZERO_3, (0.5, 0.0, 0.0), [above], LAW)
    assert output.status == LawStatus.INACTIVE
    assert output.crowd_count == 0.0
    assert (
        run((0.0, 0.0, 1.0), ZERO_3, (0.5, 0.0, 0.0), [above], law_of()).status
        != LawStatus.INACTIVE
    )


@pytest.mark.parametrize("seed", range(20))
def test_the_share_is_the_same_in_any_order_and_for_both(seed):
    position, velocity, accel, neighbours = random_case(seed)
    spread = [
        n._replace(position_enu_m=n.position_enu_m._replace(z=2.0 * n.position_enu_m.z))
        for n in neighbours
    ]
    there = run(position, velocity, accel, spread, LAW).commanded_acceleration_enu_m_s2
    back = run(position, velocity, accel, spread[::-1], LAW).commanded_acceleration_enu_m_s2
    assert there == pytest.approx(back, abs=1e-9)


def test_the_whole_share_gives_the_very_same_flight_as_cylinders():
    flights = [fly_swap(fleet_of(**keys)) for keys in ({}, {"vertical_separation_m": 50.0})]
    assert np.array_equal(flights[0].trace_enu_m, flights[1].trace_enu_m)


@pytest.mark.parametrize("gap_m", [2.0, APART_M + 0.25])
def test_vehicles_above_each_other_swap_their_heights_also_from_the_nearest_ones(gap_m):
    fleet = fleet_of(vertical_separation_m=APART_M)
    start = np.array([[[0.0, 0.0, 1.0], [0.02, 0.0, 1.0 + gap_m]]])
    flown = fly(
        Scenario(start, start[:, None, ::-1], np.zeros(1)),
        fleet_model(fleet, tuple(fleet.vehicles)),
        [3],
    )
    assert flown.is_success.all()
    assert flown.arrival_s.max() < 12.0
    gap = flown.trace_enu_m[:, 0, 0] - flown.trace_enu_m[:, 0, 1]
    assert ((np.hypot(gap[:, 0], gap[:, 1]) >= 0.8) | (abs(gap[:, 2]) >= APART_M)).all()
    assert flown.min_separation_m[0] >= 0.8


@pytest.mark.parametrize(("height_m", "goes_around"), [(1.0, True), (5.0, False)])
def test_nobody_flies_below_one_that_does_not_cooperate_and_above_it_everybody_may(
    height_m, goes_around
):
    fleet = fleet_of(vertical_separation_m=APART_M)
    start = np.array([[[-2.0, 0.1, height_m], [0.0, 0.0, 3.0]]])
    goal = np.array([[[[2.0, 0.1, height_m], [0.0, 0.0, 3.0]]]])
    model = fleet_model(fleet, tuple(fleet.vehicles))
    flown = fly(Scenario(start, goal, np.zeros(1), is_parked=(False, True)), model, [5])
    assert flown.is_success.all()
    nearest_m = np.hypot(*flown.trace_enu_m[:, 0, 0, :2].T).min()
    assert nearest_m >= 0.8 if goes_around else nearest_m < 0.3


@pytest.mark.parametrize("seed", range(10))
def test_any_message_gives_a_finite_thrust(seed):
    rng = np.random.default_rng(seed)
    others = [random_neighbour(rng, k, 1.5) for k in range(4)]
    nowhere = Vec3(0.2, 0.1, math.nan)
    others += [neighbour._replace(predicted_position_enu_m=nowhere) for neighbour in others[:2]]
    output = run((0.0, 0.0, 1.0), ZERO_3, (0.5, 0.0, 0.0), others, LAW)
    assert all(map(math.isfinite, output.commanded_acceleration_enu_m_s2))


def test_a_vertical_separation_within_the_downwash_is_refused():
    with pytest.raises(ConfigError, match="downwash"):
        fleet_of(vertical_separation_m=0.9)
    with pytest.raises(ConfigError, match="knows no heights"):
        fleet_of(vertical_separation_m=1.2, law="paper")


def fly_swap(fleet):
    start = np.array([[[-1.0, 0.0, 1.0], [1.0, 0.1, 1.3]]])
    return fly(
        Scenario(start, start[:, None, ::-1], np.zeros(1), 5.0),
        fleet_model(fleet, tuple(fleet.vehicles)),
        [1],
    )


def fleet_of(law="covey", **keys):
    vehicles = {
        name: {"system_id": k + 1, "start_enu_m": [2.0 * k, 0.0, 0.0],
        "agent": f"tcp/127.0.0.1:{20000 + k}",
               "autopilot": f"udpin://127.0.0.1:{30000 + k}"}
        for k, name in enumerate(("one", "two"))
    }  # fmt: skip
    wide = {axis: [-50.0, 50.0] for axis in "xyz"}
    section = {"name": "two", "geofence_m": wide, **keys}
    return fleet_from_mapping(
        {"schema": 1, "fleet": section, "law": {"name": law}, "vehicles": vehicles}, path="test"
    )
