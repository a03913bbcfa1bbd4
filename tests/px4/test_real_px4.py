"""Real PX4s from whoever has a build of them: ``make test-px4
PX4_BUILD=/path/to/PX4/build/px4_sitl_default``.
"""

from __future__ import annotations

import math
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from onboard.autopilot import Version
from onboard.config.fleet import FleetConfig
from tests.px4.build import Px4Build, Px4s, free_instances, is_taken
from tests.px4.flight import (
    Flight,
    break_in,
    end,
    fleet_of,
    flying,
    order,
    told,
    verdict,
    written,
)
from tests.px4.pilot import Pilot
from tests.px4.table import Table

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

_PAPER = Path(__file__).parents[2] / "configs/missions/paper.toml"
_SWAPS = """
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = 1.2
[[step]]
do = "formation"
name = "opposite"
position_enu_m = [0.0, 0.0, 1.2]
timeout_s = 60
[[step]]
do = "formation"
name = "ring"
position_enu_m = [0.0, 0.0, 1.2]
timeout_s = 60
[[step]]
do = "land"
timeout_s = 60
[expect]
min_separation_m = 0.80
arrived_within_m = 0.15
all_landed = true
[on_failure]
do = "land"
"""
_VERTICAL_M = 1.2  # of the fleet that passes on two heights
_CROSSING_S = 3.0  # into the formation of the paper's mission
_STATION = 14550
_MIN_M = 0.80  # the promise
_TOLD_WITHIN_S = 1.0


def _paper() -> str:
    return re.sub(r"(?m)^fleet = .*$", 'fleet = "fleet.toml"', _PAPER.read_text(encoding="utf-8"))


