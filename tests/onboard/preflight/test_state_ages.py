"""Delay and loss that preflight measures from the ages of the neighbours' states."""

import numpy as np
import pytest

from onboard.preflight.state_ages import StateAges

PERIOD_S = 0.02


def measured(delay_s, loss, *, samples=120, seed=1):
    """Ages of the newest state of 'mav1' at ticks, with a phase of 7 ms; 'mav2' has a good radio."""
    rng = np.random.default_rng(seed)
    ages = StateAges(PERIOD_S)
    for _ in range(samples):
        lost = 0
        while rng.random() < loss:
            lost += 1
        ages.update({"mav1": delay_s + 0.007 + lost * PERIOD_S, "mav2": 0.02})
    return ages.measured


def test_nothing_is_said_from_a_few_samples():
    assert measured(0.04, 0.1, samples=20) is None


@pytest.mark.parametrize(("delay_s", "loss"), [(0.04, 0.0), (0.2, 0.3), (0.1, 0.1)])
def test_delay_and_loss_are_those_of_the_worst_neighbour(delay_s, loss):
    radio = measured(delay_s, loss)
    assert radio.delayed == "mav1"
    assert radio.delay_s == pytest.approx(delay_s + 0.007)
    assert radio.loss_frac == pytest.approx(loss, abs=0.09)


def test_a_neighbour_that_has_gone_is_forgotten_and_no_matter_of_the_radio():
    ages = StateAges(PERIOD_S)
    for _ in range(100):
        ages.update({"mav1": 0.3, "mav2": 0.02})
    for _ in range(100):
        ages.update({"mav2": 0.02, "mav3": 7.0})
    assert ages.measured.delayed == "mav2"
    assert ages.measured.loss_frac == 0.0
