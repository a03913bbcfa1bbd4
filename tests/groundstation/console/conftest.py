"""A fleet and a console for tests; no test reads or writes the orders that somebody has written."""

from __future__ import annotations

from pathlib import Path

import pytest

from onboard.config.fleet import FleetConfig, load_fleet
from tests.groundstation.console.rig import Rig

FLEET = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"


@pytest.fixture
def fleet() -> FleetConfig:
    return load_fleet(FLEET)


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"


@pytest.fixture
def rig(fleet: FleetConfig) -> Rig:
    return Rig(fleet)