def test_px4_is_as_its_version_was_measured(build: Px4Build, table: Table, tmp_path: Path) -> None:
    (number,) = free_instances(1)
    words = ["sitl-check", f"udpin://127.0.0.1:{14540 + number}", "--wait", "30"]
    if not is_taken(_STATION):  # which all PX4s of a machine send to
        words += ["--gcs", f"udpin://127.0.0.1:{_STATION}"]
    check = subprocess.Popen(
        [sys.executable, "-m", "groundstation", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        time.sleep(2.5)  # boot facts: PX4 starts while the check waits
        with Px4s(build, tmp_path) as px4s:
            px4s.start(number, {})
            output, _ = check.communicate(timeout=800)
    finally:
        check.kill()
    different = re.findall(r"^X DIFFERS (\S+)", output, re.MULTILINE)
    counts = output.strip().rpartition("\n")[2]
    table.add(
        "`covey check endpoint`", f"{counts}{': ' + ', '.join(different) if different else ''}"
    )
    assert check.returncode in (0, 1), output
    assert len(different) <= 3, output  # on a busy machine a fact of time scatters


def test_the_papers_mission_is_flown(build: Px4Build, table: Table, tmp_path: Path) -> None:
    with flying(build, 3, tmp_path, _paper()) as flight:
        status = end(flight)
        table.add("three, the paper's mission", _success(flight))
        assert status == 0, flight.log
        assert flight.closest_m() >= 0.80


def test_six_swap_across_a_ring(build: Px4Build, table: Table, tmp_path: Path) -> None:
    with flying(build, 6, tmp_path, _SWAPS) as flight:
        status = end(flight)
        table.add("six change places across a ring, twice", _success(flight))
        assert status == 0, flight.log
        assert flight.closest_m() >= 0.80


def _on_two_heights(
    count: int, folder: Path, instances: list[int], version: Version | None
) -> FleetConfig:
    """Write the fleet file of the ring, whose vehicles pass each other on two heights."""
    data = tomllib.loads(fleet_of(count, folder, instances, version).text)
    data["fleet"]["vertical_separation_m"] = _VERTICAL_M
    data["fleet"]["geofence_m"]["z"] = [0.0, 4.0]
    data["law"]["passing_heights"] = 2
    return written(data, folder, instances)


def test_six_swap_across_a_ring_on_two_heights(
    build: Px4Build, table: Table, tmp_path: Path
) -> None:
    with flying(build, 6, tmp_path, _SWAPS, _on_two_heights) as flight:
        status = end(flight)
        highest_m = sorted(track[:, 3].max() for track in flight.tracks().values())
        table.add(
            "six change places across a ring, twice, and pass on two heights",
            f"{_success(flight)}; three of them up to {highest_m[3]:.1f} m",
        )
        assert status == 0, flight.log
        assert flight.closest_m() >= 0.80
        assert highest_m[2] < 1.2 + 0.3
        assert highest_m[3] > 1.2 + _VERTICAL_M


def _success(flight: Flight) -> str:
    judged = verdict(flight)
    distances_m = [arrival["distance_m"] for arrival in judged["arrivals"]]
    if None in distances_m:
        return "failed: not all have arrived"
    off_m = max(distances_m, default=math.nan)
    times = ", ".join(
        f"{step['duration_s']:.1f}" for step in judged["steps"] if "formation" in step["step"]
    )
    word = "passed" if judged["passed"] else "FAILED"
    return (
        f"{word}: closest {flight.closest_m():.2f} m, goals within {off_m:.2f} m, "
        f"formations in {times} s"
    )


def _kill_agent(flight: Flight) -> None:
    flight.agents["mav0"].kill()


def _hang_agent(flight: Flight) -> None:
    flight.agents["mav0"].send_signal(signal.SIGSTOP)
    time.sleep(4.0)
    flight.agents["mav0"].send_signal(signal.SIGCONT)


def _kill_px4(flight: Flight) -> None:
    flight.px4("mav0").kill()
    flight.lost.add("mav0")


def _stop_ground(flight: Flight) -> None:
    assert flight.ground is not None
    flight.ground.send_signal(signal.SIGSTOP)


_FAULTS: dict[str, Callable[[Flight], None]] = {
    "the agent of mav0 killed": _kill_agent,
    "the agent of mav0 stopped for 4 s": _hang_agent,
    "the PX4 of mav0 killed": _kill_px4,
    "the poses of all cut for 2 s": lambda flight: flight.cut_poses(2.0),
    "the poses of all cut for good": lambda flight: flight.cut_poses(),
    "the ground stopped": _stop_ground,
}


@pytest.mark.parametrize("what", _FAULTS)
def test_after_a_fault_in_the_crossing_nobody_touches_and_all_come_down(
    build: Px4Build, table: Table, tmp_path: Path, what: str
) -> None:
    with flying(build, 3, tmp_path, _paper()) as flight:
        break_in(flight, "formation", _CROSSING_S, _FAULTS[what])
        flight.wait_until_down()
        closest_m = flight.closest_m()
        down_s = flight.down_after_s()
        down = "all others" if flight.lost else "all"
        row = f"closest {closest_m:.2f} m, {down} down after {down_s:.1f} s"
        has_ground = what != "the ground stopped"
        told_s, sentence = told(flight, "formation", _CROSSING_S) if has_ground else (0.0, "")
        table.add(what, row + (f"; after {told_s:.1f} s: {sentence}" if has_ground else ""))
        assert closest_m >= _MIN_M, flight.log
        assert math.isfinite(down_s), flight.log
        assert told_s <= _TOLD_WITHIN_S, flight.log


def _height_m(flight: Flight, name: str) -> float:
    return float(flight.tracks()[name][-25:, 3].min())


def test_a_pilot_with_sticks_keeps_his_vehicle(
    build: Px4Build, table: Table, tmp_path: Path
) -> None:
    with flying(build, 3, tmp_path, _paper()) as flight:
        vehicle = flight.fleet.vehicles["mav0"]
        with Pilot(vehicle.direct or "", vehicle.system_id) as pilot:
            break_in(flight, "formation", _CROSSING_S, lambda _: pilot.take())
            status = end(flight)
            ended_s = time.monotonic() - flight.fault_s
            # longer than a lost ground waits before its agents land
            time.sleep(15.0)
            height_m = _height_m(flight, "mav0")
            others_m = max(_height_m(flight, name) for name in ("mav1", "mav2"))
        table.add(
            "a pilot takes mav0 with a joystick (POSCTL)",
            f"the mission ended after {ended_s:.0f} s; 15 s later mav0 was {height_m:.1f} m high, "
            f"the others down; closest {flight.closest_m():.2f} m",
        )
        assert status != 0
        assert "A pilot has mav0." in flight.log
        assert height_m > 0.4, flight.log
        assert others_m < 0.3, flight.log


def test_a_hold_of_a_second_ground_stays(build: Px4Build, table: Table, tmp_path: Path) -> None:
    with flying(build, 3, tmp_path, _paper()) as flight:
        held: list[int] = []
        break_in(
            flight, "formation", _CROSSING_S, lambda one: held.append(order(one, "hold", "all"))
        )
        time.sleep(15.0)
        assert flight.ground is not None
        is_beside = flight.ground.poll() is None
        lowest_m = min(_height_m(flight, name) for name in flight.fleet.enabled_names)
        landed = order(flight, "land", "all")
        status = end(flight)
        table.add(
            "a second ground orders hold in the crossing",
            f"15 s later the lowest was {lowest_m:.1f} m high and the first ground beside them; "
            f"landed by the second ground; closest {flight.closest_m():.2f} m",
        )
        assert held == [0], flight.log
        assert is_beside, flight.log
        assert lowest_m > 0.4, flight.log
        assert "has the fleet" in flight.log
        assert (landed, status) == (0, 1), flight.log
