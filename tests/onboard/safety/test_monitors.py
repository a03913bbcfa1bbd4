"""The monitors of the answer to commands, of the battery, of distances and of predictions.

Each is fed with made-up numbers.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import pytest

from onboard.safety.autopilot_monitor import AutopilotMonitor
from onboard.safety.battery_monitor import BatteryMonitor
from onboard.safety.separation_monitor import PredictionMonitor, smallest_distance_m
from onboard.safety.tracking_monitor import TrackingMonitor

START_NS = 10**9
TICK_S = 0.02

TiltDeg = Callable[[float], float]  # of the time [s]


# -- attitude and thrust ---------------------------------------------------------------------------


def tilted(degrees: float) -> tuple[float, float, float, float]:
    half_rad = 0.5 * math.radians(degrees)
    return (math.cos(half_rad), 0.0, math.sin(half_rad), 0.0)


def after(
    seconds: float,
    commanded: TiltDeg,
    measured: TiltDeg,
    monitor: TrackingMonitor | None = None,
    *,
    thrust_frac: float = 0.5,
    below_m: float = 0.0,
    climb_m_s: float = 0.0,
) -> TrackingMonitor:
    """Return the monitor after a flight with these tilts."""
    if monitor is None:
        monitor = TrackingMonitor(lag_s=0.27, largest_frac=0.98)
    for tick in range(round(seconds / TICK_S)):
        time_s = TICK_S * tick
        monitor.update(
            tilted(commanded(time_s)),
            tilted(measured(time_s)),
            thrust_frac,
            below_m=below_m,
            climb_m_s=climb_m_s,
            dt_s=TICK_S,
        )
    return monitor


def level(time_s: float) -> float:
    return 0.0


def square(time_s: float) -> float:
    return 20.0 if time_s % 2.0 < 1.0 else -20.0


def test_an_attitude_that_follows_weakly_late_and_leaning_still_follows() -> None:
    def measured(time_s: float) -> float:
        # a moving average over 0.4 s
        late = [square(max(0.0, time_s - 0.04 - 0.02 * n)) for n in range(20)]
        return 0.9 * sum(late) / len(late) + 1.5

    assert not after(20.0, square, measured).is_attitude_lost


def test_an_attitude_that_does_not_follow_is_detected_within_0_7_s_of_a_real_tilt() -> None:
    monitor = after(1.0, level, level)
    assert after(0.7, lambda _: 20.0, level, monitor).is_attitude_lost


def test_a_vehicle_on_its_side_is_detected_at_once() -> None:
    assert after(0.14, level, lambda _: 80.0).is_attitude_lost


def test_full_thrust_is_saturated_and_sinking_with_it_is_worse() -> None:
    assert not after(0.4, square, square, thrust_frac=0.98).is_saturated

    climbing = after(2.0, level, level, thrust_frac=0.98, below_m=0.3, climb_m_s=0.4)
    assert climbing.is_saturated
    assert not climbing.is_sinking

    sinking = after(2.0, level, level, thrust_frac=0.98, below_m=0.3, climb_m_s=-0.1)
    assert sinking.is_sinking


def test_full_thrust_counts_after_half_a_second_and_sinking_with_it_after_one() -> None:
    full = functools.partial(after, commanded=level, measured=level, thrust_frac=0.98)
    assert not full(0.48).is_saturated
    assert full(0.54).is_saturated
    assert not after(2.0, level, level, thrust_frac=0.96).is_saturated

    assert not full(0.98, below_m=0.2, climb_m_s=0.0).is_sinking
    assert full(1.04, below_m=0.2, climb_m_s=0.0).is_sinking
    assert not full(2.0, below_m=0.14, climb_m_s=0.0).is_sinking
    assert not full(2.0, below_m=0.2, climb_m_s=0.06).is_sinking


def test_a_tilt_counts_from_60_degrees_on_after_a_tenth_of_a_second() -> None:
    assert not after(0.08, level, lambda _: 61.0).is_attitude_lost
    assert after(0.14, level, lambda _: 61.0).is_attitude_lost
    assert not after(0.14, level, lambda _: 59.0).is_attitude_lost


# -- battery ---------------------------------------------------------------------------------------


def discharge(
    rate_1_s: float,
    height_m: float = 1.5,
    *,
    drop_frac: float = 0.0,
    floor_frac: float = 0.0,
) -> BatteryMonitor:
    """Return the monitor after a discharge from 90 %, to the landing level at most.

    Args:
        rate_1_s: of the charge.
        height_m: of the vehicle.
        drop_frac: of the charge, lost at once after 20 s.
        floor_frac: charge at which a simulated battery stops emptying.
    """
    monitor = BatteryMonitor()
    for sample in range(600):
        time_s = 0.1 * sample
        charge_frac = max(0.9 - rate_1_s * time_s, floor_frac)
        if time_s > 20.0:
            charge_frac -= drop_frac
        if charge_frac < 0.2:
            break

        monitor.update(
            time_s,
            round(charge_frac, 2),  # PX4 reports whole percents
            15.0 - 0.01 * time_s,
            land_frac=0.2,
            descent_s=height_m / 0.4,
            floor_frac=floor_frac,
        )
    return monitor


def test_an_ordinary_discharge_reaches_the_landing_level_without_being_called_a_fall() -> None:
    assert not discharge(1.0 / 600.0).is_falling
    assert not discharge(1.0 / 300.0).is_falling


def test_a_cell_that_fails_and_a_battery_that_runs_out_before_it_is_down_fall() -> None:
    assert discharge(1.0 / 600.0, drop_frac=0.25).is_falling
    assert discharge(0.02).is_falling
    assert discharge(0.008, height_m=15.0).is_falling


@pytest.mark.parametrize(("end_frac", "is_falling"), [(0.22, False), (0.19, True)])
def test_a_battery_falls_when_less_than_half_of_the_landing_level_would_be_left(
    end_frac: float, is_falling: bool
) -> None:
    """At 0.4 % a second the descent of 10 s and the reserve of 15 s take 10 % of the charge."""
    monitor = BatteryMonitor()
    for sample in range(101):
        time_s = 0.1 * sample
        monitor.update(
            time_s,
            end_frac + 0.004 * (10.0 - time_s),
            15.0,
            land_frac=0.2,
            descent_s=10.0,
        )
    assert monitor.is_falling is is_falling


def test_one_step_of_the_percentage_is_no_fall() -> None:
    monitor = BatteryMonitor()
    for sample in range(30):
        remaining_frac = 0.12 if sample < 15 else 0.10
        monitor.update(0.1 * sample, remaining_frac, 15.0, land_frac=0.2, descent_s=60.0)
    assert not monitor.is_falling


def test_the_battery_of_a_simulated_px4_counts_by_the_level_at_which_it_stops() -> None:
    rate_1_s = 1.0 / 60.0
    assert discharge(rate_1_s, height_m=30.0).is_falling
    assert not discharge(rate_1_s, height_m=30.0, floor_frac=0.5).is_falling

    is_to_run_empty = discharge(rate_1_s, height_m=30.0, floor_frac=0.05)
    assert is_to_run_empty.is_falling
    goes_below_the_level = discharge(rate_1_s, height_m=30.0, floor_frac=0.5, drop_frac=0.25)
    assert goes_below_the_level.is_falling


def test_a_voltage_that_sags_falls_and_numbers_that_px4_does_not_report_say_nothing() -> None:
    monitor = BatteryMonitor()
    for sample in range(40):
        monitor.update(0.1 * sample, math.nan, math.nan, land_frac=0.2, descent_s=2.5)
    assert not monitor.is_falling

    monitor.reset()
    for sample in range(40):
        voltage_v = 15.0 if sample < 20 else 12.5
        monitor.update(0.1 * sample, math.nan, voltage_v, land_frac=0.2, descent_s=2.5)
    assert monitor.is_falling


def is_falling(*samples: tuple[float, float, float]) -> bool:
    """Return the monitor's answer after samples of time, charge and voltage."""
    monitor = BatteryMonitor()
    for time_s, remaining_frac, voltage_v in samples:
        monitor.update(time_s, remaining_frac, voltage_v, land_frac=0.2, descent_s=10.0)
    return monitor.is_falling


