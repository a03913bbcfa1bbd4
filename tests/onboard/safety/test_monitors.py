"""The monitors of the battery, of distances and of predictions.

Each is fed with made-up numbers.
"""

from __future__ import annotations

import math

import pytest

from onboard.safety.autopilot_monitor import AutopilotMonitor
from onboard.safety.battery_monitor import BatteryMonitor
from onboard.safety.separation_monitor import PredictionMonitor, smallest_distance_m

START_NS = 10**9


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
