"""Disturbance observer: learns bias and gain, and nothing from an obedient vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from onboard.estimation import disturbance_observer
from onboard.estimation.disturbance_observer import ObserverParams
from onboard.vectors import ZERO_3, Vec3
from tests.oracles.rotation import quaternion_from_yaw, rotate

DT = 0.02


def obeying(
    gain: float, bias: float, drag: float, command: float, seconds: float = 6.0
) -> list[float]:
    """s_b over ``seconds`` of a constant command to a vehicle with static gain, bias and drag."""
    params = ObserverParams(wn_rad_s=6.0, zeta=0.7, drag_1_s=drag)
    memory = disturbance_observer.initial(ZERO_3)
    sub = 10
    h = DT / 10
    v = a = rate = 0.0
    queue = [0.0] * 20
    estimates = []
    for _ in range(round(seconds / DT)):
        for _ in range(sub):
            queue.append(command)
            rate += h * (36.0 * (gain * queue[-21] - a) - 2 * 0.7 * 6.0 * rate)
            a += h * rate
            v += h * (a + bias - drag * v)
        memory, disturbance = disturbance_observer.step(
            memory, Vec3(v, 0.0, 0.0), Vec3(command, 0.0, 0.0), params, DT, False
        )
        assert disturbance == memory.disturbance_enu_m_s2
        estimates.append(disturbance.x)
    return estimates


def test_the_observer_finds_bias_and_static_gain_of_a_weak_attitude_loop() -> None:
    assert obeying(1.0, 0.26, 0.3, 0.0)[-1] == pytest.approx(0.26, abs=0.01)
    assert obeying(0.9, 0.0, 0.3, 1.0)[-1] == pytest.approx(-0.1, abs=0.01)


def test_an_obedient_vehicle_shows_no_disturbance_even_while_it_answers() -> None:
    assert max(map(abs, obeying(1.0, 0.0, 0.3, 1.5))) < 0.05


def test_the_observer_settles_within_two_seconds() -> None:
    estimates = obeying(1.0, 0.3, 0.0, 0.0)
    assert estimates[round(2.0 / DT)] == pytest.approx(0.3, rel=0.05)
    assert max(estimates) < 0.3 * 1.05


def test_a_frozen_observer_keeps_what_it_knew_and_a_bounded_one_its_bound() -> None:
    params = ObserverParams(max_disturbance_m_s2=0.5)
    frozen = free = disturbance_observer.initial(ZERO_3)
    for tick in range(1, 301):
        v = Vec3(2.0 * tick * DT, 0.0, 0.0)
        frozen, _ = disturbance_observer.step(frozen, v, ZERO_3, params, DT, True)
        free, _ = disturbance_observer.step(free, v, ZERO_3, params, DT, False)
    assert frozen.disturbance_enu_m_s2 == ZERO_3
    assert free.disturbance_enu_m_s2 == Vec3(0.5, 0.0, 0.0)


def test_the_observer_ignores_values_that_are_not_finite() -> None:
    memory, disturbance = disturbance_observer.step(
        disturbance_observer.initial(ZERO_3),
        Vec3(math.nan, 0.0, 0.0),
        Vec3(math.inf, 0.0, 0.0),
        ObserverParams(),
        DT,
        False,
    )
    assert memory.velocity_enu_m_s == disturbance == memory.response_enu_m_s2 == ZERO_3


def test_turning_the_world_turns_the_disturbance() -> None:
    params = ObserverParams(drag_1_s=0.3, delay_s=0.047)
    q = quaternion_from_yaw(0.6)
    rng = np.random.default_rng(10)
    plain = turned = disturbance_observer.initial(ZERO_3)
    for v, u in 0.1 * rng.normal(size=(40, 2, 3)):
        plain, _ = disturbance_observer.step(
            plain, Vec3(*v.tolist()), Vec3(*u.tolist()), params, DT, False
        )
        turned, _ = disturbance_observer.step(turned, rotate(q, v), rotate(q, u), params, DT, False)
    np.testing.assert_allclose(
        turned.disturbance_enu_m_s2, rotate(q, plain.disturbance_enu_m_s2), atol=1e-9
    )


def test_a_dead_time_between_two_ticks_delays_by_just_that() -> None:
    """The response to a ramp of commands lags by the dead time plus 2 zeta/wn, also when that is no
    whole tick.
    """
    for delay_s in (0.03, 0.04, 0.047):
        params = ObserverParams(delay_s=delay_s, wn_rad_s=11.0, zeta=0.6)
        memory = disturbance_observer.initial(ZERO_3)
        for tick in range(200):
            command = Vec3(tick * DT, 0.0, 0.0)
            memory, _ = disturbance_observer.step(memory, ZERO_3, command, params, DT, False)
        lag_s = 199 * DT - memory.response_enu_m_s2.x
        # a command held over the last tick counts from the tick's middle
        assert lag_s == pytest.approx(delay_s + 2 * 0.6 / 11.0 - DT / 2, abs=1e-3)
