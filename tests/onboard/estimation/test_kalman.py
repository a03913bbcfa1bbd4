"""Estimator and disturbance observer against simulated truth."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

from onboard import frames
from onboard.estimation import disturbance_observer, kalman
from onboard.estimation.disturbance_observer import ObserverParams
from onboard.estimation.kalman import EstimateMemory, EstimateParams
from onboard.types import GRAVITY_M_S2, Array

DT = 0.02
G = GRAVITY_M_S2
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def wander(
    seconds: float, n: int, seed: int, age_s: float = 0.02, loss: float = 0.0, params: EstimateParams | None = None
) -> tuple[Array, Array, EstimateMemory]:
    """Flights under smooth random acceleration with a wrong thrust scale, tilt bias, gusts and drag.

    Returns velocity and position errors (T, n, 3) after 4 s and the memory at the end.
    """
    rng = np.random.default_rng(seed)
    params = params or EstimateParams(drag_1_s=0.3)
    sub, h = 10, DT / 10
    p, v, a, gust = (np.zeros((n, 3)) for _ in range(4))
    scale, noise_m = 0.95, 0.003
    tilt = 0.26 * rng.normal(size=(n, 3)) / np.sqrt(3)
    memory = kalman.initial(p, params=params)
    phase = rng.uniform(0, 6.28, (n, 3))
    past = [(0.0, p.copy())]
    velocity_errors, position_errors = [], []
    for tick in range(round(seconds / DT)):
        told = np.zeros((n, 3))
        for k in range(sub):
            t = tick * DT + k * h
            a = 1.5 * np.sin(1.7 * t + phase) + 0.7 * np.sin(4.1 * t + 2 * phase)
            gust += -h * gust / 1.0 + 0.1 * np.sqrt(2 * h) * rng.normal(size=gust.shape)
            told += a / sub
            v = v + h * (scale * a + tilt + gust - 0.3 * v)
            p = p + h * v
            past.append((t + h, p.copy()))
        memory = kalman.predict(memory, told, params=params, dt_s=DT)
        if rng.random() >= loss:
            steps = round(age_s / h)
            if steps < len(past):
                sample = past[-1 - steps][1] + noise_m * rng.normal(size=(n, 3))
                memory = kalman.correct(memory, sample, np.full(n, age_s), params=params)
        if tick * DT > 4.0:
            velocity_errors.append(memory.velocity_enu_m_s - v)
            position_errors.append(memory.position_enu_m - p)
    return np.array(velocity_errors), np.array(position_errors), memory


def test_velocity_is_good_to_two_centimetres_per_second_with_the_mocap_of_the_experiment() -> None:
    velocity, position, memory = wander(14.0, 40, seed=0)
    assert velocity.std() < 0.02
    assert np.abs(velocity).max() < 0.10
    assert position.std() < 0.003
    stated = float(kalman.state(memory).velocity_std_m_s[0])
    assert 0.5 * velocity.std() < stated < 2.5 * velocity.std()  # the accuracy that the law's margin is made from


@pytest.mark.parametrize(
    ("age_s", "loss", "bound"), [(0.0, 0.0, 0.02), (0.05, 0.0, 0.025), (0.02, 0.3, 0.025), (0.013, 0.0, 0.02)]
)
def test_late_and_lost_samples_cost_little(age_s: float, loss: float, bound: float) -> None:
    velocity, _, _ = wander(12.0, 30, seed=1, age_s=age_s, loss=loss)
    assert velocity.std() < bound


def test_ignoring_the_age_of_samples_would_show() -> None:
    """The test above can fail: the same samples taken for fresh give a lagging estimate."""
    honest, _, _ = wander(10.0, 20, seed=2, age_s=0.04)
    params = EstimateParams(drag_1_s=0.3)
    original = kalman.correct
    try:
        kalman.correct = lambda m, s, age, *, params: original(m, s, 0.0 * age, params=params)  # type: ignore[assignment]
        fooled, lagging, _ = wander(10.0, 20, seed=2, age_s=0.04, params=params)
    finally:
        kalman.correct = original
    assert fooled.std() > 1.5 * honest.std()
    assert lagging.std() > 0.01


def test_a_late_sample_has_the_effect_of_the_same_sample_on_time() -> None:
    """Applied at its own time and re-propagated: equal to a filter that got it when it was taken."""
    params = EstimateParams(acceleration_noise=1e-6, bias_noise=1e-6)
    rng = np.random.default_rng(3)
    drive = rng.normal(size=(8, 3))
    prompt = late = kalman.initial(np.zeros(3), params=params)
    sample = np.array([0.02, -0.01, 0.03])
    for tick in range(8):
        prompt = kalman.predict(prompt, drive[tick], params=params, dt_s=DT)
        late = kalman.predict(late, drive[tick], params=params, dt_s=DT)
        if tick == 3:
            prompt = kalman.correct(prompt, sample, 0.0, params=params)
    late = kalman.correct(late, sample, 4 * DT, params=params)
    assert np.abs(prompt.position_enu_m).max() > 0.001
    assert np.allclose(late.position_enu_m, prompt.position_enu_m, atol=1e-9)
    assert np.allclose(late.velocity_enu_m_s, prompt.velocity_enu_m_s, atol=1e-8)
    assert np.allclose(late.bias_enu_m_s2, prompt.bias_enu_m_s2, atol=1e-8)
    assert np.allclose(late.ring_position_enu_m[:4], prompt.ring_position_enu_m[:4], atol=1e-9)


def test_the_order_of_two_samples_does_not_matter() -> None:
    params = EstimateParams(acceleration_noise=1e-6, bias_noise=1e-6)
    memory = kalman.initial(np.zeros(3), params=params)
    for _ in range(6):
        memory = kalman.predict(memory, np.array([1.0, 0.0, 0.0]), params=params, dt_s=DT)
    old, new = (np.array([0.01, 0.0, 0.0]), 0.06), (np.array([0.02, 0.0, 0.0]), 0.02)
    first = kalman.correct(kalman.correct(memory, *old, params=params), *new, params=params)
    other = kalman.correct(kalman.correct(memory, *new, params=params), *old, params=params)
    assert np.allclose(first.velocity_enu_m_s, other.velocity_enu_m_s, atol=1e-9)
    assert np.allclose(first.covariance, other.covariance, atol=1e-12)


def test_the_covariance_is_that_of_a_textbook_kalman_filter() -> None:
    params = EstimateParams(drag_1_s=0.4)
    memory = kalman.initial(np.zeros(3), params=params)
    c = memory.covariance
    full = np.array([[c[0], c[1], c[2]], [c[1], c[3], c[4]], [c[2], c[4], c[5]]])
    phi = np.array([[1, DT, DT * DT / 2], [0, 1 - 0.4 * DT, DT], [0, 0, 1]])
    qa, qb = 0.03**2, 0.12**2
    q = np.array([[qa * DT**3 / 3, qa * DT**2 / 2, 0], [qa * DT**2 / 2, qa * DT, 0], [0, 0, qb * DT]])
    age = 0.02
    h = np.array([1.0, -age - 0.5 * age * age * 0.4, 0.5 * age * age])
    for _ in range(30):
        memory = kalman.predict(memory, np.zeros(3), params=params, dt_s=DT)
        memory = kalman.correct(memory, np.zeros(3), age, params=params)
        full = phi @ full @ phi.T + q
        gain = full @ h / (h @ full @ h + 0.003**2)
        full = full - np.outer(gain, h @ full)
    assert np.allclose(memory.covariance, full[np.triu_indices(3)], rtol=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_motion_to_the_east_north_or_up_is_seen_that_way(axis: int) -> None:
    params = EstimateParams()
    memory = kalman.initial(np.zeros(3), params=params)
    position = np.zeros(3)
    for tick in range(100):
        position[axis] = 0.3 * DT * (tick + 1)
        memory = kalman.predict(memory, np.zeros(3), params=params, dt_s=DT)
        memory = kalman.correct(memory, position, 0.0, params=params)
    assert memory.velocity_enu_m_s[axis] == pytest.approx(0.3, abs=0.03)
    assert np.allclose(np.delete(memory.velocity_enu_m_s, axis), 0.0)


def test_attitude_and_throttle_drive_it_east_when_tilted_east() -> None:
    params = EstimateParams()
    memory = kalman.initial(np.zeros(3), params=params)
    tilted = np.array([np.cos(0.1), 0.0, np.sin(0.1), 0.0])  # FLU to ENU, top leans east
    for _ in range(50):
        memory = kalman.drive(memory, tilted, 0.75 / np.cos(0.2), 0.75, params=params, dt_s=DT)
    assert memory.acceleration_enu_m_s2[0] == pytest.approx(G * np.tan(0.2), rel=1e-6)
    assert abs(memory.acceleration_enu_m_s2[1]) < 1e-12
    assert abs(memory.acceleration_enu_m_s2[2]) < 1e-6


def test_throttle_acts_behind_the_motor_lag() -> None:
    params = EstimateParams(motor_lag_s=0.05)
    memory = kalman.initial(np.zeros(3), params=params)
    memory = replace(memory, thrust_m_s2=np.float64(G))
    memory = kalman.drive(memory, LEVEL, 1.0, 0.5, params=params, dt_s=0.05)
    assert memory.acceleration_enu_m_s2[2] == pytest.approx(G * (1 - np.exp(-1.0)))


def test_standing_on_the_ground_is_not_falling() -> None:
    params = EstimateParams()
    memory = kalman.initial(np.zeros(3), params=params)
    for _ in range(200):
        memory = kalman.drive(memory, LEVEL, 0.1, 0.75, params=params, dt_s=DT, is_on_ground=True)
        memory = kalman.correct(memory, np.zeros(3), 0.02, params=params)
    assert np.allclose(memory.velocity_enu_m_s, 0.0)
    assert np.allclose(memory.bias_enu_m_s2, 0.0)


def test_a_constant_error_of_the_model_becomes_the_bias() -> None:
    params = EstimateParams()
    memory = kalman.initial(np.zeros(3), params=params)
    for tick in range(400):
        t = (tick + 1) * DT
        memory = kalman.predict(memory, np.zeros(3), params=params, dt_s=DT)
        memory = kalman.correct(memory, np.array([0.25 * t * t / 2, 0.0, 0.0]), 0.0, params=params)
    assert memory.bias_enu_m_s2[0] == pytest.approx(0.25, abs=0.01)


def test_a_jump_is_ignored_counted_and_forgotten_after_a_good_sample() -> None:
    params = EstimateParams()
    memory = kalman.initial(np.zeros((2, 3)), params=params)
    for _ in range(50):
        memory = kalman.predict(memory, np.zeros((2, 3)), params=params, dt_s=DT)
        memory = kalman.correct(memory, np.zeros((2, 3)), np.full(2, 0.02), params=params)
    for count in range(1, 4):
        memory = kalman.predict(memory, np.zeros((2, 3)), params=params, dt_s=DT)
        memory = kalman.correct(memory, np.array([[0.9, 0, 0], [0.001, 0, 0]]), np.full(2, 0.02), params=params)
        assert memory.rejected_count.tolist() == [count, 0]
    assert np.abs(memory.position_enu_m[0]).max() < 1e-9
    assert memory.last_age_s[0] > 0.05 > memory.last_age_s[1]
    memory = kalman.correct(memory, np.zeros((2, 3)), np.full(2, 0.02), params=params)
    assert memory.rejected_count.tolist() == [0, 0]


def test_the_stated_accuracy_grows_while_no_sample_comes() -> None:
    _, _, memory = wander(6.0, 1, seed=4)
    before = kalman.state(memory)
    for _ in range(50):
        memory = kalman.predict(memory, np.zeros((1, 3)), params=EstimateParams(), dt_s=DT)
    after = kalman.state(memory)
    assert after.velocity_std_m_s[0] > 3 * before.velocity_std_m_s[0]
    assert after.position_std_m[0] > 10 * before.position_std_m[0]
    assert memory.last_age_s[0] == pytest.approx(1.02)


@pytest.mark.parametrize("sample", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf]])
def test_samples_that_are_not_finite_change_nothing_and_warn_nothing(sample: list[float]) -> None:
    params = EstimateParams()
    memory = kalman.initial(np.zeros(3), params=params)
    memory = kalman.predict(memory, np.zeros(3), params=params, dt_s=DT)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        after = kalman.correct(memory, np.array(sample, dtype=float), 0.0, params=params)
        after = kalman.correct(after, np.zeros(3), np.nan, params=params)
        after = kalman.correct(after, np.zeros(3), np.inf, params=params)
        after = kalman.predict(after, np.array([np.nan, 0.0, 0.0]), params=params, dt_s=DT)
        after = kalman.drive(after, LEVEL, np.nan, 0.5, params=params, dt_s=DT)
        after = kalman.drive(after, np.full(4, np.nan), 0.5, 0.5, params=params, dt_s=DT)
    assert np.isfinite(after.position_enu_m).all()
    assert np.isfinite(after.velocity_enu_m_s).all()
    assert np.isfinite(after.covariance).all()


def test_a_sample_older_than_the_memory_is_ignored() -> None:
    params = EstimateParams(history=5)
    memory = kalman.initial(np.zeros(3), params=params)
    for _ in range(20):
        memory = kalman.predict(memory, np.zeros(3), params=params, dt_s=DT)
    after = kalman.correct(memory, np.array([0.05, 0.0, 0.0]), 0.5, params=params)
    assert np.array_equal(after.position_enu_m, memory.position_enu_m)
    assert np.array_equal(after.covariance, memory.covariance)


def test_turning_and_moving_the_world_turns_the_estimate() -> None:
    params, q, shift = EstimateParams(drag_1_s=0.5), frames.quaternion_from_yaw(0.9), np.array([4.0, -1.0, 2.0])
    rng = np.random.default_rng(7)
    plain, turned = kalman.initial(np.zeros(3), params=params), kalman.initial(shift, params=params)
    for _ in range(60):
        drive, sample = rng.normal(size=3), 0.02 * rng.normal(size=3)
        plain = kalman.correct(kalman.predict(plain, drive, params=params, dt_s=DT), sample, 0.03, params=params)
        turned = kalman.predict(turned, frames.rotate(q, drive), params=params, dt_s=DT)
        turned = kalman.correct(turned, frames.rotate(q, sample) + shift, 0.03, params=params)
    assert np.allclose(turned.position_enu_m, frames.rotate(q, plain.position_enu_m) + shift, atol=1e-9)
    assert np.allclose(turned.velocity_enu_m_s, frames.rotate(q, plain.velocity_enu_m_s), atol=1e-9)


def test_scaling_length_and_time_scales_the_estimate() -> None:
    length, time = 2.5, 0.4
    one = EstimateParams(drag_1_s=0.5)
    # noise densities carry half powers of time
    two = EstimateParams(
        position_noise_m=0.003 * length,
        acceleration_noise=0.03 * length / time**1.5,
        bias_noise=0.12 * length / time**2.5,
        max_bias_m_s2=3.0 * length / time**2,
        drag_1_s=0.5 / time,
        jump_gate_m=EstimateParams().jump_gate_m * length,
    )
    a, b = kalman.initial(np.zeros(3), params=one), kalman.initial(np.zeros(3), params=two)
    weights = np.array([1, 1 / time, 1 / time**2, 1 / time**2, 1 / time**3, 1 / time**4]) * length**2
    b = replace(b, covariance=a.covariance * weights)
    rng = np.random.default_rng(8)
    for _ in range(60):
        drive, sample = rng.normal(size=3), 0.02 * rng.normal(size=3)
        a = kalman.correct(kalman.predict(a, drive, params=one, dt_s=DT), sample, 0.03, params=one)
        b = kalman.predict(b, drive * length / time**2, params=two, dt_s=time * DT)
        b = kalman.correct(b, length * sample, time * 0.03, params=two)
    assert np.allclose(b.position_enu_m, length * a.position_enu_m, atol=1e-9)
    assert np.allclose(b.velocity_enu_m_s, length / time * a.velocity_enu_m_s, atol=1e-9)


def test_batch_equals_loop_also_with_unequal_ages_and_missing_samples() -> None:
    params = EstimateParams()
    rng = np.random.default_rng(9)
    together = kalman.initial(np.zeros((3, 2, 3)), params=params)
    alone = {(i, j): kalman.initial(np.zeros(3), params=params) for i in range(3) for j in range(2)}
    for _ in range(40):
        drive, sample = rng.normal(size=(3, 2, 3)), 0.02 * rng.normal(size=(3, 2, 3))
        age, here = rng.uniform(0, 0.1, (3, 2)), rng.random((3, 2)) < 0.7
        together = kalman.predict(together, drive, params=params, dt_s=DT)
        together = kalman.correct(together, sample, age, params=params, is_present=here)
        for key, memory in alone.items():
            memory = kalman.predict(memory, drive[key], params=params, dt_s=DT)
            if here[key]:
                memory = kalman.correct(memory, sample[key], age[key], params=params)
            alone[key] = memory
            assert np.allclose(memory.position_enu_m, together.position_enu_m[key], atol=1e-12)
            assert np.allclose(memory.velocity_enu_m_s, together.velocity_enu_m_s[key], atol=1e-12)
            assert np.allclose(memory.covariance, together.covariance[key], atol=1e-15)


def obeying(gain: float, bias: float, drag: float, command: float, seconds: float = 6.0) -> tuple[float, Array]:
    """s_b after ``seconds`` of a constant command to a vehicle with a static gain, a bias and drag; the way it took."""
    params = ObserverParams(wn_rad_s=6.0, zeta=0.7, drag_1_s=drag)
    memory = disturbance_observer.initial(np.zeros(3), params=params)
    sub, h = 10, DT / 10
    v = a = rate = 0.0
    queue = [0.0] * 20
    seen = []
    for _ in range(round(seconds / DT)):
        for _ in range(sub):
            queue.append(command)
            rate += h * (36.0 * (gain * queue[-21] - a) - 2 * 0.7 * 6.0 * rate)
            a += h * rate
            v += h * (a + bias - drag * v)
        memory = disturbance_observer.observe(
            memory, np.array([v, 0, 0]), np.array([command, 0, 0]), params=params, dt_s=DT
        )
        seen.append(memory.disturbance_enu_m_s2[0])
    return float(seen[-1]), np.array(seen)


def test_the_observer_finds_bias_and_static_gain_of_a_weak_attitude_loop() -> None:
    assert obeying(1.0, 0.26, 0.3, 0.0)[0] == pytest.approx(0.26, abs=0.01)
    assert obeying(0.9, 0.0, 0.3, 1.0)[0] == pytest.approx(-0.1, abs=0.01)


def test_an_obedient_vehicle_shows_no_disturbance_even_while_it_answers() -> None:
    assert np.abs(obeying(1.0, 0.0, 0.3, 1.5)[1]).max() < 0.05


def test_the_observer_settles_within_two_seconds() -> None:
    _, way = obeying(1.0, 0.3, 0.0, 0.0)
    assert way[round(2.0 / DT)] == pytest.approx(0.3, rel=0.05)
    assert way.max() < 0.3 * 1.05


def test_a_frozen_observer_keeps_what_it_knew_and_a_bounded_one_its_bound() -> None:
    params = ObserverParams(max_disturbance_m_s2=0.5)
    memory = disturbance_observer.initial(np.zeros((2, 3)), params=params)
    v = np.zeros((2, 3))
    for _ in range(300):
        v = v + DT * np.array([2.0, 0.0, 0.0])
        memory = disturbance_observer.observe(
            memory, v, np.zeros((2, 3)), params=params, dt_s=DT, is_frozen=np.array([True, False])
        )
    assert memory.disturbance_enu_m_s2[0].tolist() == [0.0, 0.0, 0.0]
    assert memory.disturbance_enu_m_s2[1].tolist() == [0.5, 0.0, 0.0]


def test_the_observer_ignores_values_that_are_not_finite() -> None:
    params = ObserverParams()
    memory = disturbance_observer.initial(np.zeros(3), params=params)
    memory = disturbance_observer.observe(
        memory, np.array([np.nan, 0, 0]), np.array([np.inf, 0, 0]), params=params, dt_s=DT
    )
    for field in (memory.velocity_enu_m_s, memory.disturbance_enu_m_s2, memory.response_enu_m_s2):
        assert np.array_equal(field, np.zeros(3))


def test_observer_batch_equals_loop_and_turns_with_the_world() -> None:
    params, q = ObserverParams(drag_1_s=0.3, delay_s=0.047), frames.quaternion_from_yaw(0.6)
    rng = np.random.default_rng(10)
    together = disturbance_observer.initial(np.zeros((4, 3)), params=params)
    turned = disturbance_observer.initial(np.zeros((4, 3)), params=params)
    alone = [disturbance_observer.initial(np.zeros(3), params=params) for _ in range(4)]
    for _ in range(40):
        v, u = 0.1 * rng.normal(size=(2, 4, 3))
        together = disturbance_observer.observe(together, v, u, params=params, dt_s=DT)
        turned = disturbance_observer.observe(turned, frames.rotate(q, v), frames.rotate(q, u), params=params, dt_s=DT)
        for i in range(4):
            alone[i] = disturbance_observer.observe(alone[i], v[i], u[i], params=params, dt_s=DT)
            assert np.allclose(alone[i].disturbance_enu_m_s2, together.disturbance_enu_m_s2[i], atol=1e-13)
    assert np.allclose(turned.disturbance_enu_m_s2, frames.rotate(q, together.disturbance_enu_m_s2), atol=1e-9)


def test_a_dead_time_between_two_ticks_delays_by_just_that() -> None:
    """The response to a ramp of commands lags by the dead time plus 2 zeta/wn, also when that is no whole tick."""
    for delay_s in (0.03, 0.04, 0.047):
        params = ObserverParams(delay_s=delay_s, wn_rad_s=11.0, zeta=0.6)
        memory = disturbance_observer.initial(np.zeros(3), params=params)
        for tick in range(200):
            command = np.array([tick * DT, 0.0, 0.0])
            memory = disturbance_observer.observe(memory, np.zeros(3), command, params=params, dt_s=DT)
        lag_s = 199 * DT - float(memory.response_enu_m_s2[0])
        # a command held over the last tick counts from the tick's middle
        assert lag_s == pytest.approx(delay_s + 2 * 0.6 / 11.0 - DT / 2, abs=1e-3)
