"""A spare that stands in for a vehicle flies its part of a mission, and lands on its spot.

The swap is ordered in the middle of a session: the fleet has flown already, and nothing restarts.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.verdict.verdict import Verdict
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from sitl.faults.catalogue import Fault
from sitl.lockstep.flight import Lockstep

SPOTS = {"mav0": (-1.5, 0.0), "mav1": (0.0, 0.0), "mav2": (1.5, 0.0), "mav7": (1.5, -3.0)}
GOALS = {"mav0": [-1.5, 1.5, 1.0], "mav1": [0.0, 1.5, 1.0], "mav2": [1.5, 1.5, 1.0]}


def fleet() -> FleetConfig:
    """Three vehicles, and a spare that stands by itself."""
    vehicles = {}
    for index, (name, (x, y)) in enumerate(SPOTS.items()):
        vehicles[name] = {
            "system_id": index + 1,
            "start_enu_m": [x, y, 0.0],
            "agent": f"tcp/127.0.0.1:{7460 + index}",
            "autopilot": f"udpin://127.0.0.1:{14540 + index}",
        }
    return fleet_from_mapping(
        {
            "schema": 1,
            "fleet": {
                "name": "swap",
                "geofence_m": {"x": [-5.0, 5.0], "y": [-5.0, 5.0], "z": [0.0, 3.0]},
            },
            "vehicles": vehicles,
        }
    )


def flown(flight: Lockstep, *ends: dict[str, object]) -> Verdict:
    """Fly a mission that knows nothing of spares."""
    steps = [
        {"do": "takeoff", "height_m": 1.0, "vehicles": "mav0,mav1,mav2"},
        {"do": "goto", "goals": GOALS},
        *ends,
    ]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="t", fleet=flight.config)
    return flight.fly(mission)


def spot_m(flight: Lockstep, name: str) -> tuple[float, float]:
    """Return where a vehicle stands by the ground truth."""
    truth = flight.state.vehicles[name].truth
    assert truth is not None
    return truth.position_enu_m[:2]


def carry(flight: Lockstep, name: str, x: float, y: float) -> None:
    """Carry a vehicle that stands to a place, at a walk."""
    index = flight.simulation.names.index(name)
    position_ned_m = flight.simulation.emulator.world.vehicles.states.position_ned_m
    begin = position_ned_m[index, :2].copy()
    way = np.array([y, x]) - begin

    for share in np.linspace(0.0, 1.0, 61):
        position_ned_m[index, :2] = begin + share * way
        flight.run(0.1)
    flight.run(3.0)


def test_a_spare_takes_off_although_the_mocap_still_sees_the_vehicle_that_was_carried_away(
    lockstep: Callable[..., Lockstep],
) -> None:
    """The agent of mav2 is dead, so its last position is the spot on which mav7 stands now."""
    flight = lockstep(fleet())
    flight.ready()
    flight.order("disable mav7")
    flight.inject(Fault("agent_dead", "mav2", at_s=flight.time_s))
    flight.run(3.0)

    carry(flight, "mav2", 3.5, -2.5)
    carry(flight, "mav7", *SPOTS["mav2"])
    assert flight.order("swap mav2 mav7")["mav7"].phase == "done"
    flight.run(5.0)
    for name in ("mav0", "mav1", "mav7"):
        telemetry = flight.state.vehicles[name].telemetry
        assert telemetry is not None
        assert not telemetry.not_ready, telemetry.not_ready
    assert flight.order("takeoff mav7 1")["mav7"].phase == "done"


@pytest.mark.long
def test_a_spare_flies_the_part_of_the_vehicle_whose_place_it_has(
    lockstep: Callable[..., Lockstep],
) -> None:
    flight = lockstep(fleet())
    flight.order("disable mav7")
    others_home: dict[str, object] = {"do": "home", "vehicles": "mav0,mav1"}
    lands_elsewhere = flown(flight, others_home, {"do": "land", "vehicles": "mav2"})
    assert lands_elsewhere.passed, lands_elsewhere.summary

    carry(flight, "mav2", 3.0, -1.5)

    refused = flight.order("swap mav2 mav7")["mav7"]
    assert refused.phase == "refused"
    assert "stands 3.0 m from the spot of mav2" in refused.sentence

    carry(flight, "mav7", *SPOTS["mav2"])
    results = flight.order("swap mav2 mav7")
    assert {name: result.phase for name, result in results.items()} == {
        "mav2": "done",
        "mav7": "done",
    }
    flight.run(0.5)  # until telemetry has told it
    left_at_m = spot_m(flight, "mav2")

    verdict = flown(flight, {"do": "home", "vehicles": "mav0,mav1,mav2"})
    assert verdict.passed, verdict.summary
    assert math.dist(spot_m(flight, "mav7"), SPOTS["mav2"]) < 0.3
    assert math.dist(spot_m(flight, "mav2"), left_at_m) < 0.05


@pytest.mark.long
@pytest.mark.parametrize(
    "dead",
    [("agent_dead",), ("agent_dead", "mocap_lost"), ("autopilot_hang", "mocap_lost")],
)
def test_a_spare_takes_off_where_a_vehicle_was_last_seen_that_nobody_sees_any_more(
    lockstep: Callable[..., Lockstep], dead: tuple[str, ...]
) -> None:
    """The battery of mav2 was taken out on its spot, and then mav2 was carried away."""
    flight = lockstep(fleet())
    flight.order("disable mav7")
    assert flown(flight, {"do": "home", "vehicles": "mav0,mav1,mav2"}).passed

    for fault in dead:
        flight.inject(Fault(fault, "mav2", at_s=flight.time_s))
    flight.run(3.0)
    carry(flight, "mav2", 4.0, -4.0)
    carry(flight, "mav7", *SPOTS["mav2"])
    assert flight.order("swap mav2 mav7")["mav7"].phase == "done"
    flight.run(0.5)

    verdict = flown(flight, {"do": "home", "vehicles": "mav0,mav1,mav2"})
    assert verdict.passed, verdict.summary
    assert math.dist(spot_m(flight, "mav7"), SPOTS["mav2"]) < 0.3
