"""The agent as a process: wrong input, taken endpoints, signals; and the timer that drives it."""

from __future__ import annotations

import asyncio
import datetime
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from groundstation.keys.secured_fleet import secure_fleet
from onboard.agent import loop
from onboard.agent.main import main
from onboard.agent.ticker import Ticker
from onboard.config.fleet import ConfigError, load_fleet
from onboard.process import realtime
from onboard.process.background_queue import BackgroundQueue

FLEET = """
schema = 1
[fleet]
name = "process-test-{agent}"
geofence_m = {{ x = [-5.0, 5.0], y = [-5.0, 5.0], z = [0.0, 3.0] }}
[vehicles.solo]
system_id = 1
start_enu_m = [0.0, 0.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{port}"
"""


def _free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@pytest.fixture
def fleet_file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    agent = _free_port(socket.SOCK_STREAM)
    port = _free_port(socket.SOCK_DGRAM)
    path.write_text(FLEET.format(agent=agent, port=port), encoding="utf-8")
    return path


def _start(fleet_file: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "onboard", "--fleet", str(fleet_file), "--vehicle", "solo"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _wait_for_port(fleet_file: Path) -> None:
    port = int(
        fleet_file.read_text(encoding="utf-8").split('agent = "tcp/127.0.0.1:')[1].split('"')[0]
    )
    deadline = time.monotonic() + 15.0
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise AssertionError("the agent does not listen")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_on_the_ground_a_signal_ends_the_agent_with_status_0(
    fleet_file: Path, number: signal.Signals
) -> None:
    with _start(fleet_file) as process:
        _wait_for_port(fleet_file)
        time.sleep(0.3)
        process.send_signal(number)
        assert process.wait(10) == 0


HANG_UP = signal.SIGHUP
TERMINATE = signal.SIGTERM


@pytest.mark.parametrize(
    ("numbers", "statuses"),
    [
        ([HANG_UP, HANG_UP, TERMINATE], []),
        ([TERMINATE, HANG_UP], []),
        ([HANG_UP, TERMINATE, TERMINATE], [130]),
    ],
)
def test_the_sighups_of_a_closed_terminal_do_not_end_an_agent_before_it_has_landed(
    fleet_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    numbers: list[signal.Signals],
    statuses: list[int],
) -> None:
    ended_at_once: list[int] = []

    async def started(_name: str, _start: object, stop_requested: asyncio.Event) -> bool:
        for number in numbers:
            signal.raise_signal(number)
            await asyncio.sleep(0.0)  # lets the loop read the signal
            await asyncio.sleep(0.0)  # lets it call the handler
        return not stop_requested.is_set()

    monkeypatch.setattr(loop, "started", started)
    monkeypatch.setattr(loop, "warm_up", lambda *_: None)
    monkeypatch.setattr(os, "_exit", ended_at_once.append)
    before = signal.signal(signal.SIGHUP, lambda *_: None)  # an unhandled one would end the tests
    try:
        agent = loop.AgentProcess(load_fleet(str(fleet_file)), "solo", apply_params=False)
        assert asyncio.run(agent.run()) == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert ended_at_once == statuses


def test_a_second_agent_for_the_same_vehicle_is_refused_in_words_with_status_2(
    fleet_file: Path,
) -> None:
    with _start(fleet_file) as first:
        _wait_for_port(fleet_file)
        with _start(fleet_file) as second:
            _, errors = second.communicate(timeout=20)
            assert second.returncode == 2
            assert "is in use" in errors
            assert "Traceback" not in errors
        assert first.poll() is None
        first.terminate()
        assert first.wait(10) == 0


def _without_device(fleet_file: Path) -> None:
    text = re.sub("udpin://.*[0-9]", "serial:///dev/covey-absent:921600", fleet_file.read_text())
    fleet_file.write_text(text, encoding="utf-8")


def _without_address(fleet_file: Path) -> None:
    # an address that no computer has (RFC 5737)
    text = fleet_file.read_text().replace("tcp/127.0.0.1", "tcp/192.0.2.1")
    fleet_file.write_text(text, encoding="utf-8")


def _with_keys_of_tomorrow(fleet_file: Path) -> None:
    text = fleet_file.read_text().replace("tcp/", "quic/")
    fleet_file.write_text(text, encoding="utf-8")
    tomorrow = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=2)
    secure_fleet(str(fleet_file), tomorrow)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_without_device, "or correct 'autopilot' of this vehicle"),
        (_without_address, "No network interface of this computer has this address"),
        (_with_keys_of_tomorrow, "Set the clock"),
    ],
)
def test_what_a_booting_computer_mends_is_waited_for_until_a_signal(
    fleet_file: Path, spoil: Callable[[Path], None], words: str
) -> None:
    spoil(fleet_file)
    with _start(fleet_file) as process:
        assert process.stderr is not None
        assert words in process.stderr.readline()
        assert "tries again" in process.stderr.readline()
        process.send_signal(signal.SIGHUP)
        assert process.wait(10) == 0


