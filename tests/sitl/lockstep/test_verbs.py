"""The verbs of the mission API, flown: a goal for each, headings, turned formations, the way home,
conditions.
"""

from __future__ import annotations

import asyncio
import math
from pathlib import Path
from typing import Any

import pytest

from groundstation.missions import conditions
from groundstation.missions.api import Fleet, OrderFailed
from groundstation.missions.conditions import ConditionTimeout

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"


def _off_deg(fleet: Fleet, name: str, yaw_deg: float) -> float:
    return abs(math.remainder((fleet[name].yaw_deg or 0.0) - yaw_deg, 360.0))


@pytest.mark.long
def test_vehicles_change_places_turn_and_land_at_home(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=3)
    flight.takeoff(1.0)
    fleet = flight.fleet
    spots = {name: fleet[name].position_enu_m for name in fleet.names}
    goals = {"mav0": spots["mav1"], "mav1": spots["mav2"], "mav2": spots["mav0"]}
    results = flight.wait_for(fleet.go_to(goals, yaw_deg=90.0))
    assert all(result.is_done for result in results.values())
    assert flight.min_separation_m > 0.8
    for name, goal in goals.items():
        assert math.dist(fleet[name].position_enu_m, goal) < 0.2
        assert _off_deg(fleet, name, 90.0) < 12.0
    flight.wait_for(fleet["mav1"].yaw(-90.0))
    assert _off_deg(fleet, "mav1", -90.0) < 12.0
    assert _off_deg(fleet, "mav0", 90.0) < 12.0
    assert list(fleet["mav0"].neighbours) == sorted(
        fleet["mav0"].neighbours, key=fleet["mav0"].neighbours.get
    )
    assert fleet["mav0"].law is not None
    results = flight.wait_for(fleet.home())
    assert all(result.is_done for result in results.values()), results
    assert flight.min_separation_m > 0.8
    for name, vehicle in fleet.config.vehicles.items():
        truth = flight.state.vehicles[name].truth
        assert truth.is_on_ground
        assert math.dist(truth.position_enu_m[:2], vehicle.start_enu_m[:2]) < 0.25


@pytest.mark.long
def test_a_formation_is_turned_and_waypoints_are_flown_through(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=1)
    flight.takeoff(1.0)
    fleet = flight.fleet
    flight.wait_for(fleet.formation("triangle", (0.0, 0.0, 1.0), spacing_m=2.0))
    before = {name: fleet[name].position_enu_m for name in fleet.names}
    flight.wait_for(fleet.rotate(60.0))
    c = math.cos(math.radians(60.0))
    s = math.sin(math.radians(60.0))
    for name, (x, y, _) in before.items():
        assert math.dist(fleet[name].position_enu_m[:2], (c * x - s * y, s * x + c * y)) < 0.25
    x, y, z = fleet["mav0"].position_enu_m
    outward = (x / math.hypot(x, y), y / math.hypot(x, y))
    points = [(x + k * outward[0], y + k * outward[1], z) for k in (0.4, 0.8)]
    results = flight.wait_for(fleet.fly_through({"mav0": points}, speed_m_s=0.5))
    assert results["mav0"].is_done
    assert math.dist(fleet["mav0"].position_enu_m, points[-1]) < 0.2


@pytest.mark.long
def test_a_mission_waits_for_conditions_and_is_told_what_was_missing(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=2)
    fleet = flight.fleet
    with pytest.raises(
        ConditionTimeout, match=r"Not all in the air within 0\.5 s: on the ground: mav0, mav1, mav2"
    ):
        flight.wait_for(fleet.until(conditions.flying(), timeout_s=0.5))
    flight.takeoff(1.0)
    begin_s = flight.time_s

    async def lands_mav1() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fleet["mav1"].land())
            tasks.create_task(fleet.until(conditions.landed("mav1"), timeout_s=20.0))

    flight.wait_for(lands_mav1())
    assert 1.0 < flight.time_s - begin_s < 15.0
    assert fleet["mav0"].is_flying


