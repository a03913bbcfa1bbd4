"""Allocation: exact, bounded, height first, and different from eq. (2) read as ZYX."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from onboard import frames
from onboard.control import allocation
from onboard.control.allocation import AllocationParams
from onboard.types import GRAVITY_M_S2, Thrust

G = GRAVITY_M_S2
WIDE = AllocationParams(max_tilt_rad=math.radians(60.0), min_thrust_frac=0.01, max_thrust_frac=1.0)
RNG = np.random.default_rng(2)


def thrusts(n: int, spread: float = 5.0) -> np.ndarray:
    f = RNG.uniform(-spread, spread, (n, 3))
    f[:, 2] = RNG.uniform(0.7, 1.4, n) * G
    return f


def test_hover_is_level_at_the_hover_throttle() -> None:
    attitude = allocation.allocate(Thrust(np.array([0.0, 0.0, G])), 0.0, 0.75, params=WIDE)
    assert np.allclose(attitude.quaternion_wxyz, [1.0, 0.0, 0.0, 0.0])
    assert attitude.thrust_frac == pytest.approx(0.75)


def test_the_attitude_points_the_thrust_exactly_and_keeps_the_yaw() -> None:
    f, yaw = thrusts(500), RNG.uniform(-math.pi, math.pi, 500)
    attitude = allocation.allocate(Thrust(f), yaw, np.full(500, 0.4), params=WIDE)
    up = frames.body_up(attitude.quaternion_wxyz)
    length = np.linalg.norm(f, axis=-1)
    assert np.allclose(up, f / length[:, None], atol=1e-12)
    assert np.allclose(frames.yaw_from_quaternion(attitude.quaternion_wxyz), yaw, atol=1e-9)
    assert np.allclose(np.linalg.norm(attitude.quaternion_wxyz, axis=-1), 1.0, atol=1e-12)
    assert np.allclose(attitude.thrust_frac, length / G * 0.4)
    assert (attitude.quaternion_wxyz[:, 0] >= 0.0).all()


def test_thrust_to_the_east_pitches_a_vehicle_that_faces_east_nose_down() -> None:
    q = allocation.allocate(Thrust(np.array([1.0, 0.0, G])), 0.0, 0.5, params=WIDE).quaternion_wxyz
    nose = frames.rotate(q, np.array([1.0, 0.0, 0.0]))
    assert nose[2] < -0.05
    assert abs(nose[1]) < 1e-12


def test_thrust_to_the_north_rolls_a_vehicle_that_faces_east_left_side_down() -> None:
    q = allocation.allocate(Thrust(np.array([0.0, 1.0, G])), 0.0, 0.5, params=WIDE).quaternion_wxyz
    left = frames.rotate(q, np.array([0.0, 1.0, 0.0]))
    assert left[2] < -0.05
    assert abs(left[0]) < 1e-12


def test_a_turned_world_turns_the_attitude() -> None:
    f, turn = thrusts(100), 0.7
    q_turn = frames.quaternion_from_yaw(turn)
    plain = allocation.allocate(Thrust(f), np.full(100, 0.2), np.full(100, 0.5), params=WIDE)
    turned = allocation.allocate(
        Thrust(frames.rotate(q_turn, f)), np.full(100, 0.2 + turn), np.full(100, 0.5), params=WIDE
    )
    expected = frames.quaternion_multiply(np.broadcast_to(q_turn, (100, 4)), plain.quaternion_wxyz)
    assert np.allclose(np.abs((expected * turned.quaternion_wxyz).sum(-1)), 1.0, atol=1e-12)
    assert np.allclose(plain.thrust_frac, turned.thrust_frac)


def test_scaling_the_thrust_scales_the_throttle_and_leaves_the_attitude() -> None:
    f = thrusts(100, 2.0)
    one = allocation.allocate(Thrust(f), np.zeros(100), np.full(100, 0.3), params=WIDE)
    two = allocation.allocate(Thrust(1.7 * f), np.zeros(100), np.full(100, 0.3), params=WIDE)
    assert np.allclose(one.quaternion_wxyz, two.quaternion_wxyz, atol=1e-12)
    assert np.allclose(1.7 * one.thrust_frac, two.thrust_frac)


def test_limits_hold_for_any_thrust() -> None:
    params = AllocationParams(max_tilt_rad=math.radians(25.0), min_thrust_frac=0.1, max_thrust_frac=0.95)
    f = RNG.normal(size=(2000, 3)) * 10.0 ** RNG.uniform(-3, 3, (2000, 1))
    attitude = allocation.allocate(Thrust(f), np.zeros(2000), np.full(2000, 0.75), params=params)
    assert (allocation.tilt_rad(attitude) <= math.radians(25.0) + 1e-9).all()
    assert (attitude.thrust_frac >= 0.1 - 1e-9).all()
    assert (attitude.thrust_frac <= 0.95 + 1e-9).all()


def test_height_comes_before_tracking_when_the_throttle_runs_out() -> None:
    params = AllocationParams(max_tilt_rad=math.radians(40.0), max_thrust_frac=1.0)
    asked = np.array([6.0, 0.0, 1.25 * G])  # more than thrust/weight 1.33 allows
    got = allocation.limit(Thrust(asked), np.float64(0.75), params=params).thrust_enu_m_s2
    assert got[2] == pytest.approx(1.25 * G)
    assert 0.0 < got[0] < 6.0
    assert got[1] == 0.0
    assert np.linalg.norm(got) == pytest.approx(G / 0.75)


def test_the_tilt_limit_shortens_the_horizontal_part_only() -> None:
    params = AllocationParams(max_tilt_rad=math.radians(20.0))
    got = allocation.limit(Thrust(np.array([6.0, 8.0, G])), np.float64(0.5), params=params).thrust_enu_m_s2
    assert got[2] == pytest.approx(G)
    assert np.hypot(got[0], got[1]) == pytest.approx(G * math.tan(math.radians(20.0)))
    assert got[0] / got[1] == pytest.approx(6.0 / 8.0)


def test_limiting_twice_changes_nothing() -> None:
    params = AllocationParams(max_tilt_rad=math.radians(25.0))
    once = allocation.limit(Thrust(thrusts(300, 20.0)), np.full(300, 0.75), params=params)
    twice = allocation.limit(once, np.full(300, 0.75), params=params)
    assert np.allclose(once.thrust_enu_m_s2, twice.thrust_enu_m_s2, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_unusable_input_levels_out_at_hover_without_a_warning(bad: float) -> None:
    params = AllocationParams(max_tilt_rad=0.4, fallback_hover_thrust_frac=0.6)
    f, yaw, hover = np.tile([1.0, 2.0, G], (4, 1)), np.full(4, 0.3), np.full(4, 0.5)
    f[0, 1], yaw[1], hover[2] = bad, bad, bad
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        attitude = allocation.allocate(Thrust(f), yaw, hover, params=params)
        usable = allocation.is_usable(Thrust(f), yaw, hover)
    assert usable.tolist() == [False, False, False, True]
    assert np.allclose(allocation.tilt_rad(attitude)[:3], 0.0)
    assert np.allclose(attitude.thrust_frac[:3], [0.5, 0.5, 0.6])
    assert frames.yaw_from_quaternion(attitude.quaternion_wxyz)[0] == pytest.approx(0.3)
    assert allocation.tilt_rad(attitude)[3] > 0.1


def test_batch_equals_loop() -> None:
    f, yaw, hover = thrusts(12).reshape(3, 4, 3), RNG.uniform(-3, 3, (3, 4)), RNG.uniform(0.3, 0.8, (3, 4))
    params = AllocationParams(max_tilt_rad=0.4)
    together = allocation.allocate(Thrust(f), yaw, hover, params=params)
    for i in range(3):
        for j in range(4):
            alone = allocation.allocate(Thrust(f[i, j]), yaw[i, j], hover[i, j], params=params)
            assert np.array_equal(alone.quaternion_wxyz, together.quaternion_wxyz[i, j])
            assert alone.thrust_frac == together.thrust_frac[i, j]


def rx(a: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])


def ry(a: float) -> np.ndarray:
    return np.array([[math.cos(a), 0, math.sin(a)], [0, 1, 0], [-math.sin(a), 0, math.cos(a)]])


@pytest.mark.parametrize(("tilt_deg", "error_m_s2"), [(10.0, 0.01), (20.0, 0.11), (30.0, 0.41), (40.0, 1.09)])
def test_equation_2_is_exact_as_roll_after_pitch_and_wrong_as_zyx(tilt_deg: float, error_m_s2: float) -> None:
    """Equation (2) read in the paper's order returns the thrust; read as PX4 composes angles it misses."""
    side = math.tan(math.radians(tilt_deg)) / math.sqrt(2.0)
    f = np.array([side, side, 1.0]) * G  # x forward, y right, z up; the height is held
    roll, pitch, length = (float(value) for value in allocation.euler_from_thrust_paper(f))
    # forward, right, down is right-handed; thrust is -z there
    frd = np.array([f[0], f[1], -f[2]])
    up = np.array([0.0, 0.0, -length])
    assert np.allclose(rx(roll) @ ry(pitch) @ up, frd, atol=1e-9)
    assert np.linalg.norm(ry(pitch) @ rx(roll) @ up - frd) == pytest.approx(error_m_s2, abs=0.03)


def test_equation_2_and_the_exact_allocation_agree_for_a_tilt_about_one_axis() -> None:
    roll, pitch, _ = allocation.euler_from_thrust_paper(np.array([2.0, 0.0, G]))
    q = allocation.allocate(Thrust(np.array([2.0, 0.0, G])), 0.0, 0.5, params=WIDE).quaternion_wxyz
    ned = frames.quaternion_ned_frd_from_enu_flu(q)
    assert roll == 0.0
    assert 2.0 * math.asin(abs(np.hypot(ned[1], ned[2]))) == pytest.approx(abs(float(pitch)))
