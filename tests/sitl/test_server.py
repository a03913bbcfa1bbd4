"""The emulator as a process: ports, who is answered, what goes on the bus, and how it ends."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from groundstation.cli import main
from onboard.bus.codec import Malformed
from onboard.bus.schema import Message, MocapPose, Truth
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import load_fleet
from sitl.fleet_emulator import emulator_of
from sitl.mavlink.endpoints import GROUND_STATION, ground_ports

FLEET = """
schema = 1
[fleet]
name = "server-test"
geofence_m = {{ x = [-5.0, 5.0], y = [-5.0, 5.0], z = [0.0, 3.0] }}
simulator = "tcp/127.0.0.1:{bus}"
[types.sih]
[defaults]
type = "sih"
[vehicles.one]
system_id = 4
start_enu_m = [1.0, -2.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{companion}"
direct = "udpout://127.0.0.1:{direct}"
mocap_body = "rigid7"
"""


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Setup:
    """A fleet file on free ports, with the companion's socket already bound."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.companion = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        while True:
            self.companion.bind(("127.0.0.1", 0))
            self.port = int(self.companion.getsockname()[1])
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                try:
                    probe.bind(("127.0.0.1", self.port + 40))
                    break
                except OSError:
                    self.companion.close()
                    self.companion = stack.enter_context(
                        socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                    )
        self.companion.settimeout(3.0)
        self.direct = free_port(socket.SOCK_DGRAM)
        self.bus = free_port(socket.SOCK_STREAM)
        self.fleet = folder / "fleet.toml"
        text = FLEET.format(
            bus=self.bus,
            agent=free_port(socket.SOCK_STREAM),
            companion=self.port,
            direct=self.direct,
        )
        self.fleet.write_text(text, encoding="utf-8")

    @contextmanager
    def running(self, *options: str) -> Iterator[subprocess.Popen[str]]:
        """The emulator's process; ended by SIGINT, which has to give status 0."""
        command = [sys.executable, "-m", "sitl", "--fleet", str(self.fleet), *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline().startswith("ready: one")
            try:
                yield process
            except BaseException:
                process.kill()
                raise
            process.send_signal(signal.SIGINT)
            assert process.wait(5) == 0


@pytest.fixture
def setup(tmp_path: Path) -> Iterator[Setup]:
    with ExitStack() as stack:
        yield Setup(tmp_path, stack)


def names_seen(sock: socket.socket, count: int) -> set[str]:
    parser = common.MAVLink(None)
    names: set[str] = set()
    for _ in range(count):
        for message in parser.parse_buffer(bytearray(sock.recv(2048))) or []:
            if message.get_type().startswith("UNKNOWN"):
                continue  # pymavlink does not know all that PX4 sends
            assert message.get_srcSystem() == 4
            names.add(message.get_type())
    return names


HEARTBEAT = bytes(
    common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(common.MAVLink(None, 255, 190))
)


@pytest.mark.parametrize(
    "first_words", [HEARTBEAT, b"no MAVLink at all"], ids=["heartbeat", "nonsense"]
)
def test_it_streams_unasked_then_locks_onto_the_first_speaker_for_good(
    setup: Setup, first_words: bytes
) -> None:
    with setup.running("--no-bus"), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        # attitude comes last
        assert {"ATTITUDE", "LOCAL_POSITION_NED"} <= names_seen(setup.companion, 500)
        other.settimeout(3.0)
        other.sendto(first_words, ("127.0.0.1", setup.port + 40))
        assert "ATTITUDE" in names_seen(other, 60)
        setup.companion.sendto(HEARTBEAT, ("127.0.0.1", setup.port + 40))
        assert "ATTITUDE" in names_seen(other, 60)


def test_the_ground_link_answers_who_speaks_first(setup: Setup) -> None:
    with setup.running("--no-bus"), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.settimeout(3.0)
        land = common.MAVLink_command_long_message(4, 1, 21, 0, 0, 0, 0, 0, 0, 0, 0)
        ground.sendto(bytes(land.pack(common.MAVLink(None, 255, 190))), ("127.0.0.1", setup.direct))
        seen = names_seen(ground, 80)
    assert {"COMMAND_ACK", "HEARTBEAT", "ATTITUDE"} <= seen


def test_every_vehicle_streams_to_a_ground_station_that_is_asked_for(setup: Setup) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(5.0)
        with setup.running("--no-bus", "--gcs", f"127.0.0.1:{station.getsockname()[1]}"):
            seen = names_seen(station, 120)
    assert {"HEARTBEAT", "ATTITUDE", "SYS_STATUS"} <= seen
    assert not {"HIGHRES_IMU", "ODOMETRY"} & seen  # for companions only


@pytest.mark.parametrize(
    ("autopilot", "direct", "expected"),
    [
        ("udpin://127.0.0.1:14540", None, 18570),
        ("udpin://127.0.0.1:14549", None, 18579),
        ("udpin://127.0.0.1:15550", None, 19580),
        ("udpin://127.0.0.1:24540", None, 0),
        ("udpin://127.0.0.1:24540", "udpout://127.0.0.1:40001", 40001),
    ],
)
def test_the_ground_link_lies_where_px4_or_the_fleet_file_puts_it(
    autopilot: str, direct: str | None, expected: int | None
) -> None:
    ports = ground_ports(autopilot, direct, "vehicles.one", GROUND_STATION)
    assert (ports.bind[1] if ports else None) == expected


def test_an_address_of_a_ground_station_that_is_none_is_refused_in_words(
    setup: Setup, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sitl", "--fleet", str(setup.fleet), "--no-bus", "--gcs", "nowhere"]) == 2
    assert "Write it as 127.0.0.1:14550" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--mocap-noise-m", "nan"),
        ("--mocap-noise-m", "-1"),
        ("--mocap-latency-s", "nan"),
        ("--mocap-latency-s", "-0.1"),
        ("--mocap-dropouts-per-s", "inf"),
        ("--mocap-dropout-s", "-1"),
        ("--truth-offset-m", "nan"),
        ("--ftp-dies-after-kb", "-1"),
    ],
)
def test_a_number_that_nothing_can_be_emulated_with_is_refused(
    setup: Setup,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    option: str,
    value: str,
) -> None:
    monkeypatch.setattr("groundstation.commands.sitl.run", lambda server: None)
    assert main(["sitl", "--fleet", str(setup.fleet), "--no-bus", f"{option}={value}"]) == 2
    assert f"{option} is {value}" in capsys.readouterr().err


def test_a_port_in_use_is_refused_in_words(
    setup: Setup, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", setup.port + 40))
        assert main(["sitl", "--fleet", str(setup.fleet), "--no-bus"]) == 2
    words = capsys.readouterr().err
    assert str(setup.port + 40) in words
    assert "one" in words
    assert "Stop it, or change the port" in words


def test_a_missing_fleet_file_and_an_unknown_vehicle_are_refused(
    setup: Setup, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sitl", "--fleet", "/nowhere/fleet.toml"]) == 2
    assert "there is no such fleet file" in capsys.readouterr().err
    assert main(["sitl", "--fleet", str(setup.fleet), "--vehicles", "ghost"]) == 2
    assert "ghost" in capsys.readouterr().err


def test_poses_and_truth_are_on_the_bus_with_stamps_of_the_monotonic_clock(setup: Setup) -> None:
    received: list[tuple[Topic, str, Message | Malformed]] = []
    with setup.running("--truth-offset-m", "10"):
        listener = BusSession(
            namespace="covey/server-test", node="listener", connect=[f"tcp/127.0.0.1:{setup.bus}"]
        )
        listener.start()
        for topic in (Topic.MOCAP, Topic.TRUTH):
            listener.subscribe(topic, "*", lambda *message: received.append(message))
        deadline_s = time.monotonic() + 8.0
        while len(received) < 120 and time.monotonic() < deadline_s:
            time.sleep(0.02)
        now_ns = time.monotonic_ns()
        listener.stop()
    poses = [(name, m) for _, name, m in received if isinstance(m, MocapPose)]
    truths = [(name, m) for _, name, m in received if isinstance(m, Truth)]
    assert len(poses) > 40
    assert len(truths) > 40
    assert {name for name, _ in poses} == {"rigid7"}
    assert {name for name, _ in truths} == {"one"}
    pose = poses[-1][1]
    truth = truths[-1][1]
    assert pose.position_enu_m == pytest.approx((1.0, -2.0, 0.0), abs=0.02)
    assert truth.position_enu_m == pytest.approx((11.0, 8.0, 10.0), abs=1e-9)
    assert abs(pose.quaternion_enu_flu_wxyz[0]) == pytest.approx(1.0, abs=1e-3)
    assert 0.0 < (now_ns - truth.stamp_ns) * 1e-9 < 0.5
    spacing_s = (truths[-1][1].stamp_ns - truths[0][1].stamp_ns) * 1e-9 / (len(truths) - 1)
    assert spacing_s == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize(("hover_time_s", "least_pct"), [(None, 50.0), (120.0, 0.0)])
def test_a_battery_empties_to_the_end_if_its_type_says_how_long_it_lasts(
    hover_time_s: float | None, least_pct: float
) -> None:
    fleet = load_fleet("paper")
    vehicle = replace(fleet.vehicles["mav0"], hover_time_s=hover_time_s)
    (px4,) = emulator_of(fleet, [vehicle], seed=0).autopilots
    assert px4.params["SIM_BAT_MIN_PCT"] == least_pct


def test_the_ground_is_that_of_all_spots_of_the_fleet_also_of_vehicles_that_are_not_emulated() -> (
    None
):
    fleet = load_fleet("paper")
    lower = replace(fleet.vehicles["mav1"], start_enu_m=(2.0, 2.0, -1.0))
    fleet = replace(fleet, vehicles={**fleet.vehicles, "mav1": lower})
    vehicles = emulator_of(fleet, [fleet.vehicles["mav0"]], seed=0).world.vehicles
    vehicles.states.position_ned_m[0] = [20.0, 20.0, 0.0]
    assert vehicles.height_m(0) == 1.0
