"""What a mission's findings say about steps in which vehicles follow paths."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.client.client import FleetClient
from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.missions.api import Fleet
from groundstation.paths.path_files import load_path
from onboard.config.fleet import ConfigError, FleetConfig, parking_distance_m
from onboard.config.obstacles import Circle, Obstacle
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.finding import Finding
from onboard.feasibility.pair_checks import parking_m
from onboard.tuples import Xyz

UP = {"do": "takeoff", "height_m": 1.0}
LAND = {"do": "land"}


def path_file(file: Path, *points: Xyz, seconds: float = 20.0) -> str:
    """Write a path through points, with the same time between each two, and return its name."""
    lines = ["t,x,y,z"]
    for index, (x, y, z) in enumerate(points):
        lines.append(f"{index * seconds},{x},{y},{z}")
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file.name


def found(
    name: str, fleet: FleetConfig, folder: Path, *steps: dict[str, Any], **options: Any
) -> list[Finding]:
    """Return the findings of a mission that have a name."""
    mission = mission_from_mapping(
        {"schema": 1, "step": list(steps)}, path=str(folder / "test.toml"), fleet=fleet
    )
    findings = mission_findings(mission, **options)
    return [one for one in findings if one.name == name]


def high(fleet: FleetConfig) -> FleetConfig:
    """Return the fleet below a ceiling of 30 m."""
    fence = replace(fleet.fleet.geofence_m, z=(0.0, 30.0))
    return replace(fleet, fleet=replace(fleet.fleet, geofence_m=fence))


def test_a_descent_without_poses_is_judged_from_the_highest_point_of_a_path(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    steps = {}
    for top_m in (2.0, 14.0):
        top = path_file(tmp_path / f"{top_m}.csv", (0, 0, 1), (0, 0, top_m), (0, 0, 1))
        steps[top_m] = {"do": "follow_path", "paths": {"mav1": top}}

    (low,) = found("descent without poses", high(fleet), tmp_path, UP, steps[2.0], LAND)
    assert low.status == "ok"
    (far,) = found("descent without poses", high(fleet), tmp_path, UP, steps[14.0], LAND)
    assert far.status == "warning"
    assert "Step[1] (follow_path): when all poses stop, mav1 is down from 14.0 m" in far.sentence

    up_alone = {**UP, "vehicles": "mav1"}
    assert not found("descent without poses", high(fleet), tmp_path, up_alone, steps[14.0], LAND)


def test_no_vehicle_rises_above_the_highest_point_of_its_path(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    passing = high(fleet)
    passing = replace(
        passing,
        fleet=replace(passing.fleet, vertical_separation_m=1.2),
        law=replace(passing.law, passing_heights=2),
    )
    top = path_file(tmp_path / "top.csv", (0, 0, 1), (0, 0, 4), (0, 0, 1))
    follow = {"do": "follow_path", "paths": {"mav1": top}}

    (finding,) = found("descent without poses", passing, tmp_path, UP, follow, LAND)
    assert "mav1 is down from 4.0 m" in finding.sentence


def test_the_spacing_of_paths_depends_on_the_accuracy_of_positions(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    paths = {
        "mav0": path_file(tmp_path / "mav0.csv", (-0.7, -1.5, 1), (-0.7, 0, 1)),
        "mav1": path_file(tmp_path / "mav1.csv", (0.7, -1.5, 1), (0.7, 0, 1)),
    }
    follow = {"do": "follow_path", "paths": paths}

    (by_mocap,) = found("path spacing", fleet, tmp_path, UP, follow, LAND)
    assert by_mocap.status == "ok"
    assert by_mocap.bound == pytest.approx(parking_distance_m(fleet) - 0.10, abs=1e-4)
    (by_gps,) = found("path spacing", fleet, tmp_path, UP, follow, LAND, errors="gps")
    assert by_gps.status == "refused"
    wider_m = parking_m(fleet, ACCURACIES["gps"]) - parking_m(fleet, ACCURACIES["mocap"])
    assert wider_m > 1.0
    assert by_gps.bound == pytest.approx(by_mocap.bound + wider_m, abs=1e-3)
    assert "with estimates as accurate as 'gps'" in by_gps.sentence


def test_paths_above_each_other_need_more_height_by_satellites(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    stacked = replace(fleet, fleet=replace(fleet.fleet, vertical_separation_m=1.2))
    paths = {
        "mav0": path_file(tmp_path / "mav0.csv", (0, 0, 0.8), (0, 1, 0.8)),
        "mav1": path_file(tmp_path / "mav1.csv", (0, 0, 2.4), (0, 1, 2.4)),
    }
    follow = {"do": "follow_path", "paths": paths}

    statuses = []
    for errors in ("mocap", "gps"):
        (finding,) = found("path spacing", stacked, tmp_path, UP, follow, LAND, errors=errors)
        statuses.append(finding.status)
    assert statuses == ["ok", "refused"]


@pytest.mark.parametrize(("margin_m", "status"), [(0.0, "ok"), (0.2, "ok"), (0.5, "refused")])
def test_a_path_keeps_the_laws_own_margin_to_the_fence(
    fleet: FleetConfig, tmp_path: Path, margin_m: float, status: str
) -> None:
    wide = replace(fleet, law=replace(fleet.law, fence_margin_m=margin_m))
    near = path_file(tmp_path / "near.csv", (0, 0, 1), (0, 3.6, 1), (0, 0, 1))  # fence at 4 m
    follow = {"do": "follow_path", "paths": {"mav1": near}}

    (finding,) = found("path room to the fence", wide, tmp_path, UP, follow, LAND)
    assert finding.status == status
    assert finding.bound == max(0.15, margin_m)


@pytest.mark.parametrize(
    ("timeout_s", "status"), [(None, "ok"), (54.0, "ok"), (53.0, "warning"), (30.0, "refused")]
)
def test_the_time_limit_of_a_step_is_compared_with_its_longest_path(
    fleet: FleetConfig, tmp_path: Path, timeout_s: float | None, status: str
) -> None:
    paths = {
        "mav1": path_file(tmp_path / "mav1.csv", (0, 0, 1), (0, 2, 1), seconds=40.0),
        "mav2": path_file(tmp_path / "mav2.csv", (2, 0, 1), (2, 1, 1)),
    }
    follow: dict[str, Any] = {"do": "follow_path", "paths": paths}
    if timeout_s is not None:
        follow["timeout_s"] = timeout_s

    (finding,) = found("time", fleet, tmp_path, UP, follow, LAND)
    assert finding.status == status
    if status == "refused":
        assert "timeout_s is 30 s; mav1's path takes 40.5 s, so at least 53.5 s leaves room" in (
            finding.sentence
        )


def around(fleet: FleetConfig, obstacle: Obstacle) -> FleetConfig:
    """Return the fleet in a wide fence with an obstacle."""
    fence = replace(fleet.fleet.geofence_m, x=(-6.0, 6.0), y=(-6.0, 6.0))
    wide = replace(fleet.fleet, geofence_m=fence)
    return replace(fleet, fleet=wide, obstacles=(obstacle,))


def pillar(radius_m: float) -> Obstacle:
    return Obstacle(name="pillar", circle=Circle(center_enu_m=(0.0, 2.0), radius_m=radius_m))


def wall(east_m: float) -> Obstacle:
    corners = ((-east_m, 1.0), (east_m, 1.0), (east_m, 1.3), (-east_m, 1.3))
    return Obstacle(name="wall", polygon_enu_m=corners)


@pytest.mark.parametrize(
    ("obstacle", "statuses"),
    [
        (pillar(0.3), ["ok", "warning"]),  # thin: the law leads the vehicle around it
        (pillar(0.6), ["refused", "warning"]),
        (wall(3.0), ["refused", "warning"]),
        (wall(6.0), ["refused", "warning"]),
    ],
)
def test_a_path_leads_through_thin_obstacles_only(
    fleet: FleetConfig, tmp_path: Path, obstacle: Obstacle, statuses: list[str]
) -> None:
    through = path_file(tmp_path / "through.csv", (0, 0, 1), (0, 4, 1), (0, 4.5, 1))
    follow = {"do": "follow_path", "paths": {"mav1": through}}
    there = around(fleet, obstacle)

    findings = []
    for name in ("path through an obstacle", "path obstacles"):
        findings += found(name, there, tmp_path, UP, follow, LAND)
    assert [finding.status for finding in findings] == statuses


@pytest.mark.parametrize(
    ("seconds", "status"),
    [
        (4.0, "ok"),
        (4.25, "refused"),  # for 4.87 s too far behind, and for 5.17 s until it has caught up
        (20.0, "refused"),
    ],
)
def test_a_path_into_an_obstacle_and_back_is_refused_if_it_stays_inside(
    fleet: FleetConfig, tmp_path: Path, seconds: float, status: str
) -> None:
    house = Obstacle(name="house", polygon_enu_m=((-3, 1.0), (3, 1.0), (3, 5.5), (-3, 5.5)))
    inside = path_file(tmp_path / "inside.csv", (0, 0, 1), (0, 3, 1), (0, 0, 1), seconds=seconds)
    follow = {"do": "follow_path", "paths": {"mav1": inside}}
    there = around(fleet, house)

    (way,) = found("path through an obstacle", there, tmp_path, UP, follow, LAND)
    assert way.status == "ok"  # no way around is needed
    (time,) = found("path inside an obstacle", there, tmp_path, UP, follow, LAND)
    assert time.status == status
    assert "the obstacle keeps the vehicle more than 0.6 m behind for" in time.sentence


def test_a_path_may_wait_where_an_obstacle_keeps_the_vehicle_near_it(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    in_wall = path_file(tmp_path / "wall.csv", (0, 0, 1), (0, 1.1, 1), (0, 1.1, 1), (0, 0, 1))
    follow = {"do": "follow_path", "paths": {"mav1": in_wall}}

    (time,) = found("path inside an obstacle", around(fleet, wall(3.0)), tmp_path, UP, follow, LAND)
    assert time.status == "ok"
    assert time.value == 0.0  # the law keeps the vehicle 0.45 m from the wall


async def test_a_path_through_a_wall_is_refused_in_python_too(
    fleet: FleetConfig, bus: Any, tmp_path: Path
) -> None:
    through = tmp_path / path_file(tmp_path / "through.csv", (0, 0, 1), (0, 4, 1))
    flown = Fleet(FleetClient(around(fleet, wall(3.0)), author="tester", bus=bus))

    with pytest.raises(ConfigError, match="Follow_path: mav1's path leads through an obstacle"):
        await flown.follow_path({"mav1": load_path(through)})
    assert bus.orders == []


def test_a_path_beside_an_obstacle_says_nothing_about_ways_around(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    there = around(fleet, pillar(0.3))
    statuses = []
    for x in (0.9, 0.6):
        beside = path_file(tmp_path / "beside.csv", (x, 0, 1), (x, 4, 1))
        follow = {"do": "follow_path", "paths": {"mav1": beside}}
        assert not found("path through an obstacle", there, tmp_path, UP, follow, LAND)
        (finding,) = found("path obstacles", there, tmp_path, UP, follow, LAND)
        statuses.append(finding.status)
    assert statuses == ["ok", "warning"]


def test_a_path_whose_first_point_cannot_be_reached_is_refused(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    behind = path_file(tmp_path / "behind.csv", (0, 3, 1), (0, 4, 1))
    follow = {"do": "follow_path", "paths": {"mav1": behind}}

    (finding,) = found("reach", around(fleet, wall(6.0)), tmp_path, UP, follow, LAND)
    assert finding.status == "refused"
    assert "the first point of the path of mav1 cannot be reached" in finding.sentence
    assert not found("reach", around(fleet, wall(3.0)), tmp_path, UP, follow, LAND)


def test_a_path_of_a_vehicle_that_is_disabled_later_is_judged_without_a_way_to_it(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    east = path_file(tmp_path / "east.csv", (0, 0, 1), (1, 0, 1))
    steps = [UP, {"do": "follow_path", "paths": {"mav1": east}}, LAND]
    content = {"schema": 1, "step": steps}
    mission = mission_from_mapping(content, path=str(tmp_path / "test.toml"), fleet=fleet)
    vehicles = dict(fleet.vehicles)
    vehicles["mav1"] = replace(vehicles["mav1"], enabled=False)

    findings = mission_findings(replace(mission, fleet=replace(fleet, vehicles=vehicles)))
    assert not [finding for finding in findings if finding.name == "reach"]
