"""The provenance names every file that decides where vehicles fly."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.evidence.provenance import provenance
from groundstation.mission_files.loading import load_mission
from onboard.config.fleet import load_fleet
from tests.groundstation.recorded import FLEET

PATH = "t,x,y,z\n0,0,0,1\n5,{x},0,1\n"
MISSION = """schema = 1
fleet = "fleet.toml"
[formations.own]
shape = "csv"
file = "slots.csv"
[[step]]
do = "takeoff"
[[step]]
do = "follow_path"
paths = {mav0 = "a/p.csv", mav1 = "b/p.csv"}
[[step]]
do = "land"
"""
SLOTS = "x,y\n0,0\n2,0\n4,{y}\n"


def files_of(folder: Path) -> dict[str, str]:
    mission = load_mission(str(folder / "show.toml"), load_fleet(folder / "fleet.toml"))
    return provenance(folder / "fleet.toml", Path(mission.path), mission).files


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shape = '\n[formations.drawn]\nshape = "csv"\nfile = "fleet_slots.csv"\n'
    (tmp_path / "fleet.toml").write_text(FLEET.read_text() + shape)
    (tmp_path / "show.toml").write_text(MISSION)
    for name, x in (("a", 1), ("b", 2)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "p.csv").write_text(PATH.format(x=x))
    for name in ("slots.csv", "fleet_slots.csv"):
        (tmp_path / name).write_text(SLOTS.format(y=0))
    return tmp_path


def test_files_of_paths_and_formations_are_named_each_once(folder: Path) -> None:
    names = ["a/p.csv", "b/p.csv", "fleet.toml", "fleet_slots.csv", "show.toml", "slots.csv"]
    assert sorted(files_of(folder)) == names


@pytest.mark.parametrize("name", ["a/p.csv", "b/p.csv", "slots.csv", "fleet_slots.csv"])
def test_another_file_changes_its_hash_only(folder: Path, name: str) -> None:
    before = files_of(folder)
    text = (folder / name).read_text()
    (folder / name).write_text(text.replace("5,", "6,").replace("4,0", "4,1"))
    after = files_of(folder)
    assert {key for key in before if before[key] != after[key]} == {name}
