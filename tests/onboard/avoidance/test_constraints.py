"""Rows of what stands still and of the speed: half-planes that say what they should."""

import math

import numpy as np
import pytest

from onboard.avoidance.constraints import (
    can_bind,
    compensated,
    faded,
    fence_rows,
    obstacle_row,
    speed_row,
)
from onboard.avoidance.half_planes import HalfPlane
from onboard.avoidance.interface import NOT_A_VEHICLE
from onboard.avoidance.pairs import MAX_OBSTACLES, surface_of
from onboard.avoidance.params import Capsule
from onboard.types import LawStatus
from onboard.vectors import Vec2
from tests.onboard.avoidance.law_cases import FENCE, law_of, run


def vec(values):
    return Vec2(*map(float, values))


def missing_m_s2(row, thrust):
    """By how much a thrust misses the bound of a row."""
    (n_x, n_y), bound = row
    return bound - n_x * thrust.x - n_y * thrust.y


def row_at(capsule, position, velocity, params):
    surface = surface_of(capsule, vec(position), vec(velocity), params.spacing.clearance_m)
    return obstacle_row(surface, params.gains)


def test_row_beside_a_wall_constrains_only_the_speed_towards_it():
    params = law_of()
    wall = Capsule(Vec2(-50.0, 0.0), Vec2(50.0, 0.0), 0.0)
    along, still, towards = (
        row_at(wall, (0.0, 1.0), v, params) for v in ((3.0, 0.0), (0.0, 0.0), (0.0, -1.0))
    )
    assert along.bound_m_s2 == pytest.approx(still.bound_m_s2)
    assert towards.bound_m_s2 > still.bound_m_s2


def test_rows_of_a_moving_vehicle_are_the_rate_of_the_constraint():
    """Finite differences: along a motion under u, h'' + (k_1 + k_2) h' + k_1 k_2 h is e.u minus the
    bound.
    """
    params = law_of()
    rng = np.random.default_rng(4)
    step = 1e-3
    k_1 = params.gains.static_kappa_1_1_s
    k_2 = params.gains.kappa_2_1_s
    for case in range(50):
        x1, y1, x2, y2 = rng.uniform(-1, 1, 4).tolist()
        capsule = Capsule(Vec2(x1, y1), Vec2(x2, y2), float(rng.uniform(0, 0.5)))
        p = rng.uniform(-3, 3, 2)
        v = rng.normal(size=2)
        u = rng.normal(size=2)
        d = capsule.radius_m + params.spacing.clearance_m

        def half_square(t, p=p, v=v, u=u, capsule=capsule, d=d):
            """|e|^2 / 2 from a row's normal: e / d times d."""
            e = d * np.array(row_at(capsule, p + t * v + 0.5 * t * t * u, v + t * u, params).normal)
            return 0.5 * (e @ e - d * d)

        before, now, after = (half_square(t) for t in (-step, 0.0, step))
        rate = (after - before) / (2 * step)
        bend = (after - 2 * now + before) / step**2
        normal, bound = row_at(capsule, p, v, params)
        derivative = bend + (k_1 + k_2) * rate + k_1 * k_2 * now
        assert d * (normal @ u - bound) == pytest.approx(derivative, abs=1e-4), case


def test_an_obstacle_ahead_is_turned_about_and_named_as_no_vehicle():
    out = run(
        [-1.3, 0, 1],
        [0.5, 0, 0],
        [2.0, 0, 0],
        [],
        law_of(),
        obstacles=[Capsule(Vec2(0, 0), Vec2(0, 0), 0.4)],
    )
    assert out.status == LawStatus.SATURATED
    assert out.active_neighbour == NOT_A_VEHICLE
    assert out.thrust.thrust_enu_m_s2.x < 2.0
    assert out.thrust.thrust_enu_m_s2.y < 0.0


def test_only_the_nearest_obstacles_count():
    params = law_of()
    near = [Capsule(Vec2(-1.0, 0.1 * k), Vec2(-1.0, 0.1 * k), 0.1) for k in range(MAX_OBSTACLES)]
    far = [Capsule(Vec2(5.0, k), Vec2(5.0, k), 0.1) for k in range(9)]
    one = run([0, 0, 1], [-0.5, 0, 0], [-2.0, 0, 0], [], params, obstacles=near)
    two = run([0, 0, 1], [-0.5, 0, 0], [-2.0, 0, 0], [], params, obstacles=[*far, *near])
    assert one == two


def test_speed_row_holds_a_vehicle_below_its_limit():
    normal, bound = speed_row(Vec2(1.0, 0.0), 1.0, jerk_m_s3=6.0)
    assert bound == pytest.approx(0.0)  # at the limit: no further acceleration along the motion
    assert normal @ np.array([1.0, 5.0]) < 0.0


def _largest_m_s2(left_m_s: float, jerk_m_s3: float) -> float:
    """Return the acceleration along the motion that a row allows below its limit."""
    row = speed_row(Vec2(1.0, 0.0), 1.0 + left_m_s, jerk_m_s3)
    return -row.bound_m_s2


def test_an_acceleration_may_be_only_as_large_as_its_jerk_takes_away_before_the_limit():
    assert _largest_m_s2(0.02, 6.0) == pytest.approx(0.16)  # near the limit: in proportion
    assert _largest_m_s2(0.75, 6.0) == pytest.approx(3.0)  # sqrt(2 * 6 * 0.75)
    assert _largest_m_s2(-0.1, 6.0) == pytest.approx(-0.8)  # beyond it: brake

    # the speed that is gained while a constant jerk reduces the acceleration to zero
    gained_m_s = _largest_m_s2(0.75, 6.0) ** 2 / (2.0 * 6.0)
    assert gained_m_s == pytest.approx(0.75)


def test_a_vehicle_that_flees_accelerates_as_strongly_as_it_can():
    assert _largest_m_s2(0.75, math.inf) == pytest.approx(6.0)


def test_wall_requires_braking_that_suffices_and_an_open_side_nothing():
    closed = law_of({"fence_enu_m": FENCE})
    still = Vec2(0.0, 0.0)
    outwards = Vec2(1.0, 0.0)
    middle = fence_rows(still, outwards, closed.fence, closed.gains)
    near = fence_rows(Vec2(2.9, 0.0), outwards, closed.fence, closed.gains)
    assert len(middle) == 4
    assert near[2].normal == (-1.0, 0.0)
    assert near[2].bound_m_s2 > 0.0 > middle[2].bound_m_s2
    opened = law_of()
    assert all(
        not can_bind(row, 100.0) for row in fence_rows(still, outwards, opened.fence, opened.gains)
    )


def test_compensation_moves_the_bound_by_its_part_along_the_normal():
    row = HalfPlane(Vec2(0.6, 0.8), 1.0)
    thrust = Vec2(0.3, -0.2)
    compensation = Vec2(1.0, 2.0)
    both = Vec2(1.3, 1.8)
    with_compensation = compensated(row, compensation)
    assert missing_m_s2(with_compensation, both) == pytest.approx(missing_m_s2(row, thrust))


def test_faded_row_lies_between_the_thrust_and_its_own_bound():
    row = HalfPlane(Vec2(0.0, 1.0), 2.0)
    thrust = Vec2(5.0, 1.0)
    rows = [faded(row, thrust, strength) for strength in (0.0, 0.5, 1.0)]
    assert [missing_m_s2(one, thrust) for one in rows] == [0.0, 0.5, 1.0]
