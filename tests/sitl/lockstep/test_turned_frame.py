"""A fleet whose motion capture is turned does not take off."""

from __future__ import annotations

import math
from typing import Any

import pytest

from groundstation.missions.api import NotReady
from onboard.config.fleet import FleetConfig
from sitl.lockstep.flight import Lockstep


def turn_places(flight: Lockstep, turn_deg: float) -> None:
    """Turn the places of all vehicles about the origin, clockwise: as the frame is turned."""
    cos = math.cos(math.radians(turn_deg))
    sin = math.sin(math.radians(turn_deg))
    for place_m in flight.simulation.emulator.world.vehicles.states.position_ned_m:
        north_m, east_m, _ = place_m.tolist()
        place_m[0] = cos * north_m - sin * east_m
        place_m[1] = cos * east_m + sin * north_m


@pytest.mark.long
def test_a_turn_that_no_single_vehicle_shows_refuses_the_take_off(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=1)
    turn_places(flight, 7.0)
    with pytest.raises(NotReady, match=r"The frame is turned by -7\.\d°"):
        flight.ready(20.0)


def test_the_same_fleet_that_stands_right_is_ready(lockstep: Any, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=1)
    turn_places(flight, 0.0)
    flight.ready(20.0)
