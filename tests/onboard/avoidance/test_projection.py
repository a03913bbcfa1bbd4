"""The projection on half-planes and disc, against slow oracles and an independent QP solver."""

import ctypes
import math

import daqp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.projection import project, pulled, relaxed_in_order
from onboard.avoidance.relaxation import least_slack
from onboard.types import LawStatus
from onboard.vectors import Vec2
from tests.onboard.avoidance.law_cases import nearest_thrust
from tests.oracles.half_planes import least_common_slack, nearest_in_rows_and_disc


def rows_of(normals, bounds):
    return [HalfPlane(Vec2(*map(float, n)), float(b)) for n, b in zip(normals, bounds, strict=True)]


def projected(u, normals, bounds, radius):
    return nearest_thrust(Vec2(*map(float, u)), rows_of(normals, bounds), float(radius))


def random_rows(rng, count, height, spread=2.0):
    angle = rng.uniform(0, 2 * np.pi, (count, height))
    normals = np.stack([np.cos(angle), np.sin(angle)], -1) * rng.uniform(
        0.5, 2.0, (count, height, 1)
    )
    return normals, rng.normal(size=(count, height)) * spread


def random_and_degenerate_rows(rng, count, height):
    """By sixths: random; one row twice; a line (two opposed rows); a strip or nothing; one common
    point; a grid.
    """
    normals, bounds = random_rows(rng, count, height)
    kind = np.arange(count) % 6

    if height > 1:
        normals[kind == 1, 1] = normals[kind == 1, 0]
        bounds[kind == 1, 1] = bounds[kind == 1, 0]

        opposed = (kind == 2) | (kind == 3)
        normals[opposed, 1] = -normals[opposed, 0]
        bounds[opposed, 1] = -bounds[opposed, 0]
        bounds[kind == 3, 1] += rng.uniform(-1, 1, (kind == 3).sum())

        points = rng.normal(size=(count, 2))
        bounds[kind == 4] = np.einsum("khc,kc->kh", normals, points)[kind == 4]

        grid = rng.integers(-2, 3, normals.shape).astype(float)
        grid[..., 0] = np.where(np.abs(grid).max(-1) == 0, 1.0, grid[..., 0])
        normals[kind == 5] = grid[kind == 5]
        bounds[kind == 5] = rng.integers(-3, 4, bounds.shape)[kind == 5]
    return normals, bounds


def by_daqp(u0, normals, bounds):
    """Independent QP: min |u - u0|^2 / 2; None when infeasible."""
    height = len(bounds)
    x, _, flag, _ = daqp.solve(
        np.eye(2), -np.ascontiguousarray(u0), np.ascontiguousarray(normals),
        np.full(height, 1e30), np.ascontiguousarray(bounds), np.zeros(height, ctypes.c_int),
        primal_tol=1e-11,
    )  # fmt: skip
    return x if flag == 1 else None


@pytest.mark.parametrize("share", [0.2, pytest.param(1.0, marks=pytest.mark.long)])
def test_projection_equals_an_independent_qp_solver_on_random_and_degenerate_cases(share):
    rng = np.random.default_rng(0)
    compared = infeasible = 0
    for height, count in ((1, 2_000), (2, 8_000), (3, 8_000), (5, 4_000), (8, 1_200), (14, 600)):
        normals, bounds = random_and_degenerate_rows(rng, count, height)
        u0 = rng.normal(size=(count, 2)) * 3
        for k in range(round(share * count)):
            result = projected(u0[k], normals[k], bounds[k], 1e5)
            reference = by_daqp(u0[k], normals[k], bounds[k])
            if reference is None:
                infeasible += 1
                assert result.status == LawStatus.RELAXED, (height, k)
            elif np.abs(reference).max() < 1e4:
                compared += 1
                assert result.status in (LawStatus.INACTIVE, LawStatus.SATURATED), (height, k)
                error = np.abs(result.point - reference).max()
                assert error <= 1e-9 * (1.0 + np.abs(reference).max()), (height, k)

    assert compared > share * 14_000
    assert infeasible > share * 2_000


def by_daqp_with_disc(u0, normals, bounds, radius):
    """The QP with a weight on |u|^2, bisected until the disc is met; None when infeasible."""
    point = by_daqp(u0, normals, bounds)
    middle = by_daqp(np.zeros(2), normals, bounds)
    if point is None or np.hypot(*middle) > radius:
        return None

    # u0 shrinks to the middle as its share goes from 1 to 0
    low = 0.0
    high = 1.0
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
        u0 = rng.normal(size=(300, 2)) * 4
        radius = rng.uniform(0.5, 5.0, 300)
        for k in range(300):
            result = projected(u0[k], normals[k], bounds[k], radius[k])
            reference = by_daqp_with_disc(u0[k], normals[k], bounds[k], radius[k])
            if reference is None:
                assert result.status == LawStatus.RELAXED, (height, k)
            elif result.status != LawStatus.RELAXED:
                compared += 1
                np.testing.assert_allclose(
                    result.point, reference, atol=1e-6, err_msg=f"{height} {k}"
                )

    assert compared > 500


