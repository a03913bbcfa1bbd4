"""A wheel, built from what the repository holds, flies the examples without the repository."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def run(folder: Path, *words: str, path: str) -> str:
    """Run ``python -S WORDS``: without the environment's own list of folders, where the repository
    may stand.
    """
    environment = {**os.environ, "PYTHONPATH": path, "COLUMNS": "120"}
    result = subprocess.run(
        [sys.executable, "-S", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    source = tmp_path_factory.mktemp("source")
    site = tmp_path_factory.mktemp("site")
    for name in ("onboard", "groundstation", "sitl", "configs"):
        shutil.copytree(
            ROOT / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)

    build = "from setuptools import build_meta; print(build_meta.build_wheel('.'))"
    wheel = run(source, "-c", build, path=sysconfig.get_path("purelib")).splitlines()[-1]

    with zipfile.ZipFile(source / wheel) as file:
        file.extractall(site)
    return site


def test_every_file_of_the_product_that_is_no_module_is_in_the_wheel(installed: Path) -> None:
    for name in ("onboard", "groundstation", "sitl", "configs"):
        for path in (ROOT / name).rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts and path.suffix != ".md":
                inside = path.relative_to(ROOT)
                if name == "configs":
                    inside = Path("onboard/config/examples") / path.relative_to(ROOT / "configs")
                assert (installed / inside).exists(), (
                    f"{inside} is missing: see package-data in pyproject.toml"
                )


@pytest.fixture(scope="module")
def path(installed: Path) -> str:
    return os.pathsep.join([str(installed), sysconfig.get_path("purelib")])


def test_the_examples_are_found_in_an_empty_folder(
    installed: Path, path: str, tmp_path: Path
) -> None:
    where = run(
        tmp_path, "-c", "import onboard, groundstation, sitl; print(onboard.__file__)", path=path
    )
    assert where.startswith(str(installed))

    out = run(
        tmp_path, "-m", "groundstation", "check", "sih", "configs/missions/paper.toml", path=path
    )
    assert out.count("This can be flown") == 2


@pytest.mark.long  # compiles the emulator, which costs a processor half a minute
@pytest.mark.parametrize("option", ["--headless", "--lockstep"])
def test_the_demo_flies_in_an_empty_folder(option: str, path: str, tmp_path: Path) -> None:
    out = run(tmp_path, "-m", "groundstation", "demo", option, path=path)
    assert "PASSED" in out
    assert (tmp_path / "flights").is_dir()
