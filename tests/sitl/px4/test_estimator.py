"""The estimate errs as measured on PX4: how much, how slowly, on which source, and what it does
when a source goes.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.physics.vehicle import STEP_S
from sitl.px4 import estimator_errors
from sitl.px4.estimator import ESTIMATE_EVERY_STEPS, HEADING, VXY, VZ, XY, Estimator, Z
from sitl.px4.estimator_errors import (
    GPS,
    VISION_DEFAULT,
    VISION_TRUSTED,
    VISION_TUNED,
    VISION_TUNED_WITH_VELOCITY,
    ErrorLevel,
    Source,
    vision_level,
)
from tests.oracles import emulated_vehicles

DT_S = ESTIMATE_EVERY_STEPS * STEP_S
VISION_S = 0.02


class Hovering:
    """Vehicles that hover where they started, and their estimator."""

    def __init__(self, count: int, **options: object) -> None:
        self.estimator = Estimator(np.zeros((count, 3)), seed=2, **options)  # type: ignore[arg-type]
        self.count = count
        self.still = np.zeros((count, 3))
        self.on_ground = np.zeros(count, dtype=np.bool_)
        self.time_s = 0.0
        self._next_vision_s = 0.0

    def fly(
        self, duration_s: float, vision_ned_m: tuple[float, float, float] | None = None
    ) -> np.ndarray:
        """(time, vehicle, 6) position and velocity as estimated; vision at 50 Hz if it says
        something.
        """
        samples = []
        for _ in range(round(duration_s / DT_S)):
            self.time_s += DT_S
            if vision_ned_m is not None and self.time_s >= self._next_vision_s:
                self._next_vision_s = self.time_s + VISION_S - 1e-9
                for i in range(self.count):
                    self.estimator.fuse_vision(i, self.time_s, np.array(vision_ned_m), delay_s=0.0)
            self.estimator.step(self.time_s, self.still, self.still, self.on_ground)
            samples.append(
                np.hstack([self.estimator.position_ned_m, self.estimator.velocity_ned_m_s])
            )
        return np.array(samples)


def on_vision(count: int, level: ErrorLevel = VISION_TUNED, **options: object) -> Hovering:
    hovering = Hovering(count, **options)
    for sensors in hovering.estimator.sensors:
        sensors.has_gps = False
        sensors.vision_level = level
    return hovering


def correlation_time_s(errors_: np.ndarray) -> float:
    """When the autocorrelation of (time, series) has fallen to 1/e."""
    variance = float((errors_**2).mean())
    lag = 1
    while float((errors_[:-lag] * errors_[lag:]).mean()) / variance > np.exp(-1.0):
        lag += max(1, lag // 20)
    return lag * DT_S


@pytest.mark.parametrize(
    "level",
    [
        GPS,
        VISION_TUNED_WITH_VELOCITY,
        *(
            pytest.param(level, marks=pytest.mark.long)
            for level in (VISION_DEFAULT, VISION_TRUSTED, VISION_TUNED)
        ),
    ],
    ids=str,
)
def test_position_and_velocity_err_as_much_and_as_slowly_as_measured(level: ErrorLevel) -> None:
    count = 80 if level.correlation_s > 1.0 else 40
    hovering = Hovering(count) if level is GPS else on_vision(count, level)
    samples = hovering.fly(25.0, None if level is GPS else (0.0, 0.0, 0.0))[round(8.0 / DT_S) :]
    free = samples - samples.mean(axis=0) if level.correlation_s < 1.0 else samples
    if level is GPS:
        # What is constant is an error of the origin, and drawn for each vehicle.
        bias = hovering.estimator.bias_ned_m + hovering.estimator.offset_ned_m
        free = samples - np.hstack([bias, np.zeros_like(bias)])
        np.testing.assert_allclose(
            hovering.estimator.bias_ned_m.std(axis=0), level.bias_m, rtol=0.35
        )
    np.testing.assert_allclose(free[..., :3].std(axis=(0, 1)), level.position_m, rtol=0.15)
    np.testing.assert_allclose(free[..., 3:].std(axis=(0, 1)), level.velocity_m_s, rtol=0.15)
    velocity = samples[..., 3:].reshape(len(samples), -1) / np.tile(level.velocity_m_s, count)
    assert correlation_time_s(velocity) == pytest.approx(level.correlation_s, rel=0.25)


def test_position_and_velocity_errors_belong_together_as_a_filters_do() -> None:
    samples = Hovering(60).fly(25.0)[round(5.0 / DT_S) :]
    moved = (samples[50:, :, 0] - samples[:-50, :, 0]) / (50 * DT_S)
    assert np.corrcoef(moved.ravel(), samples[25:-25, :, 3].ravel())[0, 1] > 0.1


def test_tuning_improves_the_error_level_step_by_step() -> None:
    steps = ((0.1, 0.25, False), (0.01, 0.25, False), (0.01, 0.02, False), (0.01, 0.02, True))
    levels = [vision_level(noise, tau, has_velocity=velocity) for noise, tau, velocity in steps]
    sizes = [sum(level.velocity_m_s) + level.correlation_s for level in levels]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 4
    # a velocity helps only a tuned filter
    assert vision_level(0.01, 0.25, has_velocity=True) is VISION_TRUSTED


def test_errors_are_each_vehicles_own_or_common_to_all() -> None:
    own = Hovering(3).fly(6.0)[-1]
    common = Hovering(3, is_common=True).fly(6.0)[-1]
    assert np.ptp(own[:, 3]) > 0.01
    np.testing.assert_array_equal(common[0], common[1])
    assert np.abs(common[0, 3:]).max() > 0.01


def test_equal_seeds_give_equal_errors_and_those_of_the_oracle(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fly() -> np.ndarray:
        hovering = on_vision(4)
        return np.concatenate([hovering.fly(2.0, (0.1, 0.2, -0.1)), hovering.fly(3.0)])

    errors = fly()
    np.testing.assert_array_equal(errors, fly())
    monkeypatch.setattr(estimator_errors, "advance", emulated_vehicles.advance)
    np.testing.assert_allclose(errors, fly(), atol=1e-12)


def test_without_errors_the_estimate_is_right() -> None:
    hovering = Hovering(2, scale=0.0)
    samples = hovering.fly(6.0)
    assert np.abs(samples).max() < 1e-9
    assert np.abs(hovering.estimator.yaw_error_rad).max() < 1e-9


@pytest.mark.long
def test_with_satellites_the_heading_errs_by_2_to_17_degrees_and_wanders_by_2_to_7() -> None:
    estimator = Estimator(np.zeros((150, 3)), seed=7)
    still = np.zeros((150, 3))
    flies = np.zeros(150, dtype=np.bool_)
    yaw = []
    for k in range(round(80.0 / DT_S)):
        estimator.step(k * DT_S, still, still, flies)
        if k % 25 == 0:
            yaw.append(np.degrees(estimator.yaw_error_rad))
    yaw_deg = np.array(yaw)
    mean = np.abs(yaw_deg.mean(axis=0))
    std = yaw_deg.std(axis=0)
    assert 8.0 < mean.mean() < 11.0
    assert (mean > 22.0).sum() == 0
    assert 3.0 < std.mean() < 6.0
    assert (yaw_deg.mean(axis=0) > 0).sum() == pytest.approx(75, abs=25)


def _flown_to_and_fro(
    mean_deg: float, duration_s: float, *, pull_m_s2: float = 1.0, vision: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fly to and fro in the north by a compass that is wrong in the mean, and has no other error.

    Returns the errors of the heading [rad] (time,), and the true and the estimated acceleration
    (time, 2).
    """
    estimator = Estimator(np.zeros((1, 3)), seed=3, scale=0.0)
    estimator.sensors[0].has_gps = not vision
    estimator.sensors[0].uses_vision_yaw = False
    estimator.compass_error_rad[:] = np.radians(mean_deg)
    position = np.zeros((1, 3))
    flies = np.zeros(1, dtype=np.bool_)
    headings, true, estimated = [], [], []
    for k in range(round(duration_s / DT_S)):
        time_s = k * DT_S
        if vision:
            estimator.fuse_vision(0, time_s, position[0].copy(), delay_s=0.0)
        velocity = np.array([[pull_m_s2 * np.sin(3.0 * time_s) / 3.0, 0.0, 0.0]])
        position = position + DT_S * velocity
        estimator.step(time_s, position, velocity, flies)
        headings.append(float(estimator.yaw_error_rad[0]))
        true.append(velocity[0, :2].copy())
        estimated.append(estimator.velocity_ned_m_s[0, :2].copy())
    return (
        np.array(headings),
        np.diff(np.array(true), axis=0) / DT_S,
        np.diff(np.array(estimated), axis=0) / DT_S,
    )


