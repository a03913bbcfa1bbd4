"""A show outdoors with real PX4s: positions by satellites, a field with corners, a pause, and home.

With PX4 v1.18, whose simulator has wind, in wind.
"""

from __future__ import annotations

import itertools
import math
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest

from onboard.autopilot import Version
from onboard.config.areas import nearest
from onboard.config.earth import latitude_longitude_deg
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.config.flight_space import flight_space_of
from tests.px4.build import Px4Build
from tests.px4.flight import Flight, break_in, end, flying, order, written
from tests.px4.table import Table

pytestmark = [pytest.mark.long, pytest.mark.timeout(900)]

_ROOT = Path(__file__).parents[2]
_FIELD_ENU_M = [(-9.0, -8.0), (9.0, -8.0), (9.0, 6.0), (4.0, 11.0), (-9.0, 11.0)]
_BUFFER_M = 1.5
# what each vehicle flies from its spot, all beside each other
_CORNERS_M = [(0.0, 0.0), (0.0, 5.0), (-1.0, 8.0), (-3.0, 8.0), (-3.0, 3.0), (0.0, 0.0)]
_HEIGHT_M = 2.5
_SPEED_M_S = 0.4
_STEP_S = 0.5
_REST_S = 2.0
_MISSION = f"""
schema = 1
fleet = "fleet.toml"
[[step]]
do = "takeoff"
height_m = {_HEIGHT_M}
timeout_s = 60
[[step]]
do = "follow_path"
timeout_s = 120
[step.paths]
mav0 = "mav0.csv"
mav1 = "mav1.csv"
mav2 = "mav2.csv"
[[step]]
do = "land"
timeout_s = 90
[expect]
min_separation_m = 1.20
all_landed = true
[on_failure]
do = "land"
"""
_BEGUN_S = 12.0  # into the step: the paths are loaded, and all fly along them
_PAUSED_S = 8.0
_GONE_ON_S = 6.0
_BRAKED_S = 3.0  # from the order to pause
_STANDS_M_S = 0.5  # by satellites a vehicle that holds moves with its estimate's errors
_GOES_ON_M = 1.0  # of the 2.4 m that the path goes on; by satellites a vehicle may be 0.5 m off
_HOME_M = 1.2
_PROMISE_M = 1.20
_WIND = {"SIH_WIND_N": 1.5, "SIH_WIND_E": 1.0}
_WITH_WIND = (1, 18)


def _outdoors(
    count: int, folder: Path, instances: list[int], version: Version | None
) -> FleetConfig:
    """Write the fleet file of configs/fleets/px4-sitl.toml, in a field with five corners."""
    path = _ROOT / "configs/fleets/px4-sitl.toml"
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    assert len(data["vehicles"]) == count
    if version == (1, 18):
        data["defaults"]["type"] = "sih118"
    for table, number in zip(data["vehicles"].values(), instances, strict=True):
        table["system_id"] = number + 1

    origin = fleet_from_mapping(data).fleet.global_origin
    assert origin is not None
    corners_deg = [
        latitude_longitude_deg(origin, east_m=east, north_m=north) for east, north in _FIELD_ENU_M
    ]
    field = {
        "name": "field",
        "keep": "in",
        "polygon_deg": [list(corner) for corner in corners_deg],
        "height_m": [-1.0, 9.0],
        "buffer_m": _BUFFER_M,
    }
    data["fences"] = [field]
    return written(data, folder, instances)


def _write_path(spot_enu_m: tuple[float, float, float], path: Path) -> None:
    """Write a path along the corners, from one vehicle's spot and back to it."""
    lines = ["t,x,y,z"]
    time_s = 0.0

    def add(east_m: float, north_m: float) -> None:
        x, y = spot_enu_m[0] + east_m, spot_enu_m[1] + north_m
        lines.append(f"{time_s:.2f},{x:.3f},{y:.3f},{_HEIGHT_M}")

    add(*_CORNERS_M[0])
    time_s += _REST_S
    for first, second in itertools.pairwise(_CORNERS_M):
        length_m = float(np.hypot(second[0] - first[0], second[1] - first[1]))
        pieces = max(1, round(length_m / (_SPEED_M_S * _STEP_S)))
        for share in np.arange(pieces) / pieces:
            east, north = np.array(first) + share * (np.array(second) - np.array(first))
            add(east, north)
            time_s += _STEP_S
    add(*_CORNERS_M[-1])
    time_s += _REST_S
    add(*_CORNERS_M[-1])
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _speeds_m_s(flight: Flight, seconds: float) -> list[float]:
    """The mean horizontal speed of each vehicle within the last seconds, by PX4's truth."""
    speeds = []
    for track in flight.tracks().values():
        last = track[track[:, 0] > track[-1, 0] - seconds]
        speeds.append(float(np.hypot(last[:, 4], last[:, 5]).mean()))
    return speeds


