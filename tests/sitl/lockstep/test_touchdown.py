"""How hard vehicles touch the ground by satellites, where PX4's own height errs by half a metre."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.lockstep.flight import Lockstep

ROOT = Path(__file__).resolve().parents[3]
FLEET = ROOT / "configs" / "fleets" / "px4-sitl.toml"


@pytest.fixture(scope="module")
def outdoors() -> FleetConfig:
    """Three vehicles that fly on PX4's own position, by satellites."""
    return load_fleet(FLEET)


def watch_thrust(flight: Lockstep) -> list[tuple[str, float]]:
    """Return a list that grows by a vehicle and its height whenever its thrust ends in the air."""
    motion = flight.simulation.emulator.world.vehicles.motion
    cuts: list[tuple[str, float]] = []

    def check(name: str, index: int, send: Any, setpoint: Any) -> None:
        if setpoint.thrust_frac == 0.0 and not motion["on_ground"][index]:
            cuts.append((name, -float(motion["position"][index, 2])))
        send(setpoint)

    for index, (name, shell) in enumerate(flight.agents.items()):
        shell.link.send_attitude = functools.partial(  # type: ignore[method-assign]
            check, name, index, shell.link.send_attitude
        )
    return cuts


# with the height as a sign of contact the vehicles of seed 8 fell from up to 0.36 m, with 2.3 m/s
@pytest.mark.long
@pytest.mark.parametrize(
    "seed", [8, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(9, 39))]
)
def test_by_satellites_thrust_ends_on_the_ground_only(lockstep, outdoors, seed: int) -> None:
    flight = lockstep(outdoors, seed=seed)
    cuts = watch_thrust(flight)
    flight.takeoff(1.5)
    flight.run(5.0)
    flight.land()
    assert not cuts
    assert len(flight.touchdowns) == 3
    assert not any(landing.is_blind or landing.is_by_px4 for landing in flight.touchdowns)
    assert max(touchdown.speed_m_s for touchdown in flight.touchdowns) < 0.8


@pytest.mark.parametrize("lifted_m", [0.03, pytest.param(0.06, marks=pytest.mark.long)])
def test_a_landing_in_the_first_centimetres_of_a_lift_off_sets_down_gently(
    lockstep, lifted_m: float
) -> None:
    # at the top of its short climb it is low and still for a moment, and fell from there
    fleet = load_fleet(ROOT / "configs" / "fleets" / "sih.toml")
    alone = {"mav0": fleet.vehicles["mav0"]}
    flight = lockstep(replace(fleet, vehicles=alone), seed=1)
    flight.ready()

    flight.start_soon(flight.client.order("takeoff mav0 1.0", 40.0))
    motion = flight.simulation.emulator.world.vehicles.motion
    while -motion["position"][0, 2] < lifted_m:
        flight.run(0.02)
    flight.land()
    assert [touchdown.speed_m_s < 0.5 for touchdown in flight.touchdowns] == [True]


def test_a_verdict_fails_with_a_vehicle_that_came_down_hard(
    lockstep, outdoors, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.fleet.touchdown.LIMIT_BY_SATELLITES_M_S", 0.2)
    one = {
        name: vehicle if name == "mav0" else replace(vehicle, enabled=False)
        for name, vehicle in outdoors.vehicles.items()
    }
    fleet = replace(outdoors, vehicles=one)
    steps = [{"do": "takeoff", "height_m": 1.0}, {"do": "land"}]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="hard.toml", fleet=fleet)

    flight = lockstep(fleet, folder=tmp_path, seed=1)
    flight.may_land_hard = True
    verdict = flight.fly(mission)
    assert not verdict.passed
    assert "mav0 touched down with" in verdict.summary
    assert [landing.vehicle for landing in verdict.touchdowns] == ["mav0"]
    assert flight.hard_touchdowns


@pytest.mark.long
@pytest.mark.parametrize("height_m", [-0.5, 0.01, 0.3])
def test_no_move_leads_into_the_ground_although_the_fence_reaches_deeper(
    lockstep, outdoors, height_m: float
) -> None:
    flight = lockstep(outdoors, seed=2)
    flight.takeoff(1.5, "mav0")
    result = flight.order(f"move mav0 -4 -4 {height_m}")["mav0"]
    assert not result.is_done
    assert "above the ground" in result.sentence
    assert "order land" in result.sentence
    flight.land("mav0")
