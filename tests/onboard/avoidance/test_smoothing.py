"""How far the own prediction is smoothed, number by number."""

import math

import pytest

from onboard.avoidance.prediction import UNKNOWN_MOTION, Motion, no_commands
from onboard.avoidance.smoothing import smoothed
from onboard.types import State
from onboard.vectors import ZERO_3, Vec3
from tests.onboard.avoidance.law_cases import state_of

LAST = Motion(Vec3(0.0, 0.0, 1.0), ZERO_3)
# at rest two millimetres further, less than two standard deviations
NEWEST = Motion(Vec3(0.002, 0.0, 1.0), ZERO_3)
WINDOW_S = 0.15
DT_S = 0.02


def estimate(position_std_m: float, velocity_std_m_s: float) -> State:
    state = state_of([0.0, 0.0, 1.0], [0.0, 0.0, 0.0])
    return state._replace(position_std_m=position_std_m, velocity_std_m_s=velocity_std_m_s)


def after(state: State, *, last: Motion = LAST, dt_s: float = DT_S) -> Motion:
    return smoothed(NEWEST, last, no_commands(), state, WINDOW_S, dt_s)


@pytest.mark.parametrize(
    ("velocity_std_m_s", "time_s"), [(0.05, 0.03), (0.2, 0.12), (0.25, 0.15), (1.0, 0.15)]
)
def test_an_accurate_estimate_is_smoothed_by_its_velocitys_accuracy_and_not_for_long(
    velocity_std_m_s: float, time_s: float
) -> None:
    kept = math.exp(-DT_S / time_s)
    found = after(estimate(0.01, velocity_std_m_s))
    assert found.position_enu_m.x == pytest.approx(0.002 * (1.0 - kept), rel=1e-9)


def test_an_estimate_is_rough_from_3_cm_on() -> None:
    kept = math.exp(-DT_S / 0.2)
    gained_m = WINDOW_S * 4.0 * DT_S * 0.002
    expected_m = 0.002 * (1.0 - kept) + gained_m
    assert after(estimate(0.03, 0.05)).position_enu_m.x == pytest.approx(expected_m, rel=1e-9)
    assert after(estimate(0.0299, 0.05)).position_enu_m.x != pytest.approx(expected_m, rel=1e-3)


@pytest.mark.parametrize(
    "last",
    [
        UNKNOWN_MOTION,
        Motion(UNKNOWN_MOTION.position_enu_m, ZERO_3),
        Motion(LAST.position_enu_m, UNKNOWN_MOTION.velocity_enu_m_s),
    ],
)
@pytest.mark.parametrize("position_std_m", [0.01, 0.05])
def test_without_a_whole_last_prediction_or_without_time_nothing_is_smoothed(
    last: Motion, position_std_m: float
) -> None:
    state = estimate(position_std_m, 0.05)
    assert after(state, last=last) == NEWEST
    assert after(state, dt_s=0.0) == NEWEST
    assert after(state, dt_s=-0.02) == NEWEST


def test_a_rough_estimate_moves_on_as_the_vehicle_has_accelerated() -> None:
    """The last prediction assumed no acceleration; the vehicle has accelerated for one tick."""
    gained_m_s = DT_S * 0.5
    state = estimate(0.05, 0.12)._replace(acceleration_enu_m_s2=Vec3(0.5, 0.0, 0.0))

    # where the vehicle is if it was at rest a tick ago, so that nothing is left to smooth
    moved_m = 0.5 * DT_S * gained_m_s + WINDOW_S * gained_m_s
    newest = Motion(Vec3(moved_m, 0.0, 1.0), Vec3(gained_m_s, 0.0, 0.0))
    found = smoothed(newest, LAST, no_commands(), state, WINDOW_S, DT_S)
    assert found.position_enu_m.x == pytest.approx(moved_m, rel=1e-9)
    assert found.velocity_enu_m_s.x == pytest.approx(gained_m_s, rel=1e-9)