def _angle_deg(true: np.ndarray, estimated: np.ndarray) -> float:
    """By how much the estimated accelerations are turned against the true ones, clockwise."""
    cross = (true[:, 0] * estimated[:, 1] - true[:, 1] * estimated[:, 0]).sum()
    return float(np.degrees(np.arctan2(cross, (true * estimated).sum())))


def test_by_satellites_it_finds_in_motion_how_wrong_its_heading_is() -> None:
    headings, _, _ = _flown_to_and_fro(20.0, 25.0)
    assert np.degrees(headings[0]) == pytest.approx(20.0, abs=0.1)
    assert 4.0 < np.degrees(headings[-1]) < 8.0


def test_at_rest_and_by_vision_the_heading_stays_as_wrong_as_its_compass() -> None:
    for motion in ({"pull_m_s2": 0.0}, {"vision": True}):
        headings, _, _ = _flown_to_and_fro(20.0, 25.0, **motion)
        assert np.degrees(headings[-1]) == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize("mean_deg", [-25.0, 20.0])
def test_its_velocity_shows_only_a_part_of_a_wrong_heading(mean_deg: float) -> None:
    headings, true, estimated = _flown_to_and_fro(mean_deg, 12.0)
    flown = slice(round(6.0 / DT_S), None)  # until then it finds its satellites
    mean_error_deg = float(np.degrees(headings[flown].mean()))
    # turned as its accelerometers are, and not as the truth
    assert 0.8 < _angle_deg(true[flown], estimated[flown]) / mean_error_deg < 1.05