def test_a_fall_is_judged_from_the_first_second_to_the_end_of_the_window() -> None:
    assert not is_falling((0.0, 0.9, 15.0), (0.9, 0.9, 12.0))
    assert is_falling((0.0, 0.9, 15.0), (1.0, 0.9, 12.0))
    assert is_falling((0.0, 0.9, 15.0), (1.2, 0.9, 12.0))
    assert is_falling((0.0, 0.9, 15.0), (10.0, 0.9, 12.0))
    assert not is_falling((0.0, 0.9, 15.0), (10.1, 0.9, 12.0))


def test_a_short_fall_counts_as_if_it_had_lasted_five_seconds() -> None:
    # 4 % in 5 s are 20 % in the descent of 10 s and the reserve of 15 s
    assert is_falling((0.0, 0.32, 15.0), (2.0, 0.28, 15.0))
    assert not is_falling((0.0, 0.36, 15.0), (2.0, 0.32, 15.0))


def test_a_voltage_of_about_nothing_is_no_measurement() -> None:
    assert not is_falling((0.0, 0.9, 0.5), (2.0, 0.9, 0.1))
    assert not is_falling((0.0, 0.9, math.inf), (2.0, 0.9, 15.0))
    assert is_falling((0.0, 0.9, 1.2), (2.0, 0.9, 1.0))


# -- distances and predictions ---------------------------------------------------------------------


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


def test_a_slow_approach_counts() -> None:
    left_m = smallest_distance_m((1.0, 0.0), (0.05, 0.0), reaction_s=1.0, deceleration_m_s2=1.0)
    assert left_m == pytest.approx(1.0 - 0.05 - 0.05**2 / 2.0)


def test_a_silent_px4_is_silent_and_one_whose_clock_stands_is_frozen() -> None:
    monitor = AutopilotMonitor()

    def hear(now_s: float, packet_s: float, boot_ms: int) -> None:
        monitor.update(
            round(1e9 * now_s),
            packet_ns=round(1e9 * packet_s),
            attitude_ns=round(1e9 * packet_s),
            heartbeat_ns=round(1e9 * packet_s),
            boot_ms=boot_ms,
        )

    hear(10.0, 10.0, 5000)
    hear(11.0, 11.0, 5000)
    assert (monitor.is_silent, monitor.is_frozen) == (False, True)
    hear(12.0, 11.0, 5000)
    assert (monitor.is_silent, monitor.is_frozen) == (True, False)


def test_a_neighbour_that_accelerates_as_it_predicts_is_right_and_one_that_does_not_is_wrong() -> (
    None
):
    right = PredictionMonitor()
    wrong = PredictionMonitor()
    for state in range(60):
        time_s = 0.1 * state
        stamp_ns = START_NS + state * 100_000_000
        predicted_m_s = (math.sin(time_s + 0.3), 0.0)
        right.update(stamp_ns, (math.sin(time_s), 0.0), predicted_m_s, 0.3)
        wrong.update(stamp_ns, (0.0, 0.0), (1.0, 0.0), 0.3)
    assert not right.is_wrong
    assert wrong.is_wrong

    wrong.reset()
    assert not wrong.is_wrong
