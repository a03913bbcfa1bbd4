"""Formations of a mission: before those of the fleet file, and gone with the next mission."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from groundstation.formations.slots import formation_names, formation_slots
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.mission_orders import MissionOrders
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.test_mission_orders import Worker

HOP: list[dict[str, Any]] = [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]
LINE = {"shape": "line", "spacing_m": 1.5}


def test_a_formation_of_a_mission_replaces_that_of_the_fleet_file(fleet: FleetConfig) -> None:
    mission = mission_from_mapping(
        {"schema": 1, "step": HOP, "formations": {"triangle": LINE}}, path="test.toml", fleet=fleet
    )
    assert formation_names(mission.fleet) == ("triangle",)
    heights = {north_m for _, north_m, _ in formation_slots(mission.fleet, "triangle").values()}
    assert heights == {0.0}
    assert "triangle" in fleet.formations


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
