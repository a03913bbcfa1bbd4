"""The projection on half-planes and disc, against slow oracles and an independent QP solver."""

import ctypes

import daqp
import numpy as np
import pytest

from onboard.control.projection import Rows, least_slack, no_rows, project
from onboard.types import LawStatus
from tests.oracles.half_planes import least_common_slack, nearest_in_rows_and_disc


def random_rows(rng, count, height, spread=2.0):
    angle = rng.uniform(0, 2 * np.pi, (count, height))
    normals = np.stack([np.cos(angle), np.sin(angle)], -1) * rng.uniform(0.5, 2.0, (count, height, 1))
    return normals, rng.normal(size=(count, height)) * spread


def hard(normals, bounds, is_on=None):
    return Rows(normals, bounds, np.ones(bounds.shape, bool) if is_on is None else is_on)


def by_daqp(u0, normals, bounds):
    """Independent QP: min |u - u0|^2 / 2; None when infeasible."""
    height = len(bounds)
    x, _, flag, _ = daqp.solve(
        np.eye(2), -np.ascontiguousarray(u0), np.ascontiguousarray(normals),
        np.full(height, 1e30), np.ascontiguousarray(bounds), np.zeros(height, ctypes.c_int), primal_tol=1e-11,
    )  # fmt: skip
    return x if flag == 1 else None


def test_projection_equals_an_independent_qp_solver():
    rng = np.random.default_rng(0)
    compared = infeasible = 0
    for height in (1, 2, 3, 5, 8, 14):
        normals, bounds = random_rows(rng, 400, height)
        u0 = rng.normal(size=(400, 2)) * 3
        result = project(u0, hard(normals, bounds), no_rows((400,)), radius_m_s2=np.full(400, 1e5))
        for k in range(400):
            reference = by_daqp(u0[k], normals[k], bounds[k])
            if reference is None or np.abs(reference).max() > 1e4:
                infeasible += reference is None
                continue
            compared += 1
            assert result.status[k] in (LawStatus.INACTIVE, LawStatus.SATURATED)
            scale = 1.0 + np.abs(reference).max()
            np.testing.assert_allclose(result.point_m_s2[k], reference, atol=1e-8 * scale)
    assert compared > 800
    assert infeasible > 100


def test_projection_with_the_disc_equals_trying_every_active_set():
    rng = np.random.default_rng(1)
    for height in (1, 2, 4, 7):
        normals, bounds = random_rows(rng, 300, height)
        u0, radius = rng.normal(size=(300, 2)) * 4, rng.uniform(0.5, 5.0, 300)
        result = project(u0, hard(normals, bounds), no_rows((300,)), radius_m_s2=radius)
        for k in range(300):
            reference = nearest_in_rows_and_disc(u0[k], normals[k], bounds[k], radius[k])
            if reference is not None and result.status[k] != LawStatus.RELAXED:
                np.testing.assert_allclose(result.point_m_s2[k], reference, atol=1e-9)
            else:
                assert result.status[k] == LawStatus.RELAXED
                assert reference is None


def test_slack_of_contradicting_rows_is_the_smallest_there_is():
    rng = np.random.default_rng(2)
    checked = 0
    for height in (2, 3, 5):
        normals, bounds = random_rows(rng, 60, height, spread=4.0)
        radius = rng.uniform(0.5, 4.0, 60)
        u0 = rng.normal(size=(60, 2))
        result = project(u0, hard(normals, bounds), no_rows((60,)), radius_m_s2=radius)
        for k in np.flatnonzero(result.status == LawStatus.RELAXED):
            checked += 1
            slack = least_common_slack(normals[k], bounds[k], radius[k])
            assert abs(slack - result.slack_m_s2[k]) < 1e-7
            lack = (bounds[k] - normals[k] @ result.point_m_s2[k]).max()
            assert lack <= result.slack_m_s2[k] + 1e-5
            assert np.hypot(*result.point_m_s2[k]) <= radius[k] * (1 + 1e-9)
    assert checked > 50


