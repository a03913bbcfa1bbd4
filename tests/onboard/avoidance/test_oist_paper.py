"""The paper-exact law: equal to the printed equations, with the properties that they have."""

from dataclasses import replace

import numpy as np
import pytest

from onboard.avoidance.oist_paper import PaperLawParams, saturate_thrust
from onboard.avoidance.projection import Rows, no_rows, project
from tests.oracles.paper_law import saturated_thrust

PARAMS = PaperLawParams(2.0, 1.7, 1.5, 1.3, 0.2, 0.8)


def cases(count, seed=0):
    rng = np.random.default_rng(seed)
    scale = np.array([1.5, 0.7, 3.0, 1.5, 0.7, 1.0])
    return [rng.normal(size=(count, 2)) * s for s in scale]


@pytest.mark.parametrize("direction", [8, 9])
def test_law_equals_the_plain_transcription_of_the_equations(direction):
    p, v, f, q, w, a = cases(500)
    params = replace(PARAMS, turn_sign=1.0 if direction == 8 else -1.0)
    result = saturate_thrust(p, v, f, q, w, a, params=params)
    mass = 0.51
    for k in range(len(p)):
        oracle = saturated_thrust(
            *p[k], *v[k], *q[k], *w[k], *a[k], *(mass * f[k]), mass,
            params.kappa_1_1_s, params.kappa_2_1_s, params.kappa_3_1_s, params.kappa_4_1_s,
            params.v_perp_m_s, params.d_inf_m, direction,
        )  # fmt: skip
        np.testing.assert_allclose(result.thrust_xy_m_s2[k], oracle / mass, rtol=1e-9, atol=1e-9)
    assert 0 < result.is_changed.sum() < len(p)


def test_law_is_the_projection_on_its_two_half_planes():
    p, v, f, q, w, a = cases(300, seed=1)
    result = saturate_thrust(p, v, f, q, w, a, params=PARAMS)
    k = PARAMS
    e, d = p - q, k.d_inf_m
    rel = v - w
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]  # noqa: E731
    dot = lambda a, b: (a * b).sum(-1)  # noqa: E731
    outside = dot(e, e) - d * d
    b1 = dot(e, a) - dot(rel, rel) - (k.kappa_1_1_s + k.kappa_2_1_s) * dot(e, rel)
    b1 -= 0.5 * k.kappa_1_1_s * k.kappa_2_1_s * outside
    b2 = -cross(rel, v) - 2 * k.kappa_3_1_s * dot(e, rel)
    b2 -= k.kappa_4_1_s * (cross(e, v) - d * k.v_perp_m_s + k.kappa_3_1_s * outside)
    rows = Rows(np.stack([e, np.stack([-e[:, 1], e[:, 0]], -1)], 1), np.stack([b1, b2], 1), np.ones((300, 2), bool))
    projected = project(f, rows, no_rows((300,)), radius_m_s2=np.full(300, 1e4))
    np.testing.assert_allclose(projected.point_m_s2, result.thrust_xy_m_s2, atol=1e-8)


def test_vehicle_that_approaches_its_obstacle_is_pushed_away_from_it():
    params = replace(PARAMS, v_perp_m_s=0.0, kappa_4_1_s=20.0)  # (8) is far from binding here
    zero = np.zeros(2)
    result = saturate_thrust(zero, np.array([1.0, 0.0]), zero, np.array([1.0, 0.0]), zero, zero, params=params)
    assert result.thrust_xy_m_s2[0] < -1.0
    assert abs(result.thrust_xy_m_s2[1]) < 1e-12


@pytest.mark.parametrize(("sign", "expected"), [(1.0, 1.0), (-1.0, -1.0)])
def test_direction_8_turns_counter_clockwise_and_9_clockwise(sign, expected):
    zero = np.zeros(2)
    result = saturate_thrust(np.array([0.8, 0.0]), zero, zero, zero, zero, zero, params=replace(PARAMS, turn_sign=sign))
    assert np.sign(result.thrust_xy_m_s2[1]) == expected


def test_turning_and_shifting_the_world_turns_the_thrust():
    p, v, f, q, w, a = cases(200, seed=2)
    angle, shift = 0.7, np.array([3.0, -2.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    plain = saturate_thrust(p, v, f, q, w, a, params=PARAMS)
    moved = saturate_thrust(
        p @ turn.T + shift, v @ turn.T, f @ turn.T, q @ turn.T + shift, w @ turn.T, a @ turn.T, params=PARAMS
    )
    np.testing.assert_allclose(moved.thrust_xy_m_s2, plain.thrust_xy_m_s2 @ turn.T, atol=1e-9)


def test_scaling_length_and_time_scales_the_thrust():
    p, v, f, q, w, a = cases(200, seed=3)
    length, time = 2.5, 0.4
    k = PARAMS
    scaled = PaperLawParams(
        k.kappa_1_1_s / time, k.kappa_2_1_s / time, k.kappa_3_1_s / time, k.kappa_4_1_s / time,
        k.v_perp_m_s * length / time, k.d_inf_m * length,
    )  # fmt: skip
    speed, push = length / time, length / time**2
    plain = saturate_thrust(p, v, f, q, w, a, params=k)
    big = saturate_thrust(p * length, v * speed, f * push, q * length, w * speed, a * push, params=scaled)
    np.testing.assert_allclose(big.thrust_xy_m_s2, plain.thrust_xy_m_s2 * push, rtol=1e-9)


def test_applying_the_law_twice_changes_nothing_more():
    p, v, f, q, w, a = cases(200, seed=4)
    once = saturate_thrust(p, v, f, q, w, a, params=PARAMS)
    twice = saturate_thrust(p, v, once.thrust_xy_m_s2, q, w, a, params=PARAMS)
    np.testing.assert_allclose(twice.thrust_xy_m_s2, once.thrust_xy_m_s2, atol=1e-9)


@pytest.mark.filterwarnings("error")
def test_coincident_vehicles_leave_the_thrust_and_say_so():
    zero, thrust = np.zeros(2), np.array([1.0, 2.0])
    result = saturate_thrust(zero, np.ones(2), thrust, zero, zero, zero, params=PARAMS)
    assert not result.is_usable
    np.testing.assert_array_equal(result.thrust_xy_m_s2, thrust)
