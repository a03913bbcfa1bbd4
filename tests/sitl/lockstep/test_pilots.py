"""A pilot who takes a vehicle from a mission keeps it, and the mission does not wait for him."""

from __future__ import annotations

from typing import Any

import pytest

from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import Fault
from tests.sitl.lockstep.taking import (
    MOMENTS,
    at_moment,
    crossing,
    landings_by_command,
    pilot_takes,
    second_ground,
)

SENTENCE = "mav1 is flown by hand: `land mav1` takes it."


def _height_m(flight: Any, name: str) -> float:
    return float(flight.state.vehicles[name].truth.position_enu_m[2])


def _deafen_agent(flight: Any, at_s: float) -> None:
    """Lose whatever the PX4 of mav1 sends to its agent, from a time on."""
    parameters: dict[str, float | str] = {"direction": "out", "link": "companion"}
    flight.inject(Fault("link_loss", "mav1", at_s=at_s, parameters=parameters))


# mode and moment; the other pairs of each are flown by make test-long
DAILY = {
    ("posctl", "crossing"),
}
PAIRS = [
    pytest.param(mode, moment, marks=() if (mode, moment) in DAILY else pytest.mark.long)
    for mode in ("posctl", "altctl", "stabilized")
    for moment in MOMENTS
]


@pytest.mark.parametrize(("mode", "moment"), PAIRS)
def test_a_pilot_with_sticks_keeps_his_vehicle(
    lockstep: Any, paper: FleetConfig, mode: str, moment: str
) -> None:
    flight = lockstep(paper, seed=3)
    # in STABILIZED his throttle stick, in the middle, is less than this vehicle hovers with
    flight.may_land_hard = mode == "stabilized"
    taken_s: list[float] = []

    def take() -> None:
        taken_s.append(flight.time_s)
        pilot_takes(flight, mode)

    at_moment(flight, moment, take)
    landings_s = landings_by_command(flight)
    verdict = flight.fly(crossing(paper))

    assert not verdict.passed
    assert "A pilot has mav1." in verdict.summary
    assert flight.time_s - taken_s[0] < 25.0, "the mission does not wait for him"
    assert landings_s == []
    for name in ("mav0", "mav2"):
        assert verdict.landed[name], name

    flight.run(5.0)
    assert landings_s == []
    mode_now = flight.state.vehicles["mav1"].telemetry.mode
    assert mode_now == mode.upper()
    assert flight.state.vehicles["mav1"].telemetry.is_flown_by_hand


@pytest.mark.long
@pytest.mark.parametrize(
    ("mode", "moment"),
    [("hold", "crossing"), ("posctl", "hover")],
)
def test_without_sticks_it_is_landed_as_ever(
    lockstep: Any, paper: FleetConfig, mode: str, moment: str
) -> None:
    flight = lockstep(paper, seed=3)
    at_moment(flight, moment, lambda: pilot_takes(flight, mode, "silent"))
    verdict = flight.fly(crossing(paper))
    assert all(verdict.landed.values())


@pytest.mark.long
def test_a_hold_by_the_transmitter_is_landed_though_its_sticks_are_heard(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    at_moment(flight, "crossing", lambda: pilot_takes(flight, "hold"))
    verdict = flight.fly(crossing(paper))
    assert all(verdict.landed.values())


@pytest.mark.long
def test_land_all_of_a_person_spares_the_pilot_and_his_name_does_not(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))
    pilot_takes(flight)
    flight.run(2.0)

    results = flight.wait_for(flight.client.order("land all", 40.0))
    assert results["mav1"].phase == "refused"
    assert results["mav1"].sentence == SENTENCE
    assert results["mav0"].is_done
    assert results["mav2"].is_done
    assert _height_m(flight, "mav1") > 0.5

    # The pilot lets go of his sticks' switch: the landing by name is PX4's.
    results = flight.wait_for(flight.client.order("land mav1", 40.0))
    assert results["mav1"].is_done
    assert _height_m(flight, "mav1") < 0.1


