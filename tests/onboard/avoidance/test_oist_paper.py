"""The paper-exact law: equal to the printed equations, with the properties that they have."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.oist_paper import PlanarState, saturate_thrust
from onboard.avoidance.params import PaperParams
from onboard.types import LawStatus
from onboard.vectors import ZERO_XY, Vec2
from tests.onboard.avoidance.law_cases import law_of, nearest_thrust, neighbour_of, run, thrust_of
from tests.oracles.paper_law import saturated_thrust

PARAMS = PaperParams(
    kappa_1_1_s=2.0,
    kappa_2_1_s=1.7,
    kappa_3_1_s=1.5,
    kappa_4_1_s=1.3,
    v_perp_m_s=0.2,
    d_inf_m=0.8,
    turn_sign=1.0,
)
NUMBER = st.floats(-3, 3)
POINT = st.builds(lambda x, y: np.array([x, y]), NUMBER, NUMBER)


def vec(values):
    return Vec2(*map(float, values))


def cases(count, seed=0):
    """Own position, velocity, thrust; obstacle's position, velocity, acceleration."""
    rng = np.random.default_rng(seed)
    scale = np.array([1.5, 0.7, 3.0, 1.5, 0.7, 1.0])[:, None]
    return [rng.normal(size=(6, 2)) * scale for _ in range(count)]


def saturated(p, v, f, q, w, a, params=PARAMS):
    own = PlanarState(vec(p), vec(v), ZERO_XY)
    obstacle = PlanarState(vec(q), vec(w), vec(a))
    return saturate_thrust(own, vec(f), obstacle, params)


def test_law_equals_the_plain_transcription_of_the_equations():
    mass = 0.51
    for direction in (8, 9):
        k = PARAMS._replace(turn_sign=1.0 if direction == 8 else -1.0)
        changed = 0
        for p, v, f, q, w, a in cases(500):
            result = saturated(p, v, f, q, w, a, k)
            arguments = (
                *p,
                *v,
                *q,
                *w,
                *a,
                *(mass * f),
                mass,
                k.kappa_1_1_s,
                k.kappa_2_1_s,
                k.kappa_3_1_s,
                k.kappa_4_1_s,
                k.v_perp_m_s,
                k.d_inf_m,
                direction,
            )
            oracle = saturated_thrust(*arguments)
            np.testing.assert_allclose(result.thrust_m_s2, oracle / mass, rtol=1e-9, atol=1e-9)
            changed += result.is_changed
        assert 0 < changed < 500


def test_law_is_the_projection_on_its_two_half_planes():
    k = PARAMS
    for p, v, f, q, w, a in cases(300, seed=1):
        e = p - q
        d = k.d_inf_m
        rel = v - w
        cross = lambda a, b: a[0] * b[1] - a[1] * b[0]  # noqa: E731
        outside = e @ e - d * d
        b1 = e @ a - rel @ rel - (k.kappa_1_1_s + k.kappa_2_1_s) * (e @ rel)
        b1 -= 0.5 * k.kappa_1_1_s * k.kappa_2_1_s * outside
        b2 = -cross(rel, v) - 2 * k.kappa_3_1_s * (e @ rel)
        b2 -= k.kappa_4_1_s * (cross(e, v) - d * k.v_perp_m_s + k.kappa_3_1_s * outside)
        rows = [HalfPlane(vec(e), float(b1)), HalfPlane(vec((-e[1], e[0])), float(b2))]
        point = nearest_thrust(vec(f), rows, 1e4).point
        np.testing.assert_allclose(point, saturated(p, v, f, q, w, a).thrust_m_s2, atol=1e-8)


def test_vehicle_that_approaches_its_obstacle_is_pushed_away_from_it():
    # (8) is far from binding here
    params = PARAMS._replace(v_perp_m_s=0.0, kappa_4_1_s=20.0)
    zero = np.zeros(2)
    result = saturated(zero, [1.0, 0.0], zero, [1.0, 0.0], zero, zero, params)
    assert result.thrust_m_s2.x < -1.0
    assert abs(result.thrust_m_s2.y) < 1e-12


