"""``[corrections]`` of a fleet file: what is refused, and what counts for the fleet's hash."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping

CONFIGS = Path(__file__).parents[3] / "configs"
NTRIP: dict[str, object] = {
    "source": "ntrip",
    "address": "caster.example.org:2101",
    "mountpoint": "NEAR_1",
    "user": "somebody",
}


def fleet_with(table: dict[str, object] | None, *, by_satellites: bool = True) -> FleetConfig:
    data = tomllib.loads((CONFIGS / "fleets" / "paper.toml").read_text())

    for table_of_type in data["types"].values():
        table_of_type["mocap_required"] = not by_satellites
    if table is not None:
        data["corrections"] = table

    return fleet_from_mapping(data, path="fleet.toml")


@pytest.mark.parametrize(
    "table",
    [
        NTRIP,
        {**NTRIP, "tls": True, "password_file": "ntrip.txt", "fix": "rtk_fixed"},
        {"source": "tcp", "address": "[fe80::1]:2101"},
        {"source": "serial", "address": "/dev/ttyUSB0", "baud": 57600},
        {"source": "file", "address": "base.rtcm3", "base_deg": [47.4, 8.5], "base_height_m": 500},
    ],
)
def test_tables_that_are_right(table):
    fleet = fleet_with(table)
    assert fleet.corrections is not None
    assert all(fleet.takes_corrections(vehicle) for vehicle in fleet.vehicles.values())


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ({"address": "x:1"}, "source"),
        ({"source": "radio", "address": "x:1"}, "source"),
        ({"source": "tcp", "address": "somewhere"}, "needs HOST:PORT"),
        ({"source": "tcp", "address": "somewhere:70000"}, "needs HOST:PORT"),
        ({"source": "tcp", "address": "a b:2101"}, "needs HOST:PORT"),
        ({"source": "file", "address": " "}, "'corrections.address' is empty"),
        ({"source": "serial", "address": "/dev/ttyUSB0", "baud": 1234}, "it is one of 9600"),
        ({"source": "tcp", "address": "x:1", "mountpoint": "A"}, "Only ntrip has it"),
        ({**NTRIP, "mountpoint": ""}, "as the caster's list names it"),
        ({**NTRIP, "mountpoint": "A HTTP/1.1\r\nX: y"}, "as the caster's list names it"),
        ({**NTRIP, "user": "a:b"}, "signs without blanks and colons"),
        ({**NTRIP, "password": "secret"}, "unknown key"),
        ({**NTRIP, "sends_position": True}, "give fleet.origin"),
        ({**NTRIP, "max_age_s": 0.5}, "corrections.max_age_s"),
        ({**NTRIP, "max_base_km": 1000.0}, "corrections.max_base_km"),
        ({**NTRIP, "base_tolerance_m": 0.0}, "corrections.base_tolerance_m"),
        ({**NTRIP, "hold_accuracy_m": 5.0}, "corrections.hold_accuracy_m"),
        ({**NTRIP, "base_deg": [91.0, 0.0]}, "no place on Earth"),
        ({**NTRIP, "base_height_m": 400.0}, "without 'corrections.base_deg'"),
        ({**NTRIP, "fix": "fixed"}, "fix"),
    ],
)
def test_mistakes_are_refused_in_a_sentence(table, sentence):
    with pytest.raises(ConfigError, match=sentence.replace("(", r"\(")) as refused:
        fleet_with(table)
    assert "fleet.toml" in str(refused.value)


def test_a_fleet_without_satellites_has_no_use_for_corrections():
    with pytest.raises(ConfigError, match="this fleet has none"):
        fleet_with(NTRIP, by_satellites=False)


def test_no_vehicle_is_named_as_the_node_of_corrections():
    data = tomllib.loads((CONFIGS / "fleets" / "paper.toml").read_text())
    data["vehicles"]["corrections"] = data["vehicles"].pop("mav0")
    for table in data.get("formations", {}).values():
        if "mav0" in table:
            table["corrections"] = table.pop("mav0")
    for port, vehicle in enumerate(data["vehicles"].values(), start=7460):
        vehicle["agent"] = f"quic/127.0.0.1:{port}"

    with pytest.raises(ConfigError, match="'corrections'"):
        fleet_from_mapping(data, path="fleet.toml")


def test_only_what_vehicles_judge_by_is_in_the_hash_of_the_fleet():
    without = fleet_with(None).config_hash
    ntrip = fleet_with(NTRIP).config_hash
    elsewhere: dict[str, object] = {"source": "tcp", "address": "x:1"}

    assert without != ntrip
    assert fleet_with(elsewhere).config_hash == ntrip
    assert fleet_with({**elsewhere, "fix": "rtk_fixed"}).config_hash != ntrip
    assert fleet_with({**elsewhere, "base_deg": [47.0, 8.0]}).config_hash != ntrip
