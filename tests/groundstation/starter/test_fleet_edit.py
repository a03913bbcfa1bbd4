"""A fleet file that commands write again."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.starter.fleet_edit import write_changes, write_text
from onboard.config.fleet import load_fleet
from tests.groundstation.recorded import FLEET


def test_a_fleet_behind_a_link_is_written_where_it_is(tmp_path: Path) -> None:
    kept = tmp_path / "kept" / "lab.toml"
    kept.parent.mkdir()
    kept.write_text("old")
    kept.chmod(0o640)
    link = tmp_path / "fleet.toml"
    link.symlink_to(kept)
    write_text(link, "new")
    assert link.is_symlink()
    assert kept.read_text() == "new"
    assert kept.stat().st_mode & 0o777 == 0o640
    assert {path.name for path in kept.parent.iterdir()} == {"lab.toml"}


@pytest.mark.parametrize("line_ending", [b"\n", b"\r\n"])
def test_an_edit_changes_one_line_whatever_the_line_endings_are(
    tmp_path: Path, line_ending: bytes
) -> None:
    before = FLEET.read_bytes().replace(b"\n", line_ending).splitlines(keepends=True)
    path = tmp_path / "fleet.toml"
    path.write_bytes(b"".join(before))

    write_changes(path, {"fleet": {"safety_distance_m": 0.83}})

    after = path.read_bytes().splitlines(keepends=True)
    assert load_fleet(path).fleet.safety_distance_m == 0.83
    assert len(after) == len(before)
    assert [line for line in after if line not in before] == [
        b"safety_distance_m = 0.83" + line_ending
    ]
