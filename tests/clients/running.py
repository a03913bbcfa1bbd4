"""Starts `python -m sitl` on free loopback ports, for clients that know nothing of Covey."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import common

_PREARM = 0x10000000
FLEET = """
schema = 1
[fleet]
name = "clients"
geofence_m = {{ x = [-50.0, 50.0], y = [-50.0, 50.0], z = [0.0, 20.0] }}
[types.sih]
hover_thrust_frac = 0.49
drag_1_s = 1.0
[defaults]
type = "sih"
[vehicles.solo]
system_id = 1
start_enu_m = [0.0, 0.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{companion}"
direct = "udpout://127.0.0.1:{ground}"
"""


@dataclass(frozen=True)
class Running:
    """A running emulator.

    Attributes:
        companion: port that a companion listens on; the emulator is bound 40 higher.
        ground: port where the emulator answers ground stations.
        station: port that a ground station listens on, streamed to unasked.
    """

    process: subprocess.Popen[str]
    fleet: Path
    companion: int
    ground: int
    station: int


def free_ports() -> tuple[int, int, int, int]:
    """A port that is free, also 40 higher, and three more."""
    while True:
        held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(5)]
        try:
            for each in held[:4]:
                each.bind(("127.0.0.1", 0))
            ports = [int(each.getsockname()[1]) for each in held[:4]]
            held[4].bind(("127.0.0.1", ports[0] + 40))
            return ports[0], ports[1], ports[2], ports[3]
        except (OSError, OverflowError):
            continue
        finally:
            for each in held:
                each.close()


@contextmanager
def running_emulator(folder: Path, *options: str) -> Iterator[Running]:
    """One emulated SIH quadrotor until the block ends; it has to end cleanly, and to have said
    nothing wrong.
    """
    companion, ground, agent, station = free_ports()
    fleet = folder / "fleet.toml"
    fleet.write_text(
        FLEET.format(companion=companion, ground=ground, agent=agent), encoding="utf-8"
    )
    words = [
        "-m",
        "sitl",
        "--fleet",
        str(fleet),
        "--no-bus",
        "--gcs",
        f"127.0.0.1:{station}",
        *options,
    ]
    with subprocess.Popen(
        [sys.executable, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        try:
            assert process.stdout.readline().startswith("ready: solo"), process.stderr.read()
            yield Running(
                process=process, fleet=fleet, companion=companion, ground=ground, station=station
            )
        finally:
            process.terminate()
            status = process.wait(10)
        assert (status, process.stderr.read()) == (0, "")


def wait_until_armable(emulator: Running, timeout_s: float = 60.0) -> None:
    """Listen where it streams to a ground station, without a word, until SYS_STATUS says ready to
    arm.
    """
    mav = common.MAVLink(None)
    mav.robust_parsing = True
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", emulator.station))
        listener.settimeout(timeout_s)
        while True:
            for message in mav.parse_buffer(listener.recv(4096)) or ():
                if (
                    message.get_type() == "SYS_STATUS"
                    and message.onboard_control_sensors_health & _PREARM
                ):
                    return
