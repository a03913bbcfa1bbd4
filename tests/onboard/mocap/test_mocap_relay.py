"""The relay as a process, and what it tells of the bodies that it passes on."""

from __future__ import annotations

import copy
import math
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

from groundstation.processes.free_ports import toml_text, with_free_ports
from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, MocapPose
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, fleet_from_mapping, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_OK
from onboard.mocap.relay.mocap_relay import MocapRelay
from onboard.mocap.relay.statistics import MocapStatistics
from onboard.tuples import Wxyz
from tests.onboard.mocap.natnet import NatNetServer, Pose

_PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"
_LEVEL = (1.0, 0.0, 0.0, 0.0)

pytest.importorskip("motioncapture", reason="the optional package 'motioncapture' is not installed")


def fleet_file(
    folder: Path, mocap: dict | None = None, *, emulated: Sequence[str] = (), **bodies: str
) -> Path:
    data = tomllib.loads(_PAPER.read_text())
    data = copy.deepcopy(with_free_ports(data, fleet_from_mapping(data)))
    if mocap is not None:
        data["mocap"] = mocap
    for vehicle, body in bodies.items():
        data["vehicles"][vehicle]["mocap_body"] = body
    for vehicle in emulated:
        data["vehicles"][vehicle]["emulated"] = True
    path = folder / "fleet.toml"
    path.write_text(toml_text(data))
    return path


class _Ear:
    """Everything on ``mocap/*``, heard as an agent would."""

    def __init__(self, fleet: FleetConfig) -> None:
        self.poses: list[MocapPose] = []
        self._bus = BusSession(
            namespace=fleet.namespace, node="ear", connect=[fleet.simulator_endpoint]
        )

    def _hear(self, _topic: Topic, _name: str, message: Message | Malformed) -> None:
        assert isinstance(message, MocapPose)
        self.poses.append(message)

    def __enter__(self) -> _Ear:
        self._bus.start()
        self._bus.subscribe(Topic.MOCAP, "*", self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        self._bus.stop()


def _command(path: Path, *more: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "groundstation",
        "mocap",
        "--fleet",
        str(path),
        "--every-s",
        "0.3",
        *more,
    ]


def test_the_process_puts_every_body_on_the_bus_and_ends_cleanly_on_ctrl_c(tmp_path: Path) -> None:
    path = fleet_file(tmp_path)
    fleet = load_fleet(path)
    with _Ear(fleet) as ear:
        command = _command(path, "--source", "mock", "--seconds", "30")
        relay = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert relay.stdout is not None
        try:
            assert any("3 bodies, 3 vehicles" in line for line in relay.stdout)
            end = time.monotonic() + 20.0
            while len({pose.body for pose in ear.poses}) < 3 or len(ear.poses) < 60:
                assert time.monotonic() < end, "no poses came"
                time.sleep(0.02)
        finally:
            relay.send_signal(signal.SIGINT)
            relay.communicate(timeout=20)
    assert relay.returncode == EXIT_OK
    for pose in ear.poses:
        start = fleet.vehicles[pose.body].start_enu_m
        assert pose.position_enu_m == pytest.approx(start, abs=1e-5)
        assert 0 < time.monotonic_ns() - pose.stamp_ns < 60e9


def test_two_relays_of_one_fleet_cannot_run(tmp_path: Path) -> None:
    path = fleet_file(tmp_path)
    with subprocess.Popen(
        _command(path, "--source", "mock"), stdout=subprocess.PIPE, text=True
    ) as first:
        assert first.stdout is not None
        first.stdout.readline()
        second = subprocess.run(
            _command(path, "--source", "mock"), capture_output=True, text=True, timeout=30
        )
        first.send_signal(signal.SIGHUP)
    assert first.returncode == EXIT_OK
    assert second.returncode == 2
    assert "cannot listen" in second.stderr


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 2, "mocap.source is 'bus'"),
        (["--source", "vicon"], 2, "'mocap.hostname' is missing"),
        (["--source", "mock", "--seconds", "0"], 2, "--seconds"),
        (
            ["--source", "qualisys", "--hostname", "127.0.0.1", "--seconds", "3"],
            10,
            "cannot be read",
        ),
    ],
)
def test_wrong_input_and_a_silent_system_have_a_sentence_and_a_status(
    tmp_path: Path, arguments: list[str], status: int, words: str
) -> None:
    found = subprocess.run(
        _command(fleet_file(tmp_path), *arguments), capture_output=True, text=True, timeout=60
    )
    assert found.returncode == status
    assert words in found.stdout + found.stderr


