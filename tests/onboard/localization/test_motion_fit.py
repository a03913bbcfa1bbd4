"""Positions against the motion that attitude and throttle explain."""

from __future__ import annotations

import math

import numpy as np

from onboard.localization.motion_fit import MotionFit
from onboard.vectors import Vec3

TICK_S = 0.02


def test_noise_is_its_own_standard_deviation() -> None:
    rng = np.random.default_rng(1)
    fit = MotionFit()
    for _ in range(2000):
        east_m, north_m = rng.normal(0.0, 0.05, 2).tolist()
        fit.step(Vec3(east_m, north_m, 3.0), TICK_S, False)
    assert math.isclose(fit.miss_m, math.sqrt(2.0) * 0.05, rel_tol=0.3)


def test_a_miss_that_lasts_is_shown_within_a_second() -> None:
    fit = MotionFit()
    for _ in range(50):
        fit.step(Vec3(0.3, 0.0, 0.0), TICK_S, False)
    assert 0.2 < fit.miss_m < 0.3


def test_on_the_ground_nothing_is_learnt() -> None:
    fit = MotionFit()
    fit.step(Vec3(5.0, 0.0, 0.0), TICK_S, False)
    fit.step(Vec3(5.0, 0.0, 0.0), TICK_S, True)
    assert fit.miss_m == 0.0
