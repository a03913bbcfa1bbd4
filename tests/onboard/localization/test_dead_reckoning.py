"""Dead reckoning between the last pose and the ground."""

from __future__ import annotations

import math
from copy import copy

import pytest

from onboard.estimation import kalman
from onboard.estimation.kalman import KalmanMemory, KalmanParams
from onboard.localization.dead_reckoning import DeadReckoning, VerticalMotion
from onboard.vectors import ZERO_3, Vec3

PARAMS = KalmanParams()
DT = 0.02


def seen(bias: Vec3, seconds: float, reckoning: DeadReckoning) -> KalmanMemory:
    """Memory of a vehicle at rest whose unexplained acceleration has this value."""
    memory = kalman.initial(Vec3(0.0, 0.0, 1.0), PARAMS)._replace(bias_enu_m_s2=bias)
    for _ in range(round(seconds / DT)):
        memory = reckoning.step(memory._replace(last_age_s=0.0), None, DT, False)
    return memory


def blind(
    memory: KalmanMemory, seconds: float, reckoning: DeadReckoning, vertical: VerticalMotion | None
) -> KalmanMemory:
    """The same, without samples."""
    for _ in range(round(seconds / DT)):
        memory = kalman.predict(memory, ZERO_3, PARAMS, DT)
        memory = reckoning.step(memory, vertical, DT, False)
    return memory


def test_it_flies_on_with_the_mean_of_the_bias_and_not_with_its_last_value() -> None:
    reckoning = DeadReckoning()
    seen(Vec3(0.3, 0.0, 0.0), 12.0, reckoning)
    memory = kalman.initial(Vec3(0.0, 0.0, 1.0), PARAMS)._replace(
        bias_enu_m_s2=Vec3(1.6, -1.3, 0.0)
    )
    memory = blind(reckoning.step(memory, None, DT, False), 1.0, reckoning, None)
    assert memory.velocity_enu_m_s.x == pytest.approx(0.3, abs=0.02)
    assert memory.velocity_enu_m_s.y == pytest.approx(0.0, abs=0.02)
    assert memory.position_enu_m.x == pytest.approx(0.15, abs=0.02)


def test_a_push_that_lasts_is_wind_and_a_short_one_is_none() -> None:
    windy = DeadReckoning()
    memory = blind(seen(Vec3(2.0, 0.0, 0.0), 20.0, windy), 1.0, windy, None)
    assert memory.velocity_enu_m_s.x == pytest.approx(2.0, abs=0.1)
    jumped = DeadReckoning()
    seen(ZERO_3, 5.0, jumped)
    memory = blind(seen(Vec3(3.0, 0.0, 0.0), 0.3, jumped), 1.0, jumped, None)
    assert memory.velocity_enu_m_s.x < 0.15


def test_soon_after_a_take_off_in_a_strong_wind_its_push_is_known() -> None:
    reckoning = DeadReckoning()
    on_ground = kalman.initial(Vec3(0.0, 0.0, 0.0), PARAMS)._replace(last_age_s=0.0)
    for _ in range(100):
        reckoning.step(on_ground, None, DT, True)
    for pushed_s, known_m_s2 in ((1.0, 2.4), (3.0, 3.3)):
        # the filter has found the push of 3.5 m/s^2 after half a second
        climbing = copy(reckoning)
        seen(Vec3(1.5, 0.0, 0.0), 0.5, climbing)
        memory = blind(seen(Vec3(3.5, 0.0, 0.0), pushed_s, climbing), 1.0, climbing, None)
        assert memory.velocity_enu_m_s.x > known_m_s2


def test_a_push_that_is_felt_in_the_lift_off_outlasts_poses_that_stop_in_it() -> None:
    # a lift-off counts as the ground until the vehicle is a few centimetres up
    reckoning = DeadReckoning()
    memory = kalman.initial(ZERO_3, PARAMS)._replace(bias_enu_m_s2=Vec3(0.6, 0.0, 0.0))
    memory = reckoning.step(memory._replace(last_age_s=0.0), None, DT, True)
    for _ in range(5):
        memory = kalman.predict(memory, ZERO_3, PARAMS, DT)
        memory = reckoning.step(memory, None, DT, True)
    memory = blind(memory, 1.0, reckoning, None)
    assert memory.velocity_enu_m_s.x > 0.5


def test_who_stands_without_poses_stays_where_it_is_whatever_pushed_it_in_the_air() -> None:
    reckoning = DeadReckoning()
    memory = blind(seen(Vec3(2.0, 0.0, 0.0), 5.0, reckoning), 1.0, reckoning, None)
    landed_enu_m = reckoning.step(memory, None, DT, True).position_enu_m
    for _ in range(500):
        memory = reckoning.step(memory, None, DT, True)
        memory = kalman.predict(memory, ZERO_3, PARAMS, DT)
    assert memory.position_enu_m == pytest.approx(landed_enu_m, abs=0.01)


def test_its_vertical_motion_follows_px4s_and_on_the_ground_it_rests() -> None:
    reckoning = DeadReckoning()
    memory = seen(Vec3(0.0, 0.0, 0.4), 4.0, reckoning)
    memory = blind(memory, 3.0, reckoning, VerticalMotion(1.0, 0.0))
    assert memory.position_enu_m.z == pytest.approx(1.0, abs=0.06)
    assert abs(memory.velocity_enu_m_s.z) < 0.1
    moving = memory._replace(velocity_enu_m_s=Vec3(0.5, 0.0, 0.0))
    still = reckoning.step(moving, VerticalMotion(1.0, 0.0), DT, True)
    assert still.velocity_enu_m_s == ZERO_3


def test_its_accuracy_grows_slowly_from_that_of_the_last_sample() -> None:
    reckoning = DeadReckoning()
    memory = seen(ZERO_3, 1.0, reckoning)
    before = reckoning.std
    assert before == pytest.approx(
        (math.sqrt(memory.covariance.pp), math.sqrt(memory.covariance.vv))
    )
    assert not reckoning.is_on
    memory = blind(memory, 2.0, reckoning, None)
    assert reckoning.is_on
    assert reckoning.std == pytest.approx((before[0] + 0.05 * 1.8, before[1]), abs=1e-3)

    assert math.sqrt(memory.covariance.pp) > 5.0 * before[0]


def test_its_accuracy_stays_the_same_on_the_ground() -> None:
    reckoning = DeadReckoning()
    memory = blind(seen(ZERO_3, 1.0, reckoning), 0.5, reckoning, None)
    landed_std = reckoning.std
    for _ in range(100):
        memory = kalman.predict(memory, ZERO_3, PARAMS, DT)
        memory = reckoning.step(memory, None, DT, True)
    assert reckoning.std == landed_std