def test_direction_8_turns_counter_clockwise_and_9_clockwise():
    zero = np.zeros(2)
    for sign in (1.0, -1.0):
        result = saturated(
            [0.8, 0.0], zero, zero, zero, zero, zero, PARAMS._replace(turn_sign=sign)
        )
        assert math.copysign(1.0, result.thrust_m_s2.y) == sign


@pytest.mark.parametrize("misses", [(0.05, -1.0), (-1.0, 0.05), (-1.0, -1.0)])
def test_a_thrust_that_misses_a_bound_by_little_is_raised_to_it(misses):
    miss_1, miss_2 = misses
    # at rest a metre east of the obstacle the bounds (20), (21) are -1.224 and -0.494
    thrust = [0.5 * (-1.224 - miss_1), -0.494 - miss_2]
    zero = np.zeros(2)
    result = saturated([1.0, 0.0], zero, thrust, zero, zero, zero)
    raised = [0.5 * max(miss_1, 0.0), max(miss_2, 0.0)]
    np.testing.assert_allclose(result.thrust_m_s2, np.add(thrust, raised), atol=1e-12)
    assert result.is_changed is (max(misses) > 0.0)


@pytest.mark.parametrize("field", ["position_enu_m", "velocity_enu_m_s", "acceleration_enu_m_s2"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_obstacle_of_which_one_number_is_missing_is_not_avoided(field, axis):
    near = neighbour_of([0.9, 0.0, 1.0])
    paper = law_of(name="paper")
    avoiding = run([0, 0, 1], [0.5, 0, 0], [0, 0, 0], [near], paper)
    assert avoiding.status == LawStatus.SATURATED

    unknown = near._replace(**{field: getattr(near, field)._replace(**{axis: math.nan})})
    output = run([0, 0, 1], [0.5, 0, 0], [0, 0, 0], [unknown], paper)
    assert output.status == LawStatus.INFEASIBLE
    assert output.thrust == thrust_of((0.0, 0.0, 0.0))


@settings(max_examples=100, deadline=None)
@given(POINT, POINT, POINT, POINT, POINT, POINT, st.floats(-math.pi, math.pi))
def test_rotation_and_translation_equivariant(p, v, f, q, w, a, angle):
    if np.hypot(*(p - q)) < 0.1:
        return
    shift = np.array([3.0, -2.0])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    plain = saturated(p, v, f, q, w, a)
    moved = saturated(turn @ p + shift, turn @ v, turn @ f, turn @ q + shift, turn @ w, turn @ a)
    np.testing.assert_allclose(moved.thrust_m_s2, turn @ plain.thrust_m_s2, rtol=1e-7, atol=1e-7)


@settings(max_examples=100, deadline=None)
@given(POINT, POINT, POINT, POINT, POINT, POINT, st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_homogeneous(p, v, f, q, w, a, length, time):
    if np.hypot(*(p - q)) < 0.1:
        return
    k = PARAMS
    speed = length / time
    push = length / time**2
    scaled = PaperParams(
        kappa_1_1_s=k.kappa_1_1_s / time,
        kappa_2_1_s=k.kappa_2_1_s / time,
        kappa_3_1_s=k.kappa_3_1_s / time,
        kappa_4_1_s=k.kappa_4_1_s / time,
        v_perp_m_s=k.v_perp_m_s * speed,
        d_inf_m=k.d_inf_m * length,
        turn_sign=k.turn_sign,
    )
    plain = saturated(p, v, f, q, w, a)
    big = saturated(p * length, v * speed, f * push, q * length, w * speed, a * push, scaled)
    np.testing.assert_allclose(
        big.thrust_m_s2, np.array(plain.thrust_m_s2) * push, rtol=1e-7, atol=1e-7 * push
    )


def test_idempotent():
    for p, v, f, q, w, a in cases(200, seed=4):
        once = saturated(p, v, f, q, w, a).thrust_m_s2
        np.testing.assert_allclose(saturated(p, v, once, q, w, a).thrust_m_s2, once, atol=1e-9)


def test_coincident_vehicles_leave_the_thrust_and_say_so():
    zero = np.zeros(2)
    result = saturated(zero, np.ones(2), [1.0, 2.0], zero, zero, zero)
    assert not result.is_usable
    assert result.thrust_m_s2 == (1.0, 2.0)
