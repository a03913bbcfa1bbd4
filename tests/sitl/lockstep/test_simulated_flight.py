"""Simulated flights: orders that take the fleet, and settings that came after the end."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.flights.recorded_flight import open_recorded
from groundstation.flights.simulation_settings import SimulationSettings
from groundstation.mission_files.mission import Mission
from groundstation.recording.record_list import written_verdict
from sitl.lockstep import command
from sitl.lockstep.flight import Lockstep
from sitl.lockstep.reflight import fly_again, record_digests
from sitl.lockstep.simulated_flight import longest_stay_s, never_happened, open_flight
from sitl.lockstep.state_digest import DIGEST_EVERY_S

_LANDED = {"mav0": True, "mav1": True, "mav2": True}
_HOVER = """\
schema = 1
fleet = "paper"

[[step]]
do = "takeoff"
height_m = 0.5

[[step]]
do = "wait"
duration_s = 9.0
"""


def test_a_flight_goes_on_after_an_order_that_takes_the_fleet_until_all_are_down(
    tmp_path: Path,
) -> None:
    mission = tmp_path / "hover.toml"
    mission.write_text(_HOVER)
    folder = tmp_path / "flight"
    words = ["fly", str(mission), "--lockstep", "--record", str(folder)]
    assert main([*words, "--order", "6 hold all", "--order", "7 land all"]) == 1
    assert written_verdict(folder)["landed"] == _LANDED

    reflown = fly_again(open_recorded(folder))
    assert reflown.verdict.landed == _LANDED


def test_a_flight_whose_vehicles_hold_for_ever_ends(hop: Mission) -> None:
    said: list[str] = []
    settings = SimulationSettings(orders=("6 hold all",))
    with open_flight(hop.fleet, settings, None, say=said.append) as flight:
        verdict = flight.fly(hop, stays=True, longest_stay_s=1.0)
    assert not any(verdict.landed.values())
    assert said[-1].endswith("has had the fleet for 1 s, and is not waited for any longer.")


def test_a_flight_stays_for_longer_than_its_last_order_takes() -> None:
    assert longest_stay_s(SimulationSettings()) == 60.0
    assert longest_stay_s(SimulationSettings(orders=("40.5 land all", "3 hold all"))) == 100.5


_INTERRUPTED = """\
import asyncio
import signal

FLEET = "paper"


async def mission(fleet):
    signal.raise_signal(signal.SIGHUP)
    await asyncio.sleep(1.0)
"""


@pytest.fixture
def ignored() -> Iterator[None]:
    """SIGTERM and SIGHUP do nothing, unless a flight handles them: they would end the tests."""
    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, lambda *_: None) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_closed_terminal_lands_a_flight_as_ctrl_c_does(ignored: None, tmp_path: Path) -> None:
    mission = tmp_path / "interrupted.py"
    mission.write_text(_INTERRUPTED)
    folder = tmp_path / "flight"
    assert main(["fly", str(mission), "--lockstep", "--record", str(folder)]) == 130
    assert written_verdict(folder)["summary"].startswith("INTERRUPTED: ")

    again = tmp_path / "again"
    what_if = ["--what-if", "wind=1,0", "--record", str(again)]
    assert main(["replay", str(folder), *what_if]) == 130
    assert written_verdict(again)["summary"].startswith("INTERRUPTED: ")


def test_a_flight_that_is_ended_while_it_starts_ends_as_by_ctrl_c(
    ignored: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def end(*_: object) -> None:
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(command, "open_flight", end)
    assert main(["fly", "paper", "--lockstep", "--record", str(tmp_path / "flight")]) == 130


def test_a_flight_whose_folder_vanishes_goes_on_and_its_record_has_failed(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    with Lockstep("paper", folder=folder) as flight:
        record_digests(flight)
        shutil.rmtree(folder)
        flight.run(2.0 * DIGEST_EVERY_S + 1.0)

        assert flight.record is not None
        assert flight.record.end.failure is not None
        assert f"{folder} cannot be written" in flight.record.end.failure
        assert [event.code for event in flight.events].count("record_failed") == 1


def test_what_was_planned_for_after_the_end_is_said() -> None:
    settings = SimulationSettings(
        faults=("mav1 motor_weak at=12", "mav0 motor_weak at=90"),
        orders=("3 hold all", "40.5 land all"),
        changes=("200 wind=3,0",),
    )
    assert never_happened(settings, 40.0) == [
        "The fault 'mav0 motor_weak at=90' never happened: the flight ended at 40.0 s.",
        "The order '40.5 land all' never happened: the flight ended at 40.0 s.",
        "The change '200 wind=3,0' never happened: the flight ended at 40.0 s.",
    ]
    assert never_happened(settings, 300.0) == []