def _ways_m(flight: Flight, seconds: float) -> list[float]:
    """The way that each vehicle has made within the last seconds, by PX4's truth."""
    ways = []
    for track in flight.tracks().values():
        last = track[track[:, 0] > track[-1, 0] - seconds]
        ways.append(float(np.hypot(*(last[-1, 1:3] - last[0, 1:3]))))
    return ways


def _room_m(flight: Flight) -> float:
    """The least distance of any vehicle to the field's edge, by PX4's truth; negative outside."""
    (field,) = flight_space_of(flight.fleet).areas
    return min(
        nearest(field, float(east), float(north)).room_m
        for track in flight.tracks().values()
        for east, north in track[::5, 1:3]
    )


def _survey(flight: Flight) -> int:
    words = ("import", "spots", "--fleet", flight.fleet.path, "--seconds", "10")
    command = [sys.executable, "-m", "groundstation", *words]
    return subprocess.run(command, check=False, timeout=90.0).returncode


def test_a_show_in_a_field_is_paused_goes_on_and_comes_home(
    build: Px4Build, table: Table, tmp_path: Path
) -> None:
    """Three by satellites fly along a polygon, pause, go on, pause and are brought home."""
    spots = tomllib.loads((_ROOT / "configs/fleets/px4-sitl.toml").read_text(encoding="utf-8"))
    for name, vehicle in spots["vehicles"].items():
        _write_path(vehicle["start_enu_m"], tmp_path / f"{name}.csv")
    wind = _WIND if build.version == _WITH_WIND else None

    # truth is wanted here, and no poses
    (tmp_path / "cut").touch()
    with flying(build, 3, tmp_path, _MISSION, _outdoors, wind) as flight:
        answers: list[int] = []
        break_in(
            flight, "follow_path", _BEGUN_S, lambda one: answers.append(order(one, "pause", "all"))
        )
        time.sleep(_PAUSED_S)
        paused_m_s = _speeds_m_s(flight, _PAUSED_S - _BRAKED_S)

        answers.append(order(flight, "resume", "all"))
        time.sleep(_GONE_ON_S)
        gone_on_m = _ways_m(flight, _GONE_ON_S)

        answers.append(order(flight, "pause", "all"))
        time.sleep(_BRAKED_S)
        answers.append(order(flight, "bring", "home", "all"))
        status = end(flight)
        flight.wait_until_down()

        homes = [np.array(one.start_enu_m[:2]) for one in flight.fleet.vehicles.values()]
        ends = [track[-1, 1:3] for track in flight.tracks().values()]
        from_home_m = max(min(float(np.hypot(*(e - h))) for h in homes) for e in ends)
        down_s = flight.down_after_s()
        room_m = _room_m(flight)
        closest_m = flight.closest_m()
        surveyed = _survey(flight)

        in_wind = "" if wind is None else f", in wind of {math.hypot(*wind.values()):.1f} m/s"
        table.add(
            f"a show in a field of five corners, by satellites{in_wind}: pause, resume, pause, "
            "bring home",
            f"all stood while paused ({max(paused_m_s):.2f} m/s in the mean at most) and went on; "
            f"down {from_home_m:.2f} m from a spot at most; {room_m:.2f} m from the fence; "
            f"closest {closest_m:.2f} m",
        )
        assert answers == [0, 0, 0, 0], flight.log
        assert max(paused_m_s) < _STANDS_M_S, flight.log
        assert min(gone_on_m) > _GOES_ON_M, flight.log
        assert status == 1, flight.log
        assert np.isfinite(down_s), flight.log
        assert from_home_m < _HOME_M, flight.log
        assert room_m > 0.0, flight.log
        assert closest_m >= _PROMISE_M, flight.log
        assert surveyed == 0, flight.log
