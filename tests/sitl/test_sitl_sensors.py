"""The estimate errs as measured, and the motion capture is noisy, late and sometimes blind."""

from __future__ import annotations

import numpy as np
import pytest

from sitl.mocap import Mocap, MocapSettings
from sitl.sensors import ESTIMATE_EVERY_STEPS, GPS, VISION_TUNED, Estimator, vision_level
from sitl.vehicle import STEP_S
from tests.sitl.sitl_flying import emulator, run_for

DT_S = ESTIMATE_EVERY_STEPS * STEP_S


def velocity_errors(count: int, *, has_gps: bool, duration_s: float) -> np.ndarray:
    """Velocity errors (time, vehicle, axis) of vehicles that hover, on satellites or on tuned vision."""
    start = np.zeros((count, 3))
    estimator = Estimator(start, seed=2)
    estimator.has_gps = [has_gps] * count
    estimator.vision_levels = [VISION_TUNED] * count
    flying = np.zeros(count, dtype=np.bool_)
    samples = []
    for k in range(int(duration_s / DT_S)):
        if not has_gps and k % 2 == 0:
            for i in range(count):
                estimator.fuse_vision(i, k * DT_S, np.zeros(3), delay_s=0.0)
        estimator.step(k * DT_S, start, np.zeros((count, 3)), flying)
        samples.append([estimator.local(i).velocity_ned_m_s for i in range(count)])
    return np.array(samples)[int(3.0 / DT_S) :]


def test_velocity_on_satellites_errs_slowly_and_as_much_as_measured() -> None:
    errors = velocity_errors(40, has_gps=True, duration_s=12.0)
    np.testing.assert_allclose(errors.reshape(-1, 3).std(axis=0), GPS.velocity_m_s, rtol=0.25)
    later = errors[int(1.0 / DT_S) :]
    correlation = np.corrcoef(errors[: later.shape[0]].ravel(), later.ravel())[0, 1]
    assert correlation > 0.5


def test_velocity_on_tuned_vision_errs_little_and_fast() -> None:
    errors = velocity_errors(10, has_gps=False, duration_s=8.0)
    np.testing.assert_allclose(errors.reshape(-1, 3).std(axis=0), VISION_TUNED.velocity_m_s, rtol=0.25)
    later = errors[int(0.6 / DT_S) :]
    assert abs(np.corrcoef(errors[: later.shape[0], :, 1].ravel(), later[:, :, 1].ravel())[0, 1]) < 0.3


def test_tuning_improves_the_error_level_step_by_step() -> None:
    levels = [vision_level(0.1, 0.25), vision_level(0.01, 0.25), vision_level(0.01, 0.02)]
    sizes = [sum(level.velocity_m_s) for level in levels]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 3


def test_each_vehicle_has_its_own_local_origin() -> None:
    emu = emulator((0.0, 0.0, 0.0), (5.0, 7.0, 0.0))
    run_for(emu, 1.0)
    for index in (0, 1):
        assert np.hypot(*emu.estimator.local(index).position_ned_m[:2]) < 0.3


def test_without_any_source_the_estimate_drifts_in_flight() -> None:
    estimator = Estimator(np.zeros((20, 3)), seed=3)
    estimator.has_gps = [False] * 20
    flying = np.zeros(20, dtype=np.bool_)
    for k in range(int(6.0 / DT_S)):
        estimator.step(k * DT_S, np.zeros((20, 3)), np.zeros((20, 3)), flying)
    drift = np.hypot(estimator.offset_ned_m[:, 0], estimator.offset_ned_m[:, 1])
    assert 0.3 < np.median(drift) < 2.0


def test_vision_that_is_not_finite_is_ignored() -> None:
    estimator = Estimator(np.zeros((1, 3)), seed=3)
    before = estimator.offset_ned_m.copy()
    estimator.fuse_vision(0, 1.0, np.array([np.nan, 0.0, 0.0]), delay_s=0.0)
    assert np.array_equal(estimator.offset_ned_m, before)


def poses_of(settings: MocapSettings, duration_s: float) -> list[tuple[float, float, bool, float]]:
    """(arrival, exposure, tracked, x) of the poses of one body that moves 1 m/s along x."""
    mocap = Mocap(1, settings, seed=1)
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    out = []
    for k in range(round(duration_s / STEP_S)):
        t = k * STEP_S
        for pose in mocap.step(t, np.array([[t, 0.0, 0.0]]), level):
            out.append((t, pose.time_s, pose.is_tracked, pose.position_enu_m[0]))
    return out


def test_poses_come_at_their_rate_late_and_with_noise_about_the_exposure() -> None:
    poses = poses_of(MocapSettings(), 20.0)
    assert len(poses) == pytest.approx(1000, abs=3)
    assert all(0.019 < arrival - exposure < 0.025 for arrival, exposure, _, _ in poses)
    errors = np.array([x - exposure for _, exposure, _, x in poses])
    assert errors.std() == pytest.approx(0.003, rel=0.1)
    assert abs(errors.mean()) < 0.0005


def test_lost_markers_are_said_to_be_lost() -> None:
    poses = poses_of(MocapSettings(dropout_per_s=0.5, dropout_s=0.3), 30.0)
    lost = [pose for pose in poses if not pose[2]]
    assert 0.02 < len(lost) / len(poses) < 0.4
