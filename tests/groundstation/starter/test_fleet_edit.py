"""A fleet file that commands write again."""

from __future__ import annotations

from pathlib import Path

from groundstation.starter.fleet_edit import write_text


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
