"""The filter against simulated truth and against a textbook filter of matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.constants import GRAVITY_M_S2
from onboard.estimation import kalman
from onboard.estimation.kalman import Covariance, KalmanMemory, KalmanParams
from onboard.vectors import ZERO_3, Vec3, add, scaled
from tests.oracles.matrix_kalman import MatrixKalman
from tests.oracles.rotation import quaternion_from_yaw, rotate

DT = 0.02
G = GRAVITY_M_S2
LEVEL = (1.0, 0.0, 0.0, 0.0)


def vec(values: object) -> Vec3:
    return Vec3(*map(float, values))  # type: ignore[call-overload]


def flights(
    seconds: float,
    count: int,
    seed: int,
    age_s: float = 0.02,
    loss: float = 0.0,
    told_age_s: float | None = None,
) -> tuple[np.ndarray, np.ndarray, KalmanMemory]:
    """Flights under smooth random acceleration with a wrong thrust scale, tilt bias, gusts and
    drag.

    Returns velocity and position errors (T, count, 3) after 4 s and the memory of the last flight.
    ``told_age_s``: the age that the filter is given instead of the true one.
    """

    rng = np.random.default_rng(seed)
    params = KalmanParams(drag_1_s=0.3)
    sub = 10
    h = DT / 10

    p, v, gust = (np.zeros((count, 3)) for _ in range(3))
    tilt = 0.26 * rng.normal(size=(count, 3)) / np.sqrt(3)

    memories = [kalman.initial(ZERO_3, params) for _ in range(count)]
    phase = rng.uniform(0, 6.28, (count, 3))
    past = [p.copy()]

    velocity_errors = []
    position_errors = []

    for tick in range(round(seconds / DT)):
        driven = np.zeros((count, 3))
        for k in range(sub):
            t = tick * DT + k * h
            a = 1.5 * np.sin(1.7 * t + phase) + 0.7 * np.sin(4.1 * t + 2 * phase)
            gust += -h * gust / 1.0 + 0.1 * np.sqrt(2 * h) * rng.normal(size=gust.shape)
            driven += a / sub
            v = v + h * (0.95 * a + tilt + gust - 0.3 * v)
            p = p + h * v
            past.append(p.copy())

        memories = [
            kalman.predict(m, vec(a), params, DT) for m, a in zip(memories, driven, strict=True)
        ]

        steps = round(age_s / h)
        if rng.random() >= loss and steps < len(past):
            samples = past[-1 - steps] + 0.003 * rng.normal(size=(count, 3))
            age = age_s if told_age_s is None else told_age_s
            memories = [
                kalman.correct(m, vec(s), age, params)
                for m, s in zip(memories, samples, strict=True)
            ]

        if tick * DT > 4.0:
            velocity_errors.append([m.velocity_enu_m_s for m in memories] - v)
            position_errors.append([m.position_enu_m for m in memories] - p)

    return np.array(velocity_errors), np.array(position_errors), memories[-1]


def test_velocity_is_good_to_two_centimetres_per_second_with_the_mocap_of_the_experiment() -> None:
    velocity, position, memory = flights(14.0, 20, seed=0)
    assert velocity.std() < 0.02
    assert np.abs(velocity).max() < 0.10
    assert position.std() < 0.003

    stated = kalman.state(memory, 0.0, 0.0, 0.0).velocity_std_m_s
    # the accuracy that the law's margin is made from
    assert 0.5 * velocity.std() < stated < 2.5 * velocity.std()


@pytest.mark.parametrize(
    ("age_s", "loss", "bound"),
    [(0.0, 0.0, 0.02), (0.05, 0.0, 0.025), (0.02, 0.3, 0.025), (0.013, 0.0, 0.02)],
)
def test_late_and_lost_samples_cost_little(age_s: float, loss: float, bound: float) -> None:
    velocity, _, _ = flights(12.0, 10, seed=1, age_s=age_s, loss=loss)
    assert velocity.std() < bound


def test_ignoring_the_age_of_samples_would_show() -> None:
    """The test above can fail: the same samples taken for fresh give a lagging estimate."""
    honest, _, _ = flights(10.0, 10, seed=2, age_s=0.04)
    fooled, lagging, _ = flights(10.0, 10, seed=2, age_s=0.04, told_age_s=0.0)

    assert fooled.std() > 1.5 * honest.std()
    assert lagging.std() > 0.01


def test_a_late_sample_has_the_effect_of_the_same_sample_on_time() -> None:
    """Applied at its own time and propagated: equal to a filter that got it when it was taken."""
    params = KalmanParams(acceleration_noise=1e-6, bias_noise=1e-6)
    rng = np.random.default_rng(3)
    prompt = late = kalman.initial(ZERO_3, params)
    sample = Vec3(0.02, -0.01, 0.03)

    for tick, driven in enumerate(rng.normal(size=(8, 3))):
        prompt = kalman.predict(prompt, vec(driven), params, DT)
        late = kalman.predict(late, vec(driven), params, DT)
        if tick == 3:
            prompt = kalman.correct(prompt, sample, 0.0, params)

    late = kalman.correct(late, sample, 4 * DT, params)

    assert np.abs(prompt.position_enu_m).max() > 0.001
    np.testing.assert_allclose(late.position_enu_m, prompt.position_enu_m, atol=1e-9)
    np.testing.assert_allclose(late.velocity_enu_m_s, prompt.velocity_enu_m_s, atol=1e-8)
    np.testing.assert_allclose(late.bias_enu_m_s2, prompt.bias_enu_m_s2, atol=1e-8)

    for tick in range(4):
        np.testing.assert_allclose(
            kalman.position_at(late, tick * DT), kalman.position_at(prompt, tick * DT), atol=1e-9
        )


def test_the_order_of_two_samples_does_not_matter() -> None:
    params = KalmanParams(acceleration_noise=1e-6, bias_noise=1e-6)
    memory = kalman.initial(ZERO_3, params)
    for _ in range(6):
        memory = kalman.predict(memory, Vec3(1.0, 0.0, 0.0), params, DT)

    old = (Vec3(0.01, 0.0, 0.0), 0.06)
    new = (Vec3(0.02, 0.0, 0.0), 0.02)

    first = kalman.correct(kalman.correct(memory, *old, params), *new, params)
    other = kalman.correct(kalman.correct(memory, *new, params), *old, params)

    np.testing.assert_allclose(first.velocity_enu_m_s, other.velocity_enu_m_s, atol=1e-9)
    np.testing.assert_allclose(first.covariance, other.covariance, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.3, 1.0]))
def test_it_is_a_textbook_kalman_filter(seed: int, drag_1_s: float) -> None:
    rng = np.random.default_rng(seed)
    params = KalmanParams(drag_1_s=drag_1_s, jump_gate_m=1e3, max_bias_m_s2=1e3)
    memory = kalman.initial(ZERO_3, params)
    textbook = MatrixKalman(drag_1_s)

    for _ in range(60):
        driven = float(rng.normal())
        t = float(rng.uniform(0.01, 0.03))
        memory = kalman.predict(memory, Vec3(driven, 0.0, 0.0), params, t)
        textbook.predict(driven, t)

        sample = Vec3(0.02 * float(rng.normal()), 0.0, 0.0)
        age = float(rng.choice([0.0, rng.uniform(0.0, 0.1)]))

        innovation = sample.x - kalman.position_at(memory, age).x
        if kalman.remembers(memory, age):
            memory = kalman.correct(memory, sample, age, params)
            textbook.correct(innovation, age)

        p = memory.position_enu_m.x
        v = memory.velocity_enu_m_s.x
        b = memory.bias_enu_m_s2.x
        np.testing.assert_allclose((p, v, b), textbook.x, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(
            memory.covariance, textbook.p[np.triu_indices(3)], rtol=1e-9, atol=1e-15
        )


def test_the_past_is_where_the_filter_was_when_nothing_corrects_it() -> None:
    params = KalmanParams(drag_1_s=0.3)
    rng = np.random.default_rng(11)
    memory = kalman.initial(Vec3(1.0, 2.0, 3.0), params)
    positions = [memory.position_enu_m]
    for _ in range(12):
        memory = kalman.predict(memory, vec(rng.normal(size=3)), params, DT)
        positions.append(memory.position_enu_m)

    for tick, position in enumerate(reversed(positions)):
        assert kalman.remembers(memory, tick * DT)
        np.testing.assert_allclose(kalman.position_at(memory, tick * DT), position, atol=1e-5)

    between = 0.5 * (np.array(positions[-3]) + np.array(positions[-4]))
    np.testing.assert_allclose(kalman.position_at(memory, 2.5 * DT), between, atol=1e-5)
    assert not kalman.remembers(memory, 12.1 * DT)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_motion_to_the_east_north_or_up_is_seen_that_way(axis: int) -> None:
    params = KalmanParams()
    memory = kalman.initial(ZERO_3, params)
    position = np.zeros(3)
    for tick in range(100):
        position[axis] = 0.3 * DT * (tick + 1)
        memory = kalman.correct(
            kalman.predict(memory, ZERO_3, params, DT), vec(position), 0.0, params
        )

    assert memory.velocity_enu_m_s[axis] == pytest.approx(0.3, abs=0.03)
    assert not np.delete(memory.velocity_enu_m_s, axis).any()


def test_attitude_and_throttle_drive_it_east_when_tilted_east() -> None:
    params = KalmanParams()
    memory = kalman.initial(ZERO_3, params)
    tilted = (math.cos(0.1), 0.0, math.sin(0.1), 0.0)  # FLU to ENU, top leans east

    for _ in range(50):
        memory = kalman.drive(memory, tilted, 0.75 / math.cos(0.2), 0.75, params, DT, False)

    assert memory.acceleration_enu_m_s2.x == pytest.approx(G * math.tan(0.2), rel=1e-6)
    assert abs(memory.acceleration_enu_m_s2.y) < 1e-12
    assert abs(memory.acceleration_enu_m_s2.z) < 1e-6


def test_throttle_acts_behind_the_motor_lag() -> None:
    params = KalmanParams(motor_lag_s=0.05)
    memory = kalman.initial(ZERO_3, params)._replace(thrust_m_s2=G)
    memory = kalman.drive(memory, LEVEL, 1.0, 0.5, params, 0.05, False)
    assert memory.acceleration_enu_m_s2.z == pytest.approx(G * (1 - math.exp(-1.0)))


def test_standing_on_the_ground_is_not_falling() -> None:
    params = KalmanParams()
    memory = kalman.initial(ZERO_3, params)
    for _ in range(200):
        memory = kalman.drive(memory, LEVEL, 0.1, 0.75, params, DT, True)
        memory = kalman.correct(memory, ZERO_3, 0.02, params)

    assert not np.any(memory.velocity_enu_m_s)
    assert not np.any(memory.bias_enu_m_s2)


def test_a_constant_error_of_the_model_becomes_the_bias() -> None:
    params = KalmanParams()
    memory = kalman.initial(ZERO_3, params)
    for tick in range(400):
        t = (tick + 1) * DT
        memory = kalman.predict(memory, ZERO_3, params, DT)
        memory = kalman.correct(memory, Vec3(0.25 * t * t / 2, 0.0, 0.0), 0.0, params)

    assert memory.bias_enu_m_s2.x == pytest.approx(0.25, abs=0.01)


def test_the_bias_is_bounded() -> None:
    params = KalmanParams(max_bias_m_s2=0.1)
    memory = kalman.initial(ZERO_3, params)
    for tick in range(400):
        t = (tick + 1) * DT
        memory = kalman.predict(memory, ZERO_3, params, DT)
        memory = kalman.correct(memory, Vec3(0.25 * t * t / 2, -0.25 * t * t / 2, 0.0), 0.0, params)

    assert memory.bias_enu_m_s2 == Vec3(0.1, -0.1, 0.0)


def test_a_jump_is_ignored_counted_and_forgotten_after_a_good_sample() -> None:
    params = KalmanParams()
    good = kalman.initial(ZERO_3, params)
    for _ in range(50):
        good = kalman.correct(kalman.predict(good, ZERO_3, params, DT), ZERO_3, 0.02, params)

    jumped = good

    for count in range(1, 4):
        good = kalman.correct(
            kalman.predict(good, ZERO_3, params, DT), Vec3(0.001, 0.0, 0.0), 0.02, params
        )
        jumped = kalman.correct(
            kalman.predict(jumped, ZERO_3, params, DT), Vec3(0.9, 0.0, 0.0), 0.02, params
        )
        assert (jumped.rejected_count, good.rejected_count) == (count, 0)

    assert np.abs(jumped.position_enu_m).max() < 1e-9
    assert jumped.last_age_s > 0.05 > good.last_age_s
    assert kalman.correct(jumped, ZERO_3, 0.02, params).rejected_count == 0


def test_the_stated_accuracy_grows_while_no_sample_comes() -> None:
    _, _, memory = flights(6.0, 1, seed=4)
    before = kalman.state(memory, 0.0, 0.0, 0.0)
    for _ in range(50):
        memory = kalman.predict(memory, ZERO_3, KalmanParams(), DT)

    after = kalman.state(memory, 0.0, 0.0, 0.0)

    assert after.velocity_std_m_s > 3 * before.velocity_std_m_s
    assert after.position_std_m > 10 * before.position_std_m
    assert memory.last_age_s == pytest.approx(1.02)


def test_the_stated_accuracy_is_never_better_than_that_of_the_samples() -> None:
    _, _, memory = flights(5.0, 1, seed=4)
    state = kalman.state(memory, 0.4, 1.5, 0.3)
    assert (state.position_std_m, state.velocity_std_m_s, state.yaw_rad, state.age_s) == (
        1.5,
        0.3,
        0.4,
        0.0,
    )


@pytest.mark.parametrize(
    "sample", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, -math.inf)]
)
def test_values_that_are_not_finite_change_nothing(sample: tuple[float, float, float]) -> None:
    params = KalmanParams()
    memory = kalman.predict(kalman.initial(ZERO_3, params), ZERO_3, params, DT)

    assert kalman.correct(memory, Vec3(*sample), 0.0, params) is memory
    assert kalman.correct(memory, ZERO_3, math.inf, params) is memory
    assert kalman.correct(memory, ZERO_3, math.nan, params) is memory
    after = kalman.predict(memory, Vec3(math.nan, 0.0, 0.0), params, DT)
    after = kalman.drive(after, LEVEL, math.nan, 0.5, params, DT, False)
    after = kalman.drive(after, (math.nan,) * 4, 0.5, 0.5, params, DT, False)
    assert np.isfinite([*after.position_enu_m, *after.velocity_enu_m_s, *after.covariance]).all()


def test_a_sample_older_than_the_memory_is_ignored() -> None:
    params = KalmanParams()
    memory = kalman.initial(ZERO_3, params)
    for _ in range(2 * kalman.HISTORY_TICKS):
        memory = kalman.predict(memory, ZERO_3, params, DT)
    sample = Vec3(0.05, 0.0, 0.0)
    assert kalman.correct(memory, sample, (kalman.HISTORY_TICKS + 1) * DT, params) is memory
    assert kalman.correct(memory, sample, kalman.HISTORY_TICKS * DT, params) is not memory


def test_turning_and_moving_the_world_turns_the_estimate() -> None:
    params = KalmanParams(drag_1_s=0.5)
    q = quaternion_from_yaw(0.9)
    shift = Vec3(4.0, -1.0, 2.0)
    rng = np.random.default_rng(7)
    plain = kalman.initial(ZERO_3, params)
    turned = kalman.initial(shift, params)
    for _ in range(60):
        driven = vec(rng.normal(size=3))
        sample = vec(0.02 * rng.normal(size=3))
        plain = kalman.correct(kalman.predict(plain, driven, params, DT), sample, 0.03, params)
        turned = kalman.predict(turned, rotate(q, driven), params, DT)
        turned = kalman.correct(turned, add(rotate(q, sample), shift), 0.03, params)
    np.testing.assert_allclose(
        turned.position_enu_m, add(rotate(q, plain.position_enu_m), shift), atol=1e-9
    )
    np.testing.assert_allclose(
        turned.velocity_enu_m_s, rotate(q, plain.velocity_enu_m_s), atol=1e-9
    )


def test_scaling_length_and_time_scales_the_estimate() -> None:
    length = 2.5
    time = 0.4
    one = KalmanParams(drag_1_s=0.5)
    # noise densities carry half powers of time
    two = KalmanParams(
        position_noise_m=0.003 * length,
        acceleration_noise=0.03 * length / time**1.5,
        bias_noise=0.12 * length / time**2.5,
        max_bias_m_s2=3.0 * length / time**2,
        drag_1_s=0.5 / time,
        jump_gate_m=one.jump_gate_m * length,
    )
    a = kalman.initial(ZERO_3, one)
    b = kalman.initial(ZERO_3, two)
    weights = (
        np.array([1, 1 / time, 1 / time**2, 1 / time**2, 1 / time**3, 1 / time**4]) * length**2
    )
    covariance = np.array(list(a.covariance)) * weights
    b = b._replace(covariance=Covariance(*covariance.tolist()))
    rng = np.random.default_rng(8)
    for _ in range(60):
        driven = vec(rng.normal(size=3))
        sample = vec(0.02 * rng.normal(size=3))
        a = kalman.correct(kalman.predict(a, driven, one, DT), sample, 0.03, one)
        b = kalman.predict(b, scaled(length / time**2, driven), two, time * DT)
        b = kalman.correct(b, scaled(length, sample), time * 0.03, two)
    np.testing.assert_allclose(b.position_enu_m, scaled(length, a.position_enu_m), atol=1e-9)
    np.testing.assert_allclose(
        b.velocity_enu_m_s, scaled(length / time, a.velocity_enu_m_s), atol=1e-9
    )


def test_a_doubted_estimate_follows_its_next_samples_within_a_fraction_of_a_second() -> None:
    # settled at rest, with the noise of satellites; in truth it flies at a metre a second
    params = KalmanParams(position_noise_m=0.05)
    settled = kalman.initial(ZERO_3, params)
    for _ in range(500):
        settled = kalman.predict(settled, ZERO_3, params, DT)
        settled = kalman.correct(settled, ZERO_3, 0.0, params)

    speeds_m_s = []
    for memory in (settled, kalman.doubted(settled)):
        for tick in range(1, 16):
            memory = kalman.predict(memory, ZERO_3, params, DT)
            memory = kalman.correct(memory, Vec3(DT * tick, 0.0, 0.0), 0.0, params)
        speeds_m_s.append(memory.velocity_enu_m_s.x)
    assert speeds_m_s[0] < 0.5
    assert 0.8 < speeds_m_s[1] < 1.3


@pytest.mark.parametrize("throttle", [0.5, 0.2])
def test_a_push_shows_sooner_after_a_lift_off_than_on_the_ground(throttle: float) -> None:
    # whoever lifts off gets 2 m/s^2 of wind from one moment to the next
    params = KalmanParams()
    memory = kalman.initial(ZERO_3, params)
    for _ in range(150):
        memory = kalman.drive(memory, LEVEL, throttle, 0.5, params, DT, True)
        memory = kalman.correct(memory, ZERO_3, 0.0, params)

    for tick in range(1, 9):
        memory = kalman.drive(memory, LEVEL, throttle, 0.5, params, DT, True)
        position_enu_m = Vec3(0.5 * 2.0 * (tick * DT) ** 2, 0.0, 0.0)
        memory = kalman.correct(memory, position_enu_m, 0.0, params)
    is_lifting = throttle == 0.5
    assert (memory.velocity_enu_m_s.x > 0.8 * 2.0 * 8 * DT) is is_lifting
    assert (memory.bias_enu_m_s2.x > 1.4) is is_lifting
