"""MAVSDK programs as users write them, against the emulator: each a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.clients.running import Running, running_emulator, wait_until_armable

pytest.importorskip("mavsdk")
_HERE = Path(__file__).parent


@pytest.fixture
def emulator(tmp_path: Path) -> Iterator[Running]:
    """A running emulator."""
    with running_emulator(tmp_path) as running:
        yield running


@pytest.fixture
def ready_emulator(emulator: Running) -> Running:
    """One that has been up for a while: MAVSDK shows a position two seconds before a PX4 can be
    armed.
    """
    wait_until_armable(emulator)
    return emulator


def seen_by(program: str, endpoint: str) -> dict[str, Any]:
    """What a program saw; it has to end well."""
    done = subprocess.run(
        [sys.executable, str(_HERE / f"mavsdk_{program}.py"), endpoint],
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def test_telemetry_shows_a_vehicle_on_its_pad(emulator: Running) -> None:
    seen = seen_by("telemetry", f"udpin://127.0.0.1:{emulator.companion}")
    assert (seen["armed"], seen["mode"], seen["landed"], seen["in_air"]) == (
        False,
        "HOLD",
        "ON_GROUND",
        False,
    )
    assert seen["health"] == [True, True, True]
    assert seen["position"][0] == pytest.approx(47.397742, abs=1e-4) == seen["home"][0]
    assert abs(seen["down_m"]) < 0.6
    assert seen["imu_down_m_s2"] == pytest.approx(-9.81, abs=1.0)
    assert seen["gps"][1].startswith("FIX_3D")
    assert seen["battery"] == [pytest.approx(16.2, abs=0.05), pytest.approx(100.0)]
    assert seen["version"] == [1, 17]
    assert seen["rate_hz"] > 70.0


def test_parameters_are_listed_read_and_set(emulator: Running) -> None:
    seen = seen_by("param", f"udpin://127.0.0.1:{emulator.companion}")
    assert seen["integers"] > 10
    assert seen["floats"] > 20
    assert seen["has"] == ["COM_OBL_RC_ACT", "COM_OF_LOSS_T", "EKF2_EV_CTRL", "MPC_THR_HOVER"]
    assert (seen["hover"], seen["hover_set"], seen["action_set"]) == (
        pytest.approx(0.5),
        pytest.approx(0.55),
        4,
    )
    assert seen["unknown"] == seen["kind"] == "ParamError"


def test_what_is_not_there_is_refused_cleanly_and_soon(emulator: Running) -> None:
    seen = seen_by("refused", f"udpin://127.0.0.1:{emulator.companion}")
    assert seen["upload"][0] != "done"
    assert seen["geofence"][0] != "done"
    assert seen["shell_answer"][0] == "silence"
    slow = {what: outcome for what, outcome in seen.items() if outcome[1] > 8.0}
    assert slow == {}


@pytest.mark.long
@pytest.mark.parametrize("link", ["companion", "ground"])
def test_takeoff_and_land_on_either_link(ready_emulator: Running, link: str) -> None:
    endpoints = {
        "companion": f"udpin://127.0.0.1:{ready_emulator.companion}",
        "ground": f"udpin://127.0.0.1:{ready_emulator.station}",
    }
    seen = seen_by("takeoff_and_land", endpoints[link])
    assert seen["altitude_m"] == pytest.approx(2.5)
    assert 2.0 < seen["height_m"] < 3.0
    assert "DENIED" in seen["disarm_in_air"].upper()
    assert seen["mode"] == "HOLD"
    assert seen["landed"]
    told = " / ".join(seen["texts"])
    for text in (
        "Armed by external command",
        "Takeoff detected",
        "Disarming denied",
        "Landing detected",
        "Disarmed by",
    ):
        assert text in told


@pytest.mark.long
def test_offboard_attitude(ready_emulator: Running) -> None:
    seen = seen_by("offboard_attitude", f"udpin://127.0.0.1:{ready_emulator.companion}")
    assert "SETPOINT" in seen["without_setpoint"].upper()
    assert seen["roll_+10"] == pytest.approx(10.0, abs=1.0)
    assert seen["roll_-10"] == pytest.approx(-10.0, abs=1.0)
    assert seen["after_stop"] == "HOLD"
    assert seen["landed"]


@pytest.mark.long
def test_offboard_position_and_velocity(ready_emulator: Running) -> None:
    seen = seen_by("offboard_position_velocity", f"udpin://127.0.0.1:{ready_emulator.companion}")
    assert seen["north_m"] == pytest.approx(3.0, abs=0.6)
    assert seen["yaw_deg"] == pytest.approx(90.0, abs=12.0)
    assert seen["north_m_s"] < -0.7
    assert seen["east_m_s"] > 0.7
    assert seen["landed"]
