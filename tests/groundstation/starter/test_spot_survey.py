"""Take-off spots where vehicles stand: how they are averaged, refused and written."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation.client.client import FleetClient
from groundstation.client.standing_positions import standing_positions
from groundstation.starter.fleet_edit import checked_edit, edited
from groundstation.starter.spot_survey import (
    changes_of,
    refuse_poor_spots,
    spot_lines,
    surveyed,
)
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.tuples import Xyz
from tests.groundstation.conftest import FakeBus

ROOT = Path(__file__).resolve().parents[3]
PAPER = ROOT / "configs" / "fleets" / "paper.toml"


def around(east_m: float, north_m: float, std_m: float = 0.02, count: int = 200) -> list[Xyz]:
    """Positions that wander around a place."""
    rng = np.random.default_rng(7)
    noise = rng.normal(0.0, std_m, (count, 2)).tolist()
    return [(east_m + east, north_m + north, 0.4) for east, north in noise]


@pytest.fixture
def stand() -> dict[str, list[Xyz]]:
    """Three vehicles beside their spots of the file."""
    return {
        "mav0": around(-1.62, -1.40),
        "mav1": around(0.1, -1.5),
        "mav2": around(1.5, -1.31),
    }


def test_a_spot_is_the_mean_and_its_spread_is_told(stand: dict[str, list[Xyz]]) -> None:
    fleet = load_fleet(PAPER)
    first, second, _ = surveyed(stand, fleet)
    assert (first.east_m, first.north_m) == pytest.approx((-1.62, -1.40), abs=0.011)
    assert first.spread_m == pytest.approx(0.02 * 2**0.5, rel=0.15)
    assert first.farthest_m > first.spread_m
    assert second.moved_m == pytest.approx(0.1, abs=0.01)
    assert "mav1" in spot_lines([second])[1]
    refuse_poor_spots([first, second], fleet, 0.3)


def test_positions_that_are_not_finite_do_not_count(stand: dict[str, list[Xyz]]) -> None:
    fleet = load_fleet(PAPER)
    unknown = (math.nan, 0.0, 0.0)
    (mixed,) = surveyed({"mav0": [unknown, *stand["mav0"], unknown]}, fleet)
    assert mixed == surveyed({"mav0": stand["mav0"]}, fleet)[0]
    with pytest.raises(ConfigError, match="mav0 has reported 0 positions"):
        surveyed({"mav0": [unknown] * 10}, fleet)


def test_only_the_spots_of_the_file_change_and_heights_stay(
    stand: dict[str, list[Xyz]], tmp_path: Path
) -> None:
    fleet = load_fleet(PAPER)
    text = PAPER.read_text(encoding="utf-8")
    changed = edited(text, changes_of(surveyed(stand, fleet), fleet))
    before, after = text.splitlines(), changed.splitlines()
    assert len(before) == len(after)
    different = [line for old, line in zip(before, after, strict=True) if old != line]
    assert len(different) == 3
    assert all(line.startswith("start_enu_m = [") and line.endswith("0.0]") for line in different)


def test_a_spread_position_is_refused_with_the_worst(stand: dict[str, list[Xyz]]) -> None:
    fleet = load_fleet(PAPER)
    spots = surveyed({**stand, "mav1": around(0.0, -1.5, std_m=0.5)}, fleet)
    with pytest.raises(ConfigError, match=r"mav1's positions are spread by 0\.\d+ m; 0\.3 m"):
        refuse_poor_spots(spots, fleet, 0.3)
    refuse_poor_spots(spots, fleet, 1.0)


def test_two_that_stand_too_near_are_refused_also_beside_one_that_was_not_surveyed(
    stand: dict[str, list[Xyz]],
) -> None:
    fleet = load_fleet(PAPER)
    near = surveyed({"mav1": around(-1.0, -1.5)}, fleet)
    with pytest.raises(ConfigError, match=r"mav0 and mav1 stand 0\.5\d m apart; to take off"):
        refuse_poor_spots(near, fleet, 0.3)


def test_a_spot_outside_the_fence_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    fleet = load_fleet(PAPER)
    path = tmp_path / "fleet.toml"
    path.write_text(PAPER.read_text(encoding="utf-8"), encoding="utf-8")
    outside = surveyed({"mav0": around(-4.5, 0.0)}, fleet)
    with pytest.raises(ConfigError, match=r"mav0\.start_enu_m"):
        checked_edit(path, changes_of(outside, fleet))


def test_too_few_positions_are_no_survey() -> None:
    with pytest.raises(ConfigError, match="mav0 has reported 2 positions"):
        surveyed({"mav0": around(0.0, 0.0, count=2)}, load_fleet(PAPER))


async def collected(fleet: FleetConfig, seconds: float = 0.12, **changes: Any) -> Any:
    """Survey vehicles, of which mav1 tells something else."""
    bus: Any = FakeBus(fleet)
    client = FleetClient(fleet, operates=False, bus=bus)

    async def beat() -> None:
        while True:
            for name in bus.vehicles:
                bus.tell(name, **(changes if name == "mav1" else {}))
            await asyncio.sleep(0.01)

    beating = asyncio.create_task(beat())
    try:
        return await standing_positions(client, fleet.enabled_names, seconds)
    finally:
        beating.cancel()


async def test_positions_of_standing_vehicles_are_collected_once_each() -> None:
    fleet = load_fleet(PAPER)
    positions = await collected(fleet)
    assert set(positions) == set(fleet.enabled_names)
    for name, reported in positions.items():
        assert len(reported) >= 2
        assert set(reported) == {fleet.vehicles[name].start_enu_m}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"is_airborne": True, "is_armed": True}, "mav1 flies: spots are surveyed while all stand"),
        ({"is_armed": True}, "mav1 is armed"),
        ({"is_position_valid": False}, "mav1 does not know well where it is"),
        ({"conditions": ("satellites lost",)}, "where it is: satellites lost"),
        ({"conditions": ("own position inaccurate",)}, "own position inaccurate"),
    ],
)
async def test_who_flies_is_armed_or_does_not_know_where_it_is_is_refused_at_once(
    changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        await collected(load_fleet(PAPER), seconds=60.0, **changes)
