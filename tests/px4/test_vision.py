"""Real PX4s that fly by visual odometry, without motion capture and satellites.

Each one's frame begins on its own take-off spot, and PX4 does not know where on Earth that is.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from onboard.autopilot import Version
from onboard.config.fleet import FleetConfig
from tests.px4.build import Px4Build
from tests.px4.flight import Flight, break_in, end, fleet_of, flying, verdict, written
from tests.px4.table import Table

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

_PAPER = Path(__file__).parents[2] / "configs/missions/paper.toml"
_CROSSING_S = 3.0  # into the formation of the paper's mission
_PROMISE_M = 0.80
_ARRIVED_M = 0.6  # by truth, in all three axes: with the drift of odometry


def _mission() -> str:
    text = re.sub(r"(?m)^fleet = .*$", 'fleet = "fleet.toml"', _PAPER.read_text(encoding="utf-8"))
    return re.sub(r"(?m)^arrived_within_m = .*$", f"arrived_within_m = {_ARRIVED_M}", text)


def _by_vision(
    count: int, folder: Path, instances: list[int], version: Version | None
) -> FleetConfig:
    """Write the fleet file of configs/fleets/sih.toml, without its motion capture."""
    data = tomllib.loads(fleet_of(count, folder, instances, version).text)
    for table in data["types"].values():
        table["mocap_required"] = False
        table["px4_position"] = "vision"
    return written(data, folder, instances)


def test_the_papers_mission_is_flown_by_vision(
    build: Px4Build, table: Table, tmp_path: Path
) -> None:
    with flying(build, 3, tmp_path, _mission(), _by_vision) as flight:
        status = end(flight)
        judged = verdict(flight)
        distances_m = [arrival["distance_m"] or math.inf for arrival in judged["arrivals"]]
        closest_m = flight.closest_m()
        table.add(
            "three, the paper's mission by visual odometry",
            f"closest {closest_m:.2f} m, goals within {max(distances_m, default=math.inf):.2f} m",
        )
        assert status == 0, flight.log
        assert closest_m >= _PROMISE_M, flight.log


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("cut for 0.6 s", lambda flight: flight.cut_poses(0.6)),
        ("cut for 2 s", lambda flight: flight.cut_poses(2.0)),
        ("cut for good", lambda flight: flight.cut_poses(math.inf)),
        ("repeats itself", Flight.freeze_cameras),
        ("turned by 40 degrees at once", lambda flight: flight.turn_cameras(0.0)),
        ("turned by 40 degrees after 0.6 s without", lambda flight: flight.turn_cameras(0.6)),
    ],
)
def test_vehicles_with_bad_odometry_in_the_crossing_keep_the_promise_and_come_down(
    build: Px4Build,
    table: Table,
    tmp_path: Path,
    words: str,
    change: Callable[[Flight], None],
) -> None:
    """Odometry is lost, stands still, or its frame begins anew with another heading."""
    with flying(build, 3, tmp_path, _mission(), _by_vision) as flight:
        break_in(flight, "formation", _CROSSING_S, change)
        flight.wait_until_down()
        closest_m = flight.closest_m()
        down_s = flight.down_after_s()
        table.add(
            f"the odometry of all {words}",
            f"closest {closest_m:.2f} m, all down after {down_s:.1f} s",
        )
        assert math.isfinite(down_s), flight.log
        assert closest_m >= _PROMISE_M, flight.log
