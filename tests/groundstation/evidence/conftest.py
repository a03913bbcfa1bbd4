"""The paper's fleet."""

from __future__ import annotations

import pytest

from onboard.config.fleet import FleetConfig, load_fleet


@pytest.fixture(scope="session")
def paper() -> FleetConfig:
    """The paper's three vehicles."""
    return load_fleet("paper")