def test_without_errors_of_the_heading_the_velocity_is_right_in_motion() -> None:
    _, true, estimated = _flown_to_and_fro(0.0, 8.0)
    np.testing.assert_allclose(estimated, true, atol=1e-9)


def test_vision_with_a_heading_replaces_the_error_of_the_compass_by_its_own() -> None:
    hovering = on_vision(1)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    assert abs(hovering.estimator.yaw_error_rad[0]) < 0.005
    _see_turned(hovering, 0.2, 4.0)
    assert hovering.estimator.yaw_error_rad[0] == pytest.approx(0.2, abs=0.01)
    assert hovering.estimator.heading_ratio(0) < 0.1


def _see_turned(hovering: Hovering, yaw_error_rad: float, duration_s: float) -> None:
    """Fuse the poses of a camera whose heading has an error."""
    for _ in range(round(duration_s / VISION_S)):
        hovering.time_s += VISION_S
        hovering.estimator.fuse_vision(
            0, hovering.time_s, np.zeros(3), delay_s=0.0, yaw_error_rad=yaw_error_rad
        )
        hovering.estimator.step(hovering.time_s, hovering.still, hovering.still, hovering.on_ground)


def test_a_heading_that_differs_by_much_is_refused_for_five_seconds() -> None:
    hovering = on_vision(1)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    _see_turned(hovering, 0.7, 4.0)
    assert abs(hovering.estimator.yaw_error_rad[0]) < 0.005
    assert hovering.estimator.heading_ratio(0) > 1.0
    _see_turned(hovering, 0.7, 2.0)
    assert hovering.estimator.yaw_error_rad[0] == pytest.approx(0.7, abs=0.01)


def test_a_heading_that_differs_by_much_after_a_gap_is_never_fused() -> None:
    hovering = on_vision(1)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    hovering.fly(1.0)
    assert math.isnan(hovering.estimator.heading_ratio(0))
    _see_turned(hovering, 0.7, 8.0)
    assert abs(hovering.estimator.yaw_error_rad[0]) < 0.005
    assert math.isnan(hovering.estimator.heading_ratio(0))


def test_the_heading_stays_where_vision_left_it_when_vision_stops() -> None:
    hovering = on_vision(1)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    hovering.fly(6.0)
    assert hovering.estimator.source(0) is Source.NONE
    assert abs(hovering.estimator.yaw_error_rad[0]) < 0.005


