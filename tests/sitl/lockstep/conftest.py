"""The fixture, and a mission that is short."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.lockstep.testing import lockstep as lockstep

ROOT = Path(__file__).resolve().parents[3]
PAPER = ROOT / "configs" / "fleets" / "paper.toml"


@pytest.fixture(scope="session")
def hop() -> Mission:
    """Up, a step forward in formation, and down."""
    return mission_from_mapping(
        {
            "schema": 1,
            "step": [
                {"do": "takeoff", "height_m": 0.8},
                {"do": "formation", "name": "triangle", "position_enu_m": [0.0, 0.6, 0.8]},
                {"do": "land"},
            ],
            "expect": {"min_separation_m": 0.8, "arrived_within_m": 0.15, "all_landed": True},
        },
        path="hop.toml",
        fleet=load_fleet(PAPER),
    )


@pytest.fixture
def paper() -> FleetConfig:
    """The paper's three vehicles."""
    return load_fleet(PAPER)
