"""Backstepping: signs, Lyapunov decrease, equivariance, homogeneity, bounds."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from onboard import frames
from onboard.control import backstepping
from onboard.control.backstepping import BacksteppingParams
from onboard.types import GRAVITY_M_S2, Array, TrajectorySetpoint

RNG = np.random.default_rng(3)
UP = np.array([0.0, 0.0, GRAVITY_M_S2])
OPEN = BacksteppingParams(max_acceleration_m_s2=1e6, max_vertical_acceleration_m_s2=1e6, max_position_error_m=1e6)


def at(position: object, velocity: object = (0, 0, 0), acceleration: object = (0, 0, 0)) -> TrajectorySetpoint:
    return TrajectorySetpoint(*(np.array(v, dtype=float) for v in (position, velocity, acceleration)))


def acceleration(p: Array, v: Array, setpoint: TrajectorySetpoint, params: BacksteppingParams) -> Array:
    return backstepping.step(p, v, setpoint, params=params).thrust_enu_m_s2 - UP


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("kind", ["position", "velocity", "acceleration"])
def test_a_setpoint_to_the_east_north_or_up_thrusts_that_way(axis: int, sign: float, kind: str) -> None:
    ahead = np.zeros(3)
    ahead[axis] = 0.2 * sign
    setpoint = at(**{"position": np.zeros(3), kind: ahead})
    a = acceleration(np.zeros(3), np.zeros(3), setpoint, BacksteppingParams())
    assert a[axis] * sign > 0.0
    assert np.allclose(np.delete(a, axis), 0.0)


def test_on_the_setpoint_only_feed_forward_and_gravity_remain() -> None:
    p, v, a = RNG.normal(size=(3, 3)) * 0.5
    thrust = backstepping.step(p, v, at(p, v, a), params=BacksteppingParams())
    assert np.allclose(thrust.thrust_enu_m_s2, a + UP)


@pytest.mark.parametrize("radius_m", [1e6, 0.4])
def test_the_lyapunov_function_falls_along_the_closed_loop(radius_m: float) -> None:
    """W = c H(e) + |z|^2/2 has the derivative -c k1 |s|^2 - k2 |z|^2, inside the clamp and outside."""
    params = replace(OPEN, max_position_error_m=radius_m)
    k1, k2, c = 1.5, 4.0, 0.5
    n, h = 200, 1e-6
    setpoint = at(RNG.normal(size=(n, 3)), RNG.normal(size=(n, 3)), RNG.normal(size=(n, 3)))
    p, v = setpoint.position_enu_m + RNG.normal(size=(n, 3)), RNG.normal(size=(n, 3))
    p[:, 2] = setpoint.position_enu_m[:, 2] + RNG.uniform(-0.3, 0.3, n)

    def parts(p: Array, v: Array, ps: Array, vs: Array) -> tuple[Array, Array, Array]:
        e = ps - p
        size = np.hypot(e[:, 0], e[:, 1])
        s = e * np.stack([np.minimum(1.0, radius_m / size)] * 2 + [np.ones(n)], axis=-1)
        huber = np.where(size <= radius_m, 0.5 * size**2, radius_m * (size - 0.5 * radius_m)) + 0.5 * e[:, 2] ** 2
        z = v - (vs + k1 * s)
        return c * huber + 0.5 * (z * z).sum(-1), (s * s).sum(-1), (z * z).sum(-1)

    a = acceleration(p, v, setpoint, params)
    ps, vs, accel = setpoint.position_enu_m, setpoint.velocity_enu_m_s, setpoint.acceleration_enu_m_s2
    w, s2, z2 = parts(p, v, ps, vs)
    later, _, _ = parts(p + h * v, v + h * a, ps + h * vs, vs + h * accel)
    earlier, _, _ = parts(p - h * v, v - h * a, ps - h * vs, vs - h * accel)
    assert np.allclose((later - earlier) / (2 * h), -c * k1 * s2 - k2 * z2, rtol=1e-4, atol=1e-4)
    assert (w > 0.0).all()


def test_turning_and_moving_the_world_turns_the_thrust() -> None:
    n = 50
    p, v, ps, vs, a = RNG.normal(size=(5, n, 3))
    q, shift = frames.quaternion_from_yaw(1.1), np.array([3.0, -2.0, 1.0])
    params = BacksteppingParams()
    plain = backstepping.step(p, v, TrajectorySetpoint(ps, vs, a), params=params).thrust_enu_m_s2
    turned = backstepping.step(
        frames.rotate(q, p) + shift,
        frames.rotate(q, v),
        TrajectorySetpoint(frames.rotate(q, ps) + shift, frames.rotate(q, vs), frames.rotate(q, a)),
        params=params,
    ).thrust_enu_m_s2
    assert np.allclose(turned, frames.rotate(q, plain), atol=1e-12)


def test_scaling_length_and_time_scales_the_acceleration() -> None:
    length, time = 3.0, 0.5
    p, v, ps, vs, a = RNG.normal(size=(5, 20, 3))
    base = BacksteppingParams()
    scaled = BacksteppingParams(
        position_gain_1_s=1.5 / time,
        velocity_gain_1_s=4.0 / time,
        coupling_1_s2=0.5 / time**2,
        max_position_error_m=base.max_position_error_m * length,
        max_acceleration_m_s2=4.0 * length / time**2,
        max_vertical_acceleration_m_s2=2.5 * length / time**2,
    )
    u = length / time
    one = acceleration(p, v, TrajectorySetpoint(ps, vs, a), base)
    two = acceleration(length * p, u * v, TrajectorySetpoint(length * ps, u * vs, u / time * a), scaled)
    assert np.allclose(two, length / time**2 * one)


def test_the_answer_is_bounded_however_far_the_setpoint() -> None:
    p = RNG.normal(size=(500, 3)) * 10.0 ** RNG.uniform(-2, 6, (500, 1))
    a = acceleration(p, 5 * RNG.normal(size=(500, 3)), at(np.zeros(3)), BacksteppingParams())
    assert (np.hypot(a[:, 0], a[:, 1]) <= 4.0 + 1e-9).all()
    assert (np.abs(a[:, 2]) <= 2.5 + 1e-9).all()


def test_a_far_setpoint_is_approached_at_a_bounded_speed() -> None:
    params = BacksteppingParams()
    p, v = np.zeros(3), np.zeros(3)
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


def test_values_that_are_not_finite_pass_through_without_a_warning() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        thrust = backstepping.step(np.full(3, np.nan), np.zeros(3), at(np.zeros(3)), params=BacksteppingParams())
    assert np.isnan(thrust.thrust_enu_m_s2[0])  # allocation levels out and says so; it is not hidden here


def test_batch_equals_loop() -> None:
    p, v, ps, vs, a = RNG.normal(size=(5, 3, 4, 3))
    k = RNG.uniform(1, 2, (3, 4))
    together = backstepping.step(
        p, v, TrajectorySetpoint(ps, vs, a), params=BacksteppingParams(position_gain_1_s=k)
    ).thrust_enu_m_s2
    for i in range(3):
        for j in range(4):
            alone = backstepping.step(
                p[i, j],
                v[i, j],
                TrajectorySetpoint(ps[i, j], vs[i, j], a[i, j]),
                params=BacksteppingParams(position_gain_1_s=k[i, j]),
            )
            np.testing.assert_allclose(alone.thrust_enu_m_s2, together[i, j], rtol=1e-13)
