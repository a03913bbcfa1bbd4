"""Exact intervals, beside figures that stand in tables."""

from __future__ import annotations

import pytest

from onboard.confidence_intervals import exact_interval, two_sided, upper_bound


@pytest.mark.parametrize(
    ("events", "count", "low", "high"),
    [
        (0, 10, 0.0, 0.3085),
        (5, 100, 0.0164, 0.1128),
        (1, 20, 0.0013, 0.2487),
        (10, 10, 0.6915, 1.0),
        (2, 200, 0.0012, 0.0357),
        (5, 280, 0.0058, 0.0412),
        (1000, 2000, 0.4779, 0.5221),
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


@pytest.mark.parametrize(
    ("events", "count", "bound"),
    [(3, 20, 0.3437), (1000, 2000, 0.5186), (20, 20, 1.0)],
)
def test_with_events_the_bound_is_the_one_sided_one(events: int, count: int, bound: float) -> None:
    assert upper_bound(events, count) == pytest.approx(bound, abs=5e-5)


@pytest.mark.parametrize(
    ("events", "count", "low", "high"),
    [
        (0, 10, 0.0, 0.2589),
        (10, 10, 0.7411, 1.0),
        (0, 300, 0.0, 0.0099),
        (2, 200, 0.0012, 0.0357),
        (5, 10, 0.1871, 0.8129),
    ],
)
def test_where_nothing_or_all_happened_the_exact_interval_is_one_sided(
    events: int, count: int, low: float, high: float
) -> None:
    interval = exact_interval(events, count)
    assert interval.low == pytest.approx(low, abs=5e-5)
    assert interval.high == pytest.approx(high, abs=5e-5)


def test_no_flights_bound_nothing() -> None:
    assert upper_bound(0, 0) == 1.0
    assert two_sided(0, 0)[2:] == (0.0, 1.0)
