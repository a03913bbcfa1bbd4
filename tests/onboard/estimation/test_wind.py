"""The wind estimate: push over drag, gusts about its mean, and the error that gusts make."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard.config.wind_limit import GUST_SHARE
from onboard.estimation import wind
from onboard.types import State
from onboard.vectors import ZERO_3, Vec3

DT = 0.02


def flown(pushes: list[Vec3]) -> wind.WindMemory:
    memory = wind.initial()
    for push in pushes:
        memory = wind.step(memory, push, DT, False)
    return memory


def gusty(std_m_s2: float, seconds: float, *, seed: int = 1) -> list[Vec3]:
    """Return pushes of gusts with a correlation time of 1 s about 1.2 m/s^2 to the east."""
    rng = np.random.default_rng(seed)
    keep = math.exp(-DT)
    gust = np.zeros(2)
    pushes = []
    for _ in range(round(seconds / DT)):
        gust = keep * gust + std_m_s2 * math.sqrt(1.0 - keep**2) * rng.standard_normal(2)
        pushes.append(Vec3(1.2 + float(gust[0]), float(gust[1]), 0.0))
    return pushes


def state() -> State:
    return State(
        position_enu_m=Vec3(1.0, 2.0, 3.0),
        velocity_enu_m_s=ZERO_3,
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=0.003,
        velocity_std_m_s=0.02,
    )


def test_a_push_over_the_drag_is_the_wind() -> None:
    memory = flown([Vec3(1.2, -0.6, 0.3)] * 100)
    assert wind.wind_enu_m_s(memory, 0.3) == pytest.approx((4.0, -2.0), abs=0.01)
    assert wind.gust_std_m_s2(memory) == pytest.approx(0.0, abs=0.01)


def test_the_wind_is_not_known_without_a_drag_on_the_ground_and_right_after_lift_off() -> None:
    memory = flown([Vec3(1.2, 0.0, 0.0)] * 100)
    assert math.isnan(wind.wind_enu_m_s(memory, 0.0)[0])
    assert math.isnan(wind.wind_enu_m_s(flown([Vec3(1.2, 0.0, 0.0)] * 40), 0.3)[0])
    landed = wind.step(memory, Vec3(1.2, 0.0, 0.0), DT, True)
    assert math.isnan(wind.wind_enu_m_s(landed, 0.3)[0])


def test_gusts_are_told_from_the_wind() -> None:
    strengths = []
    for seed in range(20):
        memory = flown(gusty(0.5, 20.0, seed=seed))
        strengths.append(wind.gust_std_m_s2(memory))
        assert wind.wind_enu_m_s(memory, 0.3)[0] == pytest.approx(4.0, abs=3.0)
    assert float(np.median(strengths)) == pytest.approx(0.4, abs=0.12)


def test_a_number_that_is_not_finite_changes_nothing() -> None:
    memory = flown([Vec3(1.2, 0.0, 0.0)] * 100)
    assert wind.step(memory, Vec3(math.nan, 0.0, 0.0), DT, False) == memory


def test_calm_air_leaves_the_estimate_as_it_is_and_gusts_widen_its_velocity() -> None:
    calm = flown([push._replace(x=push.x - 1.2) for push in gusty(0.03, 10.0)])
    assert wind.widened(state(), calm, 0.3) == state()

    widened = wind.widened(state(), flown(gusty(0.6, 20.0)), 0.3)
    assert widened.velocity_std_m_s > 0.04
    assert widened._replace(velocity_std_m_s=0.02) == state()


def test_a_lull_is_no_reason_to_come_nearer() -> None:
    gusts = [push._replace(x=push.x - 1.2) for push in gusty(0.6, 20.0)]
    lull = [ZERO_3] * round(8.0 / DT)
    in_gusts = wind.widened(state(), flown(gusts), 0.3)
    in_lull = wind.widened(state(), flown(gusts + lull), 0.3)

    assert wind.gust_std_m_s2(flown(gusts + lull)) < wind.COVERED_M_S2
    assert in_lull.velocity_std_m_s > 0.5 * in_gusts.velocity_std_m_s


@pytest.mark.parametrize(
    ("gust_m_s2", "counted_m_s2"),
    [(0.0, 0.0), (0.15, 0.0), (0.19, 0.04), (0.21, 0.16), (0.5, 0.45)],
)
def test_of_strong_gusts_only_what_the_floor_covers_is_left_out(
    gust_m_s2: float, counted_m_s2: float
) -> None:
    assert wind.counted_gust_m_s2(gust_m_s2) == pytest.approx(counted_m_s2)


@pytest.mark.parametrize("flight_s", [2.0, 4.0, 8.0])
def test_gusts_of_a_few_seconds_are_not_all_that_will_come(flight_s: float) -> None:
    # of 40 flights, the median of what is expected after so many seconds is about the true value
    expected = [
        wind.strongest_gust_std_m_s2(flown(gusty(0.5, flight_s, seed=seed))) for seed in range(40)
    ]
    assert 0.35 < float(np.median(expected)) < 0.65


def test_gusts_that_the_margin_covers_are_expected_as_they_are_seen() -> None:
    memory = flown([push._replace(x=push.x - 1.2) for push in gusty(0.1, 3.0)])
    seen_m_s2 = max(wind.gust_std_m_s2(memory), math.sqrt(memory.lasting_variance_m2_s4))
    assert seen_m_s2 < wind.COVERED_M_S2
    assert wind.widened(state(), memory, 0.3) == state()


def test_gusts_that_belong_to_a_wind_are_reckoned_with_before_they_come() -> None:
    steady = flown([Vec3(1.8, -2.4, 0.0)] * 200)
    assert wind.strongest_gust_std_m_s2(steady) == pytest.approx(GUST_SHARE * 3.0, abs=0.01)
    assert wind.widened(state(), steady, 0.3).velocity_std_m_s > 0.08
