from __future__ import annotations

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.report.columns import packed, unpacked

NUMBERS = st.floats(-1e9, 1e9) | st.just(float("nan"))


# a busy computer draws slowly, and that is no mistake
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(values=st.lists(NUMBERS, min_size=1, max_size=60), resolution=st.sampled_from((0.001, 1.0)))
def test_a_curve_comes_back_within_half_a_step_and_nan_as_nan(values, resolution):
    given_values = np.array(values)

    column = packed("0/x", given_values, resolution)
    found = unpacked(column)

    assert np.array_equal(np.isnan(found), np.isnan(given_values))
    is_known = np.isfinite(given_values)
    error = np.abs(found[is_known] - given_values[is_known])
    # the resolution that was asked for, or a 64,000th of the range where that is wider
    span = float(np.ptp(given_values[is_known])) if is_known.any() else 0.0

    assert np.all(error <= max(resolution, span / 64_000) * 0.5001 + 1e-6)


def test_a_curve_that_rests_at_zero_is_exactly_zero():
    values = np.array([0.0, 0.0, 3.217, 0.0])

    found = unpacked(packed("0/intervention", values, 0.005))

    assert found[0] == found[1] == found[3] == 0.0
