"""The law's functions one by one, with numbers that can be checked by hand.

The oracle of test_law_oracle.py has the same formulas and compares whole outputs. Here each limit
stands once more, as a literal, and each function is looked at on both sides of it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from onboard.avoidance import constraints, half_planes, heights, interface, oist, pairs, prediction
from onboard.avoidance import params as p
from onboard.avoidance.constraints import Constraint
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.heights import Climb
from onboard.avoidance.interface import NOT_A_VEHICLE
from onboard.avoidance.pairs import NeighbourPair, Own, nearest_surfaces
from onboard.avoidance.params import Capsule
from onboard.avoidance.projection import INACTIVE, RELAXED, SATURATED, project, pulled
from onboard.avoidance.relaxation import least_slack
from onboard.constants import GRAVITY_M_S2
from onboard.types import Thrust
from onboard.vectors import ZERO_3, ZERO_XY, Vec2, Vec3
from tests.onboard.avoidance.law_cases import law_of, neighbour_of, state_of, thrust_of

_NAN = math.nan
_PARAMS = law_of()
_SPACING = _PARAMS.spacing
_APART = _SPACING._replace(vertical_separation_m=1.0)


def _own(**changes: Any) -> Own:
    """A vehicle at rest at the origin that wants nothing."""
    own = Own(
        velocity_std_m_s=0.0,
        position_m=ZERO_XY,
        velocity_m_s=ZERO_XY,
        intent_m_s=ZERO_XY,
        margin_2_m2=0.0,
        thrust_m_s2=ZERO_XY,
        thrust_z_m_s2=9.81,
        compensation_m_s2=ZERO_XY,
        radius_m_s2=4.0,
        climb=Climb(2.0, 2.0, 0.0, 0.0, 0.0),
        has_motion=True,
        is_usable=True,
    )
    return own._replace(**changes)


def _pair(**changes: Any) -> NeighbourPair:
    """A cooperative neighbour, two metres to the west, to which nobody moves."""
    pair = NeighbourPair(
        e=Vec2(2.0, 0.0),
        w=ZERO_XY,
        command_m_s2=ZERO_XY,
        intent_m_s=ZERO_XY,
        d_m=1.0,
        distance_2_m2=4.0,
        crowd_count=0.0,
        is_near=False,
        is_cooperative=True,
        table_index=3,
    )
    return pair._replace(**changes)


# -- the memory of the law -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("speed_m_s", "intent_m_s", "is_held"),
    [
        (0.0, 0.5, True),
        (0.0, 0.199, False),  # intends next to nothing
        (0.0, 0.201, True),
        (0.1, 0.5, False),  # gets on with a fifth of what it intends
        (0.099, 0.5, True),
        (-0.4, 0.5, True),
    ],
)
def test_a_vehicle_is_held_back_that_hardly_goes_where_it_intends_to(
    speed_m_s: float, intent_m_s: float, is_held: bool
) -> None:
    own = _own(velocity_m_s=Vec2(speed_m_s, 0.0), intent_m_s=Vec2(intent_m_s, 0.0))
    assert oist.is_held_back(own) is is_held


@pytest.mark.parametrize(
    ("held_s", "left_s", "is_held", "later_s"),
    [
        (1.0, 0.0, True, (1.1, 0.0)),
        (1.0, 0.0, False, (0.0, 0.0)),
        (2.89, 0.0, True, (2.99, 0.0)),
        (2.9, 0.0, True, (0.0, 5.0)),
        (0.0, 5.0, True, (0.0, 4.9)),
        (0.0, 0.05, False, (0.0, 0.0)),
    ],
)
def test_who_is_held_for_three_seconds_calls_for_a_roundabout_for_five(
    held_s: float, left_s: float, is_held: bool, later_s: tuple[float, float]
) -> None:
    memory = oist.initial()._replace(held_s=held_s, roundabout_left_s=left_s)
    assert oist.next_hold(memory, is_held, 0.1) == pytest.approx(later_s)


def test_the_share_of_relaxed_ticks_follows_within_a_third_of_a_second() -> None:
    assert oist.next_relaxed_share(0.0, RELAXED, 0.02) == pytest.approx(0.07)
    assert oist.next_relaxed_share(1.0, SATURATED, 0.02) == pytest.approx(0.93)
    assert oist.next_relaxed_share(0.5, INACTIVE, 0.04) == pytest.approx(0.5 * 0.93**2)


@pytest.mark.parametrize(
    ("jam", "relaxed", "share"),
    [("slow", 0.0, 1.0), ("slow", 0.4, 0.4), ("slow", 1.0, 0.1), ("ignore", 1.0, 1.0)],
)
def test_relaxed_rows_slow_the_pursuit(jam: str, relaxed: float, share: float) -> None:
    memory = oist.initial()._replace(relaxed_share=relaxed)
    assert oist.speed_share(memory, law_of(jam=jam)) == pytest.approx(share)


def test_the_memory_begins_without_a_bound() -> None:
    memory = oist.initial()
    assert memory[2:] == (0.0, 0.0, 0.0, 1.0, math.inf)
    assert memory.predicted == prediction.UNKNOWN_MOTION
    assert len(memory.commands) == prediction.SLOTS


def test_who_is_most_violated_is_named_and_rounding_is_not() -> None:
    def one(violation_m_s2: float, index: int) -> Constraint:
        return Constraint(constraints.NO_ROW, constraints.NO_ROW, False, violation_m_s2, index)

    assert oist.most_violating([]) == -1
    assert oist.most_violating([one(1e-10, 4), one(-3.0, 5)]) == -1
    assert oist.most_violating([one(1.1e-10, 4)]) == 4
    assert oist.most_violating([one(0.5, 4), one(0.7, 5), one(0.7, 6)]) == 5


@pytest.mark.parametrize(
    ("is_cooperative", "bound_m_s2", "flees"),
    [(False, -3.9, True), (False, -4.0, False), (True, -3.9, False)],
)
def test_only_from_who_does_not_cooperate_and_matters_any_speed_will_do(
    is_cooperative: bool, bound_m_s2: float, flees: bool
) -> None:
    rows = [HalfPlane(Vec2(1.0, 0.0), bound_m_s2)]
    assert oist.is_fleeing(_own(), [_pair(is_cooperative=is_cooperative)], rows) is flees


@pytest.mark.parametrize("speed_m_s", [0.05, 0.5])
def test_the_top_speed_limits_who_is_slow_as_well(speed_m_s: float) -> None:
    own = _own(velocity_m_s=Vec2(speed_m_s, 0.0))
    params = _PARAMS._replace(top_speed_m_s=1.0)
    limit = oist.speed_limit(own, [], [], params)
    limited = oist.nearest_thrust(own, Vec2(9.0, 0.0), [], [], limit, params)
    left_m_s = 1.0 - speed_m_s
    assert limited.point == pytest.approx((math.sqrt(2.0 * 6.0 * left_m_s), 0.0))


def test_who_stands_has_no_limit_of_speed_and_who_flees_a_higher_one() -> None:
    params = _PARAMS._replace(top_speed_m_s=1.0)
    stranger = _pair(is_cooperative=False)
    binding = HalfPlane(Vec2(1.0, 0.0), -3.9)
    assert oist.speed_limit(_own(), [], [], params) == constraints.NO_ROW

    own = _own(velocity_m_s=Vec2(0.5, 0.0))
    alone = oist.speed_limit(own, [], [], params)
    assert alone.bound_m_s2 == pytest.approx(-math.sqrt(2.0 * 6.0 * 0.5))
    fleeing = oist.speed_limit(own, [stranger], [binding], params)
    assert fleeing.bound_m_s2 == pytest.approx(-8.0 * 1.5)


def test_of_rows_that_contradict_each_other_the_margin_gives_way_before_the_limit() -> None:
    """The row of a pair demands 2 m/s^2 to the east, the limit allows 1 m/s^2 to the west."""
    pair = _pair()
    limit = HalfPlane(Vec2(-1.0, 0.0), 1.0)
    found = oist.nearest_thrust(
        _own(), ZERO_XY, [pair], [HalfPlane(Vec2(1.0, 0.0), 2.0)], limit, _PARAMS
    )
    assert found.status == RELAXED
    assert found.point.x == pytest.approx(-1.0 + 3.0 / 31.0)
    assert found.slack == pytest.approx(30.0 * 3.0 / 31.0)


def test_who_does_not_know_its_motion_flies_level() -> None:
    nowhere = prediction.Motion(Vec3(_NAN, _NAN, _NAN), ZERO_3)
    baseline = interface.Baseline(thrust_of((1.0, 2.0, 3.0)), ZERO_3, ZERO_3)
    own = interface.own_at(baseline, nowhere, state_of(ZERO_3, ZERO_3), _PARAMS)
    assert (own.thrust_m_s2, own.thrust_z_m_s2) == (ZERO_XY, GRAVITY_M_S2)


# -- rows ------------------------------------------------------------------------------------------


def test_the_bounds_of_the_paper_in_numbers() -> None:
    e, w = Vec2(2.0, 1.0), Vec2(-1.0, 0.5)
    # -|w|^2 - (k_1 + k_2) e.w - k_1 k_2 (|e|^2 - d^2) / 2
    bound = constraints.separating_bound(e, w, 1.0, 2.0, 3.0)
    assert bound == pytest.approx(-1.25 + 5.0 * 1.5 - 3.0 * 4.0)

    gains = _PARAMS.gains._replace(kappa_3_1_s=2.0, kappa_4_1_s=3.0)
    v = Vec2(0.5, 1.0)
    # -w x v - k_3 2 e.w - k_4 (e x v - d v_perp + k_3 (|e|^2 - d^2))
    left = constraints.h_2(e, w, v, 1.0, 0.4, 1.0, gains)
    assert left == pytest.approx(1.25 + 2.0 * 3.0 - 3.0 * (1.5 - 0.4 + 2.0 * 4.0))
    right = constraints.h_2(e, w, v, 1.0, 0.4, -1.0, gains)
    assert right == pytest.approx(-1.25 + 2.0 * 3.0 - 3.0 * (-1.5 - 0.4 + 2.0 * 4.0))


def test_rows_are_divided_by_the_distance_to_keep() -> None:
    assert constraints.radial(Vec2(3.0, 4.0), 6.0, 2.0) == (Vec2(1.5, 2.0), 3.0)
    assert constraints.orthoradial(Vec2(3.0, 4.0), 1.0, 6.0, 2.0) == (Vec2(-2.0, 1.5), 3.0)
    assert constraints.orthoradial(Vec2(3.0, 4.0), -1.0, 6.0, 2.0) == (Vec2(2.0, -1.5), 3.0)


@pytest.mark.parametrize(
    ("responsibility", "is_cooperative", "pull_m_s2", "share", "whole_pull"),
    [
        ("full", True, 1.0, 1.0, 1.0),
        ("half", True, 1.0, 0.5, 0.0),
        ("half", False, 1.0, 1.0, 1.0),
        ("shortfall", False, 1.0, 1.0, 1.0),
    ],
)
def test_how_much_of_a_distance_a_vehicle_takes_on_itself(
    responsibility: str, is_cooperative: bool, pull_m_s2: float, share: float, whole_pull: float
) -> None:
    law = law_of(responsibility=responsibility)
    pair = _pair(is_cooperative=is_cooperative, command_m_s2=Vec2(pull_m_s2, 0.0))
    k_1, k_2 = law.gains.kappa_1_1_s, law.gains.kappa_2_1_s
    needed = -1.5 * k_1 * k_2
    row = constraints.distance_row(pair, 1.0, law)
    assert row.bound_m_s2 == pytest.approx(share * needed + 2.0 * pull_m_s2 * whole_pull)


@pytest.mark.parametrize("pull_m_s2", [-50.0, 50.0])
def test_what_the_other_one_does_not_deliver_is_taken_over_in_part(pull_m_s2: float) -> None:
    law = law_of(responsibility="shortfall")
    needed = -1.5 * law.gains.kappa_1_1_s * law.gains.kappa_2_1_s
    row = constraints.distance_row(_pair(command_m_s2=Vec2(pull_m_s2, 0.0)), 1.0, law)
    missing = max(0.0, 0.5 * needed + 2.0 * pull_m_s2)
    assert row.bound_m_s2 == pytest.approx(0.5 * needed + law.gains.shortfall_gain * missing)


def test_the_promise_is_no_more_than_the_distance_to_keep() -> None:
    near = _pair(d_m=0.5)
    assert constraints.promised_row(near, _PARAMS) == constraints.distance_row(near, 0.5, _PARAMS)
    far = _pair(d_m=3.0)
    assert constraints.promised_row(far, _PARAMS) == constraints.distance_row(far, 0.8, _PARAMS)


@pytest.mark.parametrize(
    ("e", "intent", "share"),
    [
        ((2.0, 0.0), (-1.0, 0.0), 1.0),
        ((2.0, 0.0), (1.0, 0.0), 0.0),  # they part
        ((2.0, 0.0), (0.0, 1.0), 0.0),
        ((2.0, 0.0), (0.025, 0.0), 0.0),
        ((2.0, 0.0), (-1e-7, 0.0), 0.0),
        ((2.0, 0.0), (-0.06, 0.0), 0.2),
        ((2.0, 0.0), (-0.15, 0.0), 0.5),
        ((2.0, 0.7), (-1.0, 0.0), 1.0),  # the ways pass at 0.7 d: in full up to there
        ((2.0, 0.8), (-1.0, 0.0), 0.5),
        ((2.0, -0.8), (-1.0, 0.0), 0.5),
        ((2.0, 0.9), (-1.0, 0.0), 0.0),
    ],
)
def test_how_far_two_ways_come_too_near(
    e: tuple[float, float], intent: tuple[float, float], share: float
) -> None:
    found = constraints.conflict(Vec2(*e), Vec2(*intent), 1.0)
    assert found == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize(
    ("direction", "is_crowded", "intent", "sign"),
    [
        (p.DIRECTION_FIXED, False, (0.0, -9.0), 1.0),
        (p.DIRECTION_PAIR, False, (0.0, -9.0), -1.0),
        (p.DIRECTION_PAIR, True, (0.0, -9.0), -1.0),
        (p.DIRECTION_CROWD, True, (0.0, -9.0), 1.0),
        (p.DIRECTION_CROWD, False, (0.0, -9.0), -1.0),
        (p.DIRECTION_INTENT, True, (0.0, -9.0), 1.0),
        (p.DIRECTION_INTENT, False, (0.0, 9.0), 1.0),
        (p.DIRECTION_INTENT, False, (-1.0, -0.12), 1.0),  # hardly clockwise: undecided
        (p.DIRECTION_INTENT, False, (-1.0, -0.13), -1.0),
        (p.DIRECTION_INTENT, False, (0.0, -0.0124), 1.0),  # slow: as with 0.1 m/s
        (p.DIRECTION_INTENT, False, (0.0, -0.0126), -1.0),
    ],
)
def test_the_side_of_a_turn(
    direction: int, is_crowded: bool, intent: tuple[float, float], sign: float
) -> None:
    found = constraints.turn_sign(Vec2(2.0, 0.0), Vec2(*intent), 1.0, is_crowded, direction)
    assert found == sign


@pytest.mark.parametrize(
    ("rotation", "violation_m_s2", "intent", "strength"),
    [
        ("always", -9.0, 0.0, 1.0),
        ("never", 9.0, -1.0, 0.0),
        ("violated", -9.0, -1.0, 0.0),
        ("violated", 1e-10, -1.0, 0.0),
        ("violated", 0.25, 0.0, 0.5),
        ("violated", 9.0, 0.0, 1.0),
        ("ahead", -9.0, -1.0, 1.0),
        ("ahead", 0.25, -0.03, 0.5),
        ("ahead", 0.25, -0.24, 0.8),
    ],
)
def test_how_much_of_a_turn_counts(
    rotation: str, violation_m_s2: float, intent: float, strength: float
) -> None:
    law = law_of(rotation=rotation)
    law = law._replace(gains=law.gains._replace(rotation_fade_m_s2=0.5))
    pair = _pair(intent_m_s=Vec2(intent, 0.0))
    found = constraints.turning_strength(violation_m_s2, pair, law)
    assert found == pytest.approx(strength)


@pytest.mark.parametrize(
    ("responsibility", "direction", "is_cooperative", "is_crowded", "share", "v_perp"),
    [
        ("shortfall", "intent", True, False, 0.5, 0.8),
        ("shortfall", "intent", True, True, 0.5, 1.4),  # in a crowd, faster
        ("shortfall", "crowd", True, True, 0.5, 1.4),
        ("shortfall", "pair", True, True, 0.5, 0.8),
        ("shortfall", "intent", False, False, 1.0, 0.4),
        ("shortfall", "intent", False, True, 1.0, 0.7),
    ],
)
def test_the_row_that_turns_a_pair_in_numbers(
    responsibility: str,
    direction: str,
    is_cooperative: bool,
    is_crowded: bool,
    share: float,
    v_perp: float,
) -> None:
    law = law_of(responsibility=responsibility, direction=direction)
    gains = law.gains._replace(v_perp_m_s=0.4, v_perp_crowd_m_s=0.7)
    pair = _pair(w=Vec2(0.1, 0.2), is_cooperative=is_cooperative)
    row = constraints.rotation_row(pair, ZERO_XY, is_crowded, law._replace(gains=gains))
    bound = constraints.h_2(pair.e, pair.w, pair.w, 1.0, v_perp, 1.0, gains)
    assert row.normal == pytest.approx((0.0, 2.0))
    assert row.bound_m_s2 == pytest.approx(share * bound)


def test_a_pair_turns_from_the_least_conflict_on_and_faster_in_a_crowd() -> None:
    law = law_of(rotation="ahead", direction="intent")
    crowd = float(law.gains.crowd_count)
    pair = _pair(intent_m_s=Vec2(-0.015, 0.0))  # a conflict of 0.05
    found = constraints.neighbour_constraint(_own(), pair, 0.0, law)
    assert found.is_turning
    still = constraints.neighbour_constraint(_own(), _pair(), 0.0, law)
    assert not still.is_turning

    in_crowd = constraints.neighbour_constraint(_own(), pair, crowd, law)
    among_others = constraints.neighbour_constraint(_own(), pair, crowd - 1.0, law)
    theirs = pair._replace(crowd_count=crowd)
    assert in_crowd.turn.bound_m_s2 > found.turn.bound_m_s2
    assert among_others.turn == found.turn
    assert constraints.neighbour_constraint(_own(), theirs, 0.0, law).turn == in_crowd.turn


@pytest.mark.parametrize(
    ("rotation", "is_towards_it", "is_turning"),
    [
        ("never", True, False),
        ("violated", True, True),
        ("violated", False, False),
        ("always", True, True),
        ("always", False, True),
    ],
)
def test_an_obstacle_is_turned_about_while_its_row_is_violated(
    rotation: str, is_towards_it: bool, is_turning: bool
) -> None:
    surface = pairs.Surface(e=Vec2(1.0, 0.0), w=ZERO_XY, d_m=0.9, gap_m=0.6)
    thrust = Vec2(-3.9 if is_towards_it else 3.9, 0.0)
    law = law_of(rotation=rotation)
    found = constraints.obstacle_constraint(_own(thrust_m_s2=thrust), surface, law)
    assert found.is_turning is is_turning
    assert (found.violation_m_s2 > 0.0) is is_towards_it
    assert found.table_index == NOT_A_VEHICLE


def test_the_row_of_the_speed_and_what_can_bind() -> None:
    row = constraints.speed_row(Vec2(3.0, 4.0), 6.0, jerk_m_s3=100.0)
    assert row.normal == pytest.approx((-0.6, -0.8))
    assert row.bound_m_s2 == pytest.approx(-8.0)

    two_long = Vec2(2.0, 0.0)
    assert constraints.can_bind(HalfPlane(two_long, -5.9), 3.0)
    assert not constraints.can_bind(HalfPlane(two_long, -6.0), 3.0)
    assert constraints.faded(HalfPlane(two_long, 4.0), Vec2(1.0, 0.0), 0.25) == (two_long, 2.5)


# -- pairs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("std", "known"), [(0.3, 0.3), (-0.3, 0.3), (5e3, 1e3), (math.inf, 0.0), (_NAN, 0.0)]
)
def test_a_standard_deviation_is_bounded(std: float, known: float) -> None:
    assert prediction.known_std(std) == known


def test_the_distance_to_keep_in_numbers() -> None:
    spacing = _SPACING._replace(
        safety_distance_m=0.8,
        margin_m=0.1,
        margin_floor_m=0.05,
        uncooperative_margin_m=0.3,
        sigma_position=4.0,
        sigma_velocity_s=2.0,
    )
    assert pairs.margin_2(0.1, 0.2, spacing) == pytest.approx(0.4**2 + 0.4**2)

    exact = neighbour_of((0.0, 0.0, 0.0))
    assert pairs.design_distance(0.0, exact, spacing) == pytest.approx(0.9)
    rough = exact._replace(position_std_m=0.1)
    assert pairs.design_distance(0.09, rough, spacing) == pytest.approx(0.85 + 0.5)
    unknown = exact._replace(position_std_m=900.0)
    assert pairs.design_distance(0.0, unknown, spacing) == pytest.approx(5.8)
    alone = rough._replace(is_cooperative=False)
    assert pairs.design_distance(0.09, alone, spacing) == pytest.approx(0.85 + 0.5 + 0.3)
    fixed = spacing._replace(sigma_position=0.0)
    assert pairs.design_distance(0.09, rough, fixed) == pytest.approx(0.9)


def test_what_coincides_is_separated_along_the_relative_velocity() -> None:
    assert pairs.separated(Vec2(1e-6, 0.0), Vec2(0.0, 9.0)) == (1e-6, 0.0)
    assert pairs.separated(ZERO_XY, Vec2(0.0, 9.0)) == pytest.approx((0.0, 1e-6))
    assert pairs.separated(ZERO_XY, Vec2(-2e-6, 0.0)) == pytest.approx((-1e-6, 0.0))
    assert pairs.separated(ZERO_XY, Vec2(0.0, 1e-6)) == (1e-6, 0.0)


def test_the_nearest_come_first_and_equal_ones_as_they_come() -> None:
    assert pairs.ascending([]) == []
    assert pairs.ascending([3.0, 1.0, 2.0, 1.0, 0.5]) == [4, 1, 3, 2, 0]


@pytest.mark.parametrize(
    ("position", "e", "w"),
    [
        ((1.0, 2.0), (0.0, 2.0), (0.0, 0.5)),  # beside the edge only the speed towards it counts
        ((5.0, 2.0), (1.0, 2.0), (0.7, 0.5)),
        ((-1.0, 2.0), (-1.0, 2.0), (0.7, 0.5)),
        ((4.0, 2.0), (0.0, 2.0), (0.7, 0.5)),
        ((0.0, 2.0), (0.0, 2.0), (0.7, 0.5)),
    ],
)
def test_the_nearest_point_of_an_edge(
    position: tuple[float, float], e: tuple[float, float], w: tuple[float, float]
) -> None:
    edge = Capsule(Vec2(0.0, 0.0), Vec2(4.0, 0.0), 0.3)
    surface = pairs.surface_of(edge, Vec2(*position), Vec2(0.7, 0.5), 0.2)
    assert surface.e == pytest.approx(e)
    assert surface.w == pytest.approx(w)
    assert surface.d_m == pytest.approx(0.5)
    assert surface.gap_m == pytest.approx(math.hypot(*e) - 0.3)


@pytest.mark.parametrize(
    ("away_m", "is_seen"), [(_SPACING.range_m, True), (_SPACING.range_m + 1e-6, False)]
)
def test_neighbours_count_within_range(away_m: float, is_seen: bool) -> None:
    found = pairs.nearest_pairs(_own(), [neighbour_of((away_m, 0.0, 2.0))], _PARAMS)
    assert (len(found.pairs) == 1) is is_seen


@pytest.mark.parametrize(
    ("theirs_m_s", "is_cooperative", "distances", "count"),
    [
        (0.5, True, 1.9, 1.0),
        (0.5, True, 2.1, 0.0),
        (0.09, True, 1.9, 0.0),  # settled
        (0.11, True, 1.9, 1.0),
        (0.0, False, 1.9, 1.0),
    ],
)
def test_who_is_near_and_goes_somewhere_makes_a_crowd(
    theirs_m_s: float, is_cooperative: bool, distances: float, count: float
) -> None:
    other = neighbour_of(
        (0.0, 0.0, 2.0),
        intent_enu_m_s=Vec3(0.0, theirs_m_s, 0.0),
        is_cooperative=is_cooperative,
        crowd_count=_NAN,
    )
    d_m = pairs.design_distance(0.0, other, _SPACING)
    away = Vec3(distances * d_m, 0.0, 2.0)
    other = other._replace(position_enu_m=away, predicted_position_enu_m=away)
    law = law_of(direction="intent")
    found = pairs.nearest_pairs(_own(), [other], law)
    assert found.crowd_count == count
    assert found.is_sound
    assert found.pairs[0].crowd_count == 0.0


def test_who_coincides_or_has_no_motion_is_not_sound() -> None:
    def is_sound(x: float) -> bool:
        return pairs.nearest_pairs(_own(), [neighbour_of((x, 0.0, 2.0))], _PARAMS).is_sound

    assert not is_sound(0.9e-6)
    assert is_sound(1.1e-6)
    assert not is_sound(_NAN)


# -- heights ---------------------------------------------------------------------------------------


def _share(own: Climb, other: dict[str, Any] | None = None, height_m: float = 0.0) -> float:
    neighbour = neighbour_of((0.0, 0.0, height_m))._replace(intent_enu_m_s=Vec3(0.0, 0.0, 0.0))
    return heights.share_of(own, neighbour._replace(**(other or {})), 0.2, _APART)


@pytest.mark.parametrize(
    ("gap_m", "share"), [(1.2, 0.0), (1.1, 0.5), (1.0, 1.0), (0.5, 1.0), (-1.1, 0.5), (-1.2, 0.0)]
)
def test_where_nobody_moves_the_distance_grows_over_two_decimetres(
    gap_m: float, share: float
) -> None:
    assert _share(Climb(gap_m, gap_m, 0.0, 0.0, 0.0)) == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize(
    ("own", "other", "share"),
    [
        (Climb(2.0, 2.0, -1.0, 0.0, 0.0), {}, 0.0),
        (Climb(1.5, 1.5, -1.0, 0.0, 0.0), {}, 0.25),  # 0.1 of 0.2 + 0.2
        (Climb(-1.5, -1.5, 1.0, 0.0, 0.0), {}, 0.25),  # the same from below
        (Climb(1.2, 1.2, 0.0, 0.0, _NAN), {"position_std_m": math.inf}, 0.0),
        (Climb(2.0, 2.0, 0.0, -1.0, 0.0), {}, 2.0 / 7.0),  # 0.2 of 0.2 + 0.5
        (Climb(2.0, 2.0, 0.0, 1.0, 0.0), {}, 0.0),
        (Climb(1.3, 1.3, 0.0, 0.0, 0.03), {"position_std_m": 0.04}, 0.625),  # 4.5 * 0.05
        (Climb(5.0, 5.0, _NAN, 0.0, 0.0), {}, 1.0),
        (Climb(5.0, 5.0, 0.0, 0.0, 0.0), {"age_s": 0.26}, 1.0),
        (Climb(5.0, 5.0, 0.0, 0.0, 0.0), {"age_s": 0.25}, 0.0),
        (Climb(5.0, 5.0, 0.0, 0.0, 0.0), {"is_cooperative": False}, 0.0),
        (Climb(-5.0, -5.0, 0.0, 0.0, 0.0), {"is_cooperative": False}, 1.0),
        (Climb(-5.0, -5.0, 0.0, 0.0, 0.0), {}, 0.0),
    ],
)
def test_what_two_are_about_to_close_and_do_not_know_counts_as_near(
    own: Climb, other: dict[str, Any], share: float
) -> None:
    assert _share(own, other) == pytest.approx(share, abs=1e-9)


@pytest.mark.parametrize(
    ("gap_m", "climbs_m", "is_ahead"),
    [
        (1.0, -0.21, True),
        (0.99, -0.21, False),
        (1.0, -0.19, False),
        (-1.0, 0.21, True),
        (-1.0, -0.21, False),
        (1.0, 0.21, False),
    ],
)
def test_a_climb_waits_for_those_whom_it_will_meet(
    gap_m: float, climbs_m: float, is_ahead: bool
) -> None:
    own = Climb(gap_m, gap_m, 0.0, climbs_m, 0.0)
    assert heights.is_ahead(own, neighbour_of((0.0, 0.0, 0.0)), 0.2, _APART) is is_ahead


@pytest.mark.parametrize(
    ("gap_m", "other_m_s", "limit_m_s"),
    [
        (-0.01, 0.0, math.inf),
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        (3.0, 0.0, 2.0),
        (3.0, -0.5, 2.5),
        (3.0, 0.5, 2.0),
        (_NAN, 0.0, math.inf),
    ],
)
def test_above_another_it_sinks_as_fast_as_it_can_stop(
    gap_m: float, other_m_s: float, limit_m_s: float
) -> None:
    other = neighbour_of((0.0, 0.0, 0.0), (0.0, 0.0, other_m_s), lead_time_s=0.2)
    own = Climb(gap_m, gap_m, 0.0, 0.0, 0.0)
    assert heights.sink_limit_m_s(own, other, 0.2, _APART) == pytest.approx(limit_m_s)


@pytest.mark.parametrize(("away", "share"), [(0.4, 0.0), (0.5, 0.0), (0.7, 0.5), (0.9, 1.0)])
def test_a_climb_goes_on_as_those_whom_it_meets_are_aside(away: float, share: float) -> None:
    law = _PARAMS._replace(spacing=_APART)
    other = neighbour_of((0.0, 0.0, 4.0), intent_enu_m_s=Vec3(0.0, 0.0, 0.0))
    own = _own(climb=Climb(2.0, 2.0, 0.0, 6.0, 0.0))
    part = heights.share_of(own.climb, other, law.lead_time_s, _APART)
    d_m = part * pairs.design_distance(0.0, other, _APART)
    beside = Vec3(away * d_m, 0.0, 4.0)
    other = other._replace(position_enu_m=beside, predicted_position_enu_m=beside)
    assert pairs.climb_share(own, [other], law) == pytest.approx(share, abs=1e-9)
    assert pairs.climb_share(own, [other], _PARAMS) == 1.0
    still = own._replace(climb=Climb(2.0, 2.0, 0.0, 0.0, 0.0))
    assert pairs.climb_share(still, [other], law) == 1.0


@pytest.mark.parametrize(
    ("away", "limit_m_s"), [(0.5, 2.0), (0.7, 2.0), (0.85, 2.5), (0.999, 2.9967), (1.0, math.inf)]
)
def test_beside_another_it_sinks_freely(away: float, limit_m_s: float) -> None:
    law = _PARAMS._replace(spacing=_APART)
    other = neighbour_of((0.0, 0.0, 0.0))
    beside_m = away * pairs.design_distance(0.0, other, _APART)
    other = neighbour_of((beside_m, 0.0, 0.0), lead_time_s=law.lead_time_s)
    own = _own(climb=Climb(3.0, 3.0, 0.0, 0.0, 0.0))
    assert pairs.sink_limit(own, [other], law) == pytest.approx(limit_m_s, abs=1e-3)
    assert pairs.sink_limit(own, [other], _PARAMS) == math.inf


# -- messages --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("age_s", "is_cooperative", "counts_s"),
    [
        (0.0, True, 0.0),
        (0.79, True, 0.79),
        (0.81, True, 0.8),
        (0.29, False, 0.29),
        (0.31, False, 0.3),
        (-0.1, True, 0.0),
        (-math.inf, True, 0.8),
        (_NAN, False, 0.3),
    ],
)
def test_the_age_of_a_message(age_s: float, is_cooperative: bool, counts_s: float) -> None:
    other = neighbour_of((0.0, 0.0, 0.0), age_s=age_s, is_cooperative=is_cooperative)
    assert prediction.message_age(other) == counts_s


@pytest.mark.parametrize(
    ("lead_s", "known_s"), [(0.4, 0.4), (-0.1, 0.0), (1.5, 1.0), (_NAN, 0.15), (math.inf, 0.15)]
)
def test_the_lead_time_of_a_neighbour(lead_s: float, known_s: float) -> None:
    assert prediction.lead_time(lead_s, 0.15) == known_s


def test_a_neighbour_is_carried_on_with_its_command_for_eight_hundredths_of_a_second() -> None:
    other = neighbour_of(
        (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), age_s=0.35, lead_time_s=0.15
    )
    found = prediction.receive(other, 0.15)
    assert found.velocity_m_s == pytest.approx((1.16, 0.0))
    assert found.position_m == pytest.approx((0.35 + 0.08 * (0.35 - 0.04) * 2.0, 0.0))


def test_a_neighbours_command_counts_for_the_own_longer_lag_too() -> None:
    other = neighbour_of(
        (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), age_s=0.35, lead_time_s=0.15
    )
    assert prediction.receive(other, 0.27).velocity_m_s == pytest.approx((1.4, 0.0))


def test_an_acceleration_of_one_that_does_not_cooperate_counts_for_a_quarter_of_a_second() -> None:
    other = neighbour_of(
        (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), acceleration_enu_m_s2=Vec3(2.0, 0.0, 0.0), age_s=0.3
    )._replace(is_cooperative=False)
    assert prediction.receive(other, 0.15).velocity_m_s == pytest.approx((1.5, 0.0))


def test_a_neighbour_is_carried_on_with_its_command_from_the_first_moment_on() -> None:
    other = neighbour_of(
        (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), age_s=0.05, lead_time_s=0.15
    )
    assert prediction.receive(other, 0.15).velocity_m_s == pytest.approx((1.1, 0.0))


def test_a_neighbour_that_leads_by_more_is_taken_back_along_its_way() -> None:
    other = neighbour_of(
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        predicted_velocity_enu_m_s=Vec3(3.0, 0.0, 0.0),
        lead_time_s=0.4,
    )
    found = prediction.receive(other, 0.2)
    # from 1 to 3 m/s in 0.4 s: half of that is taken back
    assert found.velocity_m_s == pytest.approx((2.0, 0.0))
    assert found.position_m == pytest.approx((-0.2 * 2.5, 0.0))


def test_who_does_not_cooperate_is_carried_on_with_at_most_one_g() -> None:
    other = neighbour_of((0.0, 0.0, 0.0), is_cooperative=False)
    other = other._replace(acceleration_enu_m_s2=Vec3(50.0, 0.0, 0.0))
    found = prediction.receive(other, 0.1)
    assert found.velocity_m_s == pytest.approx((0.980665, 0.0))
    assert found.intent_m_s == found.velocity_m_s
    assert found.has_intent
    assert found.command_m_s2 == (0.0, 0.0)


# -- half-planes -----------------------------------------------------------------------------------


def test_half_planes_in_numbers() -> None:
    row = HalfPlane(Vec2(3.0, 4.0), 10.0)
    assert half_planes.unit_row(row) == (Vec2(0.6, 0.8), 2.0)
    assert half_planes.largest_violation(Vec2(1.0, 1.0), [row]) == 3.0
    assert half_planes.foot(ZERO_XY, half_planes.unit_row(row)) == pytest.approx((1.2, 1.6))
    assert half_planes.foot(Vec2(9.0, 9.0), half_planes.unit_row(row)) == (9.0, 9.0)

    unit = HalfPlane(Vec2(1.0, 0.0), 3.0)
    assert half_planes.on_circle(unit, 5.0, 1.0) == pytest.approx((3.0, 4.0))
    assert half_planes.on_circle(unit, 5.0, -1.0) == pytest.approx((3.0, -4.0))
    assert half_planes.on_circle(unit, 2.0, 1.0) == (3.0, 0.0)

    other = HalfPlane(Vec2(0.0, 2.0), 8.0)
    assert half_planes.corner(unit, other) == pytest.approx((3.0, 4.0))
    parallel = half_planes.corner(unit, HalfPlane(Vec2(2.0, 0.0), 1.0))
    assert math.isnan(parallel.x)
    assert half_planes.difference(unit, other) == (Vec2(1.0, -2.0), -5.0)


def test_points_in_and_out_of_the_disc() -> None:
    assert half_planes.in_disc(Vec2(2.0, 0.0), 2.0)
    assert not half_planes.in_disc(Vec2(2.0 + 1e-10, 0.0), 2.0)
    assert half_planes.into_disc(Vec2(3.0, 4.0), 5.0) == (3.0, 4.0)
    assert half_planes.into_disc(Vec2(6.0, 8.0), 5.0) == pytest.approx((3.0, 4.0))
    assert half_planes.into_disc(Vec2(6.0, 8.0), 0.0) == (0.0, 0.0)


# -- the projection --------------------------------------------------------------------------------

_EAST = HalfPlane(Vec2(1.0, 0.0), 1.0)  # x >= 1
_WEST = HalfPlane(Vec2(-1.0, 0.0), 1.0)  # x <= -1
_NORTH = HalfPlane(Vec2(0.0, 1.0), 1.0)  # y >= 1


@pytest.mark.parametrize(
    ("soft", "point"),
    [
        ([], (0.0, 0.0)),
        ([_EAST], (0.75, 0.0)),
        ([_EAST, _NORTH], (0.75, 0.75)),
        ([_EAST, _WEST], (0.0, 0.0)),
        ([_EAST, _EAST], (6.0 / 7.0, 0.0)),
        ([HalfPlane(Vec2(2.0, 0.0), 2.0)], (0.75, 0.0)),
    ],
)
def test_soft_rows_pull_like_springs(soft: list[HalfPlane], point: tuple[float, float]) -> None:
    assert pulled(ZERO_XY, soft, 3.0) == pytest.approx(point)


def test_a_soft_row_that_holds_does_not_pull_and_one_that_is_pulled_past_stops() -> None:
    inside = Vec2(1.5, 0.25)
    assert pulled(inside, [_EAST], 3.0) == inside

    # Alone, the far row would move the point past the near one, which then does not pull.
    far = HalfPlane(Vec2(1.0, 0.0), 4.0)
    assert pulled(ZERO_XY, [_EAST, far], 3.0) == pytest.approx((3.0, 0.0))


def test_the_disc_binds_from_its_radius_on() -> None:
    assert project(Vec2(2.0, 0.0), [], 2.0).status == INACTIVE
    clipped = project(Vec2(2.05, 0.0), [], 2.0)
    assert clipped.point == pytest.approx((2.0, 0.0))
    assert (clipped.status, clipped.slack) == (SATURATED, 0.0)


def test_the_nearest_point_lies_on_an_edge_or_where_it_meets_the_circle() -> None:
    assert project(Vec2(0.8, 0.0), [_EAST], 4.0).point == pytest.approx((1.0, 0.0))
    high_m = math.sqrt(3.0)
    assert project(Vec2(0.0, 5.0), [_EAST], 2.0).point == pytest.approx((1.0, high_m))
    assert project(Vec2(0.0, -5.0), [_EAST], 2.0).point == pytest.approx((1.0, -high_m))


def test_the_smallest_slack_is_none_where_the_rows_agree() -> None:
    assert least_slack([_EAST, _NORTH], 4.0)[0] == 0.0
    nearly = HalfPlane(Vec2(-1.0, 0.0), -0.9)  # x <= 0.9
    assert least_slack([_EAST, nearly], 4.0)[0] == pytest.approx(0.05)


def test_the_smallest_slack_lies_where_it_can_be_seen_by_symmetry() -> None:
    opposed = HalfPlane(Vec2(-1.0, 0.0), 1.0)
    assert least_slack([_EAST, opposed], 4.0) == (1.0, ZERO_XY)

    far_east = HalfPlane(Vec2(1.0, 0.0), 3.0)
    far_north = HalfPlane(Vec2(0.0, 1.0), 3.0)
    slack, point = least_slack([far_east], 2.0)
    assert (slack, point) == (1.0, (2.0, 0.0))
    for sign in (1.0, -1.0):  # both are missed by as much on the circle
        rows = [HalfPlane(Vec2(sign * n.x, sign * n.y), b) for n, b in (far_east, far_north)]
        for ordered in (rows, rows[::-1]):
            slack, point = least_slack(ordered, 2.0)
            assert slack == pytest.approx(3.0 - math.sqrt(2.0))
            assert point == pytest.approx((sign * math.sqrt(2.0), sign * math.sqrt(2.0)))

    # three rows that are missed by 1 in their middle
    middle = Vec2(0.5, 0.3)
    normals = [Vec2(math.cos(angle), math.sin(angle)) for angle in (0.1, 2.2, 4.2)]
    rows = [HalfPlane(n, 1.0 + n.x * middle.x + n.y * middle.y) for n in normals]
    slack, point = least_slack(rows, 4.0)
    assert slack == pytest.approx(1.0)
    assert point == pytest.approx(middle)


def test_a_small_share_of_a_distance_counts_and_none_does_not() -> None:
    law = _PARAMS._replace(spacing=_APART)
    other = neighbour_of((0.3, 0.0, 0.0), intent_enu_m_s=Vec3(0.0, 0.0, 0.0))
    for height_m, count in ((1.19, 1), (1.21, 0)):
        own = _own(climb=Climb(height_m, height_m, 0.0, 0.0, 0.0))
        assert len(pairs.nearest_pairs(own, [other], law).pairs) == count

    # below it, and about to climb: far enough, and hardly
    far = _own(climb=Climb(-3.0, -3.0, 0.0, 0.3, 0.0))
    assert pairs.climb_share(far, [other], law) == 1.0
    above = neighbour_of((0.0, 0.0, 0.0), intent_enu_m_s=Vec3(0.0, 0.0, 0.0))
    near = _own(climb=Climb(-1.49, -1.49, 0.0, 0.3, 0.0))
    assert 0.0 < heights.share_of(near.climb, above, law.lead_time_s, _APART) < 0.1
    assert pairs.climb_share(near, [above], law) == 0.0

    rough = above._replace(position_std_m=5.0)
    spacing = _SPACING._replace(
        safety_distance_m=0.8, margin_m=0.1, margin_floor_m=0.05, sigma_position=0.05
    )
    assert pairs.design_distance(0.0, rough, spacing) == pytest.approx(0.8 + 0.05 + 0.25)


def test_a_law_that_does_nothing_says_so_and_a_thrust_downwards_leaves_no_tilt() -> None:
    motion = prediction.Motion(Vec3(1.0, 2.0, 3.0), Vec3(0.1, 0.2, 0.3))
    thrust = Thrust(Vec3(1.0, 2.0, GRAVITY_M_S2 + 0.5))
    output = interface.unchanged(thrust, motion, Vec3(0.0, 0.0, 0.0), _PARAMS)
    assert output.thrust == thrust
    assert output.commanded_acceleration_enu_m_s2 == pytest.approx((1.0, 2.0, 0.5))
    assert (output.status, output.active_neighbour) == (INACTIVE, -1)
    assert (output.intervention_m_s2, output.slack_m_s2, output.crowd_count) == (0.0, 0.0, 0.0)
    assert interface.horizontal_limit(-1.0, _PARAMS) == 0.0


@pytest.mark.parametrize("law", ["off", "paper"])
def test_without_coveys_law_nothing_bounds_a_climb_and_nobody_makes_a_crowd(law: str) -> None:
    vehicle = law_of()._replace(law=p.OFF if law == "off" else p.PAPER)
    state = state_of((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    memory = oist.initial()
    baseline = interface.Baseline(thrust_of((0.0, 0.0, 0.0)), ZERO_3, ZERO_3)
    predicted = oist.predict(memory, state, vehicle, 0.02)
    after, output = oist.step(memory, baseline, predicted, state, [], (), vehicle, 0.02)
    assert (after.climb_share, after.sink_limit_m_s) == (1.0, math.inf)
    assert (output.crowd_count, output.slack_m_s2) == (0.0, 0.0)


@pytest.mark.parametrize(("index", "held_s"), [(0, 0.02), (5, 0.02)])
def test_any_neighbour_that_holds_a_vehicle_back_is_counted(index: int, held_s: float) -> None:
    state = state_of((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    memory = oist.initial()
    baseline = interface.Baseline(thrust_of((3.0, 0.0, 0.0)), ZERO_3, Vec3(1.0, 0.0, 0.0))
    predicted = oist.predict(memory, state, _PARAMS, 0.02)
    ahead = neighbour_of((0.9, 0.0, 1.0), table_index=index)
    after, output = oist.step(memory, baseline, predicted, state, [ahead], (), _PARAMS, 0.02)
    assert output.active_neighbour == index
    assert after.held_s == pytest.approx(held_s)


def test_of_nine_obstacles_the_six_nearest_count():
    obstacles = [Capsule(Vec2(east, 0.0), Vec2(east, 0.0), 0.1) for east in range(9, 0, -1)]
    gaps_m = [surface.gap_m for surface in nearest_surfaces(_own(), obstacles, 0.3)]
    assert np.diff(gaps_m) == pytest.approx([1.0] * 5)
    assert gaps_m[0] == pytest.approx(nearest_surfaces(_own(), obstacles[-1:], 0.3)[0].gap_m)
