"""How near two vehicles come that brake, and when a neighbour's predictions are compared."""

from __future__ import annotations

import math

import pytest

from onboard.safety.separation_monitor import PredictionMonitor, smallest_distance_m

NS = 1_000_000_000
BEGIN_NS = 10 * NS
STILL = (0.0, 0.0)
FAST = (1.0, 0.0)


# -- distances


def test_vehicles_pass_within_two_seconds_or_not_at_all() -> None:
    """They cannot brake, and pass at 1 m: in 1.5 s, or in 3 s, of which two are looked at."""
    for ahead_m, expected_m in ((3.0, 1.0), (6.0, math.hypot(2.0, 1.0))):
        distance_m = smallest_distance_m(
            (ahead_m, 1.0), (2.0, 0.0), reaction_s=0.2, deceleration_m_s2=0.1
        )
        assert distance_m == pytest.approx(expected_m)


def test_vehicles_a_hand_apart_that_approach_will_touch() -> None:
    distance_m = smallest_distance_m((0.05, 0.0), FAST, reaction_s=0.2, deceleration_m_s2=6.0)
    assert distance_m == 0.0


def test_vehicles_in_one_place_have_no_distance() -> None:
    assert smallest_distance_m(STILL, FAST, reaction_s=0.2, deceleration_m_s2=6.0) == 0.0


# -- predictions


def compared(after_ns: int, *, lead_s: float = 0.3) -> bool:
    """Return whether a state so long after a prediction is compared with it."""
    monitor = PredictionMonitor()
    monitor.update(BEGIN_NS, STILL, predicted_m_s=FAST, lead_s=lead_s)
    monitor.update(BEGIN_NS + after_ns, STILL, predicted_m_s=STILL, lead_s=lead_s)
    return monitor.miss_m_s > 0.0


def test_a_prediction_is_compared_at_its_time_and_up_to_a_quarter_of_a_second_later() -> None:
    assert not compared(299_999_999)
    assert compared(300_000_000)
    assert compared(549_999_999)
    assert not compared(550_000_000)


@pytest.mark.parametrize(
    ("lead_s", "is_compared"), [(0.0, False), (0.02, True), (0.99, True), (1.0, False)]
)
def test_a_prediction_for_less_than_a_second_is_compared(lead_s: float, is_compared: bool) -> None:
    assert compared(round(lead_s * NS), lead_s=lead_s) is is_compared


def test_the_first_prediction_waits_and_those_that_come_meanwhile_are_not_compared() -> None:
    monitor = PredictionMonitor()
    monitor.update(BEGIN_NS, STILL, predicted_m_s=FAST, lead_s=0.3)
    for tenth in (1, 2):
        monitor.update(BEGIN_NS + tenth * NS // 10, STILL, predicted_m_s=STILL, lead_s=0.3)
    monitor.update(BEGIN_NS + 3 * NS // 10, FAST, predicted_m_s=STILL, lead_s=0.3)
    assert monitor.miss_m_s == 0.0


def missing(miss_m_s: float, comparisons: int) -> PredictionMonitor:
    """Return the monitor of a neighbour that misses all its predictions by the same velocity."""
    monitor = PredictionMonitor()
    for number in range(comparisons + 1):
        monitor.update(
            BEGIN_NS + number * 3 * NS // 10,
            STILL,
            predicted_m_s=(0.0, -miss_m_s),
            lead_s=0.3,
        )
    return monitor


def test_predictions_are_wrong_from_a_lasting_miss_of_half_a_metre_per_second_on() -> None:
    assert not missing(0.5, comparisons=50).is_wrong
    assert missing(0.6, comparisons=50).is_wrong


def test_a_miss_of_one_metre_per_second_is_wrong_at_its_second_comparison() -> None:
    assert not missing(1.0, comparisons=1).is_wrong
    assert missing(1.0, comparisons=2).is_wrong


def test_what_was_predicted_before_the_monitor_began_anew_is_not_compared() -> None:
    monitor = missing(2.0, comparisons=3)
    monitor.reset()
    assert monitor.miss_m_s == 0.0
    monitor.update(BEGIN_NS + 12 * NS // 10, STILL, predicted_m_s=STILL, lead_s=0.3)
    assert monitor.miss_m_s == 0.0