@pytest.mark.parametrize("known_s", [1.0, pytest.param(-0.3, marks=pytest.mark.long)])
def test_no_agent_lands_a_pilot_of_whom_it_cannot_hear(
    lockstep: Any, paper: FleetConfig, known_s: float
) -> None:
    """PX4 still hears its agent. The agent hears PX4 no more from 1 s after the pilot takes the
    vehicle, or from 0.3 s before.
    """
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    landings_s = landings_by_command(flight)
    _deafen_agent(flight, flight.time_s + 0.5 + known_s)
    flight.at(flight.time_s + 0.5, lambda: pilot_takes(flight))
    flight.run(3.0)

    results = flight.wait_for(flight.client.order("land all", 40.0))
    assert SENTENCE in results["mav1"].sentence
    assert results["mav0"].is_done
    assert landings_s == []
    assert _height_m(flight, "mav1") > 0.5


@pytest.mark.long
def test_the_name_of_a_vehicle_lands_it_though_its_agent_does_not_hear_px4(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    pilot_takes(flight)
    flight.run(2.0)
    _deafen_agent(flight, flight.time_s)
    flight.run(2.0)

    flight.wait_for(flight.client.order("land mav1", 40.0))
    assert _height_m(flight, "mav1") < 0.1


@pytest.mark.long
def test_a_script_and_a_mission_are_refused_as_land_all_is(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))
    pilot_takes(flight)
    flight.run(2.0)
    landings_s = landings_by_command(flight)
    with pytest.raises(RuntimeError, match="is flown by hand"):
        flight.wait_for(flight.fleet["mav1"].land())
    assert flight.wait_for(flight.fleet.land_all(10.0))
    flight.wait_for(flight.fleet.leave("land"))
    assert landings_s == []
    assert _height_m(flight, "mav1") > 0.5


@pytest.mark.long
def test_two_pilots_at_once_and_a_mission_that_goes_on_without_them(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)

    def take() -> None:
        pilot_takes(flight, "posctl", name="mav1")
        pilot_takes(flight, "altctl", name="mav2")

    at_moment(flight, "crossing", take)
    verdict = flight.fly(crossing(paper, on_failure={"do": "go_on"}))
    assert verdict.landed == {"mav0": True, "mav1": False, "mav2": False}
    assert [step.step for step in verdict.steps][-1].startswith("land")


@pytest.mark.long
def test_two_pilots_end_a_mission_in_one_sentence(lockstep: Any, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=3)

    def take() -> None:
        pilot_takes(flight, "posctl", name="mav1")
        pilot_takes(flight, "altctl", name="mav2")

    at_moment(flight, "hover", take)
    verdict = flight.fly(crossing(paper))
    assert "Pilots have mav1, mav2." in verdict.summary
    assert verdict.landed["mav0"]


@pytest.mark.long
def test_a_lost_ground_lands_all_but_the_pilot(lockstep: Any, paper: FleetConfig) -> None:
    flight = lockstep(paper, seed=3)
    landings_s = landings_by_command(flight)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))
    pilot_takes(flight)
    flight.run(2.0)
    flight.bus.partition(["ground-1"])
    flight.run(paper.fleet.ground_lost_land_s + 15.0)
    flight.bus.heal()
    flight.run(2.0)
    assert landings_s == []
    assert _height_m(flight, "mav1") > 0.5
    assert _height_m(flight, "mav0") < 0.1


@pytest.mark.long
def test_past_a_dead_agent_a_mission_asks_px4_for_its_pilot(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))
    pilot_takes(flight)
    flight.run(2.0)
    flight.agents["mav1"].kill()
    flight.run(3.0)
    px4 = flight.simulation.emulator.autopilots[1]
    results = flight.wait_for(flight.client.order("land all", 40.0))
    assert results["mav1"].phase == "refused"
    assert results["mav1"].sentence.endswith(SENTENCE)
    assert px4.mode.name == "POSCTL"

    results = flight.wait_for(flight.client.order("land mav1", 60.0))
    assert results["mav1"].is_done
    assert not px4.is_armed


@pytest.mark.long
def test_another_ground_that_lands_all_spares_the_pilot_too(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    ada = second_ground(flight)
    flight.wait_for(flight.fleet.ready())
    flight.wait_for(flight.fleet.takeoff(1.0))
    pilot_takes(flight, "stabilized")
    flight.run(2.0)
    results = flight.wait_for(ada.order("land", 40.0))
    assert results["mav1"].sentence == SENTENCE
    assert results["mav0"].is_done
    flight.wait_for(ada.stop())
