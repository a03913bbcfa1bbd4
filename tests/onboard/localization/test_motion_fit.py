"""Positions against the motion that attitude and throttle explain."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from onboard.localization.motion_fit import MotionFit
from onboard.types import TICK_S
from onboard.vectors import ZERO_3, Vec3

TICK_NS = round(TICK_S * 1e9)


def _take(fit: MotionFit, tick: int, innovation_m: Vec3, *, is_on_ground: bool = False) -> None:
    """Take a position of a vehicle that stands still."""
    fit.step(
        innovation_m=innovation_m,
        velocity_enu_m_s=ZERO_3,
        stamp_ns=tick * TICK_NS,
        is_on_ground=is_on_ground,
    )


def test_noise_is_its_own_standard_deviation() -> None:
    rng = np.random.default_rng(1)
    fit = MotionFit()
    for tick in range(2000):
        east_m, north_m = rng.normal(0.0, 0.05, 2).tolist()
        _take(fit, tick, Vec3(east_m, north_m, 3.0))
    assert math.isclose(fit.miss_m, math.sqrt(2.0) * 0.05, rel_tol=0.3)


def test_a_miss_that_lasts_is_shown_within_a_second() -> None:
    fit = MotionFit()
    for tick in range(50):
        _take(fit, tick, Vec3(0.3, 0.0, 0.0))
    assert 0.2 < fit.miss_m < 0.3


def test_on_the_ground_nothing_is_learnt() -> None:
    fit = MotionFit()
    _take(fit, 1, Vec3(5.0, 0.0, 0.0))
    _take(fit, 2, Vec3(5.0, 0.0, 0.0), is_on_ground=True)
    assert fit.miss_m == 0.0


# -- late velocities -------------------------------------------------------------------------------

Motion = Callable[[float], Vec3]  # time [s] to acceleration by attitude and throttle [m/s^2]


def _turning(time_s: float) -> Vec3:
    """Return the acceleration on a circle of 3 s and half a metre, as of a late receiver."""
    turn_rad = 2.0 * math.pi * time_s / 3.0
    return Vec3(2.2 * math.cos(turn_rad), 2.2 * math.sin(turn_rad), 0.0)


def _stepping(time_s: float) -> Vec3:
    """Return the acceleration of moves to and fro: off, braking, and a rest."""
    phase_s = time_s % 4.0
    pull_m_s2 = 2.0 if phase_s < 1.0 else -2.0 if phase_s < 2.0 else 0.0
    return Vec3(pull_m_s2, 0.3 * pull_m_s2, 0.0)


def _flown(
    motion: Motion,
    lag_s: float,
    *,
    push_m_s2: Motion = lambda time_s: ZERO_3,
    scale: float = 1.0,
    seed: int = 0,
    duration_s: float = 20.0,
) -> Iterator[tuple[float, MotionFit]]:
    """Fly a motion of which PX4's velocity tells ``lag_s`` late; yield time and memory.

    Args:
        motion: acceleration by attitude and throttle.
        lag_s: by how much PX4's velocity is late.
        push_m_s2: acceleration by the air.
        scale: true thrust by the thrust that the fleet file leads one to expect.
        seed: of the errors of PX4's velocity, which are those of PX4's simulator.
        duration_s: time of the flight.
    """
    rng = np.random.default_rng(seed)
    fit = MotionFit()
    velocity = np.zeros(2)
    error = np.zeros(2)
    for tick in range(1, round(duration_s / TICK_S)):
        time_s = tick * TICK_S
        fit.drive(motion(time_s))

        true = motion(time_s - lag_s)
        push = push_m_s2(time_s - lag_s)
        velocity += TICK_S * np.array([scale * true.x + push.x, scale * true.y + push.y])
        error += -TICK_S / 3.4 * error + 0.2 * math.sqrt(TICK_S) * rng.normal(size=2)
        east_m_s, north_m_s = (velocity + error).tolist()
        fit.step(
            innovation_m=ZERO_3,
            velocity_enu_m_s=Vec3(east_m_s, north_m_s, 0.0),
            stamp_ns=tick * TICK_NS,
            is_on_ground=False,
        )
        yield time_s, fit


@pytest.mark.parametrize("motion", [_turning, _stepping])
@pytest.mark.parametrize("lag_s", [0.36, 0.45, 0.55])
@pytest.mark.parametrize("seed", range(5))
def test_a_late_velocity_is_found_within_seconds_of_motion(
    motion: Motion, lag_s: float, seed: int
) -> None:
    found_s = next(time_s for time_s, fit in _flown(motion, lag_s, seed=seed) if fit.is_late)
    assert found_s < 6.0


@pytest.mark.parametrize("motion", [_turning, _stepping])
@pytest.mark.parametrize("lag_s", [0.0, 0.06, 0.12])
@pytest.mark.parametrize("seed", range(5))
def test_a_velocity_in_time_is_not_found_late(motion: Motion, lag_s: float, seed: int) -> None:
    largest = max(fit.lateness_m2_s3 for _, fit in _flown(motion, lag_s, seed=seed))
    assert largest < 3.0


def test_neither_a_steady_wind_nor_a_wrong_thrust_counts_as_late() -> None:
    flown = _flown(_turning, 0.0, push_m_s2=lambda time_s: Vec3(-2.5, 1.0, 0.0), scale=0.8)
    assert max(fit.lateness_m2_s3 for _, fit in flown) < 3.0


def test_a_wind_that_the_attitude_follows_does_not_count_as_late() -> None:
    def gust(time_s: float) -> Vec3:
        return Vec3(0.8 * math.sin(1.3 * time_s), 0.8 * math.cos(0.9 * time_s), 0.0)

    def against(time_s: float) -> Vec3:
        late = gust(time_s - 0.3)
        return Vec3(-late.x, -late.y, 0.0)

    flown = _flown(against, 0.0, push_m_s2=gust, duration_s=60.0)
    assert max(fit.lateness_m2_s3 for _, fit in flown) < 3.0


def test_a_late_velocity_stays_late_until_the_ground() -> None:
    flown = list(_flown(_turning, 0.4))
    _, fit = flown[-1]
    assert fit.is_late
    _take(fit, 10_000, ZERO_3, is_on_ground=True)
    assert not fit.is_late
    assert fit.lateness_m2_s3 == 0.0


def test_a_jump_of_the_velocity_or_a_gap_is_no_lag() -> None:
    fit = MotionFit()
    for tick in range(20):
        fit.drive(Vec3(-2.0 if tick < 10 else 2.0, 0.0, 0.0))
    for tick in range(1, 50):
        at_tick = tick if tick < 40 else tick + 100
        speed_m_s = 0.0 if tick < 20 else -3.0
        fit.step(
            innovation_m=ZERO_3,
            velocity_enu_m_s=Vec3(speed_m_s if tick < 40 else -20.0, 0.0, 0.0),
            stamp_ns=at_tick * TICK_NS,
            is_on_ground=False,
        )
    assert fit.lateness_m2_s3 < 3.0
