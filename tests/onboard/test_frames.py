"""Frames: signs by hand, permutations against rotation matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest

from onboard import frames
from tests.oracles.rotation import quaternion_from_yaw, quaternion_multiply, rotate

RNG = np.random.default_rng(1)
ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLIP = np.diag([1.0, -1.0, -1.0])


def random_quaternions(*shape: int) -> np.ndarray:
    q = RNG.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def matrix(q: Sequence[float] | np.ndarray) -> np.ndarray:
    """Textbook rotation matrix, the oracle."""
    w, x, y, z = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


@pytest.mark.parametrize(
    ("ned", "enu"),
    [
        ((1, 0, 0), (0, 1, 0)),
        ((0, 1, 0), (1, 0, 0)),
        ((0, 0, 1), (0, 0, -1)),
        ((1, 2, 3), (2, 1, -3)),
    ],
)
def test_north_east_down_become_east_north_up(ned: frames.Triple, enu: frames.Triple) -> None:
    assert np.array_equal(frames.enu_from_ned(ned), enu)
    assert np.array_equal(frames.ned_from_enu(enu), ned)


def test_attitude_conversion_agrees_with_matrices() -> None:
    for q in random_quaternions(50):
        expected = ENU_FROM_NED @ matrix(q) @ FLIP
        assert np.allclose(matrix(frames.enu_flu_from_ned_frd(q)), expected, atol=1e-12)


def test_attitude_conversion_there_and_back_is_the_identity() -> None:
    for q in random_quaternions(35):
        assert np.allclose(
            frames.ned_frd_from_enu_flu(frames.enu_flu_from_ned_frd(q)), q, atol=1e-15
        )


def test_level_px4_attitude_facing_north_has_its_nose_north_and_its_top_up() -> None:
    q = frames.enu_flu_from_ned_frd((1.0, 0.0, 0.0, 0.0))
    assert np.allclose(rotate(q, (1.0, 0.0, 0.0)), [0.0, 1.0, 0.0], atol=1e-12)
    assert np.allclose(frames.body_up(q), [0.0, 0.0, 1.0], atol=1e-12)
    assert frames.yaw_from_quaternion(q) == pytest.approx(math.pi / 2)


def test_px4_pitch_down_accelerates_towards_the_nose() -> None:
    # FRD: negative pitch is nose down
    pitch_down = (math.cos(-0.1), 0.0, math.sin(-0.1), 0.0)
    up = frames.body_up(frames.enu_flu_from_ned_frd(pitch_down))
    assert up[1] > 0.1
    assert abs(up.x) < 1e-12


def test_px4_roll_right_accelerates_to_the_right() -> None:
    roll_right = (math.cos(0.1), math.sin(0.1), 0.0, 0.0)
    up = frames.body_up(frames.enu_flu_from_ned_frd(roll_right))
    assert up[0] > 0.1
    assert abs(up.y) < 1e-12


def test_rotate_and_multiply_agree_with_matrices() -> None:
    for first, second in zip(random_quaternions(30), random_quaternions(30), strict=True):
        v = RNG.normal(size=3)
        x, y, z = v
        assert np.allclose(rotate(first, (x, y, z)), matrix(first) @ v, atol=1e-12)
        assert np.allclose(
            matrix(quaternion_multiply(first, second)),
            matrix(first) @ matrix(second),
            atol=1e-12,
        )
        assert np.allclose(frames.body_up(first), matrix(first)[:, 2], atol=1e-12)


def test_yaw_survives_the_way_through_a_quaternion() -> None:
    for yaw in np.linspace(-3.1, 3.1, 41):
        assert frames.yaw_from_quaternion(quaternion_from_yaw(yaw)) == pytest.approx(yaw, abs=1e-12)


def test_a_turn_about_up_is_the_product_with_that_turn() -> None:
    for attitude, yaw in zip(random_quaternions(41), np.linspace(-3.1, 3.1, 41), strict=True):
        product = quaternion_multiply(quaternion_from_yaw(yaw), attitude)
        assert np.allclose(frames.turned_about_up(attitude, yaw), product, atol=1e-15)
