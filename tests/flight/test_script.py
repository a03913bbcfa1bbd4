"""A blocking script with real processes, ended by a signal: the fleet is left in the declared
state.
"""

from __future__ import annotations

import json
import signal
import subprocess
from pathlib import Path

import pytest

from tests.flight.test_demo import COVEY, left_over

SCRIPT = """
import time

from groundstation import BlockingFleet

fleet = BlockingFleet(at_end="land")
fleet.takeoff(0.6, fleet.names[0])
print("up", flush=True)
time.sleep(60)
"""


@pytest.mark.long
@pytest.mark.timeout(120)
def test_a_script_that_is_interrupted_lands_its_fleet_and_leaves_no_process(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    folder = tmp_path / "flight"
    script.write_text(SCRIPT, encoding="utf-8")
    command = [*COVEY, "run", str(script), "--fleet", "paper", "--sitl", "--record", str(folder)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        assert process.stdout is not None
        before = []
        for line in process.stdout:
            before.append(line)
            if line.startswith("up"):
                break
        process.send_signal(signal.SIGINT)
        after = process.stdout.read()
        status = process.wait(60.0)
    assert status == 130, "".join(before) + after
    assert "Landing mav0." in after
    verdict = json.loads((folder / "verdict.json").read_text())
    assert all(verdict["landed"].values())
    assert left_over(folder) == []
