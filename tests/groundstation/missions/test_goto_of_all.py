"""A goto that names no vehicles, while one that has a goal is out of service."""

from __future__ import annotations

import msgspec

from groundstation.mission_files.expected_course import resolved
from groundstation.orders.intents import Goto
from onboard.config.fleet import FleetConfig


def test_goals_of_a_vehicle_out_of_service_are_no_goals_that_vehicles_leaves_out(
    fleet: FleetConfig,
) -> None:
    disabled = msgspec.structs.replace(fleet.vehicles["mav1"], enabled=False)
    vehicles = {**fleet.vehicles, "mav1": disabled}
    fleet = msgspec.structs.replace(fleet, vehicles=vehicles)
    goals = {"mav0": (-2.0, 0.0, 1.0), "mav1": (0.0, 0.0, 1.0)}
    assert set(resolved(Goto(goals=goals), fleet).vehicles) == {"mav0", "mav1"}