def test_the_first_position_counts_the_resets_up_to_13_on_the_pad() -> None:
    hovering = Hovering(1)
    hovering.on_ground[:] = True
    hovering.fly(2.0)
    assert hovering.estimator.source(0) is Source.NONE
    hovering.fly(1.0)
    assert hovering.estimator.source(0) is Source.GPS
    assert hovering.estimator.reset_counter(0) == 13


def test_a_jump_of_vision_is_followed_sideways_after_a_second_and_in_height_after_five() -> None:
    hovering = on_vision(1)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    before = hovering.estimator.resets[0].copy()
    hovering.fly(0.9, (1.0, -2.0, -0.8))
    assert np.abs(hovering.estimator.local(0).position_ned_m).max() < 0.1

    hovering.fly(0.2, (1.0, -2.0, -0.8))
    x, y, z = hovering.estimator.local(0).position_ned_m
    assert (x, y) == (pytest.approx(1.0, abs=0.06), pytest.approx(-2.0, abs=0.06))
    assert abs(z) < 0.1
    after = hovering.estimator.resets[0] - before
    assert after[XY] == 1
    assert after[Z] == 0
    hovering.fly(3.5, (1.0, -2.0, -0.8))
    assert abs(hovering.estimator.local(0).position_ned_m[2]) < 0.1
    hovering.fly(1.0, (1.0, -2.0, -0.8))
    assert hovering.estimator.local(0).position_ned_m[2] == pytest.approx(-0.8, abs=0.06)
    assert (hovering.estimator.resets[0] - before)[Z] == 1
    assert hovering.estimator.jumps[-1][1][2] == pytest.approx(-0.8, abs=0.06)


def test_the_ratio_of_a_jump_stays_large_until_it_is_followed_and_falls_slowly() -> None:
    """As measured on PX4 v1.16 and v1.18 (SIH): 2.0 for a second, then 0.25 after 2.5 s."""
    hovering = on_vision(1)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    assert hovering.estimator.position_ratio(0) < 0.1

    hovering.fly(0.9, (1.0, 0.0, 0.0))
    assert hovering.estimator.position_ratio(0) == 2.0
    hovering.fly(1.1, (1.0, 0.0, 0.0))
    assert 0.6 < hovering.estimator.position_ratio(0) < 1.0
    hovering.fly(1.6, (1.0, 0.0, 0.0))
    assert 0.1 < hovering.estimator.position_ratio(0) < 0.3


def test_on_the_ground_the_estimate_is_within_a_centimetre_of_vision() -> None:
    hovering = on_vision(20, VISION_DEFAULT)
    hovering.on_ground[:] = True
    hovering.fly(4.0, (3.0, -4.0, -0.1))
    samples = hovering.fly(4.0, (3.0, -4.0, -0.1))
    assert np.quantile(np.abs(samples[..., :3] - [3.0, -4.0, -0.1]), 0.99) < 0.01


def test_small_steps_of_vision_are_followed_smoothly_and_without_a_reset() -> None:
    hovering = on_vision(1)
    hovering.fly(3.0, (0.0, 0.0, 0.0))
    count = hovering.estimator.reset_counter(0)
    hovering.fly(0.05, (0.1, 0.0, 0.0))
    assert 0.01 < hovering.estimator.local(0).position_ned_m[0] < 0.09
    hovering.fly(1.0, (0.1, 0.0, 0.0))
    assert hovering.estimator.local(0).position_ned_m[0] == pytest.approx(0.1, abs=0.02)
    assert hovering.estimator.reset_counter(0) == count


def test_unmatched_delay_of_vision_is_a_lag_of_the_position() -> None:
    estimator = Estimator(np.zeros((1, 3)), seed=1, scale=0.0)
    estimator.sensors[0].has_gps = False
    flies = np.zeros(1, dtype=np.bool_)
    speed = np.array([[1.0, 0.0, 0.0]])
    for k in range(1000):
        t = k * DT_S
        if k % 3 == 0:
            estimator.fuse_vision(0, t, np.array([t - 0.04, 0.0, 0.0]), delay_s=0.0)
        estimator.step(t, t * speed, speed, flies)
    assert t - estimator.local(0).position_ned_m[0] == pytest.approx(0.038, abs=0.008)