def test_unknown_missing_unnameable_and_emulated_bodies_are_reported_and_the_rest_is_passed_on(
    tmp_path: Path,
) -> None:
    names = ["mav0", "cf 2", "person", "third"]

    def bodies() -> dict[str, Pose | None]:
        x = 0.1 * math.sin(time.monotonic())
        return dict.fromkeys(names, ((x, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)))

    with NatNetServer(names, bodies) as server:
        table: dict = {"source": "motioncapture", "type": "optitrack", "hostname": "127.0.0.1"}
        table["options"] = {"port_command": server.port}
        fleet = load_fleet(fleet_file(tmp_path, table, emulated=["mav2"], mav2="third"))
        lines: list[str] = []
        relay = MocapRelay(fleet, lines.append)
        with _Ear(fleet) as ear:
            status = relay.run(seconds=3.0, every_s=0.5, stopped=threading.Event())
    text = "\n".join(lines)
    assert status == EXIT_FAILED
    assert {pose.body for pose in ear.poses} == {"mav0", "person"}
    assert "has sent no body 'mav1' yet. Bodies that are no vehicle here: person." in text
    assert "vehicles.mav1.mocap_body" in text
    assert "the emulator sends the poses of these bodies: 'third'" in text
    assert "names cannot be keys on the bus: 'cf 2'" in text
    assert "no vehicle of the fleet" in text
    assert "ready" not in text


def body_pose(
    at_s: float, x_m: float, *, is_tracked: bool = True, quaternion: Wxyz = _LEVEL
) -> MocapPose:
    return MocapPose(
        body="a",
        boot_id=1,
        sequence=round(1000 * at_s),
        stamp_ns=round(at_s * 1e9),
        is_tracked=is_tracked,
        position_enu_m=(x_m, 0.0, 0.0),
        quaternion_enu_flu_wxyz=quaternion,
    )


def _report(*poses: MocapPose) -> MocapStatistics:
    report = MocapStatistics({"mav0": "a"})
    report.close_window(0)
    for pose in poses:
        report.add(pose)
    report.close_window(round(poses[-1].stamp_ns + 5e6))
    return report


def test_rate_gap_jumps_and_losses_of_a_body_are_counted() -> None:
    poses = [
        body_pose(0.01 * n, 0.001 * n + (2.0 if n > 50 else 0.0))
        for n in range(1, 101)
        if not 20 <= n < 30
    ]
    poses[70:75] = [body_pose(pose.stamp_ns * 1e-9, 0.0, is_tracked=False) for pose in poses[70:75]]
    body = _report(*poses).bodies["a"]
    assert (body.jumps, body.losses) == (1, 1)
    assert body.longest_gap_s == pytest.approx(0.11)
    assert body.rate_hz == pytest.approx(85.0, rel=0.02)
    assert body.is_tracked


def test_numbers_that_are_not_finite_count_as_jumps() -> None:
    body = _report(
        body_pose(0.01, 0.0), body_pose(0.02, math.nan), body_pose(0.03, math.inf)
    ).bodies["a"]
    assert body.jumps == 2


def test_a_body_that_gives_the_same_numbers_is_named_and_is_not_ready() -> None:
    moving = _report(*[body_pose(0.01 * n, 1e-4 * n) for n in range(1, 200)])
    assert not any("same numbers" in line for line in moving.findings())
    assert moving.is_complete

    still = _report(*[body_pose(0.01 * n, 1.0) for n in range(1, 200)])
    assert any("same numbers" in line for line in still.findings())
    assert not still.is_complete


def test_a_body_that_is_lost_now_is_named() -> None:
    report = _report(body_pose(0.01, 0.0), body_pose(0.5, 0.0, is_tracked=False))
    assert not report.is_complete
    assert any("not tracked now" in line for line in report.findings())
