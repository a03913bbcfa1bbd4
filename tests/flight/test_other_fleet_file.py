"""Grounds with another fleet file than the agents', as a person starts them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from groundstation.processes.free_ports import toml_text, with_free_ports
from groundstation.processes.supervisor import Processes, agent_command
from onboard.config.fleet import fleet_from_mapping, load_fleet
from tests.bench.fixture import fleet_data

pytestmark = [pytest.mark.long, pytest.mark.timeout(180)]

HOP = """
schema = 1
[[step]]
do = "takeoff"
[[step]]
do = "land"
[expect]
all_landed = true
"""


@contextmanager
def behind_a_router(folder: Path) -> Iterator[None]:
    """Two vehicles behind a router, each with a fleet file that lacks the other one.

    The files are mav0.toml and mav1.toml; wider.toml is mav0's with another safety distance.
    """
    data = fleet_data(2, 2.0, "routed")
    data["fleet"]["routers"] = ["tcp/127.0.0.1:7500"]
    data = with_free_ports(data, fleet_from_mapping(data))
    files = {"all": data}
    for name, vehicle in data["vehicles"].items():
        files[name] = {**data, "vehicles": {name: vehicle}}
    files["wider"] = {**files["mav0"], "fleet": {**data["fleet"], "safety_distance_m": 0.9}}
    for name, content in files.items():
        (folder / f"{name}.toml").write_text(toml_text(content), encoding="utf-8")
        load_fleet(folder / f"{name}.toml")
    (folder / "hop.toml").write_text(HOP, encoding="utf-8")

    processes = Processes(folder)
    try:
        words = ["groundstation", "router", str(folder / "all.toml")]
        processes.start("router", words, ends_last=True)
        processes.start("sitl", ["sitl", "--fleet", str(folder / "all.toml"), "--no-gcs"])
        for name in data["vehicles"]:
            processes.start(name, agent_command(str(folder / f"{name}.toml"), name))
        yield
    finally:
        processes.kill()


def run(folder: Path, command: str, fleet: str, *words: str) -> tuple[int, str]:
    """Run a command with one of the files; return its exit status and its output."""
    done = subprocess.run(
        [sys.executable, "-m", "groundstation", command, *words, "--fleet", f"{fleet}.toml"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=90,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def fly(folder: Path, fleet: str, record: str) -> tuple[int, str]:
    return run(folder, "fly", fleet, "hop.toml", "--headless", "--record", record)


def test_no_flight_begins_with_another_file_or_beside_a_vehicle_that_the_file_lacks(
    tmp_path: Path,
) -> None:
    with behind_a_router(tmp_path):
        status, said = run(tmp_path, "check", "mav1", "vehicles", "--timeout", "60", "--wait", "60")
        assert status == 0, said
        status, said = run(tmp_path, "order", "mav1", "takeoff", "mav1", "1.0")
        assert status == 0, said

        status, said = fly(tmp_path, "mav0", "beside")
        assert status == 1, said
        assert "mav1 is armed or in the air, and not in this ground's fleet file" in said
        assert "NOT: mav1." in said

        status, said = run(tmp_path, "order", "mav1", "land", "mav1")
        assert status == 0, said
        status, said = fly(tmp_path, "mav0", "alone")
        assert status == 0, said
        assert "Landed and disarmed: mav0." in said

        # the same vehicle, and another value
        status, said = fly(tmp_path, "wider", "wider")
        assert status == 1, said
        assert "mav0 flies with another fleet file than this ground's" in said
        status, said = run(tmp_path, "order", "wider", "takeoff", "mav0")
        assert status == 1, said
        assert "mav0 flies with another fleet file than this ground's" in said

        status, said = run(tmp_path, "order", "mav0", "takeoff", "mav0")
        assert status == 0, said
        status, said = run(tmp_path, "order", "wider", "land", "all")
        assert status == 0, said
