"""The paper's own flight: what its Proposition 1 promises holds where its assumptions do."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from groundstation import cli
from onboard.config.fleet import load_fleet
from sitl.monte_carlo import batch_flight, campaign_settings, scenarios
from tests.bench.peers import ideal_ring

ROOT = Path(__file__).parents[3]
FLEET = load_fleet(ROOT / "configs/fleets/paper.toml")


@pytest.mark.parametrize("order", itertools.permutations(range(3)))
def test_the_papers_ring_keeps_h_positive_for_every_pair_when_nothing_errs_or_lags(order):
    _, positions, gaps = ideal_ring.fly(FLEET, order)
    assert (gaps**2 - 0.8**2).min() >= 0.0
    _, slots = ideal_ring.starts_and_slots(FLEET)
    np.testing.assert_allclose(positions[-1], slots[list(order)], atol=0.01)


def test_the_ring_of_the_paper_really_has_to_act():
    _, _, gaps = ideal_ring.fly(FLEET, (0, 1, 2))
    assert gaps.min() < 0.82


# the weak vehicle made to obey at once, and nothing that errs
OBEDIENT = (
    *("delay_s=0", "loss_share=0", "gust_m_s2=0", "lag_mismatch=0", "gain=0", "vehicle.drag_1_s=0"),
    *("vehicle.attitude_wn_rad_s=60", "vehicle.attitude_zeta=1", "vehicle.attitude_delay_s=0"),
    *(
        "vehicle.hover_thrust_frac=0.5",
        "sitl.motor_lag_s=0.005",
        "sitl.static_gain=1",
        "sitl.tilt_bias_deg=0",
    ),
    "sitl.thrust_noise_frac=0",
)


def ring_flights(changes: tuple[str, ...], errors: str, count: int) -> list[batch_flight.Flown]:
    """``covey simulate form3 --seeds 0:COUNT --law paper --type ardrone``; six are every
    permutation of the slots.
    """
    setup = campaign_settings.setup_for(
        law="paper", types="ardrone", errors=errors, changes=changes
    )
    return batch_flight.fly([scenarios.plan("form3", seed) for seed in range(count)], setup)


@pytest.mark.long
def test_the_papers_ring_keeps_080_m_but_for_its_sampling_when_vehicles_obey_at_once():
    flown = ring_flights(OBEDIENT, "none", 6)
    # 50 Hz, and a neighbour heard a tick late
    assert min(one.outcome.min_separation_m for one in flown) > 0.795
    assert all(one.outcome.is_success for one in flown)


@pytest.mark.long
def test_the_same_ring_on_the_papers_weak_vehicle_does_not():
    assert min(one.outcome.min_separation_m for one in ring_flights((), "mocap", 1)) < 0.75


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_papers_flight_by_agents_and_emulator_keeps_080_m_where_its_assumptions_hold(tmp_path):
    words = [
        "fly",
        str(ROOT / "configs/missions/paper.toml"),
        "--fleet",
        str(ROOT / "configs/fleets/ideal.toml"),
    ]
    assert cli.main([*words, "--lockstep", "--headless", "--record", str(tmp_path / "ring")]) == 0
    verdict = json.loads((tmp_path / "ring" / "verdict.json").read_text())
    assert verdict["closest"]["distance_m"] >= 0.80
    assert cli.main(["plot", str(tmp_path / "ring")]) == 0
    drawn = sorted(path.stem for path in (tmp_path / "ring" / "figures").glob("*.png"))
    assert drawn == ["fig2_attitude", "fig4_plan", "fig5_tracking", "fig6_avoidance"]
