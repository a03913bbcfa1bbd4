"""More things that break while real PX4s cross each other's ways: each keeps the promise.

Run like the rest of this folder: ``make test-px4 PX4_BUILD=/path/to/PX4/build/px4_sitl_default``.
"""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink import mavutil

from tests.px4.build import Px4Build
from tests.px4.flight import Flight, break_in, flying

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

_MISSION = """
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = {height_m}
[[step]]
do = "formation"
name = "triangle"
position_enu_m = [0.0, 1.2, {height_m}]
timeout_s = 60
[[step]]
do = "land"
timeout_s = 60
[on_failure]
do = "land"
"""
_CROSSING_S = 3.0  # into the formation
_ARM_DISARM = 400  # MAV_CMD
_FORCE = 21196.0
_STALL_S = 1.5
_STAYS_S = 8.0  # that nobody lands after a hold by another ground


def _disarm(flight: Flight) -> None:
    """Stop the motors of mav0 in the air, as a kill switch does."""
    vehicle = flight.fleet.vehicles["mav0"]
    address = str(vehicle.direct).replace("udpout://", "udpout:")
    link = mavutil.mavlink_connection(address, source_system=255)
    for _ in range(3):
        link.mav.command_long_send(
            vehicle.system_id, 1, _ARM_DISARM, 0, 0.0, _FORCE, 0.0, 0.0, 0.0, 0.0, 0.0
        )
    link.close()


def _cut_ground(flight: Flight) -> None:
    assert flight.ground is not None
    flight.ground.kill()


def _hold_by_another_ground(flight: Flight) -> None:
    """The order stays, and so does the ground of the mission: Ctrl-C there lands all."""
    assert flight.ground is not None
    words = ("order", "--fleet", flight.fleet.path, "hold", "all")
    subprocess.run([sys.executable, "-m", "groundstation", *words], check=False, timeout=20)
    time.sleep(_STAYS_S)
    assert flight.ground.poll() is None
    assert "Nobody is landed from here; Ctrl-C lands all." in flight.log
    flight.ground.send_signal(signal.SIGINT)


_FAULTS: dict[str, Callable[[Flight], None]] = {
    "the motors of mav0 stopped": _disarm,
    "poses stall and come back old": lambda flight: flight.stall_poses(_STALL_S),
    "the ground killed": _cut_ground,
    "another ground orders hold": _hold_by_another_ground,
}


def _judge(flight: Flight) -> None:
    flight.wait_until_down()
    closest_m = flight.closest_m()
    down_s = flight.down_after_s()
    print(f"closest {closest_m:.2f} m, all down after {down_s:.1f} s")
    assert closest_m >= flight.fleet.fleet.safety_distance_m, flight.log
    assert math.isfinite(down_s), flight.log


@pytest.mark.parametrize("what", _FAULTS)
def test_after_a_fault_the_promise_is_kept_and_all_come_down(
    build: Px4Build, tmp_path: Path, what: str
) -> None:
    with flying(build, 3, tmp_path, _MISSION.format(height_m=1.0)) as flight:
        break_in(flight, "formation", _CROSSING_S, _FAULTS[what])
        _judge(flight)


@pytest.mark.parametrize("height_m", [1.0, 2.5])
@pytest.mark.parametrize("after_s", [1.0, 2.0, 3.0, 4.0])
def test_blinded_while_they_cross_they_keep_the_promise(
    build: Px4Build, tmp_path: Path, height_m: float, after_s: float
) -> None:
    with flying(build, 3, tmp_path, _MISSION.format(height_m=height_m)) as flight:
        break_in(flight, "formation", after_s, lambda flight: flight.cut_poses())
        _judge(flight)
