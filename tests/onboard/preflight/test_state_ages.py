"""Delay and loss that preflight measures from the ages of the neighbours' states."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.preflight.preflight_facts import RadioMeasured
from onboard.preflight.state_ages import StateAges

PERIOD_S = 0.02
PHASE_S = 0.007  # from the arrival of a state to the tick


def measured(
    delay_s: float, loss_frac: float, *, samples: int = 120, seed: int = 1
) -> RadioMeasured | None:
    """Return what is measured when the states of mav1 are late and lost; mav2 has a good radio."""
    rng = np.random.default_rng(seed)
    ages = StateAges(PERIOD_S)
    for _ in range(samples):
        lost_count = 0
        while rng.random() < loss_frac:
            lost_count += 1
        ages.update({"mav1": delay_s + PHASE_S + lost_count * PERIOD_S, "mav2": 0.02})
    return ages.measured


def test_nothing_is_said_from_a_few_samples() -> None:
    assert measured(0.04, 0.1, samples=20) is None


@pytest.mark.parametrize(("delay_s", "loss_frac"), [(0.04, 0.0), (0.2, 0.3), (0.1, 0.1)])
def test_delay_and_loss_are_those_of_the_worst_neighbour(delay_s: float, loss_frac: float) -> None:
    radio = measured(delay_s, loss_frac)
    assert radio is not None
    assert radio.delayed == "mav1"
    assert radio.delay_s == pytest.approx(delay_s + PHASE_S)
    assert radio.loss_frac == pytest.approx(loss_frac, abs=0.09)


def test_a_neighbour_that_has_left_is_forgotten() -> None:
    ages = StateAges(PERIOD_S)
    for _ in range(100):
        ages.update({"mav1": 0.3, "mav2": 0.02})
    for _ in range(100):
        ages.update({"mav2": 0.02, "mav3": 7.0})

    radio = ages.measured
    assert radio is not None
    assert radio.delayed == "mav2"
    assert radio.loss_frac == 0.0
