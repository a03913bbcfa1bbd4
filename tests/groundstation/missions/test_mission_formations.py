"""Formations of a mission: before those of the fleet file, and gone with the next mission."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from groundstation.formations.slots import formation_names, formation_slots
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.mission_orders import MissionOrders
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.test_mission_orders import Worker

HOP: list[dict[str, Any]] = [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]
LINE = {"shape": "line", "spacing_m": 1.5}
TURN: list[dict[str, Any]] = [
    HOP[0],
    {
        "do": "fly_formation",
        "name": "ring",
        "position_enu_m": [0, 0, 1],
        "to": [{"turn_deg": 60.0, "duration_s": 30.0}],
    },
    {"do": "rotate", "angle_deg": 5.0},
    HOP[1],
]


def test_a_formation_of_a_mission_replaces_that_of_the_fleet_file(fleet: FleetConfig) -> None:
    mission = mission_from_mapping(
        {"schema": 1, "step": HOP, "formations": {"triangle": LINE}}, path="test.toml", fleet=fleet
    )
    assert formation_names(mission.fleet) == ("triangle",)
    heights = {north_m for _, north_m, _ in formation_slots(mission.fleet, "triangle").values()}
    assert heights == {0.0}
    assert mission.fleet.config_hash == fleet.config_hash, "no other file than the vehicles'"


async def test_the_next_mission_does_not_know_the_formations_of_the_one_before(
    fleet: FleetConfig, client: Any, tmp_path: Path
) -> None:
    with_ring = mission_from_mapping(
        {"schema": 1, "step": HOP, "formations": {"ring": {"shape": "circle"}}},
        path="test.toml",
        fleet=fleet,
    )
    assert (await MissionRun(with_ring, client).run()).passed
    assert formation_names(client.fleet) == ("triangle", "ring"), "orders after it still do"

    file = tmp_path / "to_ring.toml"
    file.write_text(
        'schema = 1\n[[step]]\ndo = "takeoff"\n[[step]]\ndo = "formation"\nname = "ring"\n'
        "position_enu_m = [0, 0, 1]\n",
        encoding="utf-8",
    )
    refusal = MissionOrders(client, Worker().begin).take(["mission", str(file)])
    assert "'ring' is no formation" in refusal
    plain = mission_from_mapping({"schema": 1, "step": HOP}, path="test.toml", fleet=fleet)
    assert (await MissionRun(plain, client).run()).passed
    assert formation_names(client.fleet) == ("triangle",)


async def test_an_order_that_was_planned_earlier_leaves_the_formation_as_it_is_now(
    client: Any,
) -> None:
    turned = client.plan("yaw mav0 45")
    await client.submit("formation triangle 2.5 0 0 1 turned 30")
    client.send(client.check_again(turned))
    held = client.plan("hold all").held
    assert held.rotation_deg == 30.0
    assert held.spacing_m == 2.5


def test_the_plan_rotates_the_formation_at_the_end_of_its_paths(fleet: FleetConfig) -> None:
    mission = mission_from_mapping(
        {"schema": 1, "step": TURN, "formations": {"ring": {"shape": "circle"}}},
        path="test.toml",
        fleet=fleet,
    )
    rotation = list(mission.course())[2]
    for name, (x, y, _) in rotation.positions.items():
        goal_x, goal_y, _ = rotation.goals[name]
        turned_deg = math.degrees(math.atan2(goal_y, goal_x) - math.atan2(y, x))
        assert math.remainder(turned_deg, 360.0) == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize("is_done", [True, False])
async def test_the_present_formation_is_the_one_at_the_end_of_paths_that_were_flown(
    fleet: FleetConfig, client: Any, bus: Any, is_done: bool
) -> None:
    def say(line: str) -> None:
        if line.startswith("goto") and not is_done:
            bus.accept_only = {"follow_path"}

    step = {**TURN[1], "timeout_s": 0.1}
    mission = mission_from_mapping(
        {"schema": 1, "step": [HOP[0], step], "formations": {"ring": {"shape": "circle"}}},
        path="test.toml",
        fleet=fleet,
    )
    await MissionRun(mission, client, say=say).run()
    held = client.plan("hold all").held
    if is_done:
        assert (held.name, held.rotation_deg) == ("ring", pytest.approx(60.0))
    else:
        assert (held.name, held.rotation_deg) == ("triangle", 0.0)