def test_an_endpoint_that_can_never_be_right_ends_the_agent_with_status_2(
    fleet_file: Path, tmp_path: Path
) -> None:
    no_device = tmp_path / "tty"
    no_device.touch()
    text = re.sub("udpin://.*[0-9]", f"serial://{no_device}:921600", fleet_file.read_text())
    fleet_file.write_text(text, encoding="utf-8")
    with _start(fleet_file) as process:
        _, errors = process.communicate(timeout=20)
        assert process.returncode == 2
        assert "is no serial device" in errors


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--fleet", "/nowhere/fleet.toml", "--vehicle", "solo"], "no such fleet file"),
        (["--fleet", "FILE", "--vehicle", "nobody"], "nobody"),
        (["--fleet", "FILE", "--vehicle", "3"], "selects no vehicle"),
    ],
)
def test_wrong_input_is_a_sentence_and_status_2(
    fleet_file: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status = main([str(fleet_file) if word == "FILE" else word for word in arguments])
    assert status == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("written", "levels", "words"),
    [
        ("debug", ["DEBUG"], "stopped by the test"),
        ("loud", [], "COVEY_LOG is 'loud', which is no level of the log. Write debug, info,"),
    ],
)
def test_the_level_of_the_log_is_written_in_any_letters_or_refused_in_words(
    fleet_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    written: str,
    levels: list[str],
    words: str,
) -> None:
    chosen: list[str] = []

    def log_in_thread(_name: str, level: str) -> Mock:
        chosen.append(level)
        return Mock()

    monkeypatch.setenv("COVEY_LOG", written)
    monkeypatch.setattr(realtime, "log_in_thread", log_in_thread)
    stopping = Mock(side_effect=ConfigError("stopped by the test"))
    monkeypatch.setattr(loop, "credentials_of", stopping)
    assert main(["--fleet", str(fleet_file), "--vehicle", "solo"]) == 2
    assert chosen == levels
    assert words in capsys.readouterr().err


async def test_the_ticker_keeps_an_absolute_schedule_and_counts_what_comes_late() -> None:
    stamps: list[int] = []

    def tick() -> None:
        stamps.append(time.monotonic_ns())
        if len(stamps) == 10:
            time.sleep(0.05)  # a blocked loop: two ticks are due at once and become one

    ticker = Ticker(20_000_000, tick, offset_ns=3_000_000)
    ticker.start(asyncio.get_running_loop())
    for _ in range(500):
        if len(stamps) >= 30:
            break
        await asyncio.sleep(0.02)
    ticker.stop()
    ticker.stop()
    assert ticker.late_ticks >= 1
    assert ticker.missed_ticks >= 1
    assert 0.0 <= ticker.lateness_p99_ms() < 20.0
    median, _, longest = ticker.statistics_ms()
    assert 0.0 < median < longest
    assert longest > 45.0


def test_a_background_queue_keeps_the_order_drops_what_is_too_much_and_survives_what_fails(
    caplog: pytest.LogCaptureFixture,
) -> None:
    background = BackgroundQueue("test", most=3)
    done: list[Any] = []
    gate = threading.Event()
    assert background.submit(gate.wait, 5.0)
    assert background.submit(done.append, 1)
    assert background.submit(done.append)  # one argument too few
    assert not background.submit(done.append, 2)  # a hung bus: whoever submits goes on
    assert background.dropped == 1
    gate.set()
    while not background.submit(done.append, 3):
        time.sleep(0.01)
    background.stop()
    background.stop()
    assert done == [1, 3]
    assert "left undone: TypeError" in caplog.text


def test_a_reader_of_the_log_that_hangs_does_not_hold_up_who_logs() -> None:
    program = (
        "import logging, time\n"
        "from onboard.process.realtime import log_in_thread\n"
        "lines = log_in_thread('mav0', 'INFO')\n"
        # a megabyte; a pipe holds 64 kB
        "for _ in range(5000): logging.getLogger('covey').info('x' * 200)\n"
        "print('done', flush=True)\n"
        "time.sleep(60)\n"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "done\n"
        finally:
            process.kill()


def test_the_loop_goes_first_where_it_may_its_helpers_next_and_what_it_starts_later_does_not() -> (
    None
):
    program = """
import os, threading
from onboard.process import realtime as process
there, end = threading.Event(), threading.Event()
before = threading.Thread(target=lambda: (there.set(), end.wait()))
before.start(); there.wait()
said, found = process.set_realtime_priority(), []
after = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0)))
after.start(); after.join()
own = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
priority = os.sched_getparam(before.native_id).sched_priority
is_next = 0 < priority < os.sched_getparam(0).sched_priority
end.set()
print(own == os.SCHED_FIFO, is_next, found == [os.SCHED_OTHER], said)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=30.0, check=True
    )
    has_it, helpers_are_next, others_do_not, said = ended.stdout.split(" ", 3)
    assert others_do_not == "True"
    assert helpers_are_next == has_it
    assert said.startswith(
        "The loop runs with real-time priority" if has_it == "True" else "The loop runs without"
    )


def test_a_loop_that_goes_first_and_never_pauses_is_ended_and_its_log_says_where() -> None:
    program = """
import time
from onboard.process import realtime as process
process.end_when_hung()
if "without" not in process.set_realtime_priority():
    end_s = time.monotonic() + 10.0
    while time.monotonic() < end_s: pass
    print("still there")
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=30.0, check=False
    )
    assert ended.stdout == ""
    if ended.returncode != 0:  # otherwise precedence is not allowed here
        assert ended.returncode == -signal.SIGXCPU
        assert 'File "<string>", line 7 in <module>' in ended.stderr
