"""Prediction over the own lag and over the age of a message."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.avoidance import oist, prediction
from onboard.avoidance.prediction import Motion
from onboard.vectors import ZERO_3, Vec3
from tests.onboard.avoidance.law_cases import law_of, neighbour_of, state_of, vec

NUMBER = st.floats(-5, 5)
VECTOR = st.builds(Vec3, NUMBER, NUMBER, NUMBER)
COMMANDS = st.lists(VECTOR, min_size=1, max_size=12)


def history_of(commands, dt_s=0.02):
    """Oldest command first."""
    history = prediction.no_commands()
    for command in commands:
        history = prediction.remembered(history, vec(command), dt_s)
    return history


def predicted(history, position, velocity, window_s, window_z_s=None):
    motion = Motion(vec(position), vec(velocity))
    return prediction.predict_own(
        history, motion, window_s, window_s if window_z_s is None else window_z_s
    )


def integrate(commands, position, velocity, dt_s):
    for u in commands:
        position = position + dt_s * velocity + 0.5 * dt_s**2 * u
        velocity = velocity + dt_s * u
    return position, velocity


def test_whole_ticks_equal_step_by_step_integration_oldest_first():
    rng = np.random.default_rng(0)
    commands = list(rng.normal(size=(12, 3)))
    (p, v) = rng.normal(size=(2, 3))
    result = predicted(history_of(commands), p, v, 0.16)
    np.testing.assert_allclose(result, integrate(commands[-8:], p, v, 0.02), atol=1e-12)


def test_a_window_between_ticks_uses_the_part_of_the_oldest_command_that_is_inside():
    u_old = np.array([1.0, 0, 0])
    u_new = np.array([0, 2.0, 0])
    zero = np.zeros(3)
    p, v = integrate([u_old], zero, zero, 0.01)
    reference = integrate([u_new], p, v, 0.02)
    np.testing.assert_allclose(
        predicted(history_of([u_old, u_new]), zero, zero, 0.03), reference, atol=1e-15
    )


def test_unequal_ticks_are_counted_by_their_time():
    u = Vec3(1.0, 0.0, 0.0)
    history = prediction.no_commands()
    for dt in (0.02, 0.005, 0.035, 0.01):
        history = prediction.remembered(history, u, dt)
    p, v = predicted(history, ZERO_3, ZERO_3, 0.06)
    np.testing.assert_allclose(v, 0.06 * np.array(u), atol=1e-15)
    np.testing.assert_allclose(p, 0.5 * 0.06**2 * np.array(u), atol=1e-15)


def test_the_history_has_the_same_length_for_ever():
    history = history_of(np.ones((3 * prediction.SLOTS, 3)))
    assert len(history) == prediction.SLOTS


def test_no_commands_predict_constant_velocity():
    p, v = predicted(prediction.no_commands(), np.ones(3), [1.0, 2.0, 3.0], 0.5)
    np.testing.assert_allclose(p, [1.5, 2.0, 2.5])
    np.testing.assert_allclose(v, [1.0, 2.0, 3.0])


def test_vertical_axis_obeys_its_own_lag_and_then_flies_straight_on():
    history = history_of(np.tile([0.0, 0.0, 2.0], (8, 1)))
    p, v = predicted(history, ZERO_3, [0.0, 0.0, 1.0], 0.15, 0.09)
    at_z = 0.09 + 0.5 * 2.0 * 0.09**2
    np.testing.assert_allclose(v.z, 1.0 + 2.0 * 0.09, atol=1e-12)
    np.testing.assert_allclose(p.z, at_z + 0.06 * v.z, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(COMMANDS, VECTOR, VECTOR, st.floats(0, 0.24))
def test_translation_and_rotation_equivariant(commands, p, v, window_s):
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]])
    plain = np.array(predicted(history_of(commands), p, v, window_s))
    turned = predicted(history_of(np.array(commands) @ turn.T), turn @ p + 3.0, turn @ v, window_s)
    np.testing.assert_allclose(turned, plain @ turn.T + [[3.0] * 3, [0.0] * 3], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(COMMANDS, st.floats(-3, 3), st.floats(0, 0.24))
def test_linear_in_the_commands(commands, factor, window_s):
    plain = np.array(predicted(history_of(commands), ZERO_3, ZERO_3, window_s))
    scaled = predicted(history_of(factor * np.array(commands)), ZERO_3, ZERO_3, window_s)
    np.testing.assert_allclose(scaled, factor * plain, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(COMMANDS, VECTOR, VECTOR, st.integers(0, 12))
def test_a_window_cut_in_two_gives_the_same(commands, p, v, cut):
    cut = min(cut, len(commands))
    whole = predicted(history_of(commands), p, v, 0.02 * len(commands))
    position, velocity = predicted(history_of(commands[:cut]), p, v, 0.02 * cut)
    second = predicted(history_of(commands[cut:]), position, velocity, 0.02 * (len(commands) - cut))
    np.testing.assert_allclose(second, whole, atol=1e-9)


def test_a_command_that_is_not_finite_counts_as_none():
    history = history_of([[math.nan, math.inf, 1.0]])
    p, v = predicted(history, ZERO_3, ZERO_3, 0.02)
    assert np.isfinite(p).all()
    np.testing.assert_allclose(v, [0, 0, 0.02])


def test_the_law_predicts_over_lag_and_age_unless_the_policy_or_the_paper_says_otherwise():
    memory = oist.initial()
    state = state_of([1, 2, 3], [1, 0, 0])._replace(age_s=0.05)
    ahead = {
        name: oist.predict(memory, state, params, 0.02).position_enu_m.x - 1.0
        for name, params in (
            ("lag", law_of()),
            ("none", law_of(prediction="none")),
            ("paper", law_of(name="paper")),
            ("unknown age", law_of()),
        )
    }
    np.testing.assert_allclose([ahead["lag"], ahead["none"], ahead["paper"]], [0.2, 0.0, 0.0])
    unknown = oist.predict(memory, state._replace(age_s=math.nan), law_of(), 0.02)
    np.testing.assert_allclose(unknown.position_enu_m.x, 1.15)


def estimate(position_m, velocity_m_s, stds=(0.05, 0.12)):
    state = state_of(position_m, velocity_m_s)
    return state._replace(position_std_m=stds[0], velocity_std_m_s=stds[1])


def predictions(errors, stds, commands, response=1.0):
    """Predictions of a vehicle under its commands, and what they are without errors.

    It accelerates by `response` times its commands, as its estimated acceleration says.
    """
    memory = oist.initial()
    position, velocity = np.zeros(3), np.zeros(3)
    found = []
    exact = []
    flown = np.zeros(3)
    for error, command in zip(errors, commands, strict=True):
        state = estimate(position + error[:3], velocity + error[3:], stds)
        state = state._replace(acceleration_enu_m_s2=vec(flown))
        motion = oist.predict(memory, state, law_of(), 0.02)
        truth = predicted(memory.commands, position, velocity, 0.15)
        found.append([*motion.position_enu_m, *motion.velocity_enu_m_s])
        exact.append([*truth.position_enu_m, *truth.velocity_enu_m_s])

        memory = memory._replace(
            commands=prediction.remembered(memory.commands, vec(command), 0.02), predicted=motion
        )
        # the command of 0.14 s ago acts now, as the lag of 0.15 s says
        flown = response * np.array(memory.commands[7].acceleration_enu_m_s2)
        position, velocity = integrate([flown], position, velocity, 0.02)
    return np.array(found), np.array(exact)


def swinging(count):
    return [[2.0 * math.sin(0.2 * k), 2.0 * math.cos(0.1 * k), 0.0] for k in range(count)]


def test_noise_of_the_estimate_is_smoothed_and_the_answer_to_commands_is_not_delayed():
    rng = np.random.default_rng(4)
    errors = rng.normal(size=(300, 6)) * ([0.05, 0.05, 0.0, 0.12, 0.12, 0.0])
    found, exact = predictions(errors, (0.05, 0.12), swinging(300))
    columns = [0, 1, 3, 4]
    jumps = np.abs(np.diff(found - exact, axis=0))[:, columns].mean(axis=0)
    raw_jumps = np.abs(np.diff(errors, axis=0))[:, columns].mean(axis=0)
    assert (jumps < 0.25 * raw_jumps).all()

    found, exact = predictions(np.zeros((300, 6)), (0.05, 0.12), swinging(300))
    np.testing.assert_allclose(found, exact, atol=0.02)


def test_a_rough_estimate_follows_a_vehicle_that_accelerates_otherwise_than_it_was_commanded():
    found, exact = predictions(np.zeros((300, 6)), (0.05, 0.12), swinging(300), response=0.7)
    np.testing.assert_allclose(found, exact, atol=0.005)


def test_an_estimate_that_is_exact_or_says_nothing_is_not_smoothed():
    rng = np.random.default_rng(5)
    errors = 0.01 * rng.normal(size=(20, 6))
    plain = [
        oist.predict(oist.initial(), estimate(error[:3], error[3:]), law_of(), 0.02)
        for error in errors
    ]
    for std in (0.0, math.nan):
        memory = oist.initial()
        for error, motion in zip(errors, plain, strict=True):
            state = estimate(error[:3], error[3:], (0.05, std))
            found = oist.predict(memory, state, law_of(), 0.02)
            assert found == motion
            memory = memory._replace(predicted=found)


def test_a_jump_of_the_estimate_is_followed_at_once_up_to_two_standard_deviations():
    before = oist.predict(oist.initial(), estimate(ZERO_3, ZERO_3), law_of(), 0.02)
    memory = oist.initial()._replace(predicted=before)
    jumped = estimate([3.0, 0.0, 1.0], [0.0, -2.0, 0.5])
    after = oist.predict(memory, jumped, law_of(), 0.02)
    raw = oist.predict(oist.initial(), jumped, law_of(), 0.02)
    # the filter keeps its shares of two standard deviations of 0.12 m/s and of 0.05 m
    left_m_s = after.velocity_enu_m_s.y - raw.velocity_enu_m_s.y
    assert left_m_s == pytest.approx(math.exp(-0.02 / 0.7) * 2.0 * 0.12)
    left_m = raw.position_enu_m.x - after.position_enu_m.x
    # for the difference of the positions the velocity gains 4/s^2, over the lag of 0.15 s
    gained_m = 0.15 * (4.0 * 0.02 * 2.0 * 0.05)
    assert left_m == pytest.approx(math.exp(-0.02 / 0.2) * 2.0 * 0.05 - gained_m)
    assert after.position_enu_m.z == raw.position_enu_m.z


def test_a_very_inaccurate_estimate_is_not_smoothed_for_longer():
    errors = np.zeros((2, 6))
    errors[1, 3] = 1.0
    found, _ = predictions(errors, (1e6, 1e6), swinging(2))
    assert found[1, 3] - found[0, 3] == pytest.approx(1.0 - math.exp(-0.02 / 0.7), rel=0.05)


def carried(position, velocity, command, age, *, plain=None, lead=0.15, own_lead=0.15):
    neighbour = neighbour_of(
        position, velocity if plain is None else plain, command, age_s=age, lead_time_s=lead
    )
    neighbour = neighbour._replace(predicted_velocity_enu_m_s=vec(velocity))
    received = prediction.receive(neighbour, own_lead)
    assert received.is_usable
    return np.array(received.position_m), np.array(received.velocity_m_s)


def test_neighbour_is_carried_along_its_command_for_the_age_of_its_message():
    q, w = carried([0, 0, 0], [1.0, 0, 0], [0, 2.0, 0], 0.06)
    np.testing.assert_allclose(q, [0.06, 0.5 * 2.0 * 0.0036], atol=1e-15)
    np.testing.assert_allclose(w, [1.0, 0.12])


def test_silent_neighbour_is_not_extrapolated_for_ever():
    late, *others = (
        carried([0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], age) for age in (0.8, 30.0, math.nan, math.inf)
    )
    for later in others:
        np.testing.assert_array_equal(late, later)
    moving = neighbour_of([0, 0, 0], [1.0, 0, 0], [0, 0, 0], age_s=30.0)._replace(
        is_cooperative=False
    )
    np.testing.assert_allclose(prediction.receive(moving, 0.15).position_m, [0.45, 0.0])


def test_neighbour_whose_states_are_late_for_the_radio_is_carried_on_as_it_said():
    q, w = carried([0, 0, 0], [1.0, 0, 0], [0, 0, 0], 0.4)
    np.testing.assert_allclose(q, [0.4, 0.0])
    np.testing.assert_allclose(w, [1.0, 0.0])


def test_neighbour_with_another_lag_is_carried_to_our_own_time():
    """A neighbour under one constant acceleration, predicted over its own lag, is where it will be
    after ours.
    """
    p = np.array([0.3, -0.2, 1.0])
    v = np.array([0.7, 0.4, 0.0])
    a = np.array([1.5, -2.0, 0.0])
    for lead, own_lead, age in (
        (0.27, 0.15, 0.04),
        (0.15, 0.27, 0.04),
        (0.40, 0.05, 0.0),
        (0.15, 0.0, 0.02),
    ):
        q, w = carried(
            p + lead * v + 0.5 * lead**2 * a,
            v + lead * a,
            a,
            age,
            plain=v,
            lead=lead,
            own_lead=own_lead,
        )
        then = age + own_lead
        np.testing.assert_allclose(q, (p + then * v + 0.5 * then**2 * a)[:2], atol=1e-12)
        np.testing.assert_allclose(w, (v + then * a)[:2], atol=1e-12)


def test_lead_that_ends_at_our_time_leaves_the_prediction_as_it_is_from_both_sides():
    for shift in (-1e-9, 0.0, 1e-9):
        q, w = carried(
            [1, 2, 3], [1, 0, 0], [0, 5, 0], 0.05, plain=[3, 3, 3], lead=0.20 + shift, own_lead=0.15
        )
        np.testing.assert_allclose(q, [1, 2], atol=1e-7)
        np.testing.assert_allclose(w, [1, 0], atol=1e-6)


def test_neighbour_that_does_not_cooperate_is_carried_on_from_its_plain_estimate():
    neighbour = neighbour_of([1, 2, 3], [1, 0, 0], [5, 5, 0], is_cooperative=False, age_s=0.05)
    neighbour = neighbour._replace(acceleration_enu_m_s2=Vec3(0.0, 0.0, 0.0))
    received = prediction.receive(neighbour, 0.15)
    np.testing.assert_allclose(received.position_m, [1.2, 2.0])
    assert received.command_m_s2 == (0.0, 0.0)
    braking = neighbour._replace(acceleration_enu_m_s2=Vec3(-2.0, 0.0, 0.0))
    received = prediction.receive(braking, 0.15)
    np.testing.assert_allclose(received.position_m, [1.16, 2.0])
    np.testing.assert_allclose(received.velocity_m_s, [0.6, 0.0])
    absurd = neighbour._replace(acceleration_enu_m_s2=Vec3(0.0, 1e4, math.nan))
    assert prediction.receive(absurd, 0.15).position_m.y < 2.0 + 0.5 * 0.2**2 * 9.81
    assert not prediction.receive(
        neighbour._replace(position_enu_m=Vec3(math.nan, 0, 0)), 0.15
    ).is_usable


def spread_of_distance(errors, kappas=(8.0, 7.0), dt_s=0.02):
    """What errors of position and velocity (T, 2) make of the distance that a pair's row keeps."""
    a_1 = kappas[0] + kappas[1]
    a_0 = kappas[0] * kappas[1]
    distance = rate = 0.0
    found = []
    for position, velocity in errors:
        rate += dt_s * (a_0 * (position - distance) + a_1 * (velocity - rate))
        distance += dt_s * rate
        found.append(distance)
    return np.std(found)


def test_smoothing_a_rough_estimate_leaves_the_distance_of_a_pair_as_certain_as_it_was():
    count, dt_s, time_s = 10_000, 0.02, 0.5
    kept = math.exp(-dt_s / time_s)
    rng = np.random.default_rng(6)
    raw = np.zeros((count, 2))
    raw[0] = rng.normal(size=2)
    for k in range(1, count):
        raw[k] = kept * raw[k - 1] + math.sqrt(1.0 - kept**2) * rng.normal(size=2)
    raw *= (0.05, 0.12)

    errors = np.zeros((count, 6))
    errors[:, 0] = raw[:, 0]
    errors[:, 3] = raw[:, 1]
    found, exact = predictions(errors, (0.05, 0.12), np.zeros((count, 3)))
    velocity = (found - exact)[:, 3]
    position = (found - exact)[:, 0] - 0.15 * velocity
    smoothed = np.column_stack([position, velocity])
    assert spread_of_distance(smoothed) < 1.1 * spread_of_distance(raw)
    assert np.std(velocity) < 0.65 * np.std(raw[:, 1])
