"""The radio of rollouts: how old a received message is, and how old it is said to be."""

import numpy as np
import pytest

from onboard.rollout import layouts
from onboard.rollout.radio import Radio
from onboard.rollout.vehicle_model import Perturbation
from onboard.types import TICK_S

VEHICLES = 3


def states_at(tick):
    """Return the states of one flight in which all vehicles fly east with 1 m/s."""
    states = layouts.STATE.rows((1, VEHICLES))
    states["position_enu_m"][..., 0] = tick * TICK_S
    return states


def true_and_told_ages(message_delay_ticks, message_loss, ticks):
    """Return how old received positions are in each tick, and how old they are said to be."""
    errors = Perturbation(message_delay_ticks=message_delay_ticks, message_loss=message_loss)
    draws = np.random.default_rng(7)
    radio = Radio(states_at(0), np.zeros(VEHICLES, bool), errors)

    for tick in range(ticks):
        neighbours, _ = radio.receive(draws.uniform(size=(1, VEHICLES, VEHICLES)))
        true_s = tick * TICK_S - neighbours["position_enu_m"][..., 0]
        yield true_s, neighbours["age_s"]
        radio.publish(states_at(tick), None)


@pytest.mark.parametrize("message_loss", [0.0, 0.3])
@pytest.mark.parametrize("message_delay_ticks", [0, 1, 2, 5])
def test_a_message_is_as_old_as_it_is_said_to_be(message_delay_ticks, message_loss):
    ages = list(true_and_told_ages(message_delay_ticks, message_loss, ticks=60))

    # the first messages are those with which the flight begins, older than the flight itself
    for true_s, told_s in ages[30:]:
        np.testing.assert_allclose(told_s, true_s, atol=1e-9)


def test_without_losses_each_message_is_as_old_as_the_delay():
    *_, (true_s, told_s) = true_and_told_ages(message_delay_ticks=2, message_loss=0.0, ticks=20)
    np.testing.assert_allclose(true_s, 2 * TICK_S)
    np.testing.assert_allclose(told_s, 2 * TICK_S)
