"""The avoidance law for N neighbours: signs, symmetries, limits and bad input."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from onboard.avoidance import interface, oist
from onboard.avoidance.constraints import distance_row, rotation_row
from onboard.avoidance.pairs import NeighbourPair
from onboard.avoidance.prediction import Motion
from onboard.constants import GRAVITY_M_S2
from onboard.types import LawStatus
from onboard.vectors import ZERO_3, Vec2, Vec3
from tests.onboard.avoidance.law_cases import (
    horizontal,
    law_of,
    mapped,
    neighbour_of,
    neighbours_of,
    random_case,
    run,
    state_of,
    thrust_of,
    vec,
)

PARAMS = law_of()
SEEDS = st.integers(0, 10_000)


def test_vehicle_flying_at_a_neighbour_is_braked_and_turned_counter_clockwise():
    out = run([0, 0, 1], [1, 0, 0], [2, 0, 0], neighbours_of([[1.3, 0, 1]]), PARAMS)
    assert out.status == LawStatus.SATURATED
    assert out.thrust.thrust_enu_m_s2.x < 0.0
    # seen from the neighbour it starts to circle it to the left
    assert out.thrust.thrust_enu_m_s2.y < 0.0
    assert out.active_neighbour == 0


def test_vehicle_flying_away_is_left_alone_bit_for_bit():
    out = run([0, 0, 1], [-0.5, 0, 0], [-1, 0.3, 0.1], neighbours_of([[1.3, 0, 1]]), PARAMS)
    assert out.status == LawStatus.INACTIVE
    assert out.thrust.thrust_enu_m_s2[:2] == (-1.0, 0.3)
    assert out.intervention_m_s2 == 0.0
    assert out.active_neighbour == interface.NOBODY


def test_height_is_never_touched():
    for seed in range(30):
        p, v, a, neighbours = random_case(seed)
        assert run(p, v, a, neighbours, PARAMS).thrust.thrust_enu_m_s2.z == a[2] + GRAVITY_M_S2, (
            seed
        )


def test_two_vehicles_that_see_the_same_pair_share_the_work_equally():
    left = run(
        [0, 0, 1], [0.8, 0, 0], [0, 0, 0], neighbours_of([[1.4, 0, 1]], [[-0.8, 0, 0]]), PARAMS
    )
    right = run(
        [1.4, 0, 1], [-0.8, 0, 0], [0, 0, 0], neighbours_of([[0, 0, 1]], [[0.8, 0, 0]]), PARAMS
    )
    one, two = (horizontal(out.thrust.thrust_enu_m_s2) for out in (left, right))
    np.testing.assert_allclose(one, -two, atol=1e-12)


def test_neighbour_that_does_not_deliver_its_half_gets_more_from_us():
    def intervention(command):
        neighbours = neighbours_of([[1.2, 0, 1]], [[-0.4, 0, 0]], [command])
        return run([0, 0, 1], [0.4, 0, 0], [0, 0, 0], neighbours, PARAMS).intervention_m_s2

    assert intervention([0, 0, 0]) > intervention([5.0, 0, 0]) > 0


def test_neighbour_that_does_not_cooperate_gets_the_full_share():
    neighbour = neighbour_of(
        [1.3, 0, 1], [-0.4, 0, 0], predicted_position_enu_m=Vec3(1.24, 0.0, 1.0)
    )
    alone = run(
        [0, 0, 1], [0.4, 0, 0], [0, 0, 0], [neighbour._replace(is_cooperative=False)], PARAMS
    )
    shared = run([0, 0, 1], [0.4, 0, 0], [0, 0, 0], [neighbour], PARAMS)
    assert alone.intervention_m_s2 > shared.intervention_m_s2


def test_one_neighbour_with_full_share_and_no_lag_obeys_equation_17():
    params = law_of({"lag_s": 0.0}, kappa_1_1_s=2.0, kappa_2_1_s=2.0, uncooperative_margin_m=0.0)
    hits = 0
    for seed in range(60):
        p, v, a, neighbours = random_case(seed, count=1)
        out = run(p, v, a, [neighbours[0]._replace(is_cooperative=False)], params)
        e = p[:2] - horizontal(neighbours[0].position_enu_m)
        w = v[:2] - horizontal(neighbours[0].velocity_enu_m_s)
        if out.status == LawStatus.SATURATED:
            hits += 1
            bound = -(w @ w) - 4.0 * (e @ w) - 2.0 * (e @ e - 0.81)
            assert e @ horizontal(out.thrust.thrust_enu_m_s2) >= bound - 1e-8, seed
    assert hits > 10


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.floats(-math.pi, math.pi), st.floats(-20, 20), st.floats(-20, 20))
def test_rotation_and_translation_equivariant(seed, angle, east_m, north_m):
    shift = np.array([east_m, north_m, 0.5])
    turn = np.array(
        [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    )

    def move(name, value):
        if not isinstance(value, Vec3):
            return value
        return vec(turn @ value + shift) if "position" in name else vec(turn @ value)

    p, v, a, neighbours = random_case(seed)
    plain = run(p, v, a, neighbours, PARAMS)
    moved = run(turn @ p + shift, turn @ v, turn @ a, [mapped(n, move) for n in neighbours], PARAMS)
    np.testing.assert_allclose(
        moved.thrust.thrust_enu_m_s2, turn @ plain.thrust.thrust_enu_m_s2, atol=1e-6
    )
    assert moved.status == plain.status


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.permutations(range(4)))
def test_independent_of_the_neighbours_order(seed, order):
    p, v, a, neighbours = random_case(seed)
    plain = run(p, v, a, neighbours, PARAMS)
    shuffled = run(p, v, a, [neighbours[k] for k in order], PARAMS)
    np.testing.assert_allclose(
        shuffled.thrust.thrust_enu_m_s2, plain.thrust.thrust_enu_m_s2, atol=1e-6
    )
    assert shuffled.active_neighbour == plain.active_neighbour


@settings(max_examples=100, deadline=None)
@given(SEEDS, st.floats(0.2, 5.0), st.floats(0.2, 5.0), st.booleans(), st.booleans())
def test_homogeneous(seed, length, time, is_cooperative, is_crowded):
    """Rows in other units of length and time are the same rows."""
    rng = np.random.default_rng(seed)
    speed = length / time
    push = length / time**2
    e, w, u, g, own = rng.normal(size=(5, 2))
    d = rng.uniform(0.8, 1.2)
    # a slower relative velocity counts as 0.1 m/s where it decides the direction of a turn
    assume(min(1.0, speed) * np.hypot(*w) > 0.1)

    gains = PARAMS.gains
    scaled = PARAMS._replace(
        gains=gains._replace(
            kappa_1_1_s=gains.kappa_1_1_s / time,
            kappa_2_1_s=gains.kappa_2_1_s / time,
            kappa_3_1_s=gains.kappa_3_1_s / time,
            kappa_4_1_s=gains.kappa_4_1_s / time,
            v_perp_m_s=gains.v_perp_m_s * speed,
            v_perp_crowd_m_s=gains.v_perp_crowd_m_s * speed,
        )
    )

    def rows(params, length, speed, push):
        pair = NeighbourPair(
            e=Vec2(*map(float, length * e)),
            w=Vec2(*map(float, speed * w)),
            command_m_s2=Vec2(*map(float, push * u)),
            intent_m_s=Vec2(*map(float, speed * 10.0 * g)),
            d_m=d * length,
            distance_2_m2=0.0,
            crowd_count=0.0,
            is_near=True,
            is_cooperative=is_cooperative,
            table_index=0,
        )
        own_velocity = Vec2(*map(float, speed * own))
        return [
            distance_row(pair, pair.d_m, params),
            rotation_row(pair, own_velocity, is_crowded, params),
        ]

    for plain, big in zip(
        rows(PARAMS, 1.0, 1.0, 1.0), rows(scaled, length, speed, push), strict=True
    ):
        np.testing.assert_allclose(big.normal, plain.normal, rtol=1e-9, atol=1e-12)
        assert big.bound_m_s2 == pytest.approx(plain.bound_m_s2 * push, rel=1e-9)


def test_no_neighbours_at_all_change_nothing():
    out = run([0, 0, 1], [0, 0, 0], [1.0, 2.0, 0], [], PARAMS)
    assert out.thrust.thrust_enu_m_s2[:2] == (1.0, 2.0)


def test_thrust_and_compensation_together_stay_within_the_tilt_limit():
    for seed in range(60):
        p, v, a, neighbours = random_case(seed)
        extra = np.random.default_rng(seed).normal(size=3)
        thrust = run(p, v, 3 * a, neighbours, PARAMS, compensation=extra).thrust.thrust_enu_m_s2
        total = horizontal(thrust) + extra[:2]
        assert np.hypot(*total) <= interface.horizontal_limit(thrust.z, PARAMS) + 1e-6, seed


def test_squeezed_vehicle_is_relaxed_with_its_slack_and_slows_the_pursuit_down():
    around = neighbours_of(
        [[0.5, 0, 1], [-0.25, 0.43, 1], [-0.25, -0.43, 1]],
        [[-2.0, 0, 0], [1.0, -1.7, 0], [1.0, 1.7, 0]],
    )
    memory = oist.initial()
    state = state_of([0, 0, 1], [0, 0, 0])
    baseline = interface.Baseline(thrust_of([0, 0, 0]), ZERO_3, ZERO_3)
    for _ in range(20):
        predicted = oist.predict(memory, state, PARAMS, 0.02)
        memory, out = oist.step(memory, baseline, predicted, state, around, (), PARAMS, 0.02)
    assert out.status == LawStatus.RELAXED
    assert out.slack_m_s2 > 0
    assert out.crowd_count == 3
    assert oist.speed_share(memory, PARAMS) < 0.5


def test_law_off_is_the_identity_within_the_tilt_limit():
    p, v, a, neighbours = random_case(1)
    out = run(p, v, 0.5 * a, neighbours, law_of(name="off"))
    assert out.thrust == thrust_of(0.5 * a)
    assert out.status == LawStatus.INACTIVE


def test_unchanged_passes_everything_on():
    motion = Motion(Vec3(1.0, 2.0, 3.0), Vec3(0.1, 0.2, 0.3))
    out = interface.unchanged(thrust_of([20.0, 0.0, 0.0]), motion, ZERO_3, PARAMS)
    assert out.thrust == thrust_of([20.0, 0.0, 0.0])
    assert (out.predicted_position_enu_m, out.predicted_velocity_enu_m_s) == motion
    assert out.commanded_acceleration_enu_m_s2 == Vec3(20.0, 0.0, 0.0)
    assert (out.status, out.active_neighbour) == (LawStatus.INACTIVE, interface.NOBODY)


def test_paper_law_takes_the_ring_successor_only():
    near = [0.9, 0, 1]
    far = [5.0, 5.0, 1]
    paper = law_of(name="paper")
    ignoring = run([0, 0, 1], [0.5, 0, 0], [0, 0, 0], neighbours_of([far, near]), paper)
    heeding = run([0, 0, 1], [0.5, 0, 0], [0, 0, 0], neighbours_of([near, far]), paper)
    assert ignoring.status == LawStatus.INACTIVE
    assert heeding.status == LawStatus.SATURATED
    assert heeding.thrust.thrust_enu_m_s2.x < 0
    assert heeding.lead_time_s == 0.0


def everywhere(value):
    return lambda _name, old: Vec3(value, value, value) if isinstance(old, Vec3) else old


BAD = {
    "coincident": lambda n: n._replace(predicted_position_enu_m=ZERO_3),
    "not a number": lambda n: mapped(n, everywhere(math.nan))._replace(
        age_s=math.nan, crowd_count=math.nan
    ),
    "huge": lambda n: mapped(n, everywhere(1e300))._replace(age_s=1e300, position_std_m=1e300),
    "huge and fast": lambda n: n._replace(predicted_velocity_enu_m_s=Vec3(-1e300, -1e300, -1e300)),
    "endless": lambda n: n._replace(predicted_velocity_enu_m_s=Vec3(math.inf, math.inf, math.inf)),
}


def test_bad_neighbours_give_a_bounded_thrust():
    for law in ("covey", "paper", "off"):
        for kind, spoil in BAD.items():
            _, _, _, neighbours = random_case(0)
            out = run(
                np.zeros(3),
                np.zeros(3),
                [1.0, 1.0, 0.0],
                [spoil(n) for n in neighbours],
                law_of(name=law),
            )
            assert np.isfinite(out.thrust.thrust_enu_m_s2).all(), (law, kind)
            assert np.hypot(*out.thrust.thrust_enu_m_s2[:2]) <= GRAVITY_M_S2, (law, kind)
            if law == "covey" and kind in ("coincident", "not a number"):
                assert out.status == LawStatus.INFEASIBLE, kind


@settings(max_examples=100, deadline=None)
@given(SEEDS, st.lists(st.floats(width=64), min_size=26, max_size=26))
def test_no_number_of_a_message_makes_the_thrust_unbounded(seed, values):
    p, v, a, neighbours = random_case(seed)
    vectors = [Vec3(*values[3 * k : 3 * k + 3]) for k in range(7)]
    wild = neighbours[0]._replace(
        **dict(zip(neighbours[0]._fields, (*vectors, *values[21:]), strict=False))
    )
    out = run(p, v, a, [wild, *neighbours[1:]], PARAMS)
    assert (
        np.hypot(*out.thrust.thrust_enu_m_s2[:2])
        <= interface.horizontal_limit(a[2] + GRAVITY_M_S2, PARAMS) + 1e-9
    )


def test_bad_own_values_level_the_thrust_and_say_so():
    for bad in (math.nan, math.inf, -1e300):
        _, _, _, neighbours = random_case(0)
        out = run(np.full(3, bad), np.zeros(3), np.full(3, bad), neighbours, PARAMS)
        assert np.isfinite(out.thrust.thrust_enu_m_s2).all(), bad
        assert out.thrust.thrust_enu_m_s2.z == GRAVITY_M_S2, bad
        assert out.status == LawStatus.INFEASIBLE, bad
        assert math.isnan(out.predicted_position_enu_m.x), bad


def test_compensation_that_is_no_number_is_left_out_and_said():
    p, v, a, neighbours = random_case(3)
    out = run(p, v, a, neighbours, PARAMS, compensation=(math.nan, 0.0, 0.0))
    plain = run(p, v, a, neighbours, PARAMS)
    assert out.thrust == plain.thrust
    assert out.status == LawStatus.INFEASIBLE


def test_vehicles_that_start_inside_the_safety_distance_move_apart():
    out = run([0, 0, 1], [0, 0, 0], [0, 0, 0], neighbours_of([[0.5, 0, 1]]), PARAMS)
    limit = interface.horizontal_limit(GRAVITY_M_S2, PARAMS)
    # more is required than the tilt limit gives
    assert out.thrust.thrust_enu_m_s2.x == pytest.approx(-limit)
    assert out.status == LawStatus.RELAXED


def test_parallel_and_contradicting_rows_stay_bounded():
    line = [[0.5, 0, 1], [0.6, 0, 1], [-0.5, 0, 1], [-0.6, 0, 1]]
    out = run([0, 0, 1], [0, 0, 0], [0, 0, 0], neighbours_of(line), PARAMS)
    assert np.isfinite(out.thrust.thrust_enu_m_s2).all()
    assert out.status in (LawStatus.SATURATED, LawStatus.RELAXED)