def test_projection_with_the_disc_equals_trying_every_active_set():
    rng = np.random.default_rng(1)

    for height in (1, 2, 4, 7):
        normals, bounds = random_rows(rng, 300, height)
        u0 = rng.normal(size=(300, 2)) * 4
        radius = rng.uniform(0.5, 5.0, 300)
        for k in range(300):
            result = projected(u0[k], normals[k], bounds[k], radius[k])
            reference = nearest_in_rows_and_disc(u0[k], normals[k], bounds[k], radius[k])
            assert (result.status == LawStatus.RELAXED) == (reference is None), (height, k)
            if reference is not None:
                np.testing.assert_allclose(
                    result.point, reference, atol=1e-9, err_msg=f"{height} {k}"
                )


def test_slack_of_contradicting_rows_is_the_smallest_there_is():
    rng = np.random.default_rng(2)

    checked = 0
    for height in (2, 3, 5):
        normals, bounds = random_rows(rng, 25, height, spread=4.0)
        radius = rng.uniform(0.5, 4.0, 25)
        u0 = rng.normal(size=(25, 2))

        for k in range(25):
            result = projected(u0[k], normals[k], bounds[k], radius[k])
            if result.status != LawStatus.RELAXED:
                continue

            checked += 1
            assert abs(least_common_slack(normals[k], bounds[k], radius[k]) - result.slack) < 1e-7
            assert (bounds[k] - normals[k] @ result.point).max() <= result.slack + 1e-5
            assert np.hypot(*result.point) <= radius[k] * (1 + 1e-9)

    assert checked > 20


def test_project_leaves_contradicting_rows_to_whoever_knows_which_of_them_yield():
    rows = rows_of([[1.0, 0.0], [-1.0, 0.0]], [2.0, 4.0])
    result = project(Vec2(0.5, 0.0), rows, 10.0)
    assert result == (Vec2(0.5, 0.0), LawStatus.RELAXED, 0.0)


@pytest.mark.long
def test_yielding_rows_give_way_by_the_smallest_slack_that_leaves_the_firm_ones_whole():
    """The oracle shrinks the yielding rows by bisection, with the firm ones as they are."""
    rng = np.random.default_rng(5)
    count = 120
    yielding_normals, yielding_bounds = random_rows(rng, count, 3, spread=4.0)
    firm_normals, firm_bounds = random_rows(rng, count, 2, spread=1.0)
    radius = rng.uniform(2.0, 5.0, count)
    u0 = rng.normal(size=(count, 2))

    firm_held = firm_relaxed = 0
    for k in range(count):
        yielding = rows_of(yielding_normals[k], yielding_bounds[k])
        firm = rows_of(firm_normals[k], firm_bounds[k])
        if project(Vec2(*u0[k]), yielding + firm, radius[k]).status != LawStatus.RELAXED:
            continue

        result = relaxed_in_order(Vec2(*u0[k]), yielding, firm, radius[k])
        missed_firm = (firm_bounds[k] - firm_normals[k] @ result.point).max()
        assert result.status == LawStatus.RELAXED
        assert np.hypot(*result.point) <= radius[k] * (1 + 1e-9)

        if nearest_in_rows_and_disc(u0[k], firm_normals[k], firm_bounds[k], radius[k]) is None:
            firm_relaxed += 1
            least = least_common_slack(firm_normals[k], firm_bounds[k], radius[k])
            assert result.slack == pytest.approx(least, abs=1e-7)
            assert missed_firm <= least + 1e-5
        else:
            firm_held += 1
            least = least_slack_beside(
                yielding_normals[k], yielding_bounds[k], firm_normals[k], firm_bounds[k], radius[k]
            )
            missed = (yielding_bounds[k] - yielding_normals[k] @ result.point).max()
            assert missed_firm <= 0.001 * result.slack + 1e-6  # a thousand times stiffer
            assert missed <= least + 1e-5
            assert result.slack >= 0.98 * least - 1e-5

    assert firm_held > 20
    assert firm_relaxed > 4


def least_slack_beside(normals, bounds, firm_normals, firm_bounds, radius):
    """Return the smallest slack of the rows that leaves a point for them and the firm rows."""
    low = 0.0
    high = 100.0

    for _ in range(50):
        middle = 0.5 * (low + high)
        point = nearest_in_rows_and_disc(
            np.zeros(2),
            np.concatenate([normals, firm_normals]),
            np.concatenate([bounds - middle, firm_bounds]),
            radius,
            1e-12,
        )

        low, high = (low, middle) if point is not None else (middle, high)
    return high


