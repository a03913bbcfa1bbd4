"""Paths: their bytes, their motion, and the pipeline that follows them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from groundstation.paths.pieces import cut, fitted, quintic, slowed
from onboard.control import path as paths
from onboard.control import trajectory
from onboard.control.path import Path, path_of, point_at
from onboard.types import Goal
from onboard.vectors import Vec3


def wave(duration_s: float = 8.0) -> Path:
    """A path that turns, climbs and sinks."""
    times_s = np.arange(0.0, duration_s + 0.01, 0.5)
    share = times_s / duration_s
    values = np.column_stack([np.sin(6 * share), share * share, 1 + 0.2 * np.cos(4 * share), share])
    return fitted(times_s, values)


def test_a_path_is_its_bytes_and_damaged_ones_are_none() -> None:
    path = wave()
    data = paths.to_bytes(path)
    assert paths.from_bytes(data) == path
    assert paths.path_id(data) != paths.path_id(data[:-4] + b"abcd")
    for broken in (b"", data[:-1], data + bytes(132), b"\xff" * 132, data * 10_000):
        with pytest.raises(ValueError, match=r"path|piece"):
            paths.from_bytes(broken)


def test_one_time_and_many_times_give_the_same_motion_and_its_derivatives() -> None:
    path = wave()
    times_s = np.linspace(0.01, path.duration_s - 0.01, 400)
    many = paths.sampled(path, times_s)
    for index in range(0, 400, 37):
        point = point_at(path, float(times_s[index]))
        assert np.allclose(many[0, index, :3], point.position_enu_m, atol=1e-12)
        assert np.allclose(many[1, index, :3], point.velocity_enu_m_s, atol=1e-12)
        assert np.allclose(many[2, index, :3], point.acceleration_enu_m_s2, atol=1e-12)
        assert many[0, index, 3] == pytest.approx(point.yaw_rad)
    step_s = float(times_s[1] - times_s[0])
    assert np.allclose(np.gradient(many[0], step_s, axis=0)[2:-2], many[1][2:-2], atol=0.02)


def test_a_path_rests_before_its_begin_and_after_its_end() -> None:
    path = wave()
    for time_s in (-5.0, -math.inf, path.duration_s + 1.0, math.inf):
        point = point_at(path, time_s)
        assert point.velocity_enu_m_s == point.acceleration_enu_m_s2 == (0.0, 0.0, 0.0)
        end_s = 1e-6 if time_s < 0.0 else path.duration_s - 1e-6
        assert math.dist(point.position_enu_m, point_at(path, end_s).position_enu_m) < 1e-4


def test_pieces_join_cut_and_slow_down_exactly() -> None:
    begin = np.array([[0.0] * 4, [0.1] * 4, [0.2] * 4])
    end = np.array([[1.0] * 4, [-0.3] * 4, [0.5] * 4])
    piece = path_of([quintic(2.0, begin, end).tolist()])
    assert np.allclose(paths.sampled(piece, np.array([2.0]))[:, 0], end, atol=1e-5)
    path = wave()
    part = path_of(cut(path, 1.3, 6.1).tolist())
    assert math.dist(point_at(part, 2.0).position_enu_m, point_at(path, 3.3).position_enu_m) < 1e-5
    slow = slowed(path, 1.5)
    assert math.dist(point_at(slow, 4.5).position_enu_m, point_at(path, 3.0).position_enu_m) < 1e-5
    fast_m_s, slow_m_s = (
        point_at(one, t).velocity_enu_m_s.x for one, t in ((path, 3.0), (slow, 4.5))
    )
    assert slow_m_s == pytest.approx(fast_m_s / 1.5, abs=1e-5)


def test_a_leg_after_a_path_continues_its_motion() -> None:
    params = trajectory.TrajectoryParams(2.0, 3.0, lead_s=0.15)
    point = point_at(wave(), 3.0)
    goal = Goal(
        position_enu_m=point.position_enu_m,
        duration_s=0.0,
        sequence=5,
        is_on_path=True,
        velocity_enu_m_s=point.velocity_enu_m_s,
        acceleration_enu_m_s2=point.acceleration_enu_m_s2,
        yaw_rad=0.0,
        clock_rate_frac=1.0,
    )
    memory, on_path = trajectory.step(
        trajectory.initial(Vec3(9.0, 9.0, 9.0)), goal, params, 0.02, 1.0
    )
    assert on_path.position_enu_m == point.position_enu_m
    assert on_path.velocity_enu_m_s == point.velocity_enu_m_s
    _, after = trajectory.step(memory, Goal(Vec3(1.0, 1.0, 1.0), 0.0, 6), params, 0.001, 1.0)
    assert math.dist(after.position_enu_m, on_path.position_enu_m) < 0.002
    assert math.dist(after.velocity_enu_m_s, on_path.velocity_enu_m_s) < 0.01
