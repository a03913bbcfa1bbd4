"""Four accidents of fleets that happened: each happens without its defence, and not with it."""

from __future__ import annotations

import gc

import pytest

from groundstation.shows.gallery import ACCIDENTS as NAMES
from onboard.config.fleet import FleetConfig
from sitl.lockstep.accidents import ACCIDENTS, fly
from tests.bench.accidents import flown_once, is_as_promised
from tests.sitl.lockstep.taking import crossing

SEEDS = range(1, 21)


def test_each_accident_has_a_mission() -> None:
    assert set(NAMES) == set(ACCIDENTS)


def test_the_mission_of_a_ground_that_is_gone_has_ended(
    paper: FleetConfig, caplog: pytest.LogCaptureFixture
) -> None:
    accident = ACCIDENTS["aaib-29203"]._replace(ground_ends_in="takeoff")
    flown = fly(accident, crossing(paper), is_defended=True, seed=1)
    gc.collect()  # asyncio warns when a task that has not ended is collected
    assert flown.reason == "the ground is gone"
    assert "Task was destroyed" not in caplog.text


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", NAMES)
def test_an_accident_happens_without_its_defence_only(name: str) -> None:
    without = flown_once(name, is_defended=False, seed=1)
    assert is_as_promised(without), without.line
    defended = flown_once(name, is_defended=True, seed=1)
    assert is_as_promised(defended), defended.line


@pytest.mark.long
@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("is_defended", [False, True], ids=["without", "with"])
@pytest.mark.parametrize("name", NAMES)
def test_an_accident_on_every_seed(name: str, is_defended: bool, seed: int) -> None:
    flown = flown_once(name, is_defended=is_defended, seed=seed)
    assert is_as_promised(flown), flown.line