def test_springs_come_to_rest_where_the_energy_is_least():
    """The energy is convex: where no step of a grid about a point leads down, it is the least."""
    rng = np.random.default_rng(3)
    directions = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    steps = 1e-4 * np.stack([np.cos(directions), np.sin(directions)], -1)
    moved = 0

    for height in (1, 2, 3, 8, 12):
        normals, bounds = random_rows(rng, 100, height)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        u0 = rng.normal(size=(100, 2)) * 2
        for k in range(100):
            point = np.array(pulled(Vec2(*u0[k]), rows_of(normals[k], bounds[k]), 25.0))
            points = np.vstack([point, point + steps])
            missing = np.maximum(0.0, bounds[k] - points @ normals[k].T)
            energy = ((points - u0[k]) ** 2).sum(-1) + 25.0 * (missing**2).sum(-1)
            assert (energy[1:] > energy[0]).all(), (height, k)
            moved += not np.array_equal(point, u0[k])
    assert moved > 200


def test_point_that_satisfies_everything_comes_back_bit_for_bit():
    result = projected([0.1, -0.2], [[1.0, 0.0], [0.0, 1.0]], [-1.0, -1.0], 3.0)
    assert result.point == (0.1, -0.2)
    assert (result.status, result.slack) == (LawStatus.INACTIVE, 0.0)


UNIT = st.floats(0.3, 2.0)
ROWS = st.lists(
    st.tuples(st.floats(-math.pi, math.pi), UNIT, st.floats(-4, 4)), min_size=1, max_size=6
)
POINTS = st.tuples(st.floats(-5, 5), st.floats(-5, 5))


def polar(rows, turn=0.0, factor=1.0):
    normals = [
        (size * math.cos(angle + turn), size * math.sin(angle + turn)) for angle, size, _ in rows
    ]
    return normals, [factor * bound for _, _, bound in rows]


def projected_polar(u, rows, radius):
    normals, bounds = rows
    return projected(u, normals, bounds, radius)


@settings(max_examples=200, deadline=None)
@given(POINTS, ROWS, st.floats(0.5, 6.0), st.randoms())
def test_independent_of_the_order_of_the_hard_rows(u, rows, radius, random):
    shuffled = list(rows)
    random.shuffle(shuffled)
    one = projected_polar(u, polar(rows), radius)
    two = projected_polar(u, polar(shuffled), radius)
    assert one.slack == pytest.approx(two.slack, abs=1e-7)
    if one.slack == two.slack == 0.0:
        np.testing.assert_allclose(one.point, two.point, atol=1e-4)


@settings(max_examples=200, deadline=None)
@given(POINTS, ROWS, st.floats(0.5, 6.0), st.floats(-math.pi, math.pi))
def test_rotation_equivariant(u, rows, radius, turn):
    turned = (
        math.cos(turn) * u[0] - math.sin(turn) * u[1],
        math.sin(turn) * u[0] + math.cos(turn) * u[1],
    )
    one = projected_polar(u, polar(rows), radius)
    two = projected_polar(turned, polar(rows, turn), radius)
    assert one.slack == pytest.approx(two.slack, abs=1e-6)
    if one.slack == two.slack == 0.0:
        x, y = one.point
        back = (math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y)
        np.testing.assert_allclose(back, two.point, atol=1e-4)


@settings(max_examples=200, deadline=None)
@given(POINTS, ROWS, st.floats(0.5, 6.0), st.floats(0.1, 10.0))
def test_homogeneous(u, rows, radius, factor):
    one = projected_polar(u, polar(rows), radius)
    scaled = (factor * u[0], factor * u[1])
    two = projected_polar(scaled, polar(rows, factor=factor), factor * radius)
    assert two.slack == pytest.approx(factor * one.slack, abs=1e-6)
    if one.slack == two.slack == 0.0:
        np.testing.assert_allclose(two.point, np.array(one.point) * factor, atol=1e-4)


def test_degenerate_rows_give_a_finite_point_inside_the_disc():
    normals = [[1.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [-1.0, 1e-14], [1e-9, 0.0]]
    for radius in (0.0, 3.0):
        result = projected([9.0, 9.0], normals, [2.0, 2.0, 5.0, 5.0, 1.0], radius)
        assert result.status == LawStatus.RELAXED
        assert np.isfinite(result.point).all()
        assert np.hypot(*result.point) <= radius + 1e-9


def test_opposed_rows_share_the_slack_equally():
    slack, point = least_slack(rows_of([[1.0, 0.0], [-1.0, 0.0]], [2.0, 4.0]), 10.0)
    assert slack == pytest.approx(3.0)
    assert point.x == pytest.approx(-1.0)


def test_no_rows_only_clip_to_the_disc():
    result = projected([3.0, 4.0], [], [], 2.5)
    np.testing.assert_allclose(result.point, [1.5, 2.0])
    assert result.status == LawStatus.SATURATED
