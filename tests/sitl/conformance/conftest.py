"""A running emulator of one vehicle, on free ports of the loopback."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.clients.running import Running, running_emulator


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[Running]:
    """The process and its ports."""
    with running_emulator(tmp_path) as running:
        yield running


@pytest.fixture
def emulator_port(emulator: Running) -> int:
    """Where its companion listens."""
    return emulator.companion
