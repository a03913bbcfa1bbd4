"""Vehicles of one type differ as real ones were measured to differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sitl.lockstep.flight import Lockstep
from sitl.physics.scatter import one_of_type
from sitl.physics.vehicle import VehicleProfile

SIH = VehicleProfile()


def test_no_two_vehicles_of_a_type_are_alike_and_a_seed_repeats_itself() -> None:
    fleet = [one_of_type(SIH, seed=3, index=index) for index in range(20)]
    assert len({vehicle.drag_1_s for vehicle in fleet}) == 20
    assert fleet[4] == one_of_type(SIH, seed=3, index=4)
    assert fleet[4] != one_of_type(SIH, seed=4, index=4)


def test_all_lie_within_what_was_measured_on_sih() -> None:
    fleet = [one_of_type(SIH, seed=seed, index=0) for seed in range(500)]
    for name, least, most in (
        ("hover_thrust_frac", 0.487, 0.493),
        ("drag_1_s", 0.90, 1.10),
        ("attitude_delay_s", 0.035, 0.045),
        ("attitude_wn_rad_s", 10.5, 11.5),
        ("attitude_zeta", 0.576, 0.624),
    ):
        values = [getattr(vehicle, name) for vehicle in fleet]
        assert least - 1e-3 <= min(values) < max(values) <= most + 1e-3, name
        assert max(values) - min(values) > 0.9 * (most - least), name


def test_without_scatter_a_vehicle_is_its_type_and_a_windy_type_stays_as_windy() -> None:
    assert one_of_type(SIH, seed=1, index=1, scale=0.0) == SIH
    windy = replace(SIH, gust_std_m_s2=0.5, thrust_noise_frac=0.05)
    one = one_of_type(windy, seed=1, index=1)
    assert one.gust_std_m_s2 == 0.5
    assert one.thrust_noise_frac == 0.05


@pytest.mark.long
def test_the_papers_three_meet_their_goals_no_closer_than_real_px4s() -> None:
    """Real PX4s: the worst of a flight was off by .027 to .048 m."""
    worst_m: list[float] = []
    for seed in range(20):
        with Lockstep("configs/fleets/paper.toml", seed=seed) as flight:
            verdict = flight.fly("configs/missions/paper.toml")
            assert verdict.worst_arrival_m is not None
            worst_m.append(verdict.worst_arrival_m)

    assert 0.025 < float(np.median(worst_m)) < 0.048
    assert max(worst_m) < 0.08
