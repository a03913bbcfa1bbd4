"""What the README shows can be typed as it stands."""

import re
from pathlib import Path

from groundstation.cli import main
from groundstation.mission_files.loading import load_mission

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_mission_of_the_readme_loads(tmp_path: Path) -> None:
    block = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert block is not None
    (tmp_path / "my_mission.py").write_text(block[1], encoding="utf-8")
    mission = load_mission(tmp_path / "my_mission.py")
    assert mission.is_python
    assert mission.expect.min_separation_m == 0.8


def test_every_file_that_the_readme_names_exists() -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


def test_every_file_that_the_guide_for_contributors_names_exists() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    paths = re.findall(r"`((?:onboard|groundstation|sitl|tests|docs)/[^` ]*)`", guide)
    assert len(paths) > 20
    for path in paths:
        assert (ROOT / path).exists(), path


def test_every_shipped_mission_is_valid() -> None:
    missions = sorted((ROOT / "configs" / "missions").iterdir())
    assert missions
    for path in missions:
        assert main(["check", str(path)]) == 0
