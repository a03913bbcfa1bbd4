"""The copy of a fleet that is attacked, the packets of the attackers, and what is refused before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from groundstation.cli import main
from groundstation.commands.network.fleet_copy import SPARE, copy_of
from groundstation.commands.network.mavlink_frames import HEARTBEAT, SETUP_SIGNING, disarmed, packet, signing_key
from onboard.config.fleet import load_fleet

PAPER = Path(__file__).parents[4] / "configs" / "fleets" / "paper.toml"


def test_a_fleet_file_that_is_not_there_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["attack", "nowhere.toml"]) == 2
    assert "nowhere.toml" in capsys.readouterr().err


def test_a_fleet_of_one_vehicle_has_nobody_whose_key_could_be_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PAPER.read_text(encoding="utf-8")
    for name in ("mav1", "mav2"):
        text = text.replace(f"[vehicles.{name}]", f"[vehicles.{name}]\nenabled = false")
    (tmp_path / "one.toml").write_text(text, encoding="utf-8")
    assert main(["attack", str(tmp_path / "one.toml")]) == 2
    assert "needs two vehicles" in capsys.readouterr().err


def test_fleets_are_copied_with_a_vehicle_more_and_without_what_is_not_here(tmp_path: Path) -> None:
    for number, name in enumerate(("paper", "mixed", "twelve", "px4-sitl")):
        original = load_fleet(name)
        copy = copy_of(original, tmp_path / str(number), is_locked=name == "paper")
        assert copy.enabled_names == original.enabled_names[:6]
        assert SPARE in copy.vehicles
        assert copy.has_keys is (name == "paper")
        assert not copy.emulated_names or copy.emulated_names == original.emulated_names
        assert all("127.0.0.1" in vehicle.agent for vehicle in copy.vehicles.values())


def test_the_packets_of_an_attack_are_packets_of_mavlink() -> None:
    reader = common.MAVLink(None)
    kinds = [
        reader.parse_char(packet(number, payload, 7, 1)).get_type()
        for number, payload in ((HEARTBEAT, disarmed()), (SETUP_SIGNING, signing_key(7)))
    ]
    assert kinds == ["HEARTBEAT", "SETUP_SIGNING"]
