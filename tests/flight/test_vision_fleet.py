"""A fleet by visual odometry as a user runs it: real processes, real MAVLink over UDP."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from groundstation.processes.free_ports import toml_text
from tests.flight.judge import min_separation_m

_SIH = Path(__file__).parents[2] / "configs/fleets/sih.toml"
_SAFETY_DISTANCE_M = 0.80
_PX4_PARAMS = {
    "EKF2_EV_CTRL": 11,
    "EKF2_HGT_REF": 3,
    "EKF2_GPS_CTRL": 0,
    "EKF2_MAG_TYPE": 5,
    "EKF2_EVP_NOISE": 0.01,
    "EKF2_TAU_VEL": 0.02,
    "EKF2_TAU_POS": 0.1,
}
_CROSSING = """
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = 1.0
[[step]]
do = "fault"
name = "vision_lost"
vehicles = "mav1"
after_s = 1.5
duration_s = 0.7
[[step]]
do = "formation"
name = "triangle"
position_enu_m = [0.0, 0.0, 1.0]
[[step]]
do = "land"
[expect]
arrived_within_m = 0.5
all_landed = true
"""

pytestmark = pytest.mark.timeout(180)


def _write_fleet(folder: Path) -> None:
    data = tomllib.loads(_SIH.read_text())
    for table in data["types"].values():
        table["mocap_required"] = False
        table["px4_position"] = "vision"
        table.setdefault("px4_params", {}).update(_PX4_PARAMS)
    (folder / "fleet.toml").write_text(toml_text(data))
    (folder / "crossing.toml").write_text(_CROSSING)


def test_a_fleet_by_vision_crosses_while_one_camera_is_blind_for_a_moment(
    tmp_path: Path,
) -> None:
    _write_fleet(tmp_path)
    record = tmp_path / "flight"
    done = subprocess.run(
        [
            *(sys.executable, "-m", "groundstation", "fly", str(tmp_path / "crossing.toml")),
            *("--sitl", "--headless", "--record", str(record)),
        ],
        capture_output=True,
        text=True,
        timeout=150,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert min_separation_m(record) >= _SAFETY_DISTANCE_M

    verdict = json.loads((record / "verdict.json").read_text())
    assert all(verdict["landed"].values())
    assert "Own position stale" in (record / "events.txt").read_text()
