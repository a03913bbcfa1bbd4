"""Scripts whose fleet has a spare in the place of another vehicle."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.missions.api import Fleet
from onboard.config.fleet import FleetConfig
from tests.groundstation.missions.test_swapped_vehicles import fleet_with_a_fourth_vehicle, tell


@pytest.fixture
def fleet() -> FleetConfig:
    return fleet_with_a_fourth_vehicle()


@pytest.mark.parametrize("assign", ["ids", "nearest"])
async def test_a_spare_flies_to_the_slot_of_the_vehicle_that_it_replaces(
    bus: Any, client: Any, assign: Any
) -> None:
    spot = client.fleet.vehicles["mav2"].start_enu_m
    await tell(client, bus, "mav2", disabled_by="olga", position_enu_m=(4.0, 4.0, 0.0))
    await tell(client, bus, "mav3", stands_in_for="mav2", position_enu_m=spot)

    script = Fleet(client)
    await script.takeoff(1.0)
    results = await script.formation("triangle", (0.0, 0.0, 1.0), assign=assign)
    assert {name: result.phase for name, result in results.items()} == {
        "mav0": "done",
        "mav1": "done",
        "mav3": "done",
    }
