"""How many times as long paths must take, and that fitting a path adds no accelerations to it."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.paths.checks import FlightLimits, needed_slowing, sample
from groundstation.paths.pieces import fitted, slowed
from onboard.control.path import Path

WIDE_M_S = 100.0
_FINE_S = 0.005  # between two samples, so that no peak lies between them


def weaving(amplitude_m: float, period_s: float) -> Path:
    """A path that goes ten times to and fro, from rest to rest, as its samples say."""
    times_s = np.arange(0.0, 10.0 * period_s + 0.01, 0.05)
    omega = 2.0 * np.pi / period_s
    values = np.zeros((len(times_s), 4))
    values[:, 0] = amplitude_m * (1.0 - np.cos(omega * times_s))
    values[:, 2] = 1.0
    return fitted(times_s, values)


@pytest.mark.parametrize("period_s", [2.0, 3.0, 5.0])
def test_a_fitted_path_accelerates_no_more_than_its_samples(period_s: float) -> None:
    amplitude_m = 2.0
    highest_m_s2 = amplitude_m * (2.0 * np.pi / period_s) ** 2
    flown = sample({"mav0": weaving(amplitude_m, period_s)})
    # the first and the last second begin and end at rest, which the samples do not
    within = (flown.times_s > 1.0) & (flown.times_s < flown.times_s[-1] - 1.0)
    acceleration = np.abs(flown.values[2][within, 0, 0]).max()
    assert acceleration < highest_m_s2 + max(0.6, 0.15 * highest_m_s2)


@pytest.mark.parametrize("drag_1_s", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("max_tilt_deg", [10.0, 25.0])
def test_a_path_slowed_as_its_tilt_needs_uses_all_of_it_and_no_more(
    drag_1_s: float, max_tilt_deg: float
) -> None:
    limits = FlightLimits(
        max_speed_m_s=WIDE_M_S,
        max_acceleration_m_s2=WIDE_M_S,
        max_vertical_m_s2=WIDE_M_S,
        max_tilt_deg=max_tilt_deg,
        drag_1_s=drag_1_s,
    )
    path = weaving(amplitude_m=2.0, period_s=2.0)
    factor, words = needed_slowing(sample({"mav0": path}, _FINE_S), limits)
    assert factor > 1.0
    assert "tilt" in words
    again, _ = needed_slowing(sample({"mav0": slowed(path, factor)}, factor * _FINE_S), limits)
    assert again == pytest.approx(1.0, abs=0.005)


def test_a_corner_swings_nowhere_between_the_samples_of_its_path() -> None:
    """East with 2 m/s, a full stop, and west again: the speed changes by 4 m/s in half a second."""
    times_s = np.arange(0.0, 12.0, 0.05)
    values = np.zeros((len(times_s), 4))
    values[:, 0] = np.round(2.0 * np.minimum(times_s, 12.0 - times_s), 2)
    values[:, 2] = 1.0

    flown = sample({"mav0": fitted(times_s, values)}, step_s=0.001)

    within = (flown.times_s > 1.0) & (flown.times_s < flown.times_s[-1] - 1.0)
    largest_m_s2 = np.abs(flown.values[2][within, 0, 0]).max()
    assert 14.0 < largest_m_s2 < 17.0  # a triangle of half a second under 4 m/s: 16 at its top
