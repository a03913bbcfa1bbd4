"""The copies of fleets that covey demo flies with keys of their own."""

from __future__ import annotations

from pathlib import Path

from groundstation.cli import main
from groundstation.commands.demo import locked_copy
from groundstation.missions.files import load_mission


def test_a_locked_copy_has_keys_of_its_own_and_finds_a_law_of_somebodys_own(tmp_path: Path) -> None:
    original = tmp_path / "lab"
    assert main(["init", str(original), "--vehicles", "3", "--companions", "here", "--law", "mine"]) == 0
    assert main(["secure", str(original / "fleet.toml")]) == 0
    keys = {path: path.read_bytes() for path in sorted((original / "keys").iterdir())}
    folder = tmp_path / "copy"
    folder.mkdir()
    mission = load_mission(str(original / "mission.toml"))
    copy = locked_copy(mission, folder).fleet
    assert copy.has_keys
    assert Path(copy.keys_folder) == folder / "keys"
    assert (folder / "keys" / "ca.pem").read_bytes() != (original / "keys" / "ca.pem").read_bytes()
    assert {path: path.read_bytes() for path in sorted((original / "keys").iterdir())} == keys
    assert copy.own_law is not None
    assert copy.own_law.source_hash == mission.fleet.own_law.source_hash
    taken = {vehicle.agent for vehicle in mission.fleet.vehicles.values()}
    assert not taken & {vehicle.agent for vehicle in copy.vehicles.values()}


def test_keys_in_a_folder_that_the_fleet_file_names_stay_there(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    assert main(["init", str(tmp_path / "lab"), "--vehicles", "2", "--companions", "here"]) == 0
    path = tmp_path / "lab" / "fleet.toml"
    path.write_text(path.read_text(encoding="utf-8").replace("[fleet]", f'[fleet]\nkeys = "{tmp_path}/elsewhere"'))
    assert main(["secure", str(path)]) == 0
    (tmp_path / "copy").mkdir()
    copy = locked_copy(load_mission(str(tmp_path / "lab" / "mission.toml")), tmp_path / "copy").fleet
    assert Path(copy.keys_folder) == tmp_path / "copy" / "keys"
