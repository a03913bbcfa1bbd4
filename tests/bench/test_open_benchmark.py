"""The leaderboard of the open benchmark: from files to a page."""

import json

import pytest

from onboard.config.fleet import ConfigError
from sitl.monte_carlo.open_benchmark import suite
from tests.bench import open_benchmark

FLIGHT = {
    "seed": 1000,
    "success": True,
    "reason": None,
    "violation_s": 0.0,
    "collision": False,
    "min_separation_m": 0.9,
    "ratio": 1.2,
    "straight_line_s": 10.0,
    "slew_rms_m_s3": 20.0,
    "energy_hover_s": 12.5,
}


def written(path, law, *, version="a", **changes):
    row = {
        "cell": f"{law} {changes.pop('source_hash', '')} circle",
        "stage": 0,
        "law": law,
        "physics": changes.pop("physics", "emulator"),
        "scene": "circle",
        "first_seed": 1000,
        "flights": [{**FLIGHT, **changes}],
        "busy_s": 0.0,
        "calls": 0,
    }
    head = {"open_benchmark": 1, "version": version}
    path.write_text(json.dumps(head) + "\n" + json.dumps(row) + "\n")
    return str(path)


def test_the_leaderboard_begins_with_the_best_and_is_written_into_its_page(tmp_path, capsys):
    page = tmp_path / "open-benchmark.md"
    page.write_text("before\n<!-- bench: leaderboard -->\nold\n<!-- end -->\nafter\n")
    files = [
        written(tmp_path / "bad.jsonl", "bad", violation_s=0.2, min_separation_m=0.4),
        written(tmp_path / "good.jsonl", "good"),
        written(tmp_path / "late.jsonl", "late", success=False, physics="rotorpy"),
    ]
    assert open_benchmark.main([*files, "--write", "--out", str(tmp_path)]) == 0

    lines = page.read_text().splitlines()
    assert lines[0] == "before"
    assert lines[-1] == "after"
    assert "old" not in lines
    order = [line.split("|")[1].strip() for line in lines if line.startswith("| `")]
    assert order == ["`good`", "`late` on rotorpy", "`bad`"] * 2
    assert "| `bad` | 0/1 |" in lines
    capsys.readouterr()


def test_a_law_that_was_edited_between_its_flights_has_a_line_for_each_source(tmp_path, capsys):
    files = [
        written(tmp_path / "first.jsonl", "mine:law", source_hash="aa", violation_s=0.2),
        written(tmp_path / "second.jsonl", "mine:law", source_hash="bb"),
        written(tmp_path / "other.jsonl", "orca", source_hash="cc", violation_s=0.3, seed=1),
    ]
    open_benchmark.main(files)
    lines = capsys.readouterr().out.splitlines()
    assert "| `mine:law` of source aa | 0/1 |" in lines
    assert "| `mine:law` of source bb | 1/1 |" in lines
    assert "| `orca` | 0/1 |" in lines


def test_files_of_different_versions_are_refused(tmp_path):
    one = written(tmp_path / "one.jsonl", "one")
    other = written(tmp_path / "other.jsonl", "other", version="b")
    with pytest.raises(ConfigError, match="different versions"):
        open_benchmark.main([one, other])


@pytest.mark.long
def test_scenes_are_drawn_with_walls_an_intruder_and_a_second_law(tmp_path, monkeypatch):
    names = ("corridor", "intruder", "mixed")
    shown = [scene for scene in suite.scenes() if scene.name in names]
    monkeypatch.setattr(suite, "scenes", lambda: shown)
    open_benchmark.draw_scenes(tmp_path / "scenes.png")
    assert (tmp_path / "scenes.png").read_bytes().startswith(b"\x89PNG")
