"""A turned or shifted frame shows in where the vehicles of a fleet stand."""

from __future__ import annotations

import math
import random

import pytest

from onboard.preflight.frame_fit import XY, FrameFit, fit_frame

CORNERS_M = [(x, y) for x in (-10.0, 10.0) for y in (-10.0, 10.0)]
GRID_M = [(3.0 * column, 3.0 * row) for column in range(3) for row in range(2)]


def seen(turn_deg: float, shift_m: XY, std_m: float, seed: int) -> FrameFit:
    """Return the fit to a grid of six in a turned and shifted frame, put down by hand."""
    scatter = random.Random(seed)
    turn_rad = math.radians(turn_deg)
    places = []
    for x, y in GRID_M:
        east_m = math.cos(turn_rad) * x - math.sin(turn_rad) * y + shift_m[0]
        north_m = math.sin(turn_rad) * x + math.cos(turn_rad) * y + shift_m[1]
        places.append((east_m + scatter.gauss(0, std_m), north_m + scatter.gauss(0, std_m)))
    fit = fit_frame(GRID_M, places, CORNERS_M, 0.05)
    assert fit is not None
    return fit


def test_turn_and_shift_are_found_exactly_without_scatter() -> None:
    fit = seen(5.0, (0.0, 0.0), 0.0, seed=0)
    assert math.degrees(fit.turn_rad) == pytest.approx(5.0)
    assert fit.is_turned


def test_people_who_put_vehicles_down_as_told_are_refused_in_one_of_a_hundred_at_most() -> None:
    fits = [seen(0.0, (0.0, 0.0), 0.05, seed) for seed in range(1000)]
    assert sum(fit.is_turned or fit.is_shifted for fit in fits) <= 10


def test_a_frame_that_is_turned_by_seven_degrees_is_found_in_nearly_all() -> None:
    fits = [seen(7.0, (0.0, 0.0), 0.05, seed) for seed in range(1000)]
    assert sum(fit.is_turned for fit in fits) >= 990


def test_vehicles_that_stand_anyhow_show_no_turn() -> None:
    """After a flight and a restart of the agents: that is no frame that is turned."""
    fits = [seen(0.0, (0.0, 0.0), 1.0, seed) for seed in range(200)]
    assert sum(fit.is_turned for fit in fits) <= 10


def test_one_vehicle_shows_nothing() -> None:
    assert fit_frame([(0.0, 0.0)], [(0.1, 0.0)], CORNERS_M, 0.05) is None
