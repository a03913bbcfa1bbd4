"""Prediction over the own lag and over the age of a message."""

import numpy as np

from onboard.avoidance import prediction


def history_of(commands, dt_s=0.02):
    """Oldest command first."""
    history = prediction.initial(commands[0].shape[:-1])
    for command in commands:
        history = prediction.record(history, command, dt_s)
    return history


def integrate(commands, position, velocity, dt_s):
    for u in commands:
        position = position + dt_s * velocity + 0.5 * dt_s**2 * u
        velocity = velocity + dt_s * u
    return position, velocity


def test_whole_ticks_equal_step_by_step_integration_oldest_first():
    rng = np.random.default_rng(0)
    commands = list(rng.normal(size=(12, 3)))
    p, v = rng.normal(size=3), rng.normal(size=3)
    history = history_of(commands)
    predicted = prediction.predict_own(history, p, v, np.array(0.16))
    np.testing.assert_allclose(predicted, integrate(commands[-8:], p, v, 0.02), atol=1e-12)


def test_a_window_between_ticks_uses_the_part_of_the_oldest_command_that_is_inside():
    u_old, u_new = np.array([1.0, 0, 0]), np.array([0, 2.0, 0])
    history = history_of([u_old, u_new])
    p, v = prediction.predict_own(history, np.zeros(3), np.zeros(3), np.array(0.03))
    p_ref, v_ref = integrate([u_old], np.zeros(3), np.zeros(3), 0.01)
    p_ref, v_ref = integrate([u_new], p_ref, v_ref, 0.02)
    np.testing.assert_allclose(p, p_ref, atol=1e-15)
    np.testing.assert_allclose(v, v_ref, atol=1e-15)


def test_unequal_ticks_are_counted_by_their_time():
    u = np.array([1.0, 0.0, 0.0])
    history = prediction.initial(())
    for dt in (0.02, 0.005, 0.035, 0.01):
        history = prediction.record(history, u, dt)
    p, v = prediction.predict_own(history, np.zeros(3), np.zeros(3), np.array(0.06))
    np.testing.assert_allclose(v, 0.06 * u, atol=1e-15)
    np.testing.assert_allclose(p, 0.5 * 0.06**2 * u, atol=1e-15)


def test_no_commands_predict_constant_velocity():
    p, v = prediction.predict_own(prediction.initial(()), np.ones(3), np.array([1.0, 2.0, 3.0]), np.array(0.5))
    np.testing.assert_allclose(p, [1.5, 2.0, 2.5])
    np.testing.assert_allclose(v, [1.0, 2.0, 3.0])


def test_batch_equals_loop_with_a_window_each():
    rng = np.random.default_rng(1)
    commands = list(rng.normal(size=(6, 4, 3)))
    p, v, window = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), np.array([0.0, 0.03, 0.1, 9.0])
    together = prediction.predict_own(history_of(commands), p, v, window)
    for k in range(4):
        alone = prediction.predict_own(history_of([c[k] for c in commands]), p[k], v[k], window[k])
        np.testing.assert_allclose(np.array(alone), np.array(together)[:, k], atol=1e-13)


def test_turning_the_world_turns_the_prediction():
    rng = np.random.default_rng(2)
    commands, p, v = rng.normal(size=(9, 3)), rng.normal(size=3), rng.normal(size=3)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]])
    plain = prediction.predict_own(history_of(list(commands)), p, v, np.array(0.13))
    turned = prediction.predict_own(history_of(list(commands @ turn.T)), turn @ p, turn @ v, np.array(0.13))
    np.testing.assert_allclose(np.array(turned), np.array(plain) @ turn.T, atol=1e-13)


def test_a_command_that_is_not_finite_counts_as_none():
    history = history_of([np.array([np.nan, np.inf, 1.0])])
    p, v = prediction.predict_own(history, np.zeros(3), np.zeros(3), np.array(0.02))
    assert np.isfinite(p).all()
    np.testing.assert_allclose(v, [0, 0, 0.02])


def carried(position, velocity, command, age, *, plain=None, lead=0.15, own_lead=0.15):
    position, velocity, command = (np.array([x], float) for x in (position, velocity, command))
    plain = velocity if plain is None else np.array([plain], float)
    result = prediction.predict_neighbour(
        position, velocity, command, plain, np.array([age]), np.array([lead]), own_lead
    )
    return np.array(result)[:, 0]


def test_neighbour_is_carried_along_its_command_for_the_age_of_its_message():
    q, w = carried([0, 0, 0], [1.0, 0, 0], [0, 2.0, 0], 0.1)
    np.testing.assert_allclose(q, [0.1, 0.5 * 2.0 * 0.01, 0])
    np.testing.assert_allclose(w, [1.0, 0.2, 0])


def test_silent_neighbour_is_not_extrapolated_for_ever():
    late, later = (carried([0, 0, 0], [1.0, 0, 0], [1.0, 0, 0], age) for age in (0.3, 30.0))
    np.testing.assert_array_equal(late, later)


def test_neighbour_with_another_lag_is_carried_to_our_own_time():
    """A neighbour under one constant acceleration, predicted over its own lag, is where it will be after ours."""
    p, v, a = np.array([0.3, -0.2, 1.0]), np.array([0.7, 0.4, 0.0]), np.array([1.5, -2.0, 0.0])
    for lead, own_lead, age in ((0.27, 0.15, 0.04), (0.15, 0.27, 0.04), (0.40, 0.05, 0.0), (0.15, 0.0, 0.02)):
        told = p + lead * v + 0.5 * lead**2 * a, v + lead * a
        q, w = carried(*told, a, age, plain=v, lead=lead, own_lead=own_lead)
        then = age + own_lead
        np.testing.assert_allclose(q, p + then * v + 0.5 * then**2 * a, atol=1e-12)
        np.testing.assert_allclose(w, v + then * a, atol=1e-12)


def test_lead_that_ends_at_our_time_leaves_the_prediction_as_it_is_from_both_sides():
    for shift in (-1e-9, 0.0, 1e-9):
        q, w = carried([1, 2, 3], [1, 0, 0], [0, 5, 0], 0.05, plain=[3, 3, 3], lead=0.20 + shift, own_lead=0.15)
        np.testing.assert_allclose(q, [1, 2, 3], atol=1e-7)
        np.testing.assert_allclose(w, [1, 0, 0], atol=1e-6)
