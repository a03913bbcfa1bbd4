"""Dead reckoning from a motion of one second ago."""

from __future__ import annotations

import pytest

from onboard.estimation import kalman
from onboard.estimation.kalman import KalmanMemory, KalmanParams
from onboard.localization.motion_history import MotionHistory
from onboard.vectors import ZERO_3, Vec3, add_scaled

_PARAMS = KalmanParams(drag_1_s=0.3)
_DT_S = 0.02
_EAST_M_S2 = Vec3(1.0, 0.0, 0.0)
_CLOSE = 0.005  # drag is taken at the end of a tick, not in its middle


def _at_rest() -> KalmanMemory:
    return kalman.initial(ZERO_3, _PARAMS)


def _driven(memory: KalmanMemory) -> KalmanMemory:
    return kalman.predict(memory, _EAST_M_S2, _PARAMS, _DT_S)


def _following_a_frozen_camera(memory: KalmanMemory) -> KalmanMemory:
    """Return the motion of an estimate that is held where it was."""
    return memory._replace(
        position_enu_m=ZERO_3,
        velocity_enu_m_s=ZERO_3,
        bias_enu_m_s2=Vec3(-1.0, 0.0, 0.0),
        last_age_s=0.0,
    )


def test_nothing_is_reckoned_before_the_first_tick() -> None:
    assert MotionHistory().reckoned(_PARAMS) is None


def test_a_motion_by_a_camera_that_is_wrong_since_half_a_second_is_not_believed() -> None:
    history = MotionHistory()
    true = _at_rest()
    for _ in range(60):
        true = _driven(true)
        history.note(true, ZERO_3, _PARAMS, _DT_S)

    believed = true
    bias_m_s2 = ZERO_3
    for _ in range(25):
        true = _driven(true)
        believed = _following_a_frozen_camera(_driven(believed))
        bias_m_s2 = add_scaled(bias_m_s2, 0.02, believed.bias_enu_m_s2)
        history.note(believed, bias_m_s2, _PARAMS, _DT_S)

    reckoned = history.reckoned(_PARAMS)
    assert reckoned is not None
    assert reckoned.position_enu_m == pytest.approx(true.position_enu_m, abs=_CLOSE)
    assert reckoned.velocity_enu_m_s == pytest.approx(true.velocity_enu_m_s, abs=_CLOSE)
    assert reckoned.bias_enu_m_s2 == ZERO_3
    assert reckoned.last_age_s == pytest.approx(true.last_age_s)


def test_a_steady_wind_goes_on_to_push() -> None:
    history = MotionHistory()
    push_m_s2 = Vec3(0.5, 0.0, 0.0)
    true = _at_rest()._replace(bias_enu_m_s2=push_m_s2)
    for _ in range(80):
        true = _driven(true)
        noisy = true._replace(bias_enu_m_s2=Vec3(2.0, 0.0, 0.0))
        history.note(noisy, push_m_s2, _PARAMS, _DT_S)

    reckoned = history.reckoned(_PARAMS)
    assert reckoned is not None
    assert reckoned.position_enu_m == pytest.approx(true.position_enu_m, abs=_CLOSE)


def test_a_short_flight_is_reckoned_from_its_begin() -> None:
    history = MotionHistory()
    true = _at_rest()
    for _ in range(5):
        history.note(true, ZERO_3, _PARAMS, _DT_S)
        true = _driven(true)
    history.note(true, ZERO_3, _PARAMS, _DT_S)

    reckoned = history.reckoned(_PARAMS)
    assert reckoned is not None
    assert reckoned.position_enu_m == pytest.approx(true.position_enu_m, abs=_CLOSE)
