"""Which attitudes and which thrust count, in each direction and from which time on."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import pytest

from onboard.safety.tracking_monitor import TrackingMonitor
from onboard.tuples import Wxyz

TICK_S = 0.02
LEVEL: Wxyz = (1.0, 0.0, 0.0, 0.0)
TiltDeg = Callable[[float], float]  # of the time [s]
FULL_FRAC = 0.98  # throttle at which the thrust is saturated


def tilted(degrees: float, direction_deg: float = 0.0, heading_deg: float = 0.0) -> Wxyz:
    """Return the attitude of a vehicle that leans in a direction, counterclockwise from east."""
    half_tilt_rad = 0.5 * math.radians(degrees)
    half_heading_rad = 0.5 * math.radians(heading_deg)
    direction_rad = math.radians(direction_deg)

    # first it turns about the vertical, and then about a horizontal axis
    axis_x = -math.sin(direction_rad)
    axis_y = math.cos(direction_rad)
    tilt_w = math.cos(half_tilt_rad)
    tilt_x = math.sin(half_tilt_rad) * axis_x
    tilt_y = math.sin(half_tilt_rad) * axis_y
    heading_w = math.cos(half_heading_rad)
    heading_z = math.sin(half_heading_rad)
    return (
        tilt_w * heading_w,
        tilt_x * heading_w + tilt_y * heading_z,
        tilt_y * heading_w - tilt_x * heading_z,
        tilt_w * heading_z,
    )


def fly(
    monitor: TrackingMonitor,
    seconds: float,
    *,
    commanded_wxyz: Wxyz = LEVEL,
    measured_wxyz: Wxyz = LEVEL,
    thrust_frac: float = 0.5,
) -> TrackingMonitor:
    """Return the monitor after a flight below its trajectory without climbing."""
    for _ in range(round(seconds / TICK_S)):
        monitor.update(
            commanded_wxyz,
            measured_wxyz,
            thrust_frac,
            below_m=0.3,
            climb_m_s=0.0,
            dt_s=TICK_S,
        )
    return monitor


def new(lag_s: float = 0.27) -> TrackingMonitor:
    return TrackingMonitor(lag_s=lag_s, largest_frac=FULL_FRAC)


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("heading_deg", [0.0, 135.0])
@pytest.mark.parametrize(("miss_deg", "is_lost"), [(8.7, False), (9.3, True)])
def test_a_miss_that_lasts_counts_from_nine_degrees_on_in_each_direction(
    direction_deg: float, heading_deg: float, miss_deg: float, is_lost: bool
) -> None:
    level = tilted(0.0, heading_deg=heading_deg)
    leaning = tilted(miss_deg, direction_deg, heading_deg)
    assert fly(new(), 5.0, measured_wxyz=leaning, commanded_wxyz=level).is_attitude_lost is is_lost
    assert fly(new(), 5.0, measured_wxyz=level, commanded_wxyz=leaning).is_attitude_lost is is_lost


@pytest.mark.parametrize("direction_deg", [0.0, 90.0, 200.0])
def test_an_attitude_that_is_as_commanded_never_misses(direction_deg: float) -> None:
    leaning = tilted(30.0, direction_deg, heading_deg=50.0)
    monitor = fly(new(), 3.0, commanded_wxyz=leaning)
    fly(monitor, 3.0, commanded_wxyz=leaning, measured_wxyz=leaning)
    assert monitor.missed_s == 0.0


def test_a_vehicle_that_answers_at_once_may_have_no_lag_in_its_file() -> None:
    monitor = new(lag_s=0.0)
    for degrees in (-30.0, 30.0, -30.0):
        leaning = tilted(degrees)
        for _ in range(50):
            fly(monitor, TICK_S, commanded_wxyz=leaning, measured_wxyz=leaning)
            assert monitor.missed_s == 0.0


def test_no_sign_has_lasted_for_any_time_before_it_begins() -> None:
    monitor = fly(new(), 1.0)
    assert not fly(monitor, 0.08, measured_wxyz=tilted(61.0)).is_upset
    assert fly(monitor, 0.06, measured_wxyz=tilted(61.0)).is_upset

    monitor = fly(new(), 1.0)
    assert not fly(monitor, 0.48, thrust_frac=FULL_FRAC).is_saturated
    assert not fly(monitor, 0.50, thrust_frac=FULL_FRAC).is_sinking
    assert fly(monitor, 0.06, thrust_frac=FULL_FRAC).is_sinking


def test_a_monitor_that_begins_anew_is_as_a_new_one() -> None:
    monitor = fly(
        new(),
        2.0,
        commanded_wxyz=tilted(20.0, 45.0),
        measured_wxyz=tilted(70.0, 200.0),
        thrust_frac=FULL_FRAC,
    )
    assert monitor.is_attitude_lost
    assert monitor.is_sinking
    monitor.reset()
    assert monitor == new()


# -- tilts that change


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


def test_a_vehicle_that_leans_when_it_is_first_looked_at_has_not_missed_that() -> None:
    """A vehicle by satellites is looked at above a metre, in the middle of a manoeuvre."""

    def becomes_level(time_s: float) -> float:
        return 35.0 * math.exp(-time_s / 0.27)

    for seconds in (0.2, 0.4, 0.6):
        assert after(seconds, level, becomes_level).missed_s == 0.0
    assert after(1.5, level, lambda time_s: 35.0).is_attitude_lost, "it stays as it is"


@pytest.mark.parametrize("half_period_s", [0.3, 0.4, 0.5, 0.7, 1.0])
@pytest.mark.parametrize(
    ("swing_deg", "delay_s", "wn_rad_s", "zeta"),
    [
        (25.0, 0.06, 8.0, 0.6),
        (25.0, 0.1, 6.0, 0.7),
        (25.0, 0.04, 6.1, 0.6),
        (35.0, 0.04, 15.0, 0.8),
        (40.0, 0.02, 20.0, 0.9),
    ],
)
def test_an_attitude_follows_large_commands_to_both_sides(
    half_period_s: float, swing_deg: float, delay_s: float, wn_rad_s: float, zeta: float
) -> None:
    """It responds after a dead time, as a second-order system that turns by 220 deg/s at most."""

    def commanded(time_s: float) -> float:
        return swing_deg if time_s % (2.0 * half_period_s) < half_period_s else -swing_deg

    monitor = TrackingMonitor(lag_s=delay_s + 2.0 * zeta / wn_rad_s, largest_frac=0.98)
    tilt_deg = 0.0
    rate_deg_s = 0.0
    for tick in range(200):
        for _ in range(10):
            delayed_deg = commanded(TICK_S * tick - delay_s)
            acceleration = wn_rad_s * (wn_rad_s * (delayed_deg - tilt_deg) - 2 * zeta * rate_deg_s)
            rate_deg_s += 0.1 * TICK_S * acceleration
            rate_deg_s = min(max(rate_deg_s, -220.0), 220.0)
            tilt_deg += 0.1 * TICK_S * rate_deg_s
        monitor.update(
            tilted(commanded(TICK_S * tick)),
            tilted(tilt_deg),
            0.5,
            below_m=0.0,
            climb_m_s=0.0,
            dt_s=TICK_S,
        )
        assert monitor.missed_s == 0.0


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
