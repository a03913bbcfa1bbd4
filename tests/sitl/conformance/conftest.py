"""One whole check for all tests; a running emulator of one vehicle, on free ports of the loopback."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl.conformance.facts import FactReport
from tests.clients.running import Running, running_emulator
from tests.sitl.conformance.facts_page import whole_check


@pytest.fixture(scope="session")
def report() -> FactReport:
    """One whole check of the emulator in simulated time."""
    return whole_check()


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[Running]:
    """The process and its ports."""
    with running_emulator(tmp_path) as running:
        yield running


@pytest.fixture
def emulator_port(emulator: Running) -> int:
    """Where its companion listens."""
    return emulator.companion
