"""The filter in plain floats says what the filter in arrays says."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.estimation import estimate_one, kalman
from onboard.frames import quaternion_from_yaw, quaternion_multiply, wrap_rad, yaw_from_quaternion
from onboard.localization import own_state

PARAMS = kalman.EstimateParams(drag_1_s=0.3)


def _equal(one: estimate_one.OneMemory, many: kalman.EstimateMemory) -> None:
    positions, ages_s = one.remembered()
    known = len(ages_s)
    np.testing.assert_allclose(one.position_enu_m, many.position_enu_m, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.velocity_enu_m_s, many.velocity_enu_m_s, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.bias_enu_m_s2, many.bias_enu_m_s2, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.acceleration_enu_m_s2, many.acceleration_enu_m_s2, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(one.covariance, many.covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(positions, many.ring_position_enu_m[:known], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(ages_s, many.ring_age_s[:known], rtol=1e-9, atol=1e-11)
    assert np.isinf(many.ring_age_s[known:]).all()
    assert one.rejected_count == float(many.rejected_count)
    assert one.last_age_s == pytest.approx(float(many.last_age_s), abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_one_vehicle_in_floats_equals_the_batch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    position = rng.normal(size=3)
    one = estimate_one.initial(tuple(position.tolist()), params=PARAMS)
    many = kalman.initial(position, params=PARAMS)
    for tick in range(300):
        quaternion = rng.normal(size=4) * [0.1, 0.1, 0.1, 0.1] + [1.0, 0.0, 0.0, 0.0]
        quaternion /= np.linalg.norm(quaternion)
        thrust = np.nan if tick % 50 == 49 else rng.uniform(0.0, 1.0)
        if tick % 70 == 69:
            quaternion[1] = np.nan
        dt_s = rng.uniform(0.015, 0.03)
        ground = tick < 20
        one = estimate_one.drive(
            one, tuple(quaternion.tolist()), thrust, 0.5, params=PARAMS, dt_s=dt_s, is_on_ground=ground
        )
        many = kalman.drive(many, quaternion, thrust, 0.5, params=PARAMS, dt_s=dt_s, is_on_ground=ground)
        _equal(one, many)
        for _ in range(rng.integers(0, 3)):
            sample = np.array(one.position_enu_m) + rng.normal(size=3) * rng.choice([0.003, 0.003, 0.5])
            if rng.random() < 0.05:
                sample[0] = np.nan
            age_s = rng.choice([0.0, 0.02, rng.uniform(-0.01, 0.8)])
            one = estimate_one.correct(one, tuple(sample.tolist()), age_s, params=PARAMS)
            many = kalman.correct(many, sample, age_s, params=PARAMS)
            _equal(one, many)
    for mine, theirs in zip(_arrays(estimate_one.state(one, 0.3)), _arrays(kalman.state(many, 0.3)), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)


def _arrays(value: object) -> list[np.ndarray]:
    return [np.asarray(getattr(value, name)) for name in value.__slots__]  # type: ignore[attr-defined]


def test_the_agents_turns_in_floats_are_those_of_the_frames() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        q, yaw = rng.normal(size=4), rng.uniform(-7.0, 7.0)
        q /= np.linalg.norm(q)
        q4 = tuple(q.tolist())
        np.testing.assert_allclose(own_state._turned(yaw, q4), quaternion_multiply(quaternion_from_yaw(yaw), q))
        assert own_state._yaw_rad(q4) == pytest.approx(float(yaw_from_quaternion(q)), abs=1e-12)
        assert own_state._wrapped(yaw) == pytest.approx(float(wrap_rad(yaw)), abs=1e-12)
