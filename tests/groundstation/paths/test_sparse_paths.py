"""Paths through few positions: they go where the file says, and stand where it stands."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from groundstation.paths.path_files import load_path, read_path
from groundstation.paths.pieces import fitted, through, turns_far, waypoint_times_s, would_swing
from onboard.arrays import Array
from onboard.control.path import sampled

REST_S = 0.25  # by which a path passes each position later than its file says
WINDOW_S = 0.3  # corners are smoothed over it on each side
NEAR_M = 0.012  # pieces miss the curve by up to 0.01 m


def flown(times_s: Array, values: Array, at_s: Array) -> Array:
    """Return x, y, z and yaw of the path through values (T, 4) at times of the file."""
    values_there, _, _ = sampled(fitted(times_s, values), at_s + REST_S)
    return values_there


def off_line_m(times_s: Array, values: Array, step: int) -> float:
    """Return the largest distance of the path from the line between two successive positions."""
    begin = values[step, :3]
    way = values[step + 1, :3] - begin
    at_s = np.arange(times_s[step] + WINDOW_S, times_s[step + 1] - WINDOW_S, 0.02)
    from_begin = flown(times_s, values, at_s)[:, :3] - begin
    share = np.clip(from_begin @ way / np.maximum(way @ way, 1e-9), 0.0, 1.0)
    return float(np.linalg.norm(from_begin - share[:, None] * way, axis=1).max())


def ring(count: int) -> tuple[Array, Array]:
    """Return times and values of positions around a circle, 2 s apart."""
    angles = np.linspace(0.0, 2.0 * np.pi, count + 1)
    values = np.zeros((count + 1, 4))
    values[:, 0] = 2.0 * np.cos(angles)
    values[:, 1] = 2.0 * np.sin(angles)
    values[:, 2] = 1.0
    return 2.0 * np.arange(count + 1.0), values


def test_a_vehicle_that_stands_between_two_moves_in_its_file_stands() -> None:
    times_s = np.array([0.0, 10.0, 12.0, 22.0, 24.0, 34.0])
    values = np.zeros((6, 4))
    values[:, 0] = [0.0, 0.0, 2.0, 2.0, 5.0, 5.0]
    values[:, 2] = 1.0
    for begin_s, end_s, x in ((0.0, 10.0, 0.0), (12.0, 22.0, 2.0), (24.0, 34.0, 5.0)):
        standing_s = np.arange(begin_s + WINDOW_S, end_s - WINDOW_S, 0.05)
        assert np.abs(flown(times_s, values, standing_s)[:, 0] - x).max() < NEAR_M


def test_a_path_whose_spline_would_swing_stays_near_its_lines() -> None:
    rng = np.random.default_rng(5)
    swinging = 0
    for _ in range(60):
        times_s = np.cumsum(rng.choice([1.0, 1.5, 8.0], size=9))
        values = np.zeros((9, 4))
        values[:, :3] = np.cumsum(rng.choice([-3.0, 0.0, 0.5, 6.0], size=(9, 3)), axis=0)
        values[:, 3] = np.cumsum(rng.uniform(-1.0, 1.0, size=9))
        if not would_swing(times_s, values):
            continue

        swinging += 1
        for k in range(8):
            at_s = np.arange(times_s[k] + WINDOW_S, times_s[k + 1] - WINDOW_S, 0.02) - times_s[0]
            there = flown(times_s - times_s[0], values, at_s)
            assert (there > np.minimum(values[k], values[k + 1]) - NEAR_M).all()
            assert (there < np.maximum(values[k], values[k + 1]) + NEAR_M).all()

            length_m = float(np.linalg.norm(values[k + 1, :3] - values[k, :3]))
            allowed_m = max(0.1, 0.1 * length_m) + NEAR_M
            assert off_line_m(times_s - times_s[0], values, k) < allowed_m
    assert swinging > 50


@pytest.mark.parametrize(("count", "swings"), [(4, True), (8, False), (12, False), (16, False)])
def test_positions_along_a_curve_keep_their_spline(count: int, swings: bool) -> None:
    times_s, values = ring(count)
    assert would_swing(times_s, values) == swings

    at_s = np.arange(1.0, times_s[-1] - 1.0, 0.05)
    spline = CubicSpline(times_s, values[:, :3], bc_type="clamped")
    off_m = np.abs(flown(times_s, values, at_s)[:, :3] - spline(at_s)).max()
    assert (off_m > 0.05) == swings


def test_yaw_does_not_swing_beside_a_smooth_path() -> None:
    times_s, values = ring(16)
    values[8:, 3] = 2.0
    assert not would_swing(times_s, values)
    yaw_rad = flown(times_s, values, np.arange(0.0, times_s[-1], 0.05))[:, 3]
    assert yaw_rad.min() > -NEAR_M
    assert yaw_rad.max() < 2.0 + NEAR_M


def test_waypoints_of_long_and_short_legs_stay_in_their_box(tmp_path: FilePath) -> None:
    file = tmp_path / "mower.csv"
    file.write_text("x,y,z,speed\n0,0,1,1\n10,0,1,1\n10,0.5,1,1\n0,0.5,1,1\n0,1,1,1\n10,1,1,1\n")
    assert read_path(file).would_swing
    path = load_path(file)
    values, _, accelerations = sampled(path, np.arange(0.0, path.duration_s, 0.01))
    assert values[:, 0].min() > -NEAR_M
    assert values[:, 0].max() < 10.0 + NEAR_M
    assert values[:, 1].min() > -NEAR_M
    assert values[:, 1].max() < 1.0 + NEAR_M
    # the acceleration is continuous
    assert np.abs(np.diff(accelerations, axis=0)).max() < 1.0


MOWER = ((0.0, 0.0), (40.0, 0.0), (40.0, 3.0), (0.0, 3.0), (0.0, 6.0), (40.0, 6.0))
BOX = ((0.0, 0.0), (6.0, 0.0), (6.0, 1.0), (0.0, 1.0), (0.0, 0.0))


@pytest.mark.parametrize("corners", [MOWER, BOX], ids=["mower", "box"])
@pytest.mark.parametrize("turned_deg", [0.0, 20.0, 45.0, 80.0])
def test_a_turned_field_is_flown_along_its_lines(
    corners: tuple[tuple[float, float], ...], turned_deg: float
) -> None:
    east_north = np.array(corners) @ [1.0, 1.0j] * np.exp(1j * np.radians(turned_deg))
    points = np.zeros((len(corners), 4))
    points[:, 0] = east_north.real
    points[:, 1] = east_north.imag
    times_s = waypoint_times_s(points, np.full(len(points), 0.8))
    assert would_swing(times_s, points)

    for k in range(len(points) - 1):
        assert off_line_m(times_s, points, k) < NEAR_M


@pytest.mark.parametrize("turned_rad", [0.0, 0.4])
def test_a_stop_at_corners_makes_no_way_between_them_quicker(turned_rad: float) -> None:
    east_north = np.array([0.0, 6.0, 6.0 + 6.0j, 6.0j, 0.0]) * np.exp(1j * turned_rad)
    points = np.zeros((5, 4))
    points[:, 0] = east_north.real
    points[:, 1] = east_north.imag
    path = through(points, np.full(5, 0.8))
    _, rates, accelerations = sampled(path, np.arange(0.0, path.duration_s, 0.02))
    assert np.linalg.norm(rates[:, :3], axis=1).max() < 0.8
    assert np.linalg.norm(accelerations[:, :3], axis=1).max() < 1.5


@pytest.mark.parametrize(
    ("step_s", "degrees", "flown_deg"),
    [
        (10.0, (0.0, 360.0, 0.0), (0.0, 360.0, 0.0)),
        (10.0, (0.0, 270.0, 180.0), (0.0, 270.0, 180.0)),
        (10.0, (0.0, -360.0, -720.0), (0.0, -360.0, -720.0)),
        (1.0, (170.0, -170.0, -150.0), (170.0, 190.0, 210.0)),  # numbers that wrap
        (1.0, (0.0, 360.0, 720.0), (0.0, 0.0, 0.0)),
        (2.0, (350.0, 10.0, 350.0), (350.0, 370.0, 350.0)),
        (5.0, (170.0, -170.0, 170.0), (170.0, 190.0, 170.0)),  # vehicles turn slower
    ],
)
def test_yaw_of_sparse_positions_turns_as_written_unless_it_wraps(
    step_s: float, degrees: tuple[float, ...], flown_deg: tuple[float, ...]
) -> None:
    times_s = step_s * np.arange(3.0)
    values = np.zeros((3, 4))
    values[:, 3] = np.radians(degrees)
    assert turns_far(times_s, values[:, 3])
    yaw_deg = np.degrees(flown(times_s, values, times_s)[:, 3])
    assert yaw_deg == pytest.approx(flown_deg, abs=12.0)


def test_yaw_of_dense_positions_wraps_also_over_a_gap() -> None:
    times_s = np.arange(0.0, 30.0, 0.1)
    is_kept = (times_s < 12.0) | (times_s > 22.0)
    values = np.zeros((len(times_s), 4))
    values[:, 3] = np.angle(np.exp(0.2j * times_s))
    times_s = times_s[is_kept]
    values = values[is_kept]
    assert not turns_far(times_s, values[:, 3])
    yaw_rad = flown(times_s, values, times_s[5:-5])[:, 3]
    assert np.abs(yaw_rad - 0.2 * times_s[5:-5]).max() < 0.1
