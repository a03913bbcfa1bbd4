"""Hover thrust: converges, stays bounded, freezes where its model does not hold."""

from __future__ import annotations

import math

import pytest

from onboard.constants import GRAVITY_M_S2
from onboard.estimation import hover_thrust
from onboard.estimation.hover_thrust import HoverThrustParams

PARAMS = HoverThrustParams(configured_frac=0.70)


def run(
    thrust: float,
    acceleration: float,
    height: float = 1.0,
    seconds: float = 30.0,
    cos_tilt: float = 1.0,
) -> float:
    memory = hover_thrust.initial(PARAMS)
    hover = memory.hover_thrust_frac
    for _ in range(round(seconds / 0.02)):
        memory, hover = hover_thrust.step(
            memory, thrust, cos_tilt, acceleration, height, PARAMS, 0.02, True
        )
    return hover


def test_hovering_on_another_throttle_is_learnt() -> None:
    assert run(0.76, 0.0) == pytest.approx(0.76, abs=1e-3)


def test_sinking_on_the_configured_throttle_means_a_higher_hover_throttle() -> None:
    assert run(0.70, -0.5) > 0.73
    assert run(0.70, +0.5) < 0.67


def test_tilt_is_accounted_for() -> None:
    assert run(0.70 / 0.9, 0.0, cos_tilt=0.9) == pytest.approx(0.70, abs=1e-3)


@pytest.mark.parametrize(("thrust", "limit"), [(0.96, 0.84), (0.3, 0.56)])
def test_the_estimate_leaves_the_configured_value_by_a_fifth_at_most(
    thrust: float, limit: float
) -> None:
    assert run(thrust, 0.0, seconds=200.0) == pytest.approx(limit, abs=1e-9)


@pytest.mark.parametrize(
    ("thrust", "acceleration", "height", "cos_tilt"),
    [(0.8, 0.0, 0.1, 1.0), (0.99, 0.0, 1.0, 1.0), (0.05, 0.0, 1.0, 1.0), (0.8, 3.0, 1.0, 1.0),
    (0.8, 0.0, 1.0, 0.2),
     (0.8, math.nan, 1.0, 1.0), (0.8, 0.0, math.nan, 1.0)],
)  # fmt: skip
def test_it_is_frozen_near_the_ground_saturated_or_outside_its_model(
    thrust: float, acceleration: float, height: float, cos_tilt: float
) -> None:
    memory = hover_thrust.initial(PARAMS)
    for _ in range(200):
        # the motor state passes through usable throttles on its way: start it settled
        memory = hover_thrust.HoverThrustMemory(memory.hover_thrust_frac, thrust)
        memory, hover = hover_thrust.step(
            memory, thrust, cos_tilt, acceleration, height, PARAMS, 0.02, True
        )
    assert hover == 0.70


def test_a_throttle_that_is_not_finite_is_ignored() -> None:
    memory = hover_thrust.initial(PARAMS)
    memory, hover = hover_thrust.step(memory, math.nan, 1.0, 0.0, 1.0, PARAMS, 0.02, True)
    assert hover == 0.70
    assert math.isfinite(memory.effective_thrust_frac)


def test_acceleration_in_units_of_gravity_alone_decides() -> None:
    """Homogeneity: the throttle enters linearly, so doubled throttles give a doubled estimate."""
    double = HoverThrustParams(configured_frac=0.35)
    one = hover_thrust.initial(double)
    two = hover_thrust.initial(PARAMS)
    for _ in range(200):
        a = -0.03 * GRAVITY_M_S2
        args = (1.0, a, 1.0)
        one, first = hover_thrust.step(one, 0.36, *args, double, 0.02, True)
        two, second = hover_thrust.step(two, 0.72, *args, PARAMS, 0.02, True)
    assert second > 0.70
    assert second == pytest.approx(2.0 * first, rel=1e-2)


def test_lifting_off_teaches_nothing_and_flying_starts_with_settled_motors() -> None:
    memory = hover_thrust.initial(PARAMS)
    args = (0.70, 1.0, 0.0, 1.0)
    for _ in range(50):
        memory, hover = hover_thrust.step(memory, *args, PARAMS, 0.02, False)
        assert hover == 0.70
    memory, hover = hover_thrust.step(memory, *args, PARAMS, 0.02, True)
    assert hover == pytest.approx(0.70, abs=1e-6)
