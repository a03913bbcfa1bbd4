"""A law of somebody's own: found, told apart by its source, or refused in words when the fleet file
is read.
"""

import re
import sys
from importlib import metadata
from pathlib import Path

import pytest

from groundstation.cli import main
from onboard.config.fleet import ConfigError, load_fleet
from onboard.config.law_import import find_own_law

FLEET = (Path(__file__).parents[3] / "configs/fleets/paper.toml").read_text(encoding="utf-8")
GOOD = "def law(memory, inputs):\n    return memory, inputs.baseline\n"


def written(folder, source, name="mine:law"):
    """A fleet file that names a law, and the law beside it."""
    (folder / "mine.py").write_text(source)
    path = folder / "fleet.toml"
    text = re.sub(
        r"\[law\]\n", f'[law]\nname = "{name}"\n', re.sub(r'(?m)^name = "covey".*\n', "", FLEET)
    )
    path.write_text(text if "[law]" in text else f'{text}\n[law]\nname = "{name}"\n')
    return str(path)


def test_a_law_beside_the_file_is_found_and_its_source_is_part_of_what_agents_compare(tmp_path):
    hashes = []
    for number, source in enumerate((GOOD, GOOD, GOOD + "# changed\n")):
        folder = tmp_path / str(number)
        folder.mkdir()
        fleet = load_fleet(written(folder, source))
        assert fleet.own_law is not None
        assert fleet.own_law.load()(3, type("Inputs", (), {"baseline": 7})) == (3, 7)
        assert fleet.with_law("covey").own_law is None
        hashes.append(fleet.config_hash)
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.parametrize(
    ("source", "name", "said"),
    [
        (GOOD, "nothing", "there are only covey, paper, off"),
        (GOOD, "coveyy", "Did you mean 'covey'?"),
        (GOOD, "mine:", "there are only covey, paper, off"),
        (GOOD, "../mine:law", "there are only covey, paper, off"),
        (GOOD, "mine.py:law", "write the module's name without .py: mine:law"),
        (GOOD, "mine.py", "write the module's name without .py: mine:law"),
        (GOOD, "./lab/mine.py:go", "write the module's name without .py: lab.mine:go"),
        (GOOD, "/home/me/mine.py:law", "write the module's name without .py: mine:law"),
        (GOOD, "nowhere:law", "Put nowhere.py there"),
        (
            "import no_such_package\n",
            "mine:law",
            "It imports no_such_package: install that package",
        ),
        ("1 / 0\n", "mine:law", "cannot be imported (ZeroDivisionError: division by zero)"),
        ("def law(:\n", "mine:law", "cannot be imported (SyntaxError"),
        ("raise SystemExit(2)\n", "mine:law", "cannot be imported (SystemExit: 2)"),
        (GOOD, "mine:other", "has no such name"),
        ("law = 3.0\n", "mine:law", "is no function"),
        ("def law(inputs):\n    return inputs\n", "mine:law", "which takes (inputs)"),
    ],
)
def test_what_is_no_law_is_refused_in_words(tmp_path, source, name, said):
    with pytest.raises(ConfigError) as error:
        load_fleet(written(tmp_path, source, name)).import_law()
    assert said in str(error.value)
    assert f"'law.name' is '{name}'" in str(error.value)


def test_a_law_is_found_by_its_entry_point(tmp_path, monkeypatch):
    entry = metadata.EntryPoint("mine", "mine:law", "covey.laws")
    monkeypatch.setattr("onboard.config.law_import.entry_points", lambda group: (entry,))
    law = load_fleet(written(tmp_path, GOOD, "mine")).own_law
    assert law is not None
    assert law.name == "mine"
    with pytest.raises(ConfigError, match="there are only covey, paper, off, mine"):
        load_fleet(written(tmp_path, GOOD, "yours"))


def test_loading_a_fleet_file_runs_nothing_of_the_law_that_it_names(tmp_path):
    marker = tmp_path / "ran"
    source = f"open({str(marker)!r}, 'w')\n{GOOD}"
    package = tmp_path / "strangers"
    package.mkdir()
    (package / "__init__.py").write_text(source)
    (package / "inner.py").write_text(source)
    folders = list(sys.path)

    for name in ("mine:law", "strangers.inner:law"):
        fleet = load_fleet(written(tmp_path, source, name))
        assert fleet.own_law is not None
        assert len(fleet.own_law.source_hash) == 12
        assert not marker.exists()
        assert sys.path == folders

    assert fleet.own_law is not None
    assert fleet.own_law.source == str(package / "inner.py")
    fleet.import_law()
    assert marker.exists()


def test_the_commands_that_fly_nothing_run_nothing_of_it(tmp_path, capsys):
    marker = tmp_path / "ran"
    path = written(tmp_path, f"open({str(marker)!r}, 'w')\n{GOOD}")
    for command in (
        ["check", path],
        ["check", path, "--json"],
        ["doctor", path],
        ["secure", path],
        ["keys", "list", path],
        ["agent", "deploy", "--print", "--fleet", path],
        ["init", str(tmp_path / "mission.toml"), "--fleet", path],
    ):
        main(command)
        assert not marker.exists(), command

    capsys.readouterr()
    main(["check", path])
    law = load_fleet(path).own_law
    assert law is not None
    page = "".join(capsys.readouterr().out.split())
    assert f"{tmp_path / 'mine.py'}(source{law.source_hash})" in page
    assert "Noneofitscodewasrunhere;--run-lawimportsit,withyourrights." in page

    assert main(["check", path, "--run-law"]) == 0
    page = "".join(capsys.readouterr().out.split())
    assert "Itwasimportedhere,because--run-lawwasgiven" in page
    assert marker.exists()


def test_a_check_that_runs_a_law_says_what_is_wrong_with_it(tmp_path, capsys):
    path = written(tmp_path, "1 / 0\n")
    assert main(["check", path]) == 0
    assert main(["check", path, "--run-law"]) == 2
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_a_law_in_folders_without_init_files_is_found_without_importing_them(tmp_path):
    inner = tmp_path / "bare_outer" / "bare_middle" / "bare_inner"
    inner.mkdir(parents=True)
    (inner / "mine.py").write_text(GOOD)
    law = find_own_law("bare_outer.bare_middle.bare_inner.mine:law", [str(tmp_path)], "a.toml")
    assert law.source == str(inner / "mine.py")
    assert "bare_outer" not in sys.modules
    assert callable(law.load())
