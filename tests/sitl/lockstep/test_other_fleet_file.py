"""A ground whose fleet file lacks a vehicle that flies: it flies nobody, and lands its own."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from groundstation.alarms.alarm_table import GroundCondition
from groundstation.alarms.alarms import conditions
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig
from tests.sitl.lockstep.taking import second_ground

HOP = [{"do": "takeoff"}, {"do": "land"}]


def test_a_ground_that_lacks_the_third_flies_nobody_and_does_not_say_that_all_are_down(
    lockstep: Any, paper: FleetConfig
) -> None:
    flight = lockstep(paper, seed=3)
    vehicles = {name: paper.vehicles[name] for name in ("mav0", "mav1")}
    small = replace(paper, vehicles=vehicles, formations={})
    bob = second_ground(flight, "bob", small)
    flight.ready()
    assert flight.takeoff(1.0, "mav0,mav2")["mav2"].is_done

    bob.control.take()
    flight.run(1.0)
    flight.client.control.hand_over()
    flight.run(1.0)
    assert bob.control.is_operator
    now_ns = bob.now_ns()
    subjects = {
        (alarm.kind, alarm.subject)
        for alarm in conditions(bob.state, small, now_ns)
        if isinstance(alarm.kind, GroundCondition)
    }
    assert subjects == {
        (GroundCondition.UNLISTED, "mav2"),
        (GroundCondition.OTHER_FILE, "mav0"),
        (GroundCondition.OTHER_FILE, "mav1"),
    }

    for line in ("takeoff mav1", "move mav0 -1.5 0 1"):
        results = flight.wait_for(bob.order(line, 20.0))
        assert all("another fleet file" in result.sentence for result in results.values()), line
    mission = mission_from_mapping(
        {"schema": 1, "step": HOP, "expect": {"all_landed": True}}, path="hop.toml", fleet=small
    )

    results = flight.wait_for(bob.order("land all", 40.0))
    assert results["mav0"].is_done
    verdict = flight.wait_for(MissionRun(mission, bob).run())
    assert verdict.exit_status == 1
    assert "mav0, mav1 fly with another fleet file" in verdict.summary
    assert verdict.landed == {"mav0": True, "mav1": True, "mav2": False}

    assert flight.state.airborne_names == ("mav2",), "it flies on, and its own ground lands it"
    results = flight.wait_for(flight.client.order("land mav2", 40.0))
    assert results["mav2"].is_done
    flight.wait_for(bob.stop())
