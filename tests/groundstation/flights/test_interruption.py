"""Interruption of a Python mission that blocks the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from groundstation.client.client import FleetClient
from groundstation.flights import interruption
from groundstation.flights.interruption import listen, listen_no_more
from groundstation.mission_files.loading import load_mission
from groundstation.missions.runner import MissionRun
from onboard.config.fleet import FleetConfig

MISSION = """
import time

async def mission(fleet):
    await fleet.takeoff(1.0)
    fleet.say("blocks")
    {blocks}
"""


def press_twice() -> None:
    for _ in range(2):
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("blocks", ["time.sleep(60.0)", "while True: pass"])
async def test_two_interrupts_of_a_mission_that_blocks_land_the_vehicles_at_once(
    fleet: FleetConfig, bus: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blocks: str
) -> None:
    (tmp_path / "blocking.py").write_text(MISSION.format(blocks=blocks), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    client = FleetClient(fleet, bus=bus)
    await client.start()

    def say(line: str) -> None:
        if line == "blocks":
            threading.Timer(0.3, press_twice).start()

    run = MissionRun(load_mission("blocking.py", fleet), client, say=say)
    heard: list[float] = []

    def on_signal() -> None:
        heard.append(time.monotonic())
        run.interrupt()

    for name in fleet.enabled_names:
        bus.tell(name)
    listen(run.mission.path, on_signal)
    try:
        verdict = await run.run()
    finally:
        listen_no_more()
        await client.stop()
    assert len(heard) == 1, "two presses while the loop was blocked are one"
    assert verdict.exit_status == 130
    assert {order.kind for _, order in bus.orders[-3:]} == {"land"}
    assert not client.state.airborne_names


async def test_a_mission_beside_the_packages_of_a_clone_is_ended_as_well() -> None:
    """``my_mission.py`` of the README lies in the clone, as the project's own code does."""
    path = str(Path(interruption.__file__).parents[2] / "my_mission.py")
    blocks = compile("import time\ntime.sleep(20.0)", path, "exec")

    listen(path, lambda: None)
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    begin_s = time.monotonic()
    try:
        with pytest.raises(asyncio.CancelledError):
            exec(blocks, {})
    finally:
        listen_no_more()
    assert time.monotonic() - begin_s < 10.0


async def test_a_second_interrupt_is_told_while_the_loop_has_not_handled_the_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(interruption, "_BLOCKED_S", 0.2)
    heard: list[str] = []

    def press() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.3)  # nothing is awaited meanwhile

    listen("mission.py", lambda: heard.append("on the loop"), lambda: heard.append("blocked"))
    try:
        press()
        assert heard == []
        press()
        assert heard == ["blocked"]

        await asyncio.sleep(0.05)
        assert heard == ["blocked", "on the loop"]
        press()
        assert heard == ["blocked", "on the loop"], "the loop was free before this one"
    finally:
        listen_no_more()


def _errors_of_interrupted(process: subprocess.Popen[str]) -> str:
    """Interrupt a process until it ends, and return what it wrote to stderr.

    A busy computer may take two signals that were sent a second apart as one.
    """
    for _ in range(10):
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            _, errors = process.communicate(timeout=1.5)
            return errors
    raise AssertionError("ten interrupts did not end it")


@pytest.mark.realtime
def test_a_mission_that_never_awaits_is_ended_by_the_second_interrupt(tmp_path: Path) -> None:
    (tmp_path / "spins.py").write_text(
        "FLEET = 'paper'\nEXPECT = {'all_landed': True}\n\n\n"
        "async def mission(fleet):\n    print('spins', flush=True)\n"
        "    while True:\n        fleet.names\n",
        encoding="utf-8",
    )
    words = [sys.executable, "-m", "groundstation", "demo", "--headless", "--mission", "spins.py"]
    process = subprocess.Popen(
        words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert any("spins" in line for line in process.stdout)
        errors = _errors_of_interrupted(process)
    finally:
        process.kill()
    assert process.returncode == 130
    assert "never awaits" in errors
