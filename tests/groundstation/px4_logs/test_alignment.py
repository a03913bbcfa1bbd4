"""Logs are put on the record's clock by how the vehicle tilted, or refused with the reason."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundstation.px4_logs.alignment import NoAlignment, align, flu_of_frd, up_in_body
from onboard.arrays import Array
from tests.groundstation.px4_logs.made_up_logs import enu_of_ned, quaternions


def up_of_record(time_s: Array, seed: int = 1, noise: float = 0.0) -> Array:
    up = up_in_body(enu_of_ned(quaternions(time_s, seed, yaw_rad=1.0)))
    return up + noise * np.random.default_rng(0).standard_normal(up.shape)


def up_of_log(time_s: Array, seed: int = 1) -> Array:
    return up_in_body(flu_of_frd(quaternions(time_s, seed, yaw_rad=-0.4)))


def test_up_is_the_same_in_both_frames_whatever_the_heading() -> None:
    time_s = np.arange(0.0, 5.0, 0.1)
    assert up_of_log(time_s) == pytest.approx(up_of_record(time_s), abs=1e-9)
    nose_up = np.array([[math.cos(0.1), 0.0, math.sin(0.1), 0.0]])
    assert up_in_body(flu_of_frd(nose_up))[0, 0] == pytest.approx(math.sin(0.2))


@pytest.mark.parametrize("begin_s", [0.0, 8.0, 33.3])
@pytest.mark.parametrize("rate_hz", [25.0, 250.0])
def test_the_offset_is_found_within_ten_milliseconds(begin_s: float, rate_hz: float) -> None:
    record_s = np.arange(0.0, 60.0, 0.02)
    log_s = np.arange(begin_s, begin_s + 22.0, 1.0 / rate_hz)
    px4_clock_s = log_s + 987.654
    found = align(record_s, up_of_record(record_s, noise=0.001), px4_clock_s, up_of_log(log_s))
    assert found.offset_s == pytest.approx(-987.654, abs=0.01)
    assert found.residual_deg < 0.2
    assert found.overlap_s == pytest.approx(22.0, abs=0.2)


@pytest.mark.parametrize("drift_frac", [-400e-6, 300e-6])
def test_clocks_that_drift_apart_are_laid_on_each_other_at_both_ends(drift_frac: float) -> None:
    record_s = np.arange(0.0, 120.0, 0.04)
    log_s = np.arange(5.0, 115.0, 0.04)
    px4_clock_s = log_s * (1.0 + drift_frac) + 50.0

    found = align(record_s, up_of_record(record_s), px4_clock_s, up_of_log(log_s))

    shown_s = found.on_record(px4_clock_s[[0, -1]])
    assert shown_s == pytest.approx([5.0, log_s[-1]], abs=0.005)


def test_a_log_that_is_longer_than_the_record_fits_as_well() -> None:
    record_s = np.arange(20.0, 40.0, 0.02)
    log_s = np.arange(0.0, 90.0, 0.04)
    found = align(record_s, up_of_record(record_s), log_s + 5.0, up_of_log(log_s))
    assert found.offset_s == pytest.approx(-5.0, abs=0.01)


def test_gaps_of_either_tell_nothing() -> None:
    record_s = np.concatenate([np.arange(0.0, 20.0, 0.02), np.arange(32.0, 60.0, 0.02)])
    log_s = np.concatenate([np.arange(0.0, 42.0, 0.04), np.arange(45.0, 60.0, 0.04)])
    found = align(record_s, up_of_record(record_s), log_s + 1.0, up_of_log(log_s))
    assert found.offset_s == pytest.approx(-1.0, abs=0.01)
    assert found.residual_deg < 0.1


def refused(record_up: Array, log_up: Array, record_s: Array, log_s: Array) -> str:
    with pytest.raises(NoAlignment) as caught:
        align(record_s, record_up, log_s, log_up)
    return str(caught.value)


def test_another_flight_is_refused() -> None:
    times_s = np.arange(0.0, 40.0, 0.02)
    said = refused(up_of_record(times_s), up_of_log(times_s, seed=9), times_s, times_s)
    assert "another flight or vehicle" in said


def test_a_hover_is_refused_for_nothing_tells_where() -> None:
    times_s = np.arange(0.0, 40.0, 0.02)
    level = np.tile([0.0, 0.0, 1.0], (times_s.size, 1))
    assert "hardly tilts in the log" in refused(up_of_record(times_s), level, times_s, times_s)


def test_a_flight_that_repeats_itself_is_refused() -> None:
    record_s = np.arange(0.0, 60.0, 0.02)
    log_s = np.arange(0.0, 20.0, 0.02)

    def turning(time_s: Array) -> Array:
        angle_rad = 2.0 * math.pi * time_s / 5.0
        sideways = 0.1 * np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)
        return np.column_stack([sideways, np.ones(time_s.size)])

    assert "repeats itself" in refused(turning(record_s), turning(log_s), record_s, log_s)


def test_moments_are_too_short() -> None:
    times_s = np.arange(0.0, 40.0, 0.02)
    said = refused(up_of_record(times_s), up_of_log(times_s[:50]), times_s, times_s[:50])
    assert "less than 5 s" in said
