"""Every room has a door: a contract of import-linter names it."""

import re
import tomllib
from pathlib import Path

import pytest

from tests.architecture import form

ROOT = Path(__file__).parents[2]


def rooms(package: Path) -> list[str]:
    """The folders with Python files directly below a package, as dotted names."""
    return sorted({f"{package.name}.{path.parent.name}" for path in package.glob("*/*.py")})


def named_modules() -> set[str]:
    """The modules that a contract of pyproject.toml speaks of, outside its exceptions."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    names: set[str] = set()
    for contract in tomllib.loads(text)["tool"]["importlinter"]["contracts"]:
        names |= {*contract.get("source_modules", []), *contract.get("forbidden_modules", [])}
        for layer in contract.get("layers", []):
            for module in re.findall(r"[\w.]+", layer):
                containers = contract.get("containers")
                names |= {f"{one}.{module}" for one in containers} if containers else {module}
    return names


@pytest.mark.parametrize("package", form.PACKAGES)
def test_a_contract_names_every_room(package: str) -> None:
    missing = set(rooms(ROOT / package)) - named_modules()
    assert not missing, f"write {sorted(missing)} into a contract of pyproject.toml"


def test_a_room_that_no_contract_names_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "onboard" / "control").mkdir(parents=True)
    (tmp_path / "onboard" / "cellar").mkdir()
    (tmp_path / "onboard" / "control" / "pipeline.py").touch()
    (tmp_path / "onboard" / "cellar" / "__init__.py").touch()
    assert set(rooms(tmp_path / "onboard")) - named_modules() == {"onboard.cellar"}
