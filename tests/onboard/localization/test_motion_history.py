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


class _Flight:
    """Ticks of a vehicle that accelerates to the east."""

    def __init__(self, bias_m_s2: Vec3 = ZERO_3) -> None:
        self.history = MotionHistory()
        self.true = kalman.initial(ZERO_3, _PARAMS)._replace(bias_enu_m_s2=bias_m_s2)
        self.now_ns = 0

    def tick(self, believed: KalmanMemory | None = None, mean_bias_m_s2: Vec3 = ZERO_3) -> None:
        """Fly a tick; note what is true, or what is believed."""
        self.now_ns += round(_DT_S * 1e9)
        self.true = _driven(self.true)
        noted = believed if believed is not None else self.true
        self.history.note(self.now_ns, noted, mean_bias_m_s2, _EAST_M_S2, _DT_S)

    def reckoned(self, since_ns: int) -> KalmanMemory:
        reckoned = self.history.reckoned(since_ns, _PARAMS)
        assert reckoned is not None
        return reckoned


def test_nothing_is_reckoned_before_the_first_tick_or_once_forgotten() -> None:
    flight = _Flight()
    assert flight.history.reckoned(0, _PARAMS) is None
    flight.tick()
    flight.history.forget()
    assert flight.history.reckoned(0, _PARAMS) is None


def test_a_motion_by_a_camera_that_is_wrong_since_half_a_second_is_not_believed() -> None:
    flight = _Flight()
    for _ in range(60):
        flight.tick()
    wrong_since_ns = flight.now_ns

    believed = flight.true
    bias_m_s2 = ZERO_3
    for _ in range(25):
        believed = _following_a_frozen_camera(_driven(believed))
        bias_m_s2 = add_scaled(bias_m_s2, 0.02, believed.bias_enu_m_s2)
        flight.tick(believed, bias_m_s2)

    true = flight.true
    reckoned = flight.reckoned(wrong_since_ns)
    assert reckoned.position_enu_m == pytest.approx(true.position_enu_m)
    assert reckoned.velocity_enu_m_s == pytest.approx(true.velocity_enu_m_s)
    assert reckoned.bias_enu_m_s2 == ZERO_3
    assert reckoned.last_age_s == pytest.approx(true.last_age_s)


def test_what_was_known_until_then_stays() -> None:
    flight = _Flight()
    for _ in range(40):
        flight.tick(mean_bias_m_s2=Vec3(9.0, 0.0, 0.0))
    assert flight.reckoned(flight.now_ns).position_enu_m == flight.true.position_enu_m


def test_a_steady_wind_goes_on_to_push() -> None:
    push_m_s2 = Vec3(0.5, 0.0, 0.0)
    flight = _Flight(push_m_s2)
    for _ in range(80):
        noisy = _driven(flight.true)._replace(bias_enu_m_s2=Vec3(2.0, 0.0, 0.0))
        flight.tick(noisy, push_m_s2)

    reckoned = flight.reckoned(flight.now_ns - 500_000_000)
    assert reckoned.position_enu_m == pytest.approx(flight.true.position_enu_m)


def test_a_short_history_is_reckoned_from_its_begin() -> None:
    flight = _Flight()
    for _ in range(5):
        flight.tick()
    reckoned = flight.reckoned(-1_000_000_000)
    assert reckoned.position_enu_m == pytest.approx(flight.true.position_enu_m)
