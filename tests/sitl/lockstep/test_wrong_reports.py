"""Somebody plays a vehicle's PX4: single wrong reports end no flight, true ones count soon."""

from __future__ import annotations

import functools
from typing import Any

import pytest

from onboard.config.fleet import FleetConfig
from onboard.flight.types import FlightStep
from onboard.safety.failsafe_table import Condition, Situation
from sitl.lockstep.campaign.breaking import WRONG_REPORTS, wrong_report
from sitl.lockstep.flight import Lockstep
from sitl.px4.modes import Mode


def _hover(lockstep: Any, fleet: FleetConfig, seed: int) -> Lockstep:
    flight = lockstep(fleet, seed=seed)
    flight.takeoff(1.0)
    return flight


@pytest.mark.long
@pytest.mark.failsafe("PX4's reports contradict each other", step="flying")
def test_no_single_wrong_report_ends_a_flight_and_each_contradiction_is_noticed(
    lockstep, paper: FleetConfig
) -> None:
    flight = _hover(lockstep, paper, 5)
    reports = list(WRONG_REPORTS)
    for first in range(0, len(reports), len(flight.agents)):
        of_vehicle = dict(zip(flight.agents, reports[first:], strict=False))
        for vehicle, report in of_vehicle.items():
            wrong_report(report)(flight, vehicle)
        flight.run(1.2)
        for vehicle, report in of_vehicle.items():
            is_noticed = (
                Condition.REPORTS_CONTRADICT in flight.agents[vehicle].core.failsafes.conditions
            )
            assert is_noticed or report == "on the ground", report
        flight.run(2.2)
        for vehicle, report in of_vehicle.items():
            assert flight.agents[vehicle].core.flight.step is FlightStep.ARRIVED, report
    told = {event.code for event in flight.events if event.severity in ("warning", "critical")}
    assert told == {"reports-contradict"}
    assert all(result.is_done for result in flight.land().values())


@pytest.mark.long
@pytest.mark.failsafe("PX4's reports contradict each other for long", step="flying")
def test_two_senders_of_one_system_id_end_the_flight_by_a_landing_under_the_law(
    lockstep, paper: FleetConfig
) -> None:
    flight = _hover(lockstep, paper, 6)
    core = flight.agents["mav1"].core
    for number in range(8):
        flight.at(
            flight.time_s + 0.6 * number,
            functools.partial(wrong_report("another mode"), flight, "mav1"),
        )
    flight.run(5.0)
    assert core.flight.step in (FlightStep.DESCENT, FlightStep.CONTACT, FlightStep.LANDED)
    assert "contradict" in core.flight.reason


@pytest.mark.long
def test_what_is_true_is_believed_soon(lockstep, paper: FleetConfig) -> None:
    delays_s = {}
    for code, mode in (("left-offboard", Mode.LOITER), ("disarmed", None)):
        flight = _hover(lockstep, paper, 7)
        emulator = flight.simulation.emulator
        heard_ns = flight.agents["mav1"].link.snapshot().heartbeat_ns
        # just after the next heartbeat
        flight.run(1.01 - 1e-9 * (flight.simulation.now_ns - heard_ns))
        px4 = emulator.autopilots[1]
        begin_ns = flight.simulation.now_ns
        if mode is None:
            px4.request_arm(emulator.time_s, False, 21196.0)
        else:
            px4.request(emulator.time_s, mode)
        flight.run(2.5)
        (said_ns,) = [
            event.stamp_ns
            for event in flight.events
            if event.vehicle == "mav1" and event.code == code
        ]
        delays_s[code] = 1e-9 * (said_ns - begin_ns)
        assert flight.agents["mav1"].core.flight.situation in (Situation.SILENT, Situation.GROUND)
    print(
        ", ".join(
            f"{code} after {delay_s:.2f} s at the latest" for code, delay_s in delays_s.items()
        )
    )
    assert max(delays_s.values()) < 1.2
