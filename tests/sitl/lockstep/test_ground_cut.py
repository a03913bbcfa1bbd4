"""A ground that loses only its own link, or has a slow one, sends no landing past the agents."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.missions.conditions import reached
from groundstation.orders.intents import Move
from groundstation.paths.pieces import through
from onboard.config.fleet import FleetConfig, load_fleet
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.flight import GROUND, Lockstep
from tests.sitl.lockstep.conftest import ROOT

MIN_SEPARATION_M = 0.80
SIX = ("mav0", "mav1", "mav2", "mav3", "mav4", "mav5")


@pytest.fixture
def six() -> FleetConfig:
    """Six of the eight vehicles, in two rows."""
    fleet = load_fleet(ROOT / "configs" / "fleets" / "eight.toml")
    vehicles = {
        name: replace(vehicle, enabled=name in SIX) for name, vehicle in fleet.vehicles.items()
    }
    return replace(fleet, vehicles=vehicles)


def crossing(fleet: FleetConfig) -> Mission:
    """Return a mission in which the first changes places with the last, and so on."""
    names = fleet.enabled_names
    goals = {}
    for name, other in zip(names, reversed(names), strict=True):
        east_m, north_m, _ = fleet.vehicles[other].start_enu_m
        goals[name] = [east_m, north_m, 1.0]
    return mission_from_mapping(
        {
            "schema": 1,
            "step": [
                {"do": "takeoff", "height_m": 1.0},
                {"do": "goto", "goals": goals},
                {"do": "land"},
            ],
            "expect": {"min_separation_m": MIN_SEPARATION_M, "all_landed": True},
        },
        path="crossing.toml",
        fleet=fleet,
    )


def sentences(flight: Lockstep, code: str) -> list[str]:
    """Return what the events of one kind say, oldest first."""
    return [event.sentence for event in flight.events if event.code == code]


def cut_ground(flight: Lockstep, at_s: float, duration_s: float) -> None:
    """Cut the ground from everybody for a time."""
    flight.at(at_s, lambda: flight.bus.partition([GROUND]))
    flight.at(at_s + duration_s, flight.bus.heal)


@pytest.mark.parametrize(
    ("at_s", "duration_s"),
    [
        (13.0, 3.0),
        pytest.param(9.0, 8.0, marks=pytest.mark.long),
        pytest.param(9.0, 3.0, marks=pytest.mark.long),
        pytest.param(13.0, 8.0, marks=pytest.mark.long),
    ],
)
def test_a_mission_whose_ground_loses_its_own_link_waits_and_goes_on(
    lockstep, paper: FleetConfig, at_s: float, duration_s: float
) -> None:
    flight = lockstep(paper, seed=1)
    cut_ground(flight, at_s, duration_s)

    verdict = flight.fly(crossing(paper))

    assert verdict.exit_status == 0, verdict.summary
    assert flight.min_separation_m > MIN_SEPARATION_M
    assert sentences(flight, "direct_command") == []
    (lost,) = sentences(flight, "own_link_lost")
    assert "This ground hears no vehicle: its own link is down" in lost
    assert "land them in 58 s, or within seconds if they are cut off from their poses." in lost
    (back,) = sentences(flight, "own_link_back")
    assert back.endswith(": the mission goes on.")


def test_a_ground_behind_a_dead_router_does_not_promise_that_the_flight_goes_on(
    lockstep, paper: FleetConfig
) -> None:
    """The agents are cut off from each other and from their poses, and land."""
    routed = replace(paper, fleet=replace(paper.fleet, routers=("tcp/127.0.0.1:7447",)))
    flight = lockstep(routed, seed=1)
    flight.at(9.0, lambda: flight.bus.partition([GROUND], *([name] for name in routed.vehicles)))
    flight.at(12.0, flight.bus.heal)

    verdict = flight.fly(crossing(routed))

    (lost,) = sentences(flight, "own_link_lost")
    assert "its own link is down, or the fleet's routers are" in lost
    assert "or within seconds if they are cut off from each other or their poses." in lost
    (back,) = sentences(flight, "own_link_back")
    assert back.endswith("Meanwhile the flight has ended for mav0, mav1, mav2.")
    assert "Own position lost (by dead reckoning): landing." in verdict.summary


def test_vehicles_that_fly_home_while_the_ground_is_cut_have_ended_no_flight_by_themselves(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=1)
    cut_ground(flight, 12.0, 8.0)
    steps = [{"do": "takeoff", "height_m": 1.0}, {"do": "home"}]
    mission = mission_from_mapping({"schema": 1, "step": steps}, path="home.toml", fleet=paper)

    verdict = flight.fly(mission)

    assert verdict.exit_status == 0, verdict.summary
    (back,) = sentences(flight, "own_link_back")
    assert back.endswith(": the mission goes on.")


@pytest.mark.long
@pytest.mark.parametrize(
    ("at_s", "duration_s"), [(10.0, 8.0), pytest.param(12.0, 3.0, marks=pytest.mark.long)]
)
def test_six_that_cross_while_the_ground_is_cut_keep_their_distance(
    lockstep, six: FleetConfig, at_s: float, duration_s: float
) -> None:
    flight = lockstep(six, seed=1)
    cut_ground(flight, at_s, duration_s)

    verdict = flight.fly(crossing(six))

    assert flight.min_separation_m > MIN_SEPARATION_M
    assert sentences(flight, "direct_command") == []
    assert all(verdict.landed.values())


@pytest.mark.long
def test_a_step_that_begins_without_an_answer_ends_in_a_landing_through_the_agents(
    lockstep, paper: FleetConfig
) -> None:
    """The crossing ends while the ground is cut: the landing after it waits for the link."""
    flight = lockstep(paper, seed=1)
    cut_ground(flight, 14.8, 8.0)

    verdict = flight.fly(crossing(paper))

    assert flight.min_separation_m > MIN_SEPARATION_M
    assert sentences(flight, "direct_command") == []
    assert all(verdict.landed.values())


@pytest.mark.long
def test_when_the_link_stays_lost_the_agents_land_and_the_mission_says_so(
    lockstep, paper: FleetConfig
) -> None:
    impatient = replace(paper, fleet=replace(paper.fleet, ground_lost_land_s=15.0))
    flight = lockstep(impatient, seed=1)
    flight.at(9.0, lambda: flight.bus.partition([GROUND]))
    flight.at(45.0, flight.bus.heal)

    verdict = flight.fly(crossing(impatient))

    assert verdict.exit_status == 1
    assert "This ground has heard no vehicle for 15 s: its own link is down" in verdict.summary
    lost = sentences(flight, "own_link_lost")
    assert "The agents land in" in lost[1]
    assert flight.min_separation_m > MIN_SEPARATION_M
    assert sentences(flight, "direct_command") == []
    assert all(verdict.landed.values())


@pytest.mark.long
def test_a_landing_of_all_over_a_link_that_answers_after_a_while_stays_with_the_agents(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    for name in paper.enabled_names:
        flight.bus.set_link(GROUND, name, BusSettings(delay_s=0.2))

    results = flight.order("land all")

    assert all(result.is_done for result in results.values()), results
    assert sentences(flight, "direct_command") == []
    repeated = sentences(flight, "land_repeated")
    assert len(repeated) == 3
    assert all("land is sent again, and goes straight to PX4 in" in line for line in repeated)


@pytest.mark.parametrize(
    ("names", "delay_s", "loss"),
    [
        (("mav1",), 0.7, 0.0),
        pytest.param(("mav0", "mav1", "mav2"), 0.3, 0.3, marks=pytest.mark.long),
        pytest.param(("mav2",), 0.3, 0.6, marks=pytest.mark.long),
    ],
)
def test_a_mission_lands_who_is_heard_and_answers_late_through_its_agent(
    lockstep, paper: FleetConfig, names: tuple[str, ...], delay_s: float, loss: float
) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    for name in names:
        flight.bus.set_link(GROUND, name, BusSettings(delay_s=delay_s, loss=loss))

    results = flight.wait_for(flight.fleet.land())

    assert all(result.is_done for result in results.values()), results
    assert sentences(flight, "direct_command") == []


@pytest.mark.long
def test_a_person_who_lands_all_without_a_link_reaches_px4_after_a_second(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    flight.bus.partition([GROUND])
    begin_s = flight.time_s
    order = flight.wait_for(flight.client.submit("land all"))

    flight.run(0.95)
    assert len(sentences(flight, "land_repeated")) == 3
    assert sentences(flight, "direct_command") == []

    flight.run(0.15)
    assert len(sentences(flight, "direct_command")) == 3
    results = flight.wait_for(order.wait(30.0))
    assert all(result.is_done for result in results.values()), results
    assert flight.time_s > begin_s + 1.0


@pytest.mark.long
def test_followers_follow_again_when_the_link_is_back(lockstep, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    cut_ground(flight, flight.time_s + 2.0, 3.0)

    results = flight.wait_for(flight.fleet.follow("mav0", 8.0))

    assert [result.phase for result in results.values()] == ["done", "done"]
    assert len(sentences(flight, "own_link_back")) == 1


@pytest.mark.parametrize(
    "after_s",
    [
        0.4,
        pytest.param(0.0, marks=pytest.mark.long),
        pytest.param(2.0, marks=pytest.mark.long),
    ],
)
def test_paths_are_flown_when_the_link_is_back(
    lockstep, paper: FleetConfig, after_s: float
) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    paths = {}
    for name in paper.enabled_names:
        x, y, z = flight.fleet[name].position_enu_m
        points = np.array([[x, y, z + up_m, 0.0] for up_m in (0.0, 0.2, 0.4)])
        paths[name] = through(points, np.full(3, 0.2))
    cut_ground(flight, flight.time_s + after_s, 3.0)

    results = flight.wait_for(flight.fleet.follow_path(paths))

    assert [result.phase for result in results.values()] == ["done", "done", "done"]


@pytest.mark.long
def test_a_wait_does_not_count_the_time_without_a_link(lockstep, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    x, y, z = flight.fleet["mav0"].position_enu_m
    goal = (x, y, z + 0.8)
    cut_ground(flight, flight.time_s + 2.0, 5.0)

    async def wait() -> None:
        move = Move(vehicles=("mav0",), position_enu_m=goal, duration_s=4.0)
        await flight.client.submit(move, is_by_mission=True)
        await flight.fleet.until(reached({"mav0": goal}), timeout_s=5.0)

    flight.wait_for(wait())


def test_a_landing_sent_just_after_the_last_message_is_sent_again(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    flight.bus.partition([GROUND])
    flight.at(flight.time_s + 3.0, flight.bus.heal)

    results = flight.wait_for(flight.fleet.land())

    assert all(result.is_done for result in results.values()), results
    assert sentences(flight, "direct_command") == []
