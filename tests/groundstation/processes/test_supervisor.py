"""Ports that are free, files that say so, processes that never stay."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import msgspec
import pytest

from groundstation.processes.free_ports import (
    PX4_OFFSET,
    busy_ports,
    is_free,
    is_local,
    toml_text,
    with_free_ports,
)
from groundstation.processes.supervisor import ProcessError, Processes
from onboard.config.fleet import FleetConfig, fleet_from_mapping

SLEEPER = "print('ready: here', flush=True)\nimport time\ntime.sleep(60)\n"
LANDS_BEFORE_IT_ENDS = """
import signal, time

def end(*_):
    print("told to end", flush=True)
    time.sleep(0.3)
    print("landed", flush=True)
    time.sleep(0.3)
    raise SystemExit(0)

signal.signal(signal.SIGTERM, end)
print("ready", flush=True)
time.sleep(60)
"""
STUBBORN = "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\n" + SLEEPER


def module(folder: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> str:
    (folder / "covey_test_process.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return "covey_test_process"


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def pid_of(processes: Processes) -> int:
    return processes._started[0].process.pid


def test_free_ports_are_distinct_pairs_and_everything_else_stays(fleet: FleetConfig) -> None:
    made = fleet_from_mapping(with_free_ports(tomllib.loads(fleet.text), fleet))
    ports = [int(made.simulator_endpoint.rsplit(":", 1)[1])]
    for name, vehicle in made.vehicles.items():
        onboard = int(vehicle.autopilot.rsplit(":", 1)[1])
        ports += [int(vehicle.agent.rsplit(":", 1)[1]), onboard, onboard + PX4_OFFSET]
        ports.append(int((vehicle.direct or "").rsplit(":", 1)[1]))
        assert vehicle.start_enu_m == fleet.vehicles[name].start_enu_m
    assert len(set(ports)) == len(ports) == 13
    assert busy_ports(made) == []
    assert made.law == fleet.law


@pytest.mark.parametrize(
    ("key", "endpoint"),
    [
        ("agent", "tcp/192.168.1.11:7460"),
        ("autopilot", "serial:///dev/ttyAMA0:921600"),
        ("autopilot", "udpin://0.0.0.0:14549"),
        ("direct", "udpout://192.168.1.21:18570"),
    ],
)
def test_an_endpoint_of_another_computer_is_known(
    fleet: FleetConfig, key: str, endpoint: str
) -> None:
    data = tomllib.loads(fleet.text)
    data["vehicles"]["mav1"][key] = endpoint
    lab = fleet_from_mapping(data)
    assert is_local(fleet)
    assert not is_local(lab)
    assert is_local(fleet_from_mapping(with_free_ports(data, lab)))


def test_a_port_in_use_is_named_with_its_key(fleet: FleetConfig) -> None:
    made = fleet_from_mapping(with_free_ports(tomllib.loads(fleet.text), fleet))
    port = int(made.vehicles["mav1"].autopilot.rsplit(":", 1)[1]) + PX4_OFFSET
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        (sentence,) = busy_ports(made)
    assert "vehicles.mav1.autopilot" in sentence
    assert str(port) in sentence


def test_a_port_that_the_fleet_file_gives_to_two_is_named_with_both_keys(
    fleet: FleetConfig,
) -> None:
    made = fleet_from_mapping(with_free_ports(tomllib.loads(fleet.text), fleet))
    port = int(made.vehicles["mav0"].autopilot.rsplit(":", 1)[1]) + PX4_OFFSET
    mav2 = msgspec.structs.replace(made.vehicles["mav2"], direct=f"udpout://127.0.0.1:{port}")
    shared = msgspec.structs.replace(made, vehicles={**made.vehicles, "mav2": mav2})
    (sentence,) = busy_ports(shared)
    assert sentence == (
        f"'vehicles.mav2.direct' (udpout://127.0.0.1:{port}) needs UDP port {port}, which"
        " 'vehicles.mav0.autopilot' needs too."
    )


def test_an_emulated_px4_to_which_the_agent_sends_first_binds_no_second_port(
    fleet: FleetConfig,
) -> None:
    made = fleet_from_mapping(with_free_ports(tomllib.loads(fleet.text), fleet))
    mav0 = made.vehicles["mav0"]
    endpoint = mav0.autopilot.replace("udpin", "udpout")
    port = int(endpoint.rsplit(":", 1)[1]) + PX4_OFFSET
    vehicles = {
        **made.vehicles,
        "mav0": msgspec.structs.replace(mav0, autopilot=endpoint),
        "mav2": msgspec.structs.replace(made.vehicles["mav2"], direct=f"udpout://127.0.0.1:{port}"),
    }
    assert busy_ports(msgspec.structs.replace(made, vehicles=vehicles)) == []


def test_a_port_beyond_the_last_one_is_named_with_its_key(fleet: FleetConfig) -> None:
    mav0 = msgspec.structs.replace(fleet.vehicles["mav0"], autopilot="udpin://127.0.0.1:65510")
    moved = msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav0": mav0})
    (sentence,) = [line for line in busy_ports(moved) if "65550" in line]
    assert "'vehicles.mav0.autopilot'" in sentence
    assert "the last port is 65535" in sentence


def test_the_toml_that_is_written_reads_back_equal(fleet: FleetConfig) -> None:
    data = tomllib.loads(fleet.text)
    assert tomllib.loads(toml_text(data, "made\nby a test")) == data
    odd = {
        "a b": {'quo"te': 'back\\slash "and" \n newline', "list": [1, 2.5, True, {"x": "y"}]},
        "n": 1e-9,
    }
    assert tomllib.loads(toml_text(odd)) == odd


async def test_a_process_is_ready_when_it_says_so_and_ends_on_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes = Processes(tmp_path)
    processes.start("one", [module(tmp_path, SLEEPER, monkeypatch)])
    await processes.wait_for_line("one", "ready", 10.0)
    pid = pid_of(processes)
    assert is_running(pid)
    assert processes.dead() == []
    assert await processes.stop() == []
    assert not is_running(pid)
    processes.kill()


async def test_a_process_that_ignores_sigterm_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes = Processes(tmp_path)
    processes.start("stubborn", [module(tmp_path, STUBBORN, monkeypatch)])
    await processes.wait_for_line("stubborn", "ready", 10.0)
    pid = pid_of(processes)
    assert await processes.stop(timeout_s=0.2) == ["stubborn"]
    assert not is_running(pid)


async def test_routers_and_emulator_end_after_the_agents(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes = Processes(tmp_path)
    slow = module(tmp_path, LANDS_BEFORE_IT_ENDS, monkeypatch)
    for name in ("router0", "sitl"):
        processes.start(name, [slow], ends_last=True)
    processes.start("mav0", [slow])
    for name in processes.names:
        await processes.wait_for_line(name, "ready", 10.0)

    stopping = asyncio.create_task(processes.stop())
    await processes.wait_for_line("mav0", "landed", 10.0)
    for name in ("router0", "sitl"):
        assert "told to end" not in (tmp_path / f"{name}.log").read_text()
    assert await stopping == []


async def test_a_process_that_ends_early_is_told_with_the_end_of_its_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    processes = Processes(tmp_path)
    processes.start(
        "short", [module(tmp_path, "print('port 7 is taken')\nraise SystemExit(2)\n", monkeypatch)]
    )
    with pytest.raises(ProcessError, match="status 2") as caught:
        await processes.wait_for_line("short", "ready", 10.0)
    assert "port 7 is taken" in str(caught.value)
    assert [one.name for one in processes.dead()] == ["short"]
    await processes.stop()


def test_no_process_survives_a_parent_that_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = module(tmp_path, SLEEPER, monkeypatch)
    code = (
        "import sys, time; from pathlib import Path; from groundstation.processes.supervisor "
        "import Processes\n"
        f"p = Processes(Path({str(tmp_path)!r})); p.start('child', [{name!r}])\n"
        "print(p._started[0].process.pid, flush=True); time.sleep(60)\n"
    )
    path = f"{tmp_path}{os.pathsep}{Path(__file__).resolve().parents[3]}"
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline_s = time.monotonic() + 5.0
    while time.monotonic() < deadline_s and _is_alive(child):
        time.sleep(0.05)
    assert not _is_alive(child)


def _is_alive(pid: int) -> bool:
    """Also false for a zombie that nobody has collected."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_port_whose_last_connection_lingers_is_free_and_one_that_listens_is_not() -> None:
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        port = listener.getsockname()[1]
        assert not is_free(port, socket.SOCK_STREAM)
        with socket.create_connection(("127.0.0.1", port)) as client:
            served, _ = listener.accept()
            served.close()  # the side that closes first keeps the port in TIME_WAIT
            assert client.recv(1) == b""
    assert is_free(port, socket.SOCK_STREAM)


@pytest.mark.parametrize(
    ("text", "ending"),
    [
        (
            "import os, signal\nprint('in good health', flush=True)\nos.kill(os.getpid(), "
            "signal.SIGKILL)\n",
            "KILLED",
        ),
        (
            "raise SystemExit('No such port.')\n",
            "p ended by itself (status 1), see {log}: No such port.",
        ),
    ],
)
def test_who_was_killed_is_not_said_to_have_ended_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, ending: str
) -> None:
    processes = Processes(tmp_path)
    processes.start("p", [module(tmp_path, text, monkeypatch)])
    deadline = time.monotonic() + 20.0
    while not (dead := processes.dead()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    log = tmp_path / "p.log"
    expected = "p was ended by signal 9 (SIGKILL), see {log}" if ending == "KILLED" else ending
    assert dead[0].ending == expected.format(log=log)