@pytest.mark.long
def test_a_mission_reacts_to_a_battery_and_goes_on_without_the_vehicle(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=2)
    flight.takeoff(1.0)
    fleet = flight.fleet

    async def evacuate() -> None:
        fleet.leave_out("mav1")
        await fleet["mav1"].land()

    async def mission() -> None:
        async with fleet.reacting(conditions.battery_below(60.0, "mav1"), evacuate):
            await fleet.fault("battery_cell", "mav1", drop_pct=50.0)
            await fleet.wait(3.0)
            results = await fleet.hold()
            assert list(results) == ["mav0", "mav2"]

    flight.wait_for(mission())
    assert flight.state.vehicles["mav1"].truth.is_on_ground
    assert fleet["mav0"].is_flying


@pytest.mark.long
def test_a_reaction_may_end_what_is_done_now(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=2)
    flight.takeoff(1.0)
    fleet = flight.fleet

    async def mission() -> None:
        async with fleet.reacting(conditions.landed("mav0"), fleet.hold, ends=True):
            await fleet["mav0"].land()
            await fleet.wait(1000.0)

    begin_s = flight.time_s
    with pytest.raises(OrderFailed, match="mav0"):  # that is down and cannot hold
        flight.wait_for(mission())
    assert flight.time_s - begin_s < 60.0


@pytest.mark.long
def test_vehicles_follow_a_leader_and_hold_when_it_is_over(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=2)
    flight.takeoff(1.0)
    fleet = flight.fleet
    x, y, z = fleet["mav1"].position_enu_m

    async def mission() -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fleet["mav1"].move((x, y + 2.0, z)))
            results = await fleet.follow("mav1", 7.0)
        assert set(results) == {"mav0", "mav2"}
        assert all(result.is_done for result in results.values())

    flight.wait_for(mission())
    assert flight.min_separation_m > 0.8
    for name, side in (("mav0", -1.5), ("mav2", 1.5)):
        assert math.dist(fleet[name].position_enu_m, (x + side, y + 2.0, z)) < 0.35


@pytest.mark.long
def test_a_blocked_vehicle_says_what_stands_in_its_way(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=2)
    flight.takeoff(1.0)
    fleet = flight.fleet
    spots = {name: fleet[name].position_enu_m for name in fleet.names}
    (x, y, z) = spots["mav2"]
    (own_x, own_y, _) = spots["mav0"]
    between = spots["mav1"]
    assert math.dist(between[:2], (0.5 * (x + own_x), 0.5 * (y + own_y))) < 0.2
    beyond = (x + 1.1 * (x - own_x) / (math.dist(spots["mav0"], spots["mav2"])), y, z)
    with pytest.raises(
        OrderFailed, match=r"not finished within 1 s.*m from its goal\. In its way: mav1, \d"
    ) as caught:
        flight.wait_for(fleet["mav0"].go_to(beyond, timeout_s=1.0))
    assert "from the goal" in str(caught.value)


@pytest.mark.long
def test_a_px4_that_is_rebooted_between_flights_flies_again(lockstep: Any) -> None:
    """The emulated PX4 starts its clock anew, and cannot be armed before it has started."""
    flight = lockstep(PAPER, seed=2)
    flight.takeoff(0.8)
    with pytest.raises(OrderFailed, match="on the ground only"):
        flight.wait_for(flight.fleet.reboot("mav1"))
    assert flight.land()

    begin_s = flight.time_s
    results = flight.wait_for(flight.fleet.reboot("mav1"))
    assert results["mav1"].is_done
    assert flight.time_s - begin_s < 10.0
    px4 = flight.simulation.emulator.autopilots[flight.simulation.names.index("mav1")]
    assert px4.boot_time_s > begin_s
    flight.takeoff(0.8)
    assert flight.land()


@pytest.mark.parametrize("who", ["1,2", "all"])
def test_bring_home_leaves_out_a_spot_on_which_another_vehicle_stands(
    lockstep: Any, paper: Any, who: str
) -> None:
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    x, y, _ = paper.vehicles["mav1"].start_enu_m
    flight.order("move mav1 0 1.5 1.0", 20.0)
    flight.order(f"move mav0 {x} {y} 1.0", 20.0)
    flight.order("land mav0", 20.0)

    results = flight.order(f"bring home {who}", 30.0)
    assert all(results[name].is_done for name in ("mav1", "mav2")), results
    spots = {name: flight.state.telemetry_of(name).position_enu_m for name in ("mav1", "mav2")}
    assert spots["mav1"][:2] == pytest.approx((-1.5, -1.5), abs=0.3)
    assert spots["mav2"][:2] == pytest.approx((1.5, -1.5), abs=0.3)
