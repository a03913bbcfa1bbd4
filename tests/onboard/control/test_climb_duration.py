"""Climbs and landings: the same as ever near the ground, within the vehicle's limits above."""

from __future__ import annotations

import numpy as np
import pytest

from onboard.control.climb_duration import climb_duration_s

PEAK_OF_MEAN = 1.875  # of a quintic
HEIGHTS_M = np.arange(0.0, 120.0, 0.1)


@pytest.mark.parametrize("max_speed_m_s", [0.5, 1.0, 3.0])
def test_near_the_ground_it_is_slow_and_above_within_the_limits_of_the_vehicle_and_of_px4(
    max_speed_m_s: float,
) -> None:
    times_s = np.array([climb_duration_s(float(height_m), max_speed_m_s) for height_m in HEIGHTS_M])
    low = HEIGHTS_M <= 4.0
    np.testing.assert_allclose(times_s[low], HEIGHTS_M[low] / min(0.4, 0.5 * max_speed_m_s))
    peaks_m_s = PEAK_OF_MEAN * HEIGHTS_M[1:] / times_s[1:]
    assert peaks_m_s.max() < min(max_speed_m_s, 1.501)
    assert (np.diff(times_s) > 0.0).all()
    assert (np.diff(np.diff(times_s)) < 1e-9).all(), (
        "each further metre takes no longer than the one before"
    )


def test_below_the_ground_there_is_no_way() -> None:
    assert climb_duration_s(-3.0, 1.0) == 0.0
