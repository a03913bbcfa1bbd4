"""Flights far above the ground: the simulated battery, the climb and the wait for the landing go
with the height.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from onboard.config.fleet import FleetConfig
from tests.groundstation.recorded import read

HEIGHT_M = 25.0


@pytest.fixture
def high(paper: FleetConfig) -> FleetConfig:
    """The paper's room with a higher roof, whose second and third vehicle stay in the box."""
    fence = replace(paper.fleet.geofence_m, z=(0.0, 40.0))
    own = {
        name: one if name == "mav0" else replace(one, enabled=False)
        for name, one in paper.vehicles.items()
    }
    return replace(paper, fleet=replace(paper.fleet, geofence_m=fence), vehicles=own)


def fly(lockstep, fleet: FleetConfig, folder: Path, *steps: dict):
    mapping = {"schema": 1, "step": list(steps), "expect": {"all_landed": True}}
    return lockstep(fleet, folder=folder).fly(
        mission_from_mapping(mapping, path="high.toml", fleet=fleet)
    )


@pytest.mark.long
def test_a_vehicle_climbs_far_and_lands_from_there(lockstep, high, tmp_path):
    takeoff = {"do": "takeoff", "height_m": HEIGHT_M, "timeout_s": 100}
    verdict = fly(lockstep, high, tmp_path, takeoff, {"do": "land", "timeout_s": 100})
    assert verdict.passed, verdict.sentences
    told = [sample.values for sample in read(tmp_path, ("telemetry",))]
    assert max(values["position_enu_m"][2] for values in told) == pytest.approx(HEIGHT_M, abs=0.3)
    # as long as a battery of this type lasts: it does not reach PX4's floor of 0.5
    assert min(values["battery_frac"] for values in told) == pytest.approx(0.67, abs=0.02)
    assert (
        max(abs(values["velocity_enu_m_s"][2]) for values in told)
        < 1.1 * high.vehicles["mav0"].max_speed_m_s
    )


@pytest.mark.long
def test_a_mission_that_ends_high_up_waits_until_all_are_down(lockstep, high, tmp_path):
    takeoff = {"do": "takeoff", "height_m": HEIGHT_M, "timeout_s": 100}
    outside = {"do": "goto", "goals": {"mav0": [0, 0, HEIGHT_M]}, "timeout_s": 0.1}
    verdict = fly(lockstep, high, tmp_path, takeoff, outside)
    assert not verdict.passed
    assert "Landed and disarmed: mav0." in verdict.sentences, verdict.sentences
