"""The doctor on a bus with keys: what a vehicle tells arrives, and of nobody it says that nobody
answers.
"""

from __future__ import annotations

import datetime
import json
import shutil
import socket
import threading
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.cli import main
from groundstation.keys.secured_fleet import secure_fleet
from groundstation.processes.free_ports import toml_text
from onboard.bus.clock_sync import ClockNode
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.security.credentials import credentials_of
from tests.onboard.state_messages import state_message

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FleetConfig:
    """The paper's fleet with keys, on free ports."""
    monkeypatch.chdir(tmp_path)
    data = tomllib.loads(PAPER.read_text(encoding="utf-8"))
    probes = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in data["vehicles"]]
    for probe, vehicle in zip(probes, data["vehicles"].values(), strict=True):
        probe.bind(("127.0.0.1", 0))
        vehicle["agent"] = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    for probe in probes:
        probe.close()
    Path("fleet.toml").write_text(toml_text(data), encoding="utf-8")
    shutil.rmtree("keys", ignore_errors=True)
    return secure_fleet("fleet.toml", datetime.datetime.now(datetime.UTC))


def _said(capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, str]]:
    return {one["name"]: one for one in json.loads(capsys.readouterr().out)}


def test_what_one_vehicle_tells_is_measured_and_the_others_do_not_answer(
    fleet: FleetConfig, make_telemetry: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = fleet.vehicles["mav0"].agent
    agent = BusSession(
        namespace=fleet.namespace,
        node="mav0",
        listen=[endpoint],
        credentials=credentials_of(fleet, "mav0"),
    )
    agent.start()
    ended = threading.Event()

    def publish() -> None:
        clock = ClockNode(agent)
        sequence = 0
        while not ended.wait(0.02):
            sequence += 1
            told = replace(
                state_message(), vehicle="mav0", sequence=sequence, stamp_ns=time.monotonic_ns()
            )
            agent.publish(Topic.STATE, "mav0", told)
            if sequence % 5 == 0:
                agent.publish(Topic.TELEMETRY, "mav0", make_telemetry("mav0", sequence=sequence))
            if sequence % 25 == 0:
                clock.beat()

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        # two are not there
        assert main(["doctor", "fleet.toml", "--network", "--seconds", "3", "--json"]) == 1
    finally:
        ended.set()
        thread.join()
        agent.stop()
    said = _said(capsys)
    assert "0.0 % are lost" in said["mav0"]["sentence"]
    assert said["mav1"]["grade"] == said["mav2"]["grade"] == "FAIL"
    assert "over at most 600 ms there and back" in said["links"]["sentence"]
    assert "after 1.1 s of silence" in said["links"]["sentence"]


def test_a_vehicle_with_the_keys_of_a_former_authority_is_told_from_one_that_is_not_there(
    fleet: FleetConfig, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree("keys", "old")
    assert main(["keys", "init", "fleet.toml", "--force"]) == 0
    capsys.readouterr()
    former = replace(fleet, fleet=replace(fleet.fleet, keys=str(Path("old").resolve())))
    agent = BusSession(
        namespace=fleet.namespace,
        node="mav0",
        listen=[fleet.vehicles["mav0"].agent],
        credentials=credentials_of(former, "mav0"),
    )
    agent.start()
    try:
        assert main(["doctor", "fleet.toml", "--network", "--seconds", "1", "--json"]) == 10
    finally:
        agent.stop()
    said = _said(capsys)
    assert [said[name]["grade"] for name in fleet.vehicles] == ["FAIL"] * 3
    assert "accepts no link: its keys differ" in said["mav0"]["sentence"]
    assert "Nobody answers" in said["mav1"]["sentence"]
