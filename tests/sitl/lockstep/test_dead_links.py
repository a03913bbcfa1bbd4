"""Orders to a vehicle whose agent has lost its link to PX4: the ground watches for the effect."""

from __future__ import annotations

from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import Fault


def test_a_kill_over_a_dead_link_between_agent_and_px4_stops_the_motors_within_two_seconds(
    lockstep, paper: FleetConfig
) -> None:
    for direction, link_age_s in (("both", 0.0), ("both", 1.5), ("in", 0.0)):
        flight = lockstep(paper, seed=4)
        flight.wait_for(flight.fleet.ready())
        flight.wait_for(flight.fleet.takeoff(1.0))
        parameters = {"share": 1.0, "direction": direction, "link": "companion"}
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
