"""Copies of fleets with a law of somebody's own and keys, in other folders."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.flights.demo_missions import locked_copy
from groundstation.flights.identification_flight import one_alone
from groundstation.formations.slots import formation_files
from groundstation.mission_files.loading import load_mission
from onboard.config.fleet import load_fleet


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A folder with a locked fleet, a mission and a law."""
    folder = tmp_path / "lab"
    assert (
        main(["init", str(folder), "--vehicles", "3", "--companions", "here", "--law", "mine"]) == 0
    )
    assert main(["secure", str(folder / "fleet.toml")]) == 0
    return folder


def test_a_locked_copy_has_keys_of_its_own_and_finds_a_law_of_somebodys_own(
    lab: Path, tmp_path: Path
) -> None:
    keys = {path: path.read_bytes() for path in sorted((lab / "keys").iterdir())}
    folder = tmp_path / "copy"
    folder.mkdir()
    mission = load_mission(str(lab / "mission.toml"))
    copy = locked_copy(mission, folder).fleet
    assert copy.has_keys
    assert Path(copy.keys_folder) == folder / "keys"
    assert (folder / "keys" / "ca.pem").read_bytes() != (lab / "keys" / "ca.pem").read_bytes()
    assert {path: path.read_bytes() for path in sorted((lab / "keys").iterdir())} == keys
    assert copy.own_law is not None
    assert mission.fleet.own_law is not None
    assert copy.own_law.source_hash == mission.fleet.own_law.source_hash
    taken = {vehicle.agent for vehicle in mission.fleet.vehicles.values()}
    assert not taken & {vehicle.agent for vehicle in copy.vehicles.values()}


def test_keys_in_a_folder_that_the_fleet_file_names_stay_there(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    assert main(["init", str(tmp_path / "lab"), "--vehicles", "2", "--companions", "here"]) == 0
    path = tmp_path / "lab" / "fleet.toml"
    path.write_text(
        path.read_text(encoding="utf-8").replace("[fleet]", '[fleet]\nkeys = "elsewhere/keys"')
    )
    assert main(["secure", str(path)]) == 0
    (tmp_path / "copy").mkdir()
    copy = locked_copy(
        load_mission(str(tmp_path / "lab" / "mission.toml")), tmp_path / "copy"
    ).fleet
    assert Path(copy.keys_folder) == tmp_path / "copy" / "keys"


def test_a_fleet_that_the_demos_mission_does_not_fit_needs_a_mission(lab: Path, capsys) -> None:
    assert main(["demo", "--headless", "--fleet", str(lab / "fleet.toml")]) == 2
    assert f"covey demo --fleet {lab}/fleet.toml --mission FILE" in capsys.readouterr().err.replace(
        "\n", " "
    )


def test_one_vehicle_alone_and_an_imported_show_find_law_and_keys_where_they_are(
    lab: Path, tmp_path: Path
) -> None:
    fleet = load_fleet(lab / "fleet.toml")
    (tmp_path / "alone").mkdir()
    (tmp_path / "alone" / "fleet.toml").write_text(one_alone(fleet, "mav1"), encoding="utf-8")
    (tmp_path / "csvs").mkdir()
    for x_m in (0, 2):
        rows = "".join(f"{t},{x_m},{1.0 if 2 <= t <= 8 else 0.0},1.0\n" for t in range(11))
        (tmp_path / "csvs" / f"drone{x_m}.csv").write_text("t,x,y,z\n" + rows, encoding="utf-8")
    command = [
        "import",
        str(tmp_path / "csvs"),
        "--out",
        str(tmp_path / "show"),
        "--fleet",
        str(lab / "fleet.toml"),
    ]
    assert main(command) == 0
    for copied in ("alone", "show"):
        copy = load_fleet(tmp_path / copied / "fleet.toml")
        assert copy.own_law is not None
        assert fleet.own_law is not None
        assert copy.own_law.source_hash == fleet.own_law.source_hash
        assert Path(copy.keys_folder) == lab / "keys"
    assert load_fleet(tmp_path / "alone" / "fleet.toml").enabled_names == ("mav1",)


def _mission_beside_fleets(root: Path) -> Path:
    """Write a mission and, in the folder beside the mission's, its fleet; return the mission."""
    fleets = root / "fleets"
    missions = root / "missions"
    fleets.mkdir(parents=True)
    missions.mkdir()
    (fleets / "paper.toml").write_text(Path("configs/fleets/paper.toml").read_text())
    mission = missions / "paper.toml"
    mission.write_text(Path("configs/missions/paper.toml").read_text())
    return mission


def test_a_fleet_in_a_neighbouring_folder_is_named_by_its_plain_path(tmp_path: Path) -> None:
    mission = load_mission(str(_mission_beside_fleets(tmp_path)))
    assert mission.fleet.path == str(tmp_path / "fleets" / "paper.toml")


def test_a_fleet_beside_the_target_of_a_link_is_still_found(tmp_path: Path) -> None:
    mission = _mission_beside_fleets(tmp_path / "real")
    (tmp_path / "link").symlink_to(mission.parent)
    linked = load_mission(str(tmp_path / "link" / mission.name))
    assert linked.fleet.path == str(tmp_path / "link" / ".." / "fleets" / "paper.toml")


def test_refusals_name_the_file_of_the_user_and_the_option_and_no_copy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["init", "lab", "--vehicles", "2", "--companions", "here", "--law", "mine"]
    assert main(words) == 0
    capsys.readouterr()
    flight = ["fly", "lab/mission.toml", "--headless"]

    assert main([*flight, "--lockstep", "--law", "cove"]) == 2
    assert "covey: --law is 'cove', but there are only covey," in capsys.readouterr().err

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        text = Path("lab/fleet.toml").read_text(encoding="utf-8")
        endpoint = f'[fleet]\nsimulator = "tcp/127.0.0.1:{port}"'
        Path("lab/busy.toml").write_text(text.replace("[fleet]", endpoint), encoding="utf-8")
        assert main([*flight, "--sitl", "--fleet", "lab/busy.toml"]) == 2
    assert "covey: lab/busy.toml: 'fleet.simulator'" in capsys.readouterr().err

    Path("lab/mine.py").write_text("import nothing_of_this_name\n", encoding="utf-8")
    assert main([*flight, "--lockstep"]) == 2
    refusal = capsys.readouterr().err
    assert "covey: lab/fleet.toml: 'law.name' is 'mine:law'" in refusal
    assert "flights" not in refusal


def test_a_copy_finds_the_files_of_its_formations(tmp_path: Path) -> None:
    assert main(["init", str(tmp_path), "--vehicles", "2", "--companions", "here"]) == 0
    path = tmp_path / "fleet.toml"
    text = path.read_text(encoding="utf-8")
    path.write_text(f'{text}\n[formations.pair]\nshape = "csv"\nfile = "pair.csv"\n', "utf-8")
    (tmp_path / "pair.csv").write_text("x,y,z\n0,0,0\n2,0,0\n", encoding="utf-8")

    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "fleet.toml").write_text(one_alone(load_fleet(path), "mav1"), "utf-8")
    copy = load_fleet(tmp_path / "copy" / "fleet.toml")
    assert formation_files(copy) == [str(tmp_path / "pair.csv")]
