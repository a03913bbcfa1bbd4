"""One fleet of real and emulated vehicles.

A second emulator plays the real one; its poses come as a relay's do.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.client.client import FleetClient
from groundstation.processes.free_ports import toml_text, with_free_ports
from groundstation.processes.supervisor import Processes
from onboard.config.fleet import FleetConfig, fleet_from_mapping, load_fleet
from tests.flight.judge import min_separation_m, truth

_MIXED = Path(__file__).parents[2] / "configs/fleets/mixed.toml"
_REAL = "mav0"
_EMULATED = "mav2"
_EXCHANGE = """
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = 1.0
[[step]]
do = "formation"
name = "exchanged"
position_enu_m = [0.0, 0.0, 1.0]
[[step]]
do = "land"
[expect]
min_separation_m = 0.80
arrived_within_m = 0.15
all_landed = true
"""


def _fleets(folder: Path) -> FleetConfig:
    """One real and one emulated vehicle on free ports; and the file of the emulator that plays the
    real one.
    """
    data = tomllib.loads(_MIXED.read_text(encoding="utf-8"))
    pair = (_REAL, _EMULATED)
    data["vehicles"] = {name: data["vehicles"][name] for name in pair}
    data["formations"] = {
        "exchanged": {name: data["formations"]["exchanged"][name] for name in pair}
    }
    data = with_free_ports(data, fleet_from_mapping(data))
    (folder / "fleet.toml").write_text(toml_text(data), encoding="utf-8")
    other = {
        **data,
        "vehicles": {
            name: {**table, "emulated": name == _REAL} for name, table in data["vehicles"].items()
        },
    }
    # it sends its poses where a relay does, a port above the place of the emulator of a part
    host, _, port = data["fleet"]["simulator"].rpartition(":")
    other["fleet"] = {**data["fleet"], "simulator": f"{host}:{int(port) + 1}"}
    (folder / "real.toml").write_text(toml_text(other), encoding="utf-8")
    return load_fleet(folder / "fleet.toml")


@contextmanager
def _running(folder: Path) -> Iterator[tuple[FleetConfig, Processes]]:
    """Both worlds and both agents."""
    fleet = _fleets(folder)
    processes = Processes(folder)
    try:
        processes.start("emulator", ["sitl", "--fleet", fleet.path], ends_last=True)
        processes.start("real", ["sitl", "--fleet", str(folder / "real.toml")])
        for name in fleet.enabled_names:
            processes.start(
                name, ["onboard", "--fleet", fleet.path, "--vehicle", name, "--apply-params"]
            )
        yield fleet, processes
    finally:
        processes.kill()


async def _until(
    fleet: FleetConfig, is_true: Callable[[dict[str, str]], bool], timeout_s: float = 40.0
) -> dict[str, str]:
    """Wait for the sentences of the rule "position" of all vehicles to be as they should."""
    client = FleetClient(fleet)
    await client.start()
    try:
        end_s = time.monotonic() + timeout_s
        while True:
            reports = {name: view.preflight for name, view in client.state.vehicles.items()}
            checks = {name: report.checks for name, report in reports.items() if report is not None}
            said = {
                name: check[2]
                for name, rows in checks.items()
                for check in rows
                if check[0] == "position"
            }
            if len(said) == len(reports) and is_true(said):
                return said
            assert time.monotonic() < end_s, said
            await asyncio.sleep(0.05)
    finally:
        await client.stop()


@pytest.mark.long
def test_each_body_has_one_source_of_poses_and_a_second_one_is_said(tmp_path: Path) -> None:
    with _running(tmp_path) as (fleet, processes):
        asyncio.run(
            _until(
                fleet, lambda said: all(sentence.startswith("At (") for sentence in said.values())
            )
        )
        data = tomllib.loads((tmp_path / "real.toml").read_text(encoding="utf-8"))
        # other ports, the same bodies and the same agents
        again = with_free_ports(data, fleet_from_mapping(data))
        for name, table in again["vehicles"].items():
            table["agent"] = data["vehicles"][name]["agent"]
        (tmp_path / "third.toml").write_text(toml_text(again), encoding="utf-8")
        processes.start("third", ["sitl", "--fleet", str(tmp_path / "third.toml")])
        said = asyncio.run(
            _until(fleet, lambda said: said[_REAL].startswith("2 programs send poses"))
        )
        assert said[_EMULATED].startswith("At (")


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_real_and_an_emulated_vehicle_avoid_each_other(tmp_path: Path) -> None:
    with _running(tmp_path) as (fleet, _):
        asyncio.run(
            _until(
                fleet, lambda said: all(sentence.startswith("At (") for sentence in said.values())
            )
        )
        (tmp_path / "exchange.toml").write_text(_EXCHANGE, encoding="utf-8")
        words = [
            "fly",
            str(tmp_path / "exchange.toml"),
            "--headless",
            "--record",
            str(tmp_path / "record"),
        ]
        done = subprocess.run(
            [sys.executable, "-m", "groundstation", *words],
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert set(truth(tmp_path / "record")) == {_REAL, _EMULATED}
    assert min_separation_m(tmp_path / "record") >= 0.80


def test_each_command_takes_its_own_part_of_the_fleet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mixed = str(_MIXED)
    for words in (
        ["sitl", "--fleet", mixed, "--vehicles", "mav0"],
        ["sitl-truth", "--fleet", mixed, "--vehicles", "mav2"],
    ):
        assert main(words) == 2
        assert "from one source only" in capsys.readouterr().err
