"""Exact intervals, beside figures that stand in tables."""

from __future__ import annotations

import pytest

from groundstation.evidence.intervals import two_sided, upper_bound


@pytest.mark.parametrize(
    ("events", "count", "low", "high"),
    [
        (0, 10, 0.0, 0.3085),
        (5, 100, 0.0164, 0.1128),
        (1, 20, 0.0013, 0.2487),
        (10, 10, 0.6915, 1.0),
    ],
)
def test_the_two_sided_interval_is_that_of_clopper_and_pearson(
    events: int, count: int, low: float, high: float
) -> None:
    interval = two_sided(events, count)
    assert interval.low == pytest.approx(low, abs=5e-5)
    assert interval.high == pytest.approx(high, abs=5e-5)
    assert interval.holds(events / count)


def test_without_an_event_the_bound_is_nearly_three_by_the_number_of_flights() -> None:
    assert upper_bound(0, 59) == pytest.approx(1.0 - 0.05 ** (1.0 / 59.0), abs=1e-9)
    assert upper_bound(0, 3000) == pytest.approx(3.0 / 3000.0, rel=0.01)


def test_no_flights_bound_nothing() -> None:
    assert upper_bound(0, 0) == 1.0
    assert two_sided(0, 0)[2:] == (0.0, 1.0)
