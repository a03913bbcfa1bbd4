"""Whether this computer and the network are fit: what is said of what was heard, and what of wrong
input.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import pytest

from groundstation.cli import main
from groundstation.client.ground_node import session
from groundstation.network import link_checks, network_interfaces
from groundstation.network import machine as machine_checks
from groundstation.network.diagnosis import Diagnosis, Grade, as_text
from groundstation.network.link_checks import Heard, judged
from groundstation.network.machine import machine
from groundstation.network.network_interfaces import interfaces
from onboard.bus.clock_sync import ClockNode
from onboard.bus.control_token import WATCHER
from onboard.config.fleet import load_fleet
from onboard.config.radio import RadioConfig
from tests.onboard.state_messages import state_message

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
SECONDS = 4.0


@pytest.fixture
def heard(make_telemetry: Any) -> Heard:
    """A fleet of which everything is as it should be; mav2 runs on another computer."""
    heard = Heard(nodes={"mav0", "mav1", "mav2"}, seconds=SECONDS)
    for name in ("mav0", "mav1", "mav2"):
        heard.first[name] = heard.last[name] = make_telemetry(name)
        heard.sequences[name] = set(range(100, 300))
        heard.ages_s[name] = [0.02] * 200
        heard.hosts[name] = 2 if name == "mav2" else 1
        for other in {"mav0", "mav1", "mav2"} - {name}:
            heard.ages_at_receiver_s[name, other] = [0.02] * 200
    heard.delays_ns = {  # clocks that are 5 s apart, and 4 ms there and back
        (one, other): 2_000_000 + (-1) ** (one == "mav2") * 5_000_000_000
        for one, other in (("mav0", "mav2"), ("mav2", "mav0"), ("mav1", "mav2"), ("mav2", "mav1"))
    }
    heard.clock_errors_s = {"mav2": 0.002}
    return heard


def _bad(heard: Heard) -> dict[str, Diagnosis]:
    return {one.name: one for one in judged(load_fleet(PAPER), heard) if one.grade is not Grade.OK}


def test_a_fleet_that_is_all_right_gets_no_advice(heard: Heard) -> None:
    fleet = load_fleet(PAPER)
    said = list(judged(fleet, heard))
    assert not _bad(heard)
    assert not [one for one in said if one.remedy]
    assert "4.0 ms at best, there and back." in as_text(said)


def test_a_big_fleet_that_sends_every_second_state_loses_none(heard: Heard) -> None:
    heard.state_ticks = 2
    for name in heard.sequences:
        heard.sequences[name] = set(range(100, 300, 2))
    assert not _bad(heard)


def test_a_fleet_that_expects_a_slow_radio_gets_no_advice_for_it(heard: Heard) -> None:
    fleet = load_fleet(PAPER)
    heard.ages_at_receiver_s["mav1", "mav2"] = [0.2] * 100
    assert "mav1 hears" in _bad(heard)
    slow = msgspec.structs.replace(fleet, radio=RadioConfig(expected_delay_s=0.18))
    assert not [one for one in judged(slow, heard) if one.grade is not Grade.OK]


def test_each_fault_of_a_link_is_said_with_a_remedy(heard: Heard, make_telemetry: Any) -> None:
    heard.sequences["mav0"] = set(range(100, 300, 3))
    heard.ages_at_receiver_s["mav1", "mav2"] = [0.02] * 100 + [0.3] * 100
    heard.last["mav1"] = make_telemetry("mav1", malformed_messages=7, refused_messages=2)
    heard.clock_errors_s["mav2"] = float("inf")
    heard.delays_ns["mav2", "mav1"] -= 10**12
    del heard.last["mav2"]
    found = _bad(heard)
    assert {name: one.grade for name, one in found.items()} == {
        "mav0": Grade.FAIL,
        "mav1 hears": Grade.FAIL,
        "mav1 did not use": Grade.WARN,
        "mav2": Grade.FAIL,
        "clock of mav2": Grade.WARN,
    }
    assert all(one.remedy for one in found.values())
    assert "66.3 % are lost" in found["mav0"].sentence
    assert "7 malformed, 2 refused" in found["mav1 did not use"].sentence
    assert "on the bus, but publishes nothing" in found["mav2"].sentence.lower()


def test_an_agent_that_restarts_meanwhile_has_lost_nothing(heard: Heard) -> None:
    fleet = load_fleet(PAPER)
    bus = session(fleet, WATCHER)
    clock = ClockNode(bus)
    heard.sequences["mav0"].clear()
    for boot_id, numbers in ((1, range(5000, 5050)), (2, range(100))):
        for number in numbers:
            state = state_message(vehicle="mav0", boot_id=boot_id, sequence=number)
            link_checks._note(heard, bus, clock, "mav0", state)

    (found,) = [one for one in judged(fleet, heard) if one.name == "mav0"]
    assert "0.0 % are lost" in found.sentence


def test_a_vehicle_that_falls_silent_meanwhile_is_said(heard: Heard) -> None:
    bus = session(load_fleet(PAPER), WATCHER)
    clock = ClockNode(bus)
    for name in heard.sequences:
        link_checks._note(heard, bus, clock, name, state_message(vehicle=name, sequence=300))
    heard.end_ns = heard.last_state_ns["mav2"] + 200_000_000
    heard.last_state_ns["mav1"] = heard.end_ns - 300_000_000

    found = _bad(heard)
    assert {name: one.grade for name, one in found.items()} == {"mav1": Grade.FAIL}
    assert "no state came in the last 0.3 s" in found["mav1"].sentence
    assert found["mav1"].remedy

    slow = msgspec.structs.replace(load_fleet(PAPER), radio=RadioConfig(expected_delay_s=0.18))
    assert not [one for one in judged(slow, heard) if one.grade is not Grade.OK]


def test_this_computer_is_looked_at_in_one_line_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = [one.name for one in [*machine(), *interfaces()]]
    assert {
        "Python",
        "libraries",
        "cores",
        "real-time priority",
        "timer",
        "clock",
        "disk",
        "disk's speed",
    } <= set(names)
    assert len(names) == len(set(names))


def test_an_entry_beside_the_interfaces_that_is_none_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bonding_masters").touch()
    monkeypatch.setattr(network_interfaces, "_INTERFACES", tmp_path)
    assert [one.name for one in interfaces()] == ["network"]


def test_the_governor_of_a_processor_that_is_switched_off_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in (0, 1):
        (tmp_path / f"cpu{number}" / "cpufreq").mkdir(parents=True)
    (tmp_path / "cpu0" / "cpufreq" / "scaling_governor").write_text("powersave\n")
    # Linux answers EBUSY for a processor that is off; a folder cannot be read as a file either
    (tmp_path / "cpu1" / "cpufreq" / "scaling_governor").mkdir()
    monkeypatch.setattr(machine_checks, "_GOVERNORS", tmp_path)

    (governor,) = [one for one in machine() if one.name == "CPU governor"]
    assert governor.sentence == "powersave."


def test_keys_that_do_not_fit_are_a_fail_and_json_has_an_object_for_each_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(PAPER, tmp_path / "fleet.toml")
    assert main(["secure", "fleet.toml"]) == 0
    capsys.readouterr()
    (tmp_path / "keys" / "mav1.key").chmod(0o600)
    (tmp_path / "keys" / "mav1.pem").write_bytes((tmp_path / "keys" / "mav2.pem").read_bytes())
    assert main(["doctor", "fleet.toml", "--json"]) == 1
    lines = {one["name"]: one for one in json.loads(capsys.readouterr().out)}
    assert lines["keys of mav1"]["grade"] == "FAIL"
    assert "mav2, ground" in lines["keys"]["sentence"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["doctor", "nowhere.toml"], "nowhere.toml"),
        (["doctor", "--network"], "--network needs the fleet file"),
        (["doctor", "paper", "--network", "--seconds", "0"], "give 1 to 600"),
    ],
)
def test_wrong_input_is_said_before_anything_is_done(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert said in capsys.readouterr().err
