"""A flight in lockstep compiles the law before it begins, and says so if that takes long."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from groundstation.flights.simulation_settings import SimulationSettings
from onboard.config.fleet import load_fleet
from onboard.rollout import first_compilation, loops
from sitl.lockstep.simulated_flight import open_flight

pytestmark = pytest.mark.skipif(not loops.is_compiled(), reason="numba is not installed")

PAPER = load_fleet("configs/fleets/paper.toml")
SETTINGS = SimulationSettings(is_lockstep=True)


@pytest.fixture(autouse=True)
def new_process() -> None:
    """Let the next batch compile the law, or load it from numba's cache, as in a new process."""
    loops.loops.cache_clear()


@pytest.mark.parametrize("told_after_s", [0.0, 600.0])
def test_the_compilation_is_told_once_it_takes_longer_than_a_limit(
    told_after_s: float, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(first_compilation, "_TOLD_AFTER_S", told_after_s)
    open_flight(PAPER, SETTINGS, None).close()

    told = f"{first_compilation.SENTENCE}\n" if told_after_s == 0.0 else ""
    assert capsys.readouterr().err == told


def test_nothing_is_compiled_for_a_single_vehicle() -> None:
    alone = msgspec.structs.replace(PAPER, vehicles={"mav0": PAPER.vehicles["mav0"]})
    open_flight(alone, SETTINGS, None).close()
    assert loops.loops.cache_info().currsize == 0


@pytest.mark.long
def test_the_first_flight_on_a_machine_tells_that_it_compiles(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.mkdir()
    words = ["fly", "paper", "--lockstep", "--record", str(tmp_path / "flight")]
    flown = subprocess.run(
        [sys.executable, "-m", "groundstation", *words],
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert flown.stderr.splitlines() == [first_compilation.SENTENCE]
