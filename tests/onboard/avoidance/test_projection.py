"""The projection on half-planes and disc, against slow oracles and an independent QP solver."""

import ctypes

import daqp
import numpy as np
import pytest

from onboard.avoidance import kernel_projection
from onboard.avoidance.projection import Rows, least_slack, no_rows, project
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


def random_and_degenerate_rows(rng, count, height):
    """By sixths: random; one row twice; a line (two opposed rows); a strip or nothing; one common point; a grid."""
    normals, bounds = random_rows(rng, count, height)
    kind = np.arange(count) % 6
    if height > 1:
        normals[kind == 1, 1], bounds[kind == 1, 1] = normals[kind == 1, 0], bounds[kind == 1, 0]
        opposed = (kind == 2) | (kind == 3)
        normals[opposed, 1], bounds[opposed, 1] = -normals[opposed, 0], -bounds[opposed, 0]
        bounds[kind == 3, 1] += rng.uniform(-1, 1, (kind == 3).sum())
        points = rng.normal(size=(count, 2))
        bounds[kind == 4] = np.einsum("khc,kc->kh", normals, points)[kind == 4]
        grid = rng.integers(-2, 3, normals.shape).astype(float)
        grid[..., 0] = np.where(np.abs(grid).max(-1) == 0, 1.0, grid[..., 0])
        normals[kind == 5] = grid[kind == 5]
        bounds[kind == 5] = rng.integers(-3, 4, bounds.shape)[kind == 5]
    return normals, bounds


def test_projection_equals_an_independent_qp_solver_on_100_000_random_and_degenerate_cases():
    rng = np.random.default_rng(0)
    compared = infeasible = 0
    for height, count in ((1, 10_000), (2, 30_000), (3, 30_000), (5, 20_000), (8, 6_000), (14, 4_000)):
        normals, bounds = random_and_degenerate_rows(rng, count, height)
        u0 = rng.normal(size=(count, 2)) * 3
        result = project(u0, hard(normals, bounds), no_rows((count,)), radius_m_s2=np.full(count, 1e5))
        for k in range(count):
            reference = by_daqp(u0[k], normals[k], bounds[k])
            if reference is None:
                infeasible += 1
                assert result.status[k] == LawStatus.RELAXED
            elif np.abs(reference).max() < 1e4:
                compared += 1
                assert result.status[k] in (LawStatus.INACTIVE, LawStatus.SATURATED)
                error = np.abs(result.point_m_s2[k] - reference).max()
                assert error <= 1e-9 * (1.0 + np.abs(reference).max()), (height, k)
    assert compared > 60_000
    assert infeasible > 10_000


def by_daqp_with_disc(u0, normals, bounds, radius):
    """The QP with a weight on |u|^2 that is bisected until the disc is met; None when infeasible."""
    point, middle = by_daqp(u0, normals, bounds), by_daqp(np.zeros(2), normals, bounds)
    if point is None or np.hypot(*middle) > radius:
        return None
    low, high = 0.0, 1.0  # u0 shrinks to the middle as its share goes from 1 to 0
    if np.hypot(*point) <= radius:
        return point
    for _ in range(50):
        share = 0.5 * (low + high)
        point = by_daqp(share * u0, normals, bounds)
        low, high = (share, high) if np.hypot(*point) <= radius else (low, share)
    return point


def test_projection_with_the_disc_equals_the_qp_solver_with_a_multiplier():
    rng = np.random.default_rng(9)
    compared = 0
    for height in (1, 2, 4, 8):
        normals, bounds = random_and_degenerate_rows(rng, 300, height)
        u0, radius = rng.normal(size=(300, 2)) * 4, rng.uniform(0.5, 5.0, 300)
        result = project(u0, hard(normals, bounds), no_rows((300,)), radius_m_s2=radius)
        for k in range(300):
            reference = by_daqp_with_disc(u0[k], normals[k], bounds[k], radius[k])
            if reference is None:
                assert result.status[k] == LawStatus.RELAXED
            elif result.status[k] != LawStatus.RELAXED:
                compared += 1
                np.testing.assert_allclose(result.point_m_s2[k], reference, atol=1e-6)
    assert compared > 500


def by_kernel(u0, hard_rows, soft_rows, radius):
    """kernel_projection.project for one vehicle, rows switched off left out."""
    rows = [
        (*normal, bound)
        for given in (hard_rows, soft_rows)
        for normal, bound, is_on in zip(given.normals, given.bounds_m_s2, given.is_on, strict=True)
        if is_on
    ]
    count = int(hard_rows.is_on.sum())
    n_x, n_y, b = ([float(row[c]) for row in rows] for c in range(3))
    unit = tuple([0.0] * len(rows) for _ in range(3))
    return kernel_projection.project(
        *map(float, u0), n_x, n_y, b, count, len(rows) - count, float(radius), unit, [0] * len(rows)
    )


def test_kernel_equals_the_array_form_with_soft_rows_and_slack():
    rng = np.random.default_rng(12)
    seen = set()
    for hard_count, soft_count in ((1, 0), (1, 2), (3, 3), (6, 4), (10, 6)):
        count = 600
        first = hard(*random_and_degenerate_rows(rng, count, hard_count))
        second = hard(*random_rows(rng, count, soft_count), rng.random((count, soft_count)) < 0.8)
        u0, radius = rng.normal(size=(count, 2)) * 3, rng.uniform(0.5, 6.0, count)
        result = project(u0, first, second, radius_m_s2=radius)
        for k in range(count):
            pick = [Rows(r.normals[k], r.bounds_m_s2[k], r.is_on[k]) for r in (first, second)]
            x, y, status, slack = by_kernel(u0[k], *pick, radius[k])
            np.testing.assert_allclose([x, y], result.point_m_s2[k], atol=1e-9)
            assert status == result.status[k]
            assert slack == pytest.approx(result.slack_m_s2[k], abs=1e-9)
            seen.add(status)
    assert seen == {LawStatus.INACTIVE, LawStatus.SATURATED, LawStatus.RELAXED}


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
