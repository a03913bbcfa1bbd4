"""The motion capture is noisy, late and sometimes blind."""

from __future__ import annotations

import numpy as np
import pytest

from sitl.emulator.mocap import Mocap, MocapSettings
from sitl.physics.vehicle import STEP_S


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


def test_a_body_without_markers_is_reported_as_lost() -> None:
    poses = poses_of(MocapSettings(dropout_per_s=0.5, dropout_s=0.3), 30.0)
    lost = [pose for pose in poses if not pose[2]]
    assert 0.02 < len(lost) / len(poses) < 0.4
