"""The demo as a user runs it: real processes, real MAVLink over UDP, the real bus; judged by an
independent reader.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.flight.judge import min_separation_m, topics, truth

COVEY = [sys.executable, "-m", "groundstation"]
SAFETY_DISTANCE_M = 0.80
BODY_DIAMETER_M = 0.50

pytestmark = pytest.mark.timeout(240)


def demo(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [*COVEY, "demo", "--headless", "--record", str(folder), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=220, check=False, stdin=subprocess.DEVNULL
    )


def left_over(folder: Path) -> list[str]:
    """Command lines of processes that still use the flight's own fleet file."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (
                    (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                )
            except OSError:
                continue
            if str(folder) in line and "-m" in line and int(entry.name) != os.getpid():
                found.append(line)
    return found


def test_the_papers_flight_ends_well(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    done = demo(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    assert min_separation_m(folder) >= SAFETY_DISTANCE_M
    verdict = json.loads((folder / "verdict.json").read_text())
    assert verdict["worst_arrival_m"] <= 0.15
    assert set(verdict["landed"]) == {"mav0", "mav1", "mav2"}
    assert all(verdict["landed"].values())
    vehicles = {"mav0", "mav1", "mav2"}
    kinds = ("state", "telemetry", "tick", "event", "mocap", "truth")
    assert {f"{kind}/{name}" for kind in kinds for name in vehicles} <= topics(folder)
    for name in ("fleet.toml", "mission.toml", "events.txt", "orders.txt"):
        assert (folder / name).stat().st_size > 0, name
    for track in truth(folder).values():
        assert track[:, 3].max() > 0.9, "did not climb"
        assert track[-1, 3] < 0.1, "did not land"
        assert (len(track) - 1) / (track[-1, 0] - track[0, 0]) >= 45.0, "truth sampled too slowly"
    assert left_over(folder) == []


@pytest.mark.long  # lockstep flies the same in the quick tests
def test_without_the_law_they_collide(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    done = demo(folder, "--law", "off")
    assert done.returncode == 1, done.stdout + done.stderr
    assert min_separation_m(folder) < BODY_DIAMETER_M
    assert left_over(folder) == []


def test_ctrl_c_lands_and_leaves_no_process_and_no_key(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    keys = tmp_path / "keys"
    keys.mkdir()
    command = [*COVEY, "demo", "--secure", "--headless", "--record", str(folder)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "TMPDIR": str(keys)},
    )
    try:
        deadline = time.monotonic() + 60.0
        events = folder / "events.txt"
        while not (events.exists() and "order-takeoff" in events.read_text()):
            assert process.poll() is None, process.communicate()[0]
            assert time.monotonic() < deadline, "nobody flew"
            time.sleep(0.1)
        assert len(list(keys.rglob("*.key"))) == 9  # the bus of this flight is locked
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=60)
        assert process.returncode == 130, output
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    for name, track in truth(folder).items():
        assert track[-1, 3] < 0.1, f"{name} was left in the air"
    assert not list(keys.rglob("*.key"))
    assert not list(folder.rglob("*.key"))
    assert left_over(folder) == []
