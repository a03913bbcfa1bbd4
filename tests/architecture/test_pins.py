"""What is installed is what was tested: every library is pinned, with the hashes of its files."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SYSTEMS = [
    {
        "python_version": python,
        "python_full_version": f"{python}.9",
        "platform_machine": machine,
        "sys_platform": "linux",
    }
    for python in ("3.11", "3.12", "3.13")
    for machine in ("x86_64", "aarch64")
]


def pinned(extra: str) -> list[Requirement]:
    """Read the pins of one extra; each has hashes."""
    text = (ROOT / "requirements" / f"{extra}.txt").read_text(encoding="utf-8")
    lines = [line.partition("#")[0].strip() for line in text.replace("\\\n", " ").splitlines()]
    pins = []
    for line in filter(None, lines):
        name, *hashes = re.split(r"\s+--hash=", line)
        assert hashes, f"{name} has no hash"
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", value) for value in hashes), name
        pins.append(Requirement(name))
    return pins


def declared(name: str) -> list[Requirement]:
    """Return what one of the lists has to contain: an extra, or a group on top of `all`.

    The group `docs` is installed beside `all`.
    """
    if name == "docs":
        return group(name)

    lines = [Requirement(line) for line in PROJECT["project"]["dependencies"]]
    if name in PROJECT["dependency-groups"]:
        return [*lines, *extra("all"), *group(name)]
    if name == "base":
        return lines
    return [*lines, *extra(name)]


def extra(name: str) -> list[Requirement]:
    """Return what an extra asks for, its other extras followed."""
    project = PROJECT["project"]
    lines = []
    for text in project["optional-dependencies"][name]:
        line = Requirement(text)
        if line.name != project["name"]:
            lines.append(line)
            continue
        for inner in line.extras:
            lines += extra(inner)
    return lines


def group(name: str) -> list[Requirement]:
    """Return what a dependency group asks for, its other groups followed."""
    lines = []
    for entry in PROJECT["dependency-groups"][name]:
        if isinstance(entry, dict):
            lines += group(entry["include-group"])
        else:
            lines.append(Requirement(entry))
    return lines


@pytest.mark.parametrize("name", ["base", "all", "dev", "docs"])
def test_every_library_of_pyproject_is_pinned_once_and_within_its_range(name: str) -> None:
    pins = pinned(name)
    for system in SYSTEMS:
        versions = {}
        for pin in pins:
            if pin.marker is None or pin.marker.evaluate(system):
                assert canonicalize_name(pin.name) not in versions, f"{pin.name} twice on {system}"
                (only,) = pin.specifier
                assert only.operator == "==", pin
                versions[canonicalize_name(pin.name)] = only.version
        build = [Requirement(line) for line in PROJECT["build-system"]["requires"]]
        for line in declared(name) + build:
            if line.marker is None or line.marker.evaluate(system):
                version = versions.get(canonicalize_name(line.name))
                assert version is not None, (
                    f"{line} is not in requirements/{name}.txt on {system}: run make pins"
                )
                assert line.specifier.contains(version), (
                    f"{line} is pinned to {version}: run make pins"
                )


def test_whoever_flies_has_the_versions_that_were_tested() -> None:
    tested = {str(pin) for pin in pinned("dev")}
    assert {str(pin) for pin in pinned("base") + pinned("all")} <= tested


def test_the_pins_name_no_registry_and_no_file_of_one_machine() -> None:
    for path in (ROOT / "requirements").iterdir():
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"//|file:| @ ", text), path
        assert set(re.findall(r"(?<!\S)-[a-z-]+", re.sub("#.*", "", text))) <= {"--hash"}, (
            f"{path} has an option of pip's"
        )


def test_setup_installs_pinned_wheels_with_hashes_and_covey_without_libraries() -> None:
    setup = (ROOT / ".ci" / "setup").read_text(encoding="utf-8")
    assert "install --disable-pip-version-check -q --no-deps" in setup
    assert '--require-hashes --only-binary :all: -r "$venv/half-$1.txt"' in setup
    assert "libraries && pip --no-build-isolation -e ." in setup
    for line in PROJECT["build-system"]["requires"]:
        assert line in (ROOT / "requirements" / "build.in").read_text(encoding="utf-8")


def test_the_two_halves_that_setup_installs_are_the_whole_list() -> None:
    setup = (ROOT / ".ci" / "setup").read_text(encoding="utf-8")
    (program,) = re.findall(r"awk -v \"half=\$1\" '([^']*)'", setup)
    pins = ROOT / "requirements" / "dev.txt"

    halves = []
    for half in ("0", "1"):
        words = ["awk", "-v", f"half={half}", program, str(pins)]
        text = subprocess.run(words, capture_output=True, text=True, check=True).stdout
        halves.append(text.splitlines())
    assert sorted(halves[0] + halves[1]) == sorted(pins.read_text(encoding="utf-8").splitlines())
    for lines in halves:
        begins = [line for line in lines if "==" in line]
        assert abs(len(begins) - len(pinned("dev")) / 2) <= 1
        assert lines.index(begins[0]) <= 2, "a hash without its library"
