"""Allocation: exact, bounded, height first, and different from eq. (2) read as ZYX."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard import frames
from onboard.constants import GRAVITY_M_S2
from onboard.control import allocation
from onboard.control.allocation import AllocationParams
from onboard.types import AttitudeSetpoint, Thrust
from onboard.vectors import Vec3
from tests.oracles.paper_angles import euler_from_thrust
from tests.oracles.rotation import quaternion_from_yaw, quaternion_multiply, rotate

G = GRAVITY_M_S2
WIDE = AllocationParams(math.radians(60.0), 0.5, min_thrust_frac=0.01, max_thrust_frac=1.0)
RNG = np.random.default_rng(2)


def thrusts(n: int, spread: float = 5.0) -> list[Thrust]:
    f = RNG.uniform(-spread, spread, (n, 3))
    f[:, 2] = RNG.uniform(0.7, 1.4, n) * G
    return [Thrust(Vec3(*row)) for row in f.tolist()]


def tilt_rad(attitude: AttitudeSetpoint) -> float:
    _, x, y, _ = attitude.quaternion_wxyz
    return 2.0 * math.asin(min(1.0, math.hypot(x, y)))


def test_hover_is_level_at_the_hover_throttle() -> None:
    attitude = allocation.allocate(Thrust(Vec3(0.0, 0.0, G)), 0.0, 0.75, WIDE)
    assert attitude.quaternion_wxyz == pytest.approx((1.0, 0.0, 0.0, 0.0))
    assert attitude.thrust_frac == pytest.approx(0.75)


def test_the_attitude_points_the_thrust_exactly_and_keeps_the_yaw() -> None:
    for thrust in thrusts(500):
        f = np.array(thrust.thrust_enu_m_s2)
        yaw = float(RNG.uniform(-math.pi, math.pi))
        attitude = allocation.allocate(thrust, yaw, 0.4, WIDE)
        length = np.linalg.norm(f)
        np.testing.assert_allclose(frames.body_up(attitude.quaternion_wxyz), f / length, atol=1e-12)
        assert frames.yaw_from_quaternion(attitude.quaternion_wxyz) == pytest.approx(yaw, abs=1e-9)
        assert np.linalg.norm(attitude.quaternion_wxyz) == pytest.approx(1.0, abs=1e-12)
        assert attitude.thrust_frac == pytest.approx(length / G * 0.4)
        assert attitude.quaternion_wxyz[0] >= 0.0


def test_thrust_to_the_east_pitches_a_vehicle_that_faces_east_nose_down() -> None:
    q = allocation.allocate(Thrust(Vec3(1.0, 0.0, G)), 0.0, 0.5, WIDE).quaternion_wxyz
    nose = rotate(q, Vec3(1.0, 0.0, 0.0))
    assert nose.z < -0.05
    assert abs(nose.y) < 1e-12


def test_thrust_to_the_north_rolls_a_vehicle_that_faces_east_left_side_down() -> None:
    q = allocation.allocate(Thrust(Vec3(0.0, 1.0, G)), 0.0, 0.5, WIDE).quaternion_wxyz
    left = rotate(q, Vec3(0.0, 1.0, 0.0))
    assert left.z < -0.05
    assert abs(left.x) < 1e-12


def test_a_turned_world_turns_the_attitude() -> None:
    turn = 0.7
    q_turn = quaternion_from_yaw(turn)
    for thrust in thrusts(100):
        plain = allocation.allocate(thrust, 0.2, 0.5, WIDE)
        turned = allocation.allocate(
            Thrust(rotate(q_turn, thrust.thrust_enu_m_s2)), 0.2 + turn, 0.5, WIDE
        )
        expected = quaternion_multiply(q_turn, plain.quaternion_wxyz)
        assert abs(np.dot(expected, turned.quaternion_wxyz)) == pytest.approx(1.0, abs=1e-12)
        assert plain.thrust_frac == pytest.approx(turned.thrust_frac)


def test_scaling_the_thrust_scales_the_throttle_and_leaves_the_attitude() -> None:
    for thrust in thrusts(100, 2.0):
        x, y, z = thrust.thrust_enu_m_s2
        one = allocation.allocate(thrust, 0.0, 0.3, WIDE)
        two = allocation.allocate(Thrust(Vec3(1.7 * x, 1.7 * y, 1.7 * z)), 0.0, 0.3, WIDE)
        np.testing.assert_allclose(one.quaternion_wxyz, two.quaternion_wxyz, atol=1e-12)
        assert 1.7 * one.thrust_frac == pytest.approx(two.thrust_frac)


def test_limits_hold_for_any_thrust() -> None:
    params = AllocationParams(math.radians(25.0), 0.75, min_thrust_frac=0.1, max_thrust_frac=0.95)
    for f in RNG.normal(size=(2000, 3)) * 10.0 ** RNG.uniform(-3, 3, (2000, 1)):
        attitude = allocation.allocate(Thrust(Vec3(*f.tolist())), 0.0, 0.75, params)
        assert tilt_rad(attitude) <= math.radians(25.0) + 1e-9
        assert 0.1 - 1e-9 <= attitude.thrust_frac <= 0.95 + 1e-9


def test_height_comes_before_tracking_when_the_throttle_runs_out() -> None:
    params = AllocationParams(math.radians(40.0), 0.75, max_thrust_frac=1.0)
    # more than thrust/weight 1.33 allows
    limited = allocation.limit(Thrust(Vec3(6.0, 0.0, 1.25 * G)), 0.75, params).thrust_enu_m_s2
    assert limited.z == pytest.approx(1.25 * G)
    assert 0.0 < limited.x < 6.0
    assert limited.y == 0.0
    assert np.linalg.norm(limited) == pytest.approx(G / 0.75)


def test_the_tilt_limit_shortens_the_horizontal_part_only() -> None:
    params = AllocationParams(math.radians(20.0), 0.5)
    limited = allocation.limit(Thrust(Vec3(6.0, 8.0, G)), 0.5, params).thrust_enu_m_s2
    assert limited.z == pytest.approx(G)
    assert math.hypot(limited.x, limited.y) == pytest.approx(G * math.tan(math.radians(20.0)))
    assert limited.x / limited.y == pytest.approx(6.0 / 8.0)


def test_limiting_twice_changes_nothing() -> None:
    params = AllocationParams(math.radians(25.0), 0.75)
    for thrust in thrusts(300, 20.0):
        once = allocation.limit(thrust, 0.75, params)
        twice = allocation.limit(once, 0.75, params)
        np.testing.assert_allclose(once.thrust_enu_m_s2, twice.thrust_enu_m_s2, atol=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_unusable_input_levels_out_at_hover(bad: float) -> None:
    params = AllocationParams(0.4, 0.6)
    good = Thrust(Vec3(1.0, 2.0, G))
    for thrust, yaw, hover, expected_frac in (
        (Thrust(Vec3(1.0, bad, G)), 0.3, 0.5, 0.5),
        (good, bad, 0.5, 0.5),
        (good, 0.3, bad, 0.6),
        (good, 0.3, 0.0, 0.6),
    ):
        assert not allocation.is_usable(thrust, yaw, hover)
        attitude = allocation.allocate(thrust, yaw, hover, params)
        assert tilt_rad(attitude) == 0.0
        assert attitude.thrust_frac == pytest.approx(expected_frac)
        if math.isfinite(yaw):
            assert frames.yaw_from_quaternion(attitude.quaternion_wxyz) == pytest.approx(0.3)
    assert allocation.is_usable(good, 0.3, 0.5)
    assert tilt_rad(allocation.allocate(good, 0.3, 0.5, params)) > 0.1


def rx(a: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])


def ry(a: float) -> np.ndarray:
    return np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])


@pytest.mark.parametrize(
    ("tilt_deg", "error_m_s2"), [(10.0, 0.01), (20.0, 0.11), (30.0, 0.41), (40.0, 1.09)]
)
def test_equation_2_is_exact_as_roll_after_pitch_and_wrong_as_zyx(
    tilt_deg: float, error_m_s2: float
) -> None:
    """Equation (2) read in the paper's order returns the thrust; read as PX4 composes angles it
    misses.
    """
    side = math.tan(math.radians(tilt_deg)) / math.sqrt(2.0)
    f = np.array([side, side, 1.0]) * G  # x forward, y right, z up; the height is held
    roll, pitch, length = euler_from_thrust(*f.tolist())
    # forward, right, down is right-handed; thrust is -z there
    frd = np.array([f[0], f[1], -f[2]])
    up = np.array([0.0, 0.0, -length])
    assert np.allclose(rx(roll) @ ry(pitch) @ up, frd, atol=1e-9)
    assert np.linalg.norm(ry(pitch) @ rx(roll) @ up - frd) == pytest.approx(error_m_s2, abs=0.03)


def test_equation_2_and_the_exact_allocation_agree_for_a_tilt_about_one_axis() -> None:
    roll, pitch, _ = euler_from_thrust(2.0, 0.0, G)
    q = allocation.allocate(Thrust(Vec3(2.0, 0.0, G)), 0.0, 0.5, WIDE).quaternion_wxyz
    _, x, y, _ = frames.ned_frd_from_enu_flu(q)
    assert roll == 0.0
    assert 2.0 * math.asin(math.hypot(x, y)) == pytest.approx(abs(pitch))
