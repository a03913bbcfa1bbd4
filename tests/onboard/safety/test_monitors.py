"""The monitors of the answer to commands, of the battery, of distances and of promises, each with
made-up numbers.
"""

from __future__ import annotations

import math

import pytest

from onboard.safety.battery_monitor import BatteryMonitor
from onboard.safety.separation_monitor import PredictionMonitor, smallest_distance_m
from onboard.safety.tracking_monitor import TrackingMonitor

START_NS = 10**9
LEVEL = (1.0, 0.0, 0.0, 0.0)


def tilted(degrees: float) -> tuple[float, float, float, float]:
    half = 0.5 * math.radians(degrees)
    return (math.cos(half), 0.0, math.sin(half), 0.0)


def answer(
    commanded: object,
    measured: object,
    seconds: float,
    monitor: TrackingMonitor | None = None,
    **extra: float,
) -> TrackingMonitor:
    """``commanded(t)`` and ``measured(t)`` give tilts in degrees."""
    monitor = monitor or TrackingMonitor(lag_s=0.27, largest_frac=0.98)
    numbers = {"thrust_frac": 0.5, "below_m": 0.0, "climb_m_s": 0.0, **extra}
    for tick in range(round(seconds / 0.02)):
        t = 0.02 * tick
        monitor.update(tilted(commanded(t)), tilted(measured(t)), dt_s=0.02, **numbers)  # type: ignore[operator]
    return monitor


def square(t: float) -> float:
    return 20.0 if t % 2.0 < 1.0 else -20.0


def test_an_attitude_that_follows_weakly_late_and_leaning_still_follows() -> None:
    def measured(t: float) -> float:
        # a moving average over 0.4 s
        late = [square(max(0.0, t - 0.04 - 0.02 * n)) for n in range(20)]
        return 0.9 * sum(late) / len(late) + 1.5

    assert not answer(square, measured, 20.0).is_attitude_lost


def test_an_attitude_that_does_not_follow_is_detected_within_seven_tenths_of_a_second_of_a_real_tilt() -> (
    None
):
    monitor = answer(lambda t: 0.0, lambda t: 0.0, 1.0)
    assert answer(lambda t: 20.0, lambda t: 0.0, 0.7, monitor).is_attitude_lost


def test_a_vehicle_on_its_side_is_detected_at_once() -> None:
    assert answer(lambda t: 0.0, lambda t: 80.0, 0.14).is_attitude_lost


def test_full_thrust_is_saturated_and_sinking_with_it_is_worse() -> None:
    assert not answer(square, square, 0.4, thrust_frac=0.98).is_saturated
    climbing = answer(
        lambda t: 0.0, lambda t: 0.0, 2.0, thrust_frac=0.98, below_m=0.3, climb_m_s=0.4
    )
    assert climbing.is_saturated
    assert not climbing.is_sinking
    assert answer(
        lambda t: 0.0, lambda t: 0.0, 2.0, thrust_frac=0.98, below_m=0.3, climb_m_s=-0.1
    ).is_sinking


def discharge(
    rate_1_s: float,
    from_frac: float = 0.9,
    height_m: float = 1.5,
    drop: float = 0.0,
    floor_frac: float = 0.0,
) -> BatteryMonitor:
    monitor = BatteryMonitor()
    for tick in range(600):
        t = 0.1 * tick
        frac = max(from_frac - rate_1_s * t, floor_frac) - (drop if t > 20.0 else 0.0)
        if frac < 0.2:
            break
        told_frac = round(frac, 2)  # PX4 tells whole percents
        monitor.update(
            t,
            told_frac,
            15.0 - 0.01 * t,
            land_frac=0.2,
            descent_s=height_m / 0.4,
            floor_frac=floor_frac,
        )
    return monitor


def test_an_ordinary_discharge_reaches_the_landing_level_without_being_called_a_fall() -> None:
    assert not discharge(1.0 / 600.0).is_falling
    assert not discharge(1.0 / 300.0).is_falling


def test_a_cell_that_fails_and_a_battery_that_runs_out_before_it_is_down_fall() -> None:
    assert discharge(1.0 / 600.0, drop=0.25).is_falling
    assert discharge(0.02).is_falling
    assert discharge(0.008, height_m=15.0).is_falling


def test_the_battery_of_a_simulated_px4_counts_by_the_level_at_which_it_stops() -> None:
    assert discharge(1.0 / 60.0, height_m=30.0).is_falling
    assert not discharge(1.0 / 60.0, height_m=30.0, floor_frac=0.5).is_falling
    assert discharge(1.0 / 60.0, height_m=30.0, floor_frac=0.05).is_falling, (
        "PX4 was told to let it run empty"
    )
    assert discharge(1.0 / 60.0, height_m=30.0, floor_frac=0.5, drop=0.25).is_falling, (
        "a fault went below the level"
    )


def test_a_voltage_that_sags_falls_and_numbers_that_px4_does_not_tell_say_nothing() -> None:
    monitor = BatteryMonitor()
    for tick in range(40):
        monitor.update(0.1 * tick, math.nan, math.nan, land_frac=0.2, descent_s=2.5)
    assert not monitor.is_falling
    monitor.reset()
    for tick in range(40):
        monitor.update(
            0.1 * tick, math.nan, 15.0 if tick < 20 else 12.5, land_frac=0.2, descent_s=2.5
        )
    assert monitor.is_falling


def test_the_distance_left_when_both_brake() -> None:
    for apart, closing, left in (
        ((2.0, 0.0), (0.0, 0.0), 2.0),
        ((2.0, 0.0), (-1.0, 0.0), 2.0),  # flying apart
        ((2.0, 0.0), (2.0, 0.0), 2.0 - 0.4 - 4.0 / 12.0),
        ((1.0, 0.0), (3.0, 0.0), 0.0),  # too late
        ((1.0, 0.9), (3.0, 0.0), 0.9),  # passes beside
    ):
        case = f"{apart}, {closing}"
        distance_m = smallest_distance_m(apart, closing, reaction_s=0.2, deceleration_m_s2=6.0)
        assert distance_m == pytest.approx(left), case


def test_a_neighbour_that_accelerates_as_it_predicts_is_right_and_one_that_does_not_is_wrong() -> (
    None
):
    right, wrong = PredictionMonitor(), PredictionMonitor()
    for tick in range(60):
        stamp_ns, t = START_NS + tick * 100_000_000, 0.1 * tick
        speed = math.sin(t)
        right.update(stamp_ns, (speed, 0.0), (math.sin(t + 0.3), 0.0), 0.3)
        wrong.update(stamp_ns, (0.0, 0.0), (1.0, 0.0), 0.3)
    assert not right.is_wrong
    assert wrong.is_wrong
    wrong.reset()
    assert not wrong.is_wrong
