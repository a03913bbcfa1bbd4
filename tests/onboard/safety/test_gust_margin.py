"""The margin in gusts is the one that the law keeps between vehicles that publish the error."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from onboard.avoidance.pairs import design_distance, margin_2
from onboard.avoidance.params import VehicleLimits, params_of
from onboard.config.fleet import load_fleet
from onboard.config.law import LawConfig
from onboard.estimation.accuracies import ACCURACIES
from onboard.safety.gust_margin import gust_margin_m
from tests.onboard.avoidance.law_cases import neighbour_of

PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"
LAW = LawConfig()
VEHICLE = load_fleet(PAPER).vehicles["mav0"]
LAG_S = VEHICLE.lag_s
SPACING = params_of(LAW, VehicleLimits(lag_s=LAG_S)).spacing


@pytest.mark.parametrize("gust_m_s2", [0.0, 0.1, 0.15])
def test_weak_gusts_need_no_more_than_the_margin_in_calm_air(gust_m_s2: float) -> None:
    assert gust_margin_m(gust_m_s2, VEHICLE, LAW) == SPACING.margin_m


@pytest.mark.parametrize("gust_m_s2", [0.4, 0.6, 0.8])
def test_strong_gusts_count_as_an_error_of_both_velocities(gust_m_s2: float) -> None:
    # all but the 0.05 m/s^2 of the floor acts for the lag and half of the observer's time
    velocity_std_m_s = (LAG_S + 0.125) * (gust_m_s2 - 0.05)
    own = margin_2(0.0, velocity_std_m_s, SPACING)
    neighbour = neighbour_of((2.0, 0.0, 1.0), velocity_std_m_s=velocity_std_m_s)
    kept_m = design_distance(own, neighbour, SPACING) - SPACING.safety_distance_m

    assert gust_margin_m(gust_m_s2, VEHICLE, LAW) == pytest.approx(kept_m)
    assert kept_m > SPACING.margin_m


def test_without_a_margin_in_calm_air_each_gust_beyond_the_covered_ones_widens_it() -> None:
    tight = LawConfig(design_margin_m=0.0, lag_margin_m_s=0.0)
    spacing = params_of(tight, VehicleLimits(lag_s=LAG_S)).spacing
    calm_m = spacing.margin_floor_m
    assert gust_margin_m(0.15, VEHICLE, tight) == pytest.approx(calm_m)
    assert gust_margin_m(0.16, VEHICLE, tight) == pytest.approx(
        calm_m + math.sqrt(2.0) * spacing.sigma_velocity_s * (LAG_S + 0.125) * 0.01
    )


def test_strong_gusts_need_a_margin_on_top_of_the_usual_one() -> None:
    # errors, lag and gusts come together: the usual margin is used up without strong gusts
    assert gust_margin_m(0.3, VEHICLE, LAW) > SPACING.margin_m + 0.15


@pytest.mark.parametrize("source", ["gps", "vision"])
def test_the_errors_of_px4s_own_position_count_as_in_the_margin_that_others_keep(
    source: Any,
) -> None:
    bare = replace(VEHICLE, mocap_required=False, px4_position=source)
    position_std_m = ACCURACIES[source].position_std_m
    velocity_std_m_s = ACCURACIES[source].velocity_std_m_s
    own = margin_2(position_std_m, velocity_std_m_s, SPACING)
    neighbour = neighbour_of(
        (2.0, 0.0, 1.0), position_std_m=position_std_m, velocity_std_m_s=velocity_std_m_s
    )
    kept_m = design_distance(own, neighbour, SPACING) - SPACING.safety_distance_m

    assert gust_margin_m(0.0, bare, LAW) == pytest.approx(kept_m)
    assert gust_margin_m(0.5, bare, LAW) > kept_m