def test_when_vision_stops_the_estimate_drifts_as_measured_and_its_flags_fade() -> None:
    hovering = on_vision(160)
    hovering.fly(4.0, (0.0, 0.0, 0.0))
    estimator = hovering.estimator
    assert estimator.flags(0, hovering.time_s) == 0x1EF
    base = estimator.offset_ned_m.copy()
    misses = {}
    leans = {}
    for tenth in range(1, 70):
        hovering.fly(0.1)
        if tenth == 11:
            assert estimator.flags(0, hovering.time_s) == 0xEF
        misses[tenth] = np.linalg.norm(estimator.offset_ned_m - base, axis=1)
        leans[tenth] = np.degrees(np.hypot(*estimator.tilt_error_rad.T))
        if tenth == 10:
            high_m = base[:, 2] - estimator.offset_ned_m[:, 2]
            assert -0.22 < high_m.min() < -0.1
            assert 0.2 < high_m.max() < 0.32
            # believed, too
            assert 0.15 < np.median(np.hypot(*estimator.velocity_ned_m_s[:, :2].T)) < 0.35
    assert estimator.flags(0, hovering.time_s) == 0xE5
    assert np.median(misses[31]) > 1.0
    assert np.median(misses[40]) < 2.3
    assert np.ptp(misses[35]) > 0.5
    assert leans[36].min() > 0.6
    assert leans[36].max() < 3.6
    assert 1.3 < np.median(leans[36]) < 2.1
    counts = estimator.resets.copy()
    hovering.fly(1.0, (0.0, 0.0, 0.0))
    assert (estimator.resets - counts)[:, [XY, VXY, Z, VZ, HEADING]].min() == 1
    assert estimator.flags(0, hovering.time_s) == 0x1EF


def test_with_satellites_vision_does_not_move_the_frame() -> None:
    hovering = Hovering(1)
    hovering.fly(4.0)
    hovering.fly(3.0, (5.0, 7.0, -2.0))
    assert np.abs(hovering.estimator.local(0).position_ned_m).max() < 1.2


def test_a_restart_begins_a_new_origin_where_the_vehicle_is_and_counts_anew() -> None:
    estimator = Estimator(np.zeros((1, 3)), seed=1, scale=0.0)
    there = np.array([[3.0, -1.0, -2.0]])
    still = np.zeros((1, 3))
    flies = np.zeros(1, dtype=np.bool_)
    for k in range(500):
        estimator.step(k * DT_S, there, still, flies)
    assert estimator.reset_counter(0) == 13
    estimator.restart(0, 4.0, there[0])
    estimator.step(4.0, there, still, flies)
    assert estimator.source(0) is Source.NONE
    assert estimator.reset_counter(0) == 9
    np.testing.assert_allclose(estimator.position_ned_m[0], 0.0, atol=1e-9)


def test_vision_that_is_not_finite_is_ignored() -> None:
    estimator = Estimator(np.zeros((1, 3)), seed=3)
    before = estimator.offset_ned_m.copy()
    for bad in (np.nan, np.inf):
        estimator.fuse_vision(0, 1.0, np.array([bad, 0.0, 0.0]), delay_s=0.0)
    assert np.array_equal(estimator.offset_ned_m, before)


def test_the_reported_accuracy_grows_without_satellites_and_recovers_with_them() -> None:
    hovering = Hovering(1)
    hovering.fly(5.0)
    told_m = hovering.estimator.accuracy_m
    assert told_m(0, hovering.time_s) == 0.3
    hovering.estimator.sensors[0].gps_blocked = True
    hovering.fly(0.1)
    for measured_m in (0.37, 0.53, 0.74, 1.0, 1.32):  # PX4 v1.18, SIH, a second apart
        hovering.fly(1.0)
        assert told_m(0, hovering.time_s) == pytest.approx(measured_m, rel=0.12)
    hovering.fly(1.0)
    assert told_m(0, hovering.time_s) > 4.0
    hovering.estimator.sensors[0].gps_blocked = False
    hovering.fly(0.2)
    assert told_m(0, hovering.time_s) == 0.3


def test_satellites_that_come_back_bring_the_position_back() -> None:
    hovering = Hovering(1)
    hovering.fly(5.0)
    hovering.estimator.sensors[0].gps_blocked = True
    hovering.fly(10.0)
    drifted_m = np.hypot(*hovering.estimator.offset_ned_m[0, :2])
    hovering.estimator.sensors[0].gps_blocked = False
    hovering.fly(0.5)
    assert np.hypot(*hovering.estimator.offset_ned_m[0, :2]) < 0.1 < drifted_m
