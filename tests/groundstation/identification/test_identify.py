"""Identification from logs whose truth is known: values, intervals, and words when there is too
little to see.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from groundstation.identification.attitude_fit import step_response
from groundstation.identification.identify import Identified, identify
from groundstation.identification.logged_stretch import (
    MEMORY_S,
    Log,
    TooLittleFlown,
    tilt_vector_rad,
)
from groundstation.identification.motion_fit import WINDOW_S
from onboard.arrays import Array
from onboard.constants import GRAVITY_M_S2

TICK_S = 0.02
STEP_S = 0.005
MOTOR_LAG_S = 0.05


@dataclass(frozen=True)
class Truth:
    delay_s: float = 0.04
    wn_rad_s: float = 11.0
    zeta: float = 0.6
    drag_1_s: float = 1.0
    hover_frac: float = 0.49
    gain: float = 1.0
    error_deg: tuple[float, float] = (0.0, 0.0)
    gust_m_s2: float = 0.05
    attitude_age_s: float = 0.0

    @property
    def lag_s(self) -> float:
        return self.delay_s + 2.0 * self.zeta / self.wn_rad_s


WEAK = Truth(wn_rad_s=6.0, zeta=0.7, drag_1_s=0.3, hover_frac=0.75, gain=0.9, error_deg=(-1.2, 0.7))


def quaternion(tilt_rad: Array) -> Array:
    """(..., 4) whose thrust leans by tilt (..., 2) in ENU."""
    angle = np.sqrt((tilt_rad**2).sum(-1))
    share = 0.5 * np.sinc(0.5 * angle / np.pi)
    zero = np.zeros_like(angle)
    return np.stack(
        [np.cos(0.5 * angle), -tilt_rad[..., 1] * share, tilt_rad[..., 0] * share, zero], axis=-1
    )


def logs(truth: Truth, seeds: range, duration_s: float = 32.0, tilt_deg: float = 8.0) -> list[Log]:
    """Open-loop flights of doublets, one per seed, all integrated at once."""
    count = len(seeds)
    ticks = round(duration_s / TICK_S)
    noise = [np.random.default_rng(seed) for seed in seeds]

    asked = np.zeros((ticks, count, 2))
    for number, rng in enumerate(noise):
        at = 0
        while at < ticks:
            width = int(rng.integers(20, 45))
            axis = int(rng.integers(2))
            size = (
                math.radians(tilt_deg)
                * float(rng.uniform(0.5, 1.0))
                * float(rng.choice([-1.0, 1.0]))
            )
            for sign in (1.0, -1.0, -1.0, 1.0):  # moves away and back
                asked[at : at + width, number, axis] = sign * size
                at += width
            at += int(rng.integers(0, 30))
    asked = asked[:ticks]

    thrust = (
        truth.hover_frac
        * (1.0 + 0.03 * np.sin(np.arange(ticks) * TICK_S * 1.7))[:, None]
        * np.ones(count)
    )

    tilt = np.zeros((count, 2))
    rate = np.zeros((count, 2))
    position = np.zeros((count, 3))
    velocity = np.zeros((count, 3))
    lift = np.full(count, truth.hover_frac)
    gust = np.zeros((count, 3))

    error = np.radians(np.array(truth.error_deg))
    flown_tilt = np.zeros((ticks, count, 2))
    places = np.zeros((ticks, count, 3))

    keep = math.exp(-STEP_S / 1.0)
    draw = np.stack([rng.standard_normal((ticks * 4, 3)) for rng in noise], axis=1)

    for k in range(ticks * 4):
        time_s = k * STEP_S
        if k % 4 == 0:
            flown_tilt[k // 4] = tilt
            places[k // 4] = position

        heard = (
            asked[max(0, math.floor((time_s - truth.delay_s) / TICK_S + 1e-6))]
            if time_s >= truth.delay_s
            else 0.0
        )

        push = (
            truth.wn_rad_s**2 * (truth.gain * heard + error - tilt)
            - 2.0 * truth.zeta * truth.wn_rad_s * rate
        )
        tilt = tilt + STEP_S * rate + 0.5 * STEP_S**2 * push
        rate = rate + STEP_S * push

        lift = lift + (1.0 - math.exp(-STEP_S / MOTOR_LAG_S)) * (thrust[k // 4] - lift)
        gust = keep * gust + truth.gust_m_s2 * math.sqrt(1.0 - keep**2) * draw[k] * np.array(
            [1.0, 1.0, 0.2]
        )

        angle = np.sqrt((tilt**2).sum(-1))
        up = np.concatenate(
            [tilt * np.sinc(angle / np.pi)[:, None], np.cos(angle)[:, None]], axis=-1
        )
        force = (GRAVITY_M_S2 * lift / truth.hover_frac)[:, None] * up

        acceleration = force - truth.drag_1_s * velocity + gust - np.array([0.0, 0.0, GRAVITY_M_S2])
        position = position + STEP_S * velocity + 0.5 * STEP_S**2 * acceleration
        velocity = velocity + STEP_S * acceleration

    time: Array = np.arange(ticks, dtype=np.float64) * TICK_S
    found = []
    for number, rng in enumerate(noise):
        seen_tilt = flown_tilt[:, number] + math.radians(0.15) * rng.standard_normal((ticks, 2))
        seen = places[:, number] + 0.003 * rng.standard_normal((ticks, 3))

        stamps: Array = time + truth.attitude_age_s

        found.append(
            Log(
                command_time_s=time,
                command_quaternion_wxyz=quaternion(asked[:, number]),
                thrust_frac=thrust[:, number],
                attitude_time_s=stamps,
                attitude_quaternion_wxyz=quaternion(seen_tilt),
                position_time_s=time,
                position_enu_m=seen,
            )
        )
    return found


def misses(found: Identified, truth: Truth) -> dict[str, tuple[float, bool]]:
    """Error and whether the interval covers the truth, of each parameter."""
    expected = {
        "hover_thrust_frac": truth.hover_frac,
        "lag_s": truth.lag_s,
        "drag_1_s": truth.drag_1_s,
        "static_gain": truth.gain,
        "tilt_error_x_deg": truth.error_deg[0],
        "tilt_error_y_deg": truth.error_deg[1],
    }
    return {
        name: (
            getattr(found, name).value - value,
            getattr(found, name).low <= value <= getattr(found, name).high,
        )
        for name, value in expected.items()
    }


@pytest.mark.long
@pytest.mark.parametrize("truth", [Truth(), WEAK], ids=["sih", "weak"])
def test_values_are_recovered_and_intervals_cover_the_truth_about_as_often_as_they_say(
    truth: Truth,
) -> None:
    covered: dict[str, list[bool]] = {}
    for log in logs(truth, range(8)):
        for name, (miss, is_covered) in misses(identify(log), truth).items():
            bound = {
                "hover_thrust_frac": 0.01 * truth.hover_frac,
                "lag_s": 0.02,
                "drag_1_s": 0.2,
                "static_gain": 0.02,
            }
            assert abs(miss) < bound.get(name, 0.35), name
            covered.setdefault(name, []).append(is_covered)

    assert np.mean([share for one in covered.values() for share in one]) > 0.90
    assert all(np.mean(one) >= 0.75 for one in covered.values())


@pytest.mark.long
def test_an_attitude_that_is_old_when_written_down_does_not_lengthen_the_lag() -> None:
    log = logs(Truth(attitude_age_s=0.03), range(1))[0]
    for age_s, std_s, error_s in ((0.03, 0.002, 0.008), (0.012, 0.008, 0.012), (0.0, 0.03, 0.015)):
        told = replace(log, attitude_age_s=age_s, attitude_age_std_s=std_s)
        assert identify(told).lag_s.value == pytest.approx(Truth().lag_s, abs=error_s)


@pytest.mark.long
def test_the_lag_of_a_slow_vehicle_is_seen_to_be_long() -> None:
    slow = Truth(delay_s=0.12, wn_rad_s=5.0, zeta=0.9)
    found = identify(logs(slow, range(1))[0])
    assert found.lag_s.value == pytest.approx(slow.lag_s, abs=0.02)
    assert found.lag_s.low < slow.lag_s < found.lag_s.high


@pytest.mark.long
def test_no_drag_is_found_where_there_is_none() -> None:
    found = identify(logs(Truth(drag_1_s=0.0), range(1))[0])
    assert found.drag_1_s.low < 0.0 < found.drag_1_s.high


@pytest.mark.long
def test_less_flight_means_wider_intervals() -> None:
    short, long = (
        identify(logs(WEAK, range(3, 4), duration_s=seconds)[0]) for seconds in (14.0, 40.0)
    )
    assert short.drag_1_s.std > long.drag_1_s.std


def test_too_short_or_too_still_is_said_in_words() -> None:
    with pytest.raises(TooLittleFlown, match="without landing and the first 2 s; 8 s are"):
        identify(logs(Truth(), range(1), duration_s=6.0)[0])
    with pytest.raises(TooLittleFlown, match="quick moves"):
        identify(logs(Truth(), range(1), tilt_deg=0.1)[0])

    log = logs(Truth(), range(1), duration_s=14.0)[0]
    with pytest.raises(TooLittleFlown, match="100 samples"):
        identify(
            replace(
                log, position_time_s=log.position_time_s[:9], position_enu_m=log.position_enu_m[:9]
            )
        )


@pytest.mark.long
def test_gaps_in_the_mocap_cost_precision_and_nothing_else() -> None:
    log = logs(WEAK, range(5, 6))[0]
    kept = np.sin(log.position_time_s * 2.0) > -0.7
    found = identify(
        replace(
            log, position_time_s=log.position_time_s[kept], position_enu_m=log.position_enu_m[kept]
        )
    )
    assert all(abs(miss) < 0.4 for miss, _ in misses(found, WEAK).values())


@pytest.mark.long
def test_a_second_in_which_something_else_was_sent_than_the_log_says_changes_nothing() -> None:
    log = logs(Truth(), range(7, 8))[0]
    told = log.command_quaternion_wxyz.copy()
    told[700:750] = quaternion(np.full((50, 2), 0.2))
    found = identify(replace(log, command_quaternion_wxyz=told))
    assert abs(found.static_gain.value - 1.0) < 0.02
    assert found.static_gain.std < 0.01
    assert all(is_covered for _, is_covered in misses(found, Truth()).values())


@pytest.mark.parametrize(
    ("windows", "student"),
    [(3, 4.303), (4, 2.776), (6, 2.306)],  # tables of Student's t, 0.975, for 2, 4 and 8 degrees
)
def test_the_fewer_windows_have_positions_the_more_standard_deviations_an_interval_spans(
    windows: int, student: float
) -> None:
    log = logs(WEAK, range(5, 6), duration_s=16.0)[0]
    used = log.position_time_s < MEMORY_S + windows * WINDOW_S
    used[-10:] = True  # the log is as long, with too few positions for a window at its end
    found = identify(
        replace(
            log, position_time_s=log.position_time_s[used], position_enu_m=log.position_enu_m[used]
        )
    )
    half_1_s = 0.5 * (found.drag_1_s.high - found.drag_1_s.low)
    assert half_1_s / found.drag_1_s.std == pytest.approx(student, rel=0.01)


@pytest.mark.parametrize("zeta", [0.4, 1.0, 1.8])
def test_the_step_response_is_that_of_the_differential_equation(zeta: float) -> None:
    wn = 7.0
    h = 1e-4
    x = 0.0
    v = 0.0
    seen = []
    for _ in range(10_000):
        v += h * (wn * wn * (1.0 - x) - 2.0 * zeta * wn * v)
        x += h * v
        seen.append(x)
    times: Array = h * np.arange(1, 10_001, dtype=np.float64)
    assert np.abs(step_response(times, wn, zeta) - seen).max() < 1e-3
    assert step_response(np.array([-1.0, 0.0]), wn, zeta) == pytest.approx([0.0, 0.0], abs=1e-12)


def test_the_tilt_vector_is_the_lean_that_the_quaternion_was_made_of() -> None:
    tilt = np.radians(np.random.default_rng(1).uniform(-25.0, 25.0, (50, 2)))
    assert np.abs(tilt_vector_rad(quaternion(tilt)) - tilt).max() < 1e-12
    assert tilt_vector_rad(np.array([1.0, 0.0, 0.0, 0.0])).tolist() == [0.0, 0.0]
