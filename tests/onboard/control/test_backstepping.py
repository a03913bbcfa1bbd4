"""Backstepping: signs, Lyapunov decrease, equivariance, homogeneity, bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard.constants import GRAVITY_M_S2
from onboard.control import backstepping
from onboard.control.backstepping import BacksteppingParams
from onboard.types import TrajectorySetpoint
from onboard.vectors import Vec3
from tests.oracles.rotation import quaternion_from_yaw, rotate

Array = np.ndarray
RNG = np.random.default_rng(3)
UP = np.array([0.0, 0.0, GRAVITY_M_S2])
OPEN = BacksteppingParams(
    max_acceleration_m_s2=1e6,
    max_vertical_acceleration_m_s2=1e6,
    max_position_error_m=1e6,
    max_height_error_m=1e6,
)


def vec(values: object) -> Vec3:
    return Vec3(*map(float, values))  # type: ignore[call-overload]


def at(
    position: object, velocity: object = (0, 0, 0), acceleration: object = (0, 0, 0)
) -> TrajectorySetpoint:
    return TrajectorySetpoint(vec(position), vec(velocity), vec(acceleration))


def acceleration(
    p: Array, v: Array, setpoint: TrajectorySetpoint, params: BacksteppingParams
) -> Array:
    return np.array(backstepping.step(vec(p), vec(v), setpoint, params).thrust_enu_m_s2) - UP


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["position", "velocity", "acceleration"])
def test_a_setpoint_to_the_east_north_or_up_thrusts_that_way(
    axis: int, sign: float, kind: str
) -> None:
    ahead = np.zeros(3)
    ahead[axis] = 0.2 * sign
    setpoint = at(**{"position": np.zeros(3), kind: ahead})
    a = acceleration(np.zeros(3), np.zeros(3), setpoint, BacksteppingParams())
    assert a[axis] * sign > 0.0
    assert np.allclose(np.delete(a, axis), 0.0)


def test_on_the_setpoint_only_feed_forward_and_gravity_remain() -> None:
    p, v, a = RNG.normal(size=(3, 3)) * 0.5
    assert np.allclose(acceleration(p, v, at(p, v, a), BacksteppingParams()), a)


@pytest.mark.parametrize("radius_m", [1e6, 0.4])
def test_the_lyapunov_function_falls_along_the_closed_loop(radius_m: float) -> None:
    """W = c H(e) + |z|^2/2 has the derivative -c k1 |s|^2 - k2 |z|^2, clamped or not."""
    params = OPEN._replace(max_position_error_m=radius_m)
    k1 = 1.5
    k2 = 4.0
    c = 0.5
    h = 1e-6

    def parts(p: Array, v: Array, ps: Array, vs: Array) -> tuple[float, float, float]:
        e = ps - p
        size = math.hypot(e[0], e[1])
        s = e * [min(1.0, radius_m / size), min(1.0, radius_m / size), 1.0]
        huber = 0.5 * size**2 if size <= radius_m else radius_m * (size - 0.5 * radius_m)
        z = v - (vs + k1 * s)
        return c * (huber + 0.5 * e[2] ** 2) + 0.5 * float(z @ z), float(s @ s), float(z @ z)

    for ps, vs, accel, offset, v in RNG.normal(size=(200, 5, 3)):
        offset[2] = RNG.uniform(-0.3, 0.3)
        p = ps + offset
        a = acceleration(p, v, at(ps, vs, accel), params)
        w, s2, z2 = parts(p, v, ps, vs)
        later, _, _ = parts(p + h * v, v + h * a, ps + h * vs, vs + h * accel)
        earlier, _, _ = parts(p - h * v, v - h * a, ps - h * vs, vs - h * accel)
        assert (later - earlier) / (2 * h) == pytest.approx(
            -c * k1 * s2 - k2 * z2, rel=1e-4, abs=1e-4
        )
        assert w > 0.0


def test_turning_and_moving_the_world_turns_the_thrust() -> None:
    q = quaternion_from_yaw(1.1)
    shift = np.array([3.0, -2.0, 1.0])
    params = BacksteppingParams()

    def turned(vector: Array) -> Array:
        return np.array(list(rotate(q, vec(vector))))

    for p, v, ps, vs, a in RNG.normal(size=(50, 5, 3)):
        plain = acceleration(p, v, at(ps, vs, a), params)
        other = acceleration(
            turned(p) + shift, turned(v), at(turned(ps) + shift, turned(vs), turned(a)), params
        )
        assert np.allclose(other, turned(plain), atol=1e-12)


def test_scaling_length_and_time_scales_the_acceleration() -> None:
    length = 3.0
    time = 0.5
    base = BacksteppingParams()
    scaled = BacksteppingParams(
        position_gain_1_s=1.5 / time,
        velocity_gain_1_s=4.0 / time,
        coupling_1_s2=0.5 / time**2,
        max_position_error_m=base.max_position_error_m * length,
        max_height_error_m=base.max_height_error_m * length,
        max_acceleration_m_s2=4.0 * length / time**2,
        max_vertical_acceleration_m_s2=2.5 * length / time**2,
    )
    u = length / time
    for p, v, ps, vs, a in RNG.normal(size=(20, 5, 3)):
        one = acceleration(p, v, at(ps, vs, a), base)
        two = acceleration(length * p, u * v, at(length * ps, u * vs, u / time * a), scaled)
        assert np.allclose(two, length / time**2 * one)


def test_the_answer_is_bounded_however_far_the_setpoint() -> None:
    for p in RNG.normal(size=(500, 3)) * 10.0 ** RNG.uniform(-2, 6, (500, 1)):
        a = acceleration(p, 5 * RNG.normal(size=3), at(np.zeros(3)), BacksteppingParams())
        assert math.hypot(a[0], a[1]) <= 4.0 + 1e-9
        assert abs(a[2]) <= 2.5 + 1e-9


def test_a_far_setpoint_is_approached_at_a_bounded_speed() -> None:
    params = BacksteppingParams()
    p = np.zeros(3)
    v = np.zeros(3)
    fastest = 0.0
    for _ in range(1500):
        v = v + 0.02 * acceleration(p, v, at([8.0, 0.0, 0.0]), params)
        p = p + 0.02 * v
        fastest = max(fastest, float(v[0]))
    assert fastest < params.max_position_error_m * (1.5 + 0.5 / 4.0) * 1.05
    assert np.allclose(p, [8.0, 0.0, 0.0], atol=1e-3)


def test_a_far_setpoint_in_the_plane_does_not_weaken_the_hold_of_height() -> None:
    low = np.array([0.0, 0.0, -0.2])
    near = acceleration(low, np.zeros(3), at([0.0, 0.0, 0.0]), BacksteppingParams())
    far = acceleration(low, np.zeros(3), at([100.0, 0.0, 0.0]), BacksteppingParams())
    assert near[2] == far[2] > 0.0


def test_values_that_are_not_finite_pass_through() -> None:
    lost = acceleration(np.full(3, np.nan), np.zeros(3), at(np.zeros(3)), BacksteppingParams())
    assert np.isnan(lost[0])  # allocation levels out and says so; it is not hidden here
