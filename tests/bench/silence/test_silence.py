"""The benchmark of silence can say no: its listener is not blind, and its verdict knows what is
wrong.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from tests.bench.silence import wire
from tests.bench.silence.bench import CASES, LIMIT_S, Case, judge, main

MS = 1_000_000
FAULT_NS = 10_000 * MS
END_NS = 12_000 * MS
HANG = CASES[0]
GO_ON = next(case for case in CASES if case.limit_s is None and not case.lands)
LANDS = next(case for case in CASES if case.lands)


def setpoints(*ranges: tuple[int, int]) -> list[wire.Passed]:
    """Every 20 ms in these ranges [ms]."""
    return [
        wire.Passed(at * MS, "mav0", True) for begin, end in ranges for at in range(begin, end, 20)
    ]


def heartbeats(is_armed: bool) -> list[wire.Passed]:
    """Once a second, armed or not from 13 s on."""
    return [
        wire.Passed(at * MS, "mav0", False, is_armed or at < 13_000)
        for at in range(9000, 20_000, 1000)
    ]


@pytest.mark.parametrize(
    ("case", "passed", "is_right"),
    [
        (HANG, setpoints((8000, 10_000)) + heartbeats(False), True),
        (HANG, setpoints((8000, 10_090)) + heartbeats(False), True),
        (HANG, setpoints((8000, 10_140)) + heartbeats(False), False),  # too late
        # once, long after
        (HANG, setpoints((8000, 10_000), (11_000, 11_020)) + heartbeats(False), False),
        # takes it from PX4's landing
        (HANG, setpoints((8000, 10_000), (12_500, 12_520)) + heartbeats(False), False),
        (HANG, setpoints((8000, 10_000)) + heartbeats(True), False),  # never landed
        (GO_ON, setpoints((8000, 20_000)) + heartbeats(True), True),
        (GO_ON, setpoints((8000, 10_500), (11_000, 20_000)) + heartbeats(True), False),
        (LANDS, setpoints((8000, 14_000)) + heartbeats(False), True),
        (LANDS, setpoints((8000, 20_000)) + heartbeats(True), False),  # never landed
    ],
)
def test_the_verdict_knows_what_is_wrong(
    case: Case, passed: list[wire.Passed], is_right: bool
) -> None:
    assert judge(case, passed, FAULT_NS, END_NS).is_right is is_right


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[tuple[int, int, Path]]:
    """The listening process with one way; front port, agent's port and log."""
    ports = []
    for _ in range(3):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            ports.append(int(probe.getsockname()[1]))
    front, autopilot, agent = ports
    log = tmp_path / "wire.txt"
    command = [
        sys.executable,
        "-m",
        "tests.bench.silence.wire",
        str(log),
        f"mav0:{front}:{autopilot}:{agent}",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().strip() == "ready"
            yield front, agent, log
        finally:
            process.kill()


def test_the_listener_sees_a_sender_that_never_stops(listener: tuple[int, int, Path]) -> None:
    front, port, log = listener
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as px4,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as agent,
    ):
        agent.bind(("127.0.0.1", port))
        agent.settimeout(5.0)
        mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        px4.sendto(
            mav.heartbeat_encode(2, 12, 128 | 81, 6 << 16, 4).pack(mav), ("127.0.0.1", front)
        )
        _, way_back = agent.recvfrom(2048)
        target = mav.set_attitude_target_encode(
            0, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, 0.5
        ).pack(mav)
        other = mav.timesync_encode(0, 1).pack(mav)
        begin_ns = time.monotonic_ns()
        for _ in range(25):
            agent.sendto(other + target, way_back)  # two frames in one datagram
            time.sleep(0.02)
        end_ns = time.monotonic_ns()
        deadline = time.monotonic() + 10.0
        while len(wire.read(log)) < 26:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    heartbeat, *sent = wire.read(log)
    assert heartbeat.is_armed
    assert heartbeat.custom_mode >> 16 == 6
    assert [one.is_setpoint for one in sent] == [True] * 25
    assert all(begin_ns - MS <= one.stamp_ns <= end_ns + MS for one in sent)
    found = judge(HANG, wire.read(log), begin_ns, end_ns)
    assert not found.is_right
    assert found.silent_after_ms > 1e3 * LIMIT_S


@pytest.mark.long
@pytest.mark.timeout(240)
def test_the_wire_is_silent_however_an_agent_hangs() -> None:
    assert main([]) == 0
