"""Real agents killed, stopped, continued in flight: the others keep away, it lands, the ground says
which and why.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from onboard.exit_status import EXIT_FAILED, EXIT_MIXED
from tests.flight.judge import truth

BODY_DIAMETER_M = 0.50
LOST = "mav1"

pytestmark = pytest.mark.timeout(240)

# From their row they cross into a triangle: the one that is lost is in the others' way.
MISSION = """
schema = 1
fleet = "{fleet}"

[[step]]
do = "takeoff"
height_m = 1.0

[[step]]
do = "formation"
name = "triangle"
position_enu_m = [0.0, 1.2, 1.0]

[[step]]
do = "wait"
duration_s = 20.0

[[step]]
do = "land"

[expect]
all_landed = true
"""


@contextmanager
def flying(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A headless flight of three, from the moment at which all are up."""
    mission = folder / "mission.toml"
    fleet = Path(__file__).resolve().parents[2] / "configs" / "fleets" / "paper.toml"
    mission.write_text(MISSION.format(fleet=fleet), encoding="utf-8")
    record = folder / "flight"
    command = [
        sys.executable,
        "-m",
        "groundstation",
        "demo",
        "--headless",
        "--mission",
        str(mission),
    ]
    process = subprocess.Popen(
        [*command, "--record", str(record)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        deadline = time.monotonic() + 90.0
        events = record / "events.txt"
        while not (events.exists() and events.read_text().count("order-takeoff") >= 3):
            assert process.poll() is None, process.communicate()[0]
            assert time.monotonic() < deadline, "nobody flew"
            time.sleep(0.1)
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()


def agent_pid(folder: Path) -> int:
    """Process id of the agent to lose, found by its command line."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if (
                str(folder / "flight" / "fleet.toml") in words
                and "--vehicle" in words
                and LOST in words
            ):
                return int(entry.name)
    raise AssertionError(f"no agent of {LOST} runs")


def assert_everybody_is_down_and_nobody_was_hit(folder: Path) -> None:
    tracks = truth(folder / "flight")
    for name, track in tracks.items():
        assert track[:, 3].max() > 0.8, f"{name} never flew"
        assert track[-1, 3] < 0.1, f"{name} was left in the air"
    for (first, one), (second, other) in itertools.combinations(tracks.items(), 2):
        times = np.arange(max(one[0, 0], other[0, 0]), min(one[-1, 0], other[-1, 0]), 0.02)
        a, b = (
            [np.interp(times, track[:, 0], track[:, axis]) for axis in (1, 2, 3)]
            for track in (one, other)
        )
        is_flying = np.maximum(a[2], b[2]) > 0.1
        nearest_m = float(np.hypot(a[0] - b[0], a[1] - b[1])[is_flying].min())
        assert nearest_m > BODY_DIAMETER_M, f"{first} and {second} met"


@pytest.mark.long
def test_who_loses_its_agent_in_flight_lands_while_the_others_stay_away(tmp_path: Path) -> None:
    with flying(tmp_path) as process:
        time.sleep(1.5)  # on the way across
        os.kill(agent_pid(tmp_path), signal.SIGKILL)
        output, _ = process.communicate(timeout=120)
    assert process.returncode == 1, output
    assert f"{LOST} was ended by signal 9 (SIGKILL)" in output
    assert_everybody_is_down_and_nobody_was_hit(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("continued_after_s", [None, 2.0])
def test_who_hangs_in_flight_is_landed_and_named_even_if_it_comes_back(
    tmp_path: Path, continued_after_s: float | None
) -> None:
    with flying(tmp_path) as process:
        time.sleep(1.5)
        pid = agent_pid(tmp_path)
        os.kill(pid, signal.SIGSTOP)
        if continued_after_s is not None:
            time.sleep(continued_after_s)
            os.kill(pid, signal.SIGCONT)
        output, _ = process.communicate(timeout=120)
    # mixed, if the others have reached their slots meanwhile
    assert process.returncode in (EXIT_FAILED, EXIT_MIXED), output
    assert LOST in output.split("The mission ends here", 1)[-1], output
    assert_everybody_is_down_and_nobody_was_hit(tmp_path)
    if continued_after_s is not None:
        log = (tmp_path / "flight" / f"{LOST}.log").read_text()
        assert "PX4 lands" in log or "no more setpoints" in log
