"""Real processes whose poses come another way than from the bus of one host: from another clock,
over OptiTrack.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, MocapPose, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, fleet_from_mapping, load_fleet
from tests.flight.judge import min_separation_m
from tests.onboard.mocap.natnet import NatNetServer, Pose

_PAPER = Path(__file__).parents[2] / "configs/fleets/paper.toml"
_SHIFT_S = 5000
_IN_ANOTHER_TIME = [
    "unshare",
    "--time",
    "--fork",
    "--kill-child",
    "--monotonic",
    str(_SHIFT_S),
    "-r",
]
_HOP = """
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = 0.8
[[step]]
do = "move"
position_enu_m = [0.2, 0.3, 0.9]
[[step]]
do = "land"
[expect]
arrived_within_m = 0.2
all_landed = true
"""

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


def _fleet(folder: Path, bodies: dict[str, str], **tables: dict) -> FleetConfig:
    """Vehicles of the paper's fleet with their bodies, on free ports, and a mission."""
    data = tomllib.loads(_PAPER.read_text())
    data["vehicles"] = {
        name: {**data["vehicles"][name], "mocap_body": body} for name, body in bodies.items()
    }
    data["formations"]["triangle"] = {name: data["formations"]["triangle"][name] for name in bodies}
    data = with_free_ports(data, fleet_from_mapping(data))
    (folder / "fleet.toml").write_text(toml_text({**data, **tables}))
    (folder / "hop.toml").write_text(_HOP)
    return load_fleet(folder / "fleet.toml")


@contextlib.contextmanager
def _running(folder: Path, name: str, command: list[str]) -> Iterator[None]:
    """A process with its output in a file, in a group of its own that ends with the block."""
    with (folder / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(
            command, stdout=log, stderr=log, stdin=subprocess.DEVNULL, start_new_session=True
        )
        try:
            yield
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _python(*words: str) -> list[str]:
    return [sys.executable, "-m", *words]


def _agent(folder: Path, name: str) -> list[str]:
    return _python(
        "onboard", "--fleet", str(folder / "fleet.toml"), "--vehicle", name, "--apply-params"
    )


def _wait_ready(folder: Path, names: Iterable[str], seconds: float = 60.0) -> None:
    """Until every agent has said that it may fly; a busy machine needs a while."""
    end = time.monotonic() + seconds
    while not all(f"agent {name}: ready" in (folder / f"{name}.log").read_text() for name in names):
        assert time.monotonic() < end, _logs(folder)
        time.sleep(0.2)


def _fly(folder: Path) -> subprocess.CompletedProcess[str]:
    words = ["fly", str(folder / "hop.toml"), "--headless", "--record", str(folder / "record")]
    return subprocess.run(
        _python("groundstation", *words), capture_output=True, text=True, timeout=200
    )


def _logs(folder: Path) -> str:
    return "\n".join(
        f"--- {log.name}\n{log.read_text()[-2000:]}" for log in sorted(folder.glob("*.log"))
    )


class _Ear:
    """Hears one topic as a node of its own."""

    def __init__(self, fleet: FleetConfig, topic: Topic, kind: type[Message]) -> None:
        agents = [fleet.vehicles[name].agent for name in fleet.enabled_names]
        self._bus = BusSession(
            namespace=fleet.namespace, node="ear", connect=[*agents, fleet.simulator_endpoint]
        )
        self._topic = topic
        self._kind = kind
        self._lock = threading.Lock()
        self._newest: dict[str, Message] = {}

    def _hear(self, _topic: Topic, name: str, message: Message | Malformed) -> None:
        if isinstance(message, self._kind):
            with self._lock:
                self._newest[name] = message

    def newest(self) -> dict[str, Message]:
        with self._lock:
            return dict(self._newest)

    def __enter__(self) -> _Ear:
        self._bus.start()
        self._bus.subscribe(self._topic, "*", self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        self._bus.stop()


def test_a_vehicle_whose_computer_has_another_clock_flies_with_the_others(tmp_path: Path) -> None:
    if subprocess.run([*_IN_ANOTHER_TIME, "true"], capture_output=True).returncode != 0:
        pytest.skip("this kernel allows no time namespaces")
    fleet = _fleet(tmp_path, {name: name for name in ("mav0", "mav1", "mav2")})
    with contextlib.ExitStack() as stack:
        stack.enter_context(
            _running(tmp_path, "sitl", _python("sitl", "--fleet", str(tmp_path / "fleet.toml")))
        )
        for name in fleet.enabled_names:
            prefix = _IN_ANOTHER_TIME if name == "mav1" else []
            stack.enter_context(_running(tmp_path, name, [*prefix, *_agent(tmp_path, name)]))
        ear = stack.enter_context(_Ear(fleet, Topic.TELEMETRY, Telemetry))
        _wait_ready(tmp_path, fleet.enabled_names)
        told: dict[str, Any] = ear.newest()
        done = _fly(tmp_path)
    stamps = {name: message.stamp_ns * 1e-9 for name, message in told.items()}
    # its clock really is another one
    assert stamps["mav1"] - stamps["mav0"] == pytest.approx(_SHIFT_S, abs=30.0)
    # what comes from the other clock has its true age, here and there
    for name, message in told.items():
        assert message.state_age_s < 0.5, name
        assert message.neighbour_age_s < 0.5, name
    assert done.returncode == 0, done.stdout + done.stderr + _logs(tmp_path)
    assert min_separation_m(tmp_path / "record") >= 0.80


def test_an_agent_that_reads_the_motion_capture_itself_flies_without_poses_on_the_bus(
    tmp_path: Path,
) -> None:
    pytest.importorskip(
        "motioncapture", reason="the optional package 'motioncapture' is not installed"
    )
    ear: _Ear | None = None

    def bodies() -> dict[str, Pose | None]:
        pose = ear.newest().get("Drone1") if ear is not None else None
        if not isinstance(pose, MocapPose):
            return {"Drone1": None}
        # the lab's frame: y up, turned by 90 degrees, its origin one metre east of the fleet's
        east, north, up = pose.position_enu_m
        turn = math.sqrt(0.5)  # back by 90 degrees about up
        w, x, y, z = pose.quaternion_enu_flu_wxyz
        w, x, y, z = turn * (w + z), turn * (x + y), turn * (y - x), turn * (z - w)
        return {"Drone1": ((north, up, east - 1.0), (x, z, -y, w))}

    with NatNetServer(["Drone1"], bodies) as server, contextlib.ExitStack() as stack:
        fleet = _fleet(
            tmp_path,
            {"mav0": "Drone1"},
            mocap={
                "source": "motioncapture",
                "type": "optitrack",
                "hostname": "127.0.0.1",
                "options": {"port_command": server.port},
                "direct": True,
                "up": "y",
                "yaw_deg": 90.0,
                "offset_m": [1.0, 0.0, 0.0],
                "latency_s": 0.03,
            },
        )
        stack.enter_context(
            _running(tmp_path, "sitl", _python("sitl", "--fleet", str(tmp_path / "fleet.toml")))
        )
        stack.enter_context(_running(tmp_path, "mav0", _agent(tmp_path, "mav0")))
        ear = stack.enter_context(_Ear(fleet, Topic.MOCAP, MocapPose))
        _wait_ready(tmp_path, fleet.enabled_names)
        done = _fly(tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr + _logs(tmp_path)
