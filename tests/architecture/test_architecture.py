"""The house is built as documented; public fields say their quantity, frame and unit."""

import ast
import re
import sys
import tomllib
from pathlib import Path

import pytest

from onboard import types
from onboard.bus import schema
from onboard.bus.topics import TOPICS
from onboard.config.fleet import FleetSection, LawConfig, SitlProfile, Vehicle
from tests.architecture import documents, form

ROOT = Path(__file__).parents[2]

UNITS = (
    "_m", "_m_s", "_m_s2", "_m_s3", "_rad", "_rad_s", "_deg", "_s", "_ms", "_ns", "_frac", "_pct",
    "_v", "_hz", "_kg",
    "_kg_m2", "_1_s", "_wxyz", "_count", "_ticks", "_messages",
)  # fmt: skip
# named one by one
WITHOUT_UNIT = {"shortfall_gain", "static_gain", "attitude_zeta", "px4_params", "parameters"}
NUMBERS = ("float", "Vec3", "Xyz", "Wxyz", "Array")


def public_fields() -> list[tuple[str, str, str]]:
    found = []
    structs: list[type] = [spec.message for spec in TOPICS.values() if spec.message] + [
        schema.TickSample,
        schema.OrderReply,
    ]
    for struct in [*structs, FleetSection, LawConfig, SitlProfile, Vehicle]:
        found += [
            (struct.__name__, name, str(kind)) for name, kind in struct.__annotations__.items()
        ]
    for value in (
        types.State,
        types.Goal,
        types.TrajectorySetpoint,
        types.Thrust,
        types.AttitudeSetpoint,
        types.Neighbour,
        types.LawOutput,
    ):
        found += [(value.__name__, name, str(kind)) for name, kind in value.__annotations__.items()]
    return found


def test_a_number_names_its_unit_and_a_vector_its_frame() -> None:
    for owner, name, kind in public_fields():
        if not any(re.search(rf"\b{number}\b", kind) for number in NUMBERS) or name in WITHOUT_UNIT:
            continue
        assert name.endswith(UNITS), f"{owner}.{name} does not say its unit"
        is_vector = ("Vec3" in kind or "Xyz" in kind) and "inertia" not in name
        assert not is_vector or "_enu_" in name, f"{owner}.{name} does not say its frame"


# what was explored is compared beside the explorer, which takes its time
@pytest.mark.parametrize("name", [name for name in documents.PRINTED if name != "explored"])
def test_what_the_docs_print_from_the_code_is_current(name: str) -> None:
    assert documents.written(name) == documents.PRINTED[name][1](), (
        f"docs/{documents.PRINTED[name][0]} is old: run `.venv/bin/python -m "
        "tests.architecture.documents --write`"
    )


def test_no_agent_code_knows_the_ground_truth() -> None:
    for path in (ROOT / "onboard").rglob("*.py"):
        if path.parent.name not in ("bus", "security"):  # they name all topics
            assert "TRUTH" not in path.read_text(encoding="utf-8"), f"{path} reads the ground truth"


def test_the_drawing_of_the_rooms_has_few_arrows_and_each_is_an_import() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    arrows = re.findall(r"^  (\w+) --> (\w+)$", page, re.MULTILINE)
    assert 0 < len(arrows) <= 30
    by_name = {module.name: module for module in form.modules()}
    drawn = {
        (module.room.rpartition("/")[2], by_name[target].room.rpartition("/")[2])
        for module in form.modules()
        for target in form.imports(module, set(by_name), with_late=True)
    }
    assert set(arrows) - drawn == set(), "drawn in docs/architecture.md, but nothing imports so"


def test_every_room_stands_in_the_table_of_the_rooms() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    for room in {module.room for module in form.modules()} - set(form.PACKAGES):
        assert f"`{room.rpartition('/')[2]}`" in page, f"docs/architecture.md does not name {room}"


def imported_libraries(package: str) -> set[str]:
    """Names of the libraries, neither Python's own nor ours, that a package's modules import
    anywhere.
    """
    found = set()
    for module in form.modules():
        if not module.path.startswith(f"{package}/"):
            continue
        for node in module.nodes:
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).split(".")[0])
    return (
        found - set(sys.stdlib_module_names) - {*form.PACKAGES, "tests", "pytest"}
    )  # pytest: sitl.lockstep.testing is a plugin


def test_what_is_imported_is_installed_by_the_readme_s_one_command() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = [
        *project["dependencies"],
        *(
            line
            for name in ("ground", "sim", "plots", "viewers", "rtk", "cluster", "bench")
            for line in extras[name]
        ),
    ]
    declared = {re.split(r"[<>=\[; ]", line)[0].replace("-", "_") for line in wanted}
    imported = {
        {
            "foxglove": "foxglove_sdk",
            "zenoh": "eclipse_zenoh",
            "PIL": "pillow",
            "google": "protobuf",
            "mcap_protobuf": "mcap_protobuf_support",
        }.get(name, name)
        for room in form.PACKAGES
        for name in imported_libraries(room)
    }
    assert imported - declared == set(), "imported, but no extra of pyproject.toml installs it"
