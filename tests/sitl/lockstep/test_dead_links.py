"""Orders to a vehicle whose agent has lost its link to PX4: the ground watches for the effect."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from groundstation.client.direct_mavlink import DirectCommand
from groundstation.mission_files.loading import load_mission
from groundstation.missions.api import OrderFailed
from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import Fault
from sitl.px4.modes import Mode
from sitl.px4.sticks import CENTRED

MISSION = Path(__file__).parents[3] / "configs" / "missions" / "paper.toml"


@pytest.mark.long
def test_a_kill_over_a_dead_link_between_agent_and_px4_stops_the_motors_within_two_seconds(
    lockstep, paper: FleetConfig
) -> None:
    for direction, link_age_s in (("both", 0.0), ("both", 1.5), ("in", 0.0)):
        flight = lockstep(paper, seed=4)
        flight.wait_for(flight.fleet.ready())
        flight.wait_for(flight.fleet.takeoff(1.0))
        parameters: dict[str, float | str] = {
            "share": 1.0,
            "direction": direction,
            "link": "companion",
        }
        flight.inject(Fault("link_loss", "mav1", at_s=flight.time_s, parameters=parameters))
        flight.run(0.1 + link_age_s)
        px4 = flight.simulation.emulator.autopilots[flight.simulation.names.index("mav1")]
        case = f"{direction}, link dead for {link_age_s} s"
        assert px4.is_armed, case
        order = flight.wait_for(flight.client.submit("kill mav1"))
        flight.run(2.0)
        assert not px4.is_armed, case
        results = flight.wait_for(order.wait(10.0))
        assert results["mav1"].is_done, (case, results)
        assert "straight to PX4" in results["mav1"].sentence, case


@pytest.mark.long
def test_the_vehicle_whose_px4_died_is_named_first_and_for_that(
    lockstep, paper: FleetConfig
) -> None:
    """A simulated PX4 takes its vehicle's poses along, which are missed before PX4 is."""
    flight = lockstep(paper, seed=3)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))

    def die() -> None:
        for name in ("autopilot_hang", "mocap_lost"):
            flight.inject(Fault(name, "mav1", at_s=flight.time_s))

    flight.at(flight.time_s + 1.0, die)
    with pytest.raises(OrderFailed) as failed:
        flight.wait_for(flight.fleet.formation("triangle", (0.0, 1.2, 1.0), timeout_s=12.0))
    said = str(failed.value)
    assert "failed. mav1 failed: PX4 silent: no more setpoints are sent." in said
    assert "Neighbour silent and not seen (mav1)" in said


@pytest.mark.long
def test_a_mission_lands_a_vehicle_whose_px4_died_within_four_seconds(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    died_s = 13.0
    fault = Fault("autopilot_hang", "mav1", at_s=died_s)
    flight.at(died_s, lambda: flight.inject(fault))
    assert not flight.fly(load_mission(MISSION)).passed

    direct = [
        logged.received_ns
        for logged in flight.client.state.events
        if "land goes straight to PX4" in logged.event.sentence
    ]
    begin_ns = flight.simulation.clock_ns() - round(1e9 * flight.time_s)
    assert (direct[0] - begin_ns) * 1e-9 < died_s + 4.0
    gaps_s = [(later - earlier) * 1e-9 for earlier, later in pairwise(direct)]
    assert min(gaps_s, default=60.0) > 8.0, "each waits for PX4's own answer"


def test_the_direct_path_sees_that_a_px4_that_has_restarted_is_disarmed(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=4)
    flight.takeoff(1.0)
    system_id = paper.vehicles["mav1"].system_id
    begin_s = flight.time_s
    flight.inject(Fault("autopilot_reboot", "mav1", at_s=begin_s + 1.0))
    land = DirectCommand("", system_id, "land", watch_s=20.0)
    answer = flight.wait_for(flight._send_directly(land))
    assert answer.is_disarmed
    assert flight.time_s - begin_s < 5.0


def test_a_descent_without_a_position_is_landed_though_sticks_are_heard(
    lockstep, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=4)
    flight.takeoff(1.0)
    system_id = paper.vehicles["mav1"].system_id
    px4 = flight.simulation.emulator.autopilots[flight.simulation.names.index("mav1")]
    px4.mode = Mode.DESCEND  # shown as AUTO.LAND
    px4.take_sticks(flight.time_s, CENTRED)
    land = DirectCommand("", system_id, "land", spares_pilot=True)
    answer = flight.wait_for(flight._send_directly(land))
    assert not answer.is_flown_by_hand


@pytest.mark.parametrize(
    ("name", "parameters", "has_answered", "is_obeyed"),
    [
        ("link_loss", {"direction": "both"}, False, False),
        ("link_loss", {"direction": "out"}, False, True),
        ("link_loss", {"direction": "both", "share": 0.5}, True, True),  # it is repeated
        ("link_delay", {"direction": "in", "delay_s": 1.0}, True, True),
    ],
)
def test_a_fault_of_the_ground_link_disturbs_the_direct_path(
    lockstep,
    paper: FleetConfig,
    name: str,
    parameters: dict[str, float | str],
    has_answered: bool,
    is_obeyed: bool,
) -> None:
    flight = lockstep(paper, seed=4)
    flight.ready()
    fault = Fault(name, "mav1", at_s=flight.time_s, parameters={"link": "ground", **parameters})
    flight.inject(fault)
    flight.run(0.1)
    px4 = flight.simulation.emulator.autopilots[flight.simulation.names.index("mav1")]
    assert px4.mode is not Mode.LAND

    system_id = paper.vehicles["mav1"].system_id
    land = DirectCommand("udpout://px4", system_id, "land", timeout_s=2.0)
    begin_s = flight.time_s
    answer = flight.wait_for(flight._send_directly(land))
    assert answer.has_answered is has_answered
    assert answer.is_accepted is has_answered
    assert (px4.mode is Mode.LAND) is is_obeyed
    if not has_answered:
        assert answer.sentence == "PX4 did not answer at udpout://px4 within 2 s either"
    if name == "link_delay":
        assert flight.time_s - begin_s >= 1.0