def test_soft_rows_are_dropped_last_first_and_never_cost_a_hard_row():
    rng = np.random.default_rng(3)
    count = 300
    hard_normals, hard_bounds = random_rows(rng, count, 2, spread=1.0)
    soft_normals, soft_bounds = random_rows(rng, count, 3)
    u0, radius = rng.normal(size=(count, 2)) * 2, np.full(count, 4.0)
    result = project(u0, hard(hard_normals, hard_bounds), hard(soft_normals, soft_bounds), radius_m_s2=radius)
    for k in np.flatnonzero(result.status == LawStatus.SATURATED):
        for kept in (3, 2, 1, 0):
            normals = np.concatenate([hard_normals[k], soft_normals[k, :kept]])
            bounds = np.concatenate([hard_bounds[k], soft_bounds[k, :kept]])
            reference = nearest_in_rows_and_disc(u0[k], normals, bounds, radius[k])
            if reference is not None:
                break
        assert result.dropped_soft[k] == 3 - kept
        np.testing.assert_allclose(result.point_m_s2[k], reference, atol=1e-9)
    assert (result.dropped_soft > 0).any()


def test_point_that_satisfies_everything_comes_back_bit_for_bit():
    u0 = np.array([0.1, -0.2])
    rows = hard(np.array([[1.0, 0.0], [0.0, 1.0]]), np.array([-1.0, -1.0]))
    result = project(u0, rows, no_rows(()), radius_m_s2=np.array(3.0))
    np.testing.assert_array_equal(result.point_m_s2, u0)
    assert result.status == LawStatus.INACTIVE


def test_batch_equals_loop():
    rng = np.random.default_rng(4)
    normals, bounds = random_rows(rng, 60, 4)
    soft = hard(*random_rows(rng, 60, 2))
    is_on = rng.random((60, 4)) < 0.7
    u0, radius = rng.normal(size=(60, 2)) * 3, rng.uniform(1, 4, 60)
    together = project(u0, hard(normals, bounds, is_on), soft, radius_m_s2=radius)
    shaped = project(
        u0.reshape(5, 12, 2),
        hard(normals.reshape(5, 12, 4, 2), bounds.reshape(5, 12, 4), is_on.reshape(5, 12, 4)),
        Rows(soft.normals.reshape(5, 12, 2, 2), soft.bounds_m_s2.reshape(5, 12, 2), soft.is_on.reshape(5, 12, 2)),
        radius_m_s2=radius.reshape(5, 12),
    )
    np.testing.assert_allclose(shaped.point_m_s2.reshape(60, 2), together.point_m_s2, atol=1e-12)
    for k in range(60):
        alone = project(
            u0[k],
            hard(normals[k], bounds[k], is_on[k]),
            Rows(soft.normals[k], soft.bounds_m_s2[k], soft.is_on[k]),
            radius_m_s2=radius[k],
        )
        np.testing.assert_allclose(alone.point_m_s2, together.point_m_s2[k], atol=1e-12)
        assert alone.status == together.status[k]


def test_order_of_hard_rows_does_not_matter():
    rng = np.random.default_rng(5)
    normals, bounds = random_rows(rng, 100, 5)
    u0 = rng.normal(size=(100, 2))
    order = rng.permutation(5)
    one = project(u0, hard(normals, bounds), no_rows((100,)), radius_m_s2=np.full(100, 5.0))
    two = project(u0, hard(normals[:, order], bounds[:, order]), no_rows((100,)), radius_m_s2=np.full(100, 5.0))
    np.testing.assert_allclose(one.point_m_s2, two.point_m_s2, atol=1e-6)
    np.testing.assert_allclose(one.slack_m_s2, two.slack_m_s2, atol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("radius", [0.0, 3.0])
def test_degenerate_rows_give_a_finite_point_inside_the_disc(radius):
    normals = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [-1.0, 1e-14], [np.nan, 1.0], [1e-300, 0.0]])
    bounds = np.array([1.0, 2.0, 2.0, 5.0, 5.0, 1.0, 1.0])
    result = project(np.array([9.0, 9.0]), hard(normals, bounds), no_rows(()), radius_m_s2=np.array(radius))
    assert result.status == LawStatus.RELAXED
    assert np.isfinite(result.point_m_s2).all()
    assert np.hypot(*result.point_m_s2) <= radius + 1e-9


def test_opposed_rows_share_the_slack_equally():
    normals = np.array([[[1.0, 0.0], [-1.0, 0.0]]])
    slack, _ = least_slack(normals, np.array([[2.0, 4.0]]), np.ones((1, 2), bool), np.array([10.0]))
    assert slack[0] == pytest.approx(3.0)


def test_no_rows_only_clip_to_the_disc():
    result = project(np.array([3.0, 4.0]), no_rows(()), no_rows(()), radius_m_s2=np.array(2.5))
    np.testing.assert_allclose(result.point_m_s2, [1.5, 2.0])
