"""Shows of other programs: what is read, mended and written, and what is refused in words."""

from __future__ import annotations

import base64
import json
import math
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w

from groundstation.cli import main
from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import mission_findings
from groundstation.mission_files.steps import FollowPathStep
from groundstation.orders.intents import Takeoff
from groundstation.paths.lights import colour_at
from groundstation.paths.path_files import write_path
from groundstation.paths.pieces import quintic, resting
from groundstation.shows.conversion import Converted
from groundstation.shows.csv_folder import read_folder
from groundstation.shows.import_show import read_show
from groundstation.shows.light_program import colours
from groundstation.shows.output import write_show
from groundstation.shows.show import bezier_piece, path_from_pieces
from groundstation.shows.skyc import read_skyc
from onboard.arrays import Array
from onboard.config.earth import latitude_longitude_deg
from onboard.config.fleet import (
    ConfigError,
    FleetConfig,
    Origin,
    fleet_from_mapping,
    load_fleet,
)
from onboard.control.path import jumps, path_of, point_at
from tests.groundstation.shows.made_shows import (
    crossing,
    csvs,
    eased,
    line_of,
    up_and_down,
    write_skyc,
)

ROOT = Path(__file__).resolve().parents[3]


def imported(
    show: Path, out: Path, fleet: FleetConfig | None = None, promise_m: float | None = None
) -> Mission:
    """The mission that import has written."""
    read = read_folder(show) if show.is_dir() else read_skyc(show)
    write_show(read, out, show.name, fleet, promise_m)
    mission = load_mission(out / "mission.toml")
    assert not [
        finding.sentence for finding in mission_findings(mission) if finding.status == "refused"
    ]
    return mission


def test_music_and_pictures_of_a_show_are_left_alone(tmp_path: Path) -> None:
    show = write_skyc(tmp_path / "line.skyc", line_of(3), 12.0)
    with zipfile.ZipFile(show) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    content = json.loads(members["show.json"])
    content["media"] = {"audio": {"data": {"$ref": "./music.mp3"}}, "cover": {"$ref": "a.PNG"}}
    members["show.json"] = json.dumps(content).encode()
    members["music.mp3"] = b"\xff\xfb not JSON"
    with zipfile.ZipFile(show, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    assert main(["import", str(show), "--out", str(tmp_path / "out")]) == 0


def test_a_show_becomes_a_mission_with_homes_and_paths(tmp_path: Path) -> None:
    show = write_skyc(tmp_path / "line.skyc", line_of(3), 12.0)
    assert main(["import", str(show), "--out", str(tmp_path / "out")]) == 0
    mission = load_mission(tmp_path / "out" / "mission.toml")
    assert [
        mission.fleet.vehicles[name].start_enu_m[0] for name in mission.fleet.enabled_names
    ] == [0.0, 1.6, 3.2]
    assert mission.fleet.fleet.safety_distance_m == 0.8
    (follow,) = (step for step in mission.steps if isinstance(step, FollowPathStep))
    path = mission.paths_of(follow)["mav1"]
    assert point_at(path, 0.0).position_enu_m == pytest.approx((1.6, 0.0, 1.0), abs=0.06)
    assert point_at(path, path.duration_s).position_enu_m == pytest.approx(
        (1.6, 1.0, 1.0), abs=0.06
    )
    assert max(point_at(path, 0.1 * k).position_enu_m.z for k in range(100)) == pytest.approx(
        1.6, abs=0.02
    )
    # nothing is overwritten
    assert main(["import", str(show), "--out", str(tmp_path / "out")]) == 2


def test_a_show_that_the_fleet_cannot_fly_leaves_no_files_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    show = write_skyc(tmp_path / "wide.skyc", line_of(3, metres=6.0), 30.0)
    out = tmp_path / "out"
    command = ["import", str(show), "--out", str(out)]
    assert main([*command, "--fleet", str(ROOT / "configs" / "fleets" / "paper.toml")]) == 2
    refusal = capsys.readouterr().err
    assert "nothing is written" in refusal
    assert "fence" in refusal
    assert not out.exists()
    assert main(command) == 0  # nothing of the refused one is in the way


def test_bezier_curves_pass_where_their_control_points_say() -> None:
    points = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 2.0, 1.5], [3.0, 2.0, 2.0]]
    for count, middle in ((2, (1.5, 1.0, 1.5)), (3, (1.25, 0.5, 1.25)), (4, (1.125, 1.0, 1.3125))):
        chosen = [points[0], points[3]] if count == 2 else [*points[: count - 1], points[3]]
        path = path_of([bezier_piece(4.0, chosen)])
        assert point_at(path, 2.0).position_enu_m == pytest.approx(middle, abs=1e-6)


def test_a_show_that_is_too_fast_is_slowed_and_says_so(tmp_path: Path) -> None:
    show = write_skyc(tmp_path / "fast.skyc", line_of(2, metres=6.0), 12.0)
    mission = imported(show, tmp_path / "out")
    text = (tmp_path / "out" / "paths" / "mav0.csv").read_text(encoding="utf-8")
    assert "slowed to" in text
    assert "slowed to" in (tmp_path / "out" / "mission.toml").read_text(encoding="utf-8")
    assert max(path.duration_s for path in mission.paths.values()) > 10.0
    with pytest.raises(ConfigError, match="times as long"):
        imported(write_skyc(tmp_path / "mad.skyc", line_of(2, metres=60.0), 12.0), tmp_path / "mad")


def test_a_show_with_corners_is_slowed_until_the_checks_let_it_fly(tmp_path: Path) -> None:
    """A star: after each corner the speed has turned by 144 degrees at once."""
    corners = [
        [2.0 * math.sin(0.8 * math.pi * k), 2.0 * math.cos(0.8 * math.pi * k), 2.0]
        for k in range(6)
    ]
    points: list[object] = [[0, [0, 2, 0], []], [4, corners[0], []]]
    points += [[4.0 + 2.03 * k, corner, []] for k, corner in enumerate(corners[1:], start=1)]
    points.append([20, [0, 2, 0], []])
    star = {"version": 1, "points": points, "takeoffTime": 0.0}
    show = write_skyc(tmp_path / "star.skyc", line_of(1), 12.0, trajectory=star)

    imported(show, tmp_path / "out")

    text = (tmp_path / "out" / "mission.toml").read_text(encoding="utf-8")
    assert "slowed to" in text


def test_starts_are_spread_where_paths_would_meet(tmp_path: Path) -> None:
    mission = imported(write_skyc(tmp_path / "cross.skyc", crossing(), 16.0), tmp_path / "out")
    texts = [
        (tmp_path / "out" / "paths" / f"{name}.csv").read_text(encoding="utf-8")
        for name in ("mav0", "mav1")
    ]
    assert sum("begins" in text and "later" in text for text in texts) == 1
    assert len({round(path.duration_s, 1) for path in mission.paths.values()}) == 2


def test_homes_far_from_their_paths_are_dealt_out_anew_and_said_so(tmp_path: Path) -> None:
    ways = line_of(3)
    show = read_skyc(write_skyc(tmp_path / "show.skyc", ways, 12.0))
    homes = [drone.home_enu_m for drone in show.drones]
    mixed = [replace(drone, home_enu_m=homes[(k + 1) % 3]) for k, drone in enumerate(show.drones)]
    made, fleet = write_show(
        replace(show, drones=tuple(mixed)), tmp_path / "out", "show", None, None
    )
    for name, path in made.paths.items():
        x, y, _ = point_at(path, 0.0).position_enu_m
        assert fleet.vehicles[name].start_enu_m[:2] == pytest.approx((x, y), abs=0.02)
    assert "home" in (tmp_path / "out/paths/mav0.csv").read_text().partition("duration")[0]


def test_what_comes_too_near_is_refused_with_the_pairs(tmp_path: Path) -> None:
    near = write_skyc(tmp_path / "near.skyc", line_of(3, apart_m=0.7), 12.0)
    with pytest.raises(
        ConfigError,
        match=r"each other: mav0 and mav1 0\.70 m; mav1 and mav2 0\.70 m\. The law needs 1\.00 m "
        r"with positions as accurate as 'mocap'\. Move them apart\.$",
    ):
        imported(near, tmp_path / "near")
    over = {
        "low": up_and_down(lambda _: 0.0, lambda _: 0.0, 12.0, 1.5),
        "high": up_and_down(
            lambda t: 2.0 if t < 3 else max(2.0 - (t - 3) / 2, 0.0), lambda _: 0.0, 12.0, 4.0
        ),
    }
    with pytest.raises(ConfigError, match=r"mav0 and mav1 .* above the other"):
        imported(write_skyc(tmp_path / "over.skyc", over, 12.0), tmp_path / "over")
    with pytest.raises(ConfigError, match=r"law needs 1\.7"):
        imported(
            write_skyc(tmp_path / "line.skyc", line_of(2), 12.0), tmp_path / "line", promise_m=1.5
        )


def test_folders_of_csvs_are_shows_too(tmp_path: Path) -> None:
    folder = csvs(tmp_path / "csvs", list(line_of(3).values()), 12.0)
    mission = imported(folder, tmp_path / "out")
    assert list(mission.fleet.vehicles) == ["mav0", "mav1", "mav2"]
    lights = (tmp_path / "out" / "lights" / "mav0.csv").read_text(encoding="utf-8").splitlines()
    assert lights[0] == "t,red,green,blue"
    assert lights[1].endswith(",255,0,0")
    assert lights[-1].endswith(",0,0,255")


def test_paths_from_positions_pass_them_at_the_times_of_the_colours(tmp_path: Path) -> None:
    show = read_folder(csvs(tmp_path / "csvs", list(line_of(2).values()), 12.0))
    assert [light[0] for light in show.drones[0].lights] == pytest.approx([0.0, 4.9, 5.0, 12.0])
    for drone in show.drones:
        for time_s in (4.0, 6.0, 7.5):
            y_m = point_at(drone.path, time_s - drone.begin_s).position_enu_m.y
            assert y_m == pytest.approx(eased((time_s - 3.0) / 6.0), abs=0.015)


@pytest.mark.parametrize(
    "head", ["t,x,y,z", "time,latitude,longitude,altitude"], ids=["metres", "degrees"]
)
def test_an_import_says_whose_spline_would_swing(tmp_path: Path, head: str) -> None:
    scale = 1.0 if head.startswith("t,") else 1e-5  # 1.1 m
    for name, xs in (("smooth", (0.0, 2.0, 4.0)), ("stands", (0.0, 0.0, 4.0))):
        rows = [f"{10 * k},{x * scale:.7f},0,{2 + k % 2}" for k, x in enumerate(xs)]
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows]), encoding="utf-8")
    *_, note = read_folder(tmp_path).notes
    assert "a spline through the few positions of stands.csv would swing" in note


def test_an_import_says_whose_yaw_turns_by_more_than_half_a_circle(tmp_path: Path) -> None:
    for name, last_deg in (("half", 180), ("full", 360)):
        rows = ["t,x,y,z,yaw", "0,0,0,2,0", f"10,2,0,2,{last_deg}"]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows), encoding="utf-8")
    (note,) = read_folder(tmp_path).notes
    assert "the yaw of full.csv turns by more than half a circle" in note


def test_an_import_names_the_columns_that_are_not_read(tmp_path: Path) -> None:
    heads = {"a": "t,x,y,z,yaw_rate,Red,Green,Blue", "b": "t,x,y,z,speed,yaw,yaw_rate"}
    for name, head in heads.items():
        others = ",0" * (head.count(",") - 3)
        rows = [head, f"0,0,0,2{others}", f"10,5,0,2{others}"]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows), encoding="utf-8")
    assert read_folder(tmp_path).notes == ("columns that are not read: yaw_rate, speed",)


def test_a_smoothed_path_keeps_the_clock_of_the_others(tmp_path: Path) -> None:
    """To the east at 0.5 m/s from 2 s to 14 s, once with corners and once at rest at both ends."""
    corners = [[0, [0, 0, 0], []], [2, [0, 0, 2], []], [14, [6, 0, 2], []], [16, [6, 0, 0], []]]
    smooth = json.loads(json.dumps(corners))
    for k in range(1, len(smooth)):
        smooth[k][2] = [smooth[k - 1][1], smooth[k][1]]

    for takeoff_s in (0.0, 3.0):
        begins_s = []
        for points in (corners, smooth):
            trajectory = {"version": 1, "points": points, "takeoffTime": takeoff_s}
            (drone,) = read_skyc(_with_show(tmp_path, _one(trajectory))).drones
            # the middle of the way, by symmetry of both
            middle_s = takeoff_s + 8.0 - drone.begin_s
            assert point_at(drone.path, middle_s).position_enu_m.x == pytest.approx(3.0, abs=0.01)
            begins_s.append(drone.begin_s)
        assert begins_s == pytest.approx([takeoff_s - 0.25, takeoff_s], abs=0.001)


def test_smoothing_keeps_the_last_position_of_a_path() -> None:
    corner = [bezier_piece(2.03, [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]])]
    corner.append(bezier_piece(2.0, [[1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]))
    path = path_from_pieces("drone", corner)
    assert point_at(path, path.duration_s).position_enu_m == pytest.approx((1.0, 1.0, 1.0))


def _piece_csvs(folder: Path, second_x_m: float) -> Path:
    """Files of 33 columns: a climb, then a way to the east at once at 0.5 m/s, and a descent."""
    folder.mkdir()
    for k in range(2):
        climb = quintic(4.0, _at_rest(0.0, 3.0 * k, 0.0), _at_rest(0.0, 3.0 * k, 2.0))
        way = resting(8.0, np.array([second_x_m, 3.0 * k, 2.0, 0.0]))
        way[2] = 0.5  # coefficient of x at the first power of time
        east_m = second_x_m + 4.0
        descent = quintic(4.0, _at_rest(east_m, 3.0 * k, 2.0), _at_rest(east_m, 3.0 * k, 0.0))
        path = path_of([climb.tolist(), way.tolist(), descent.tolist()])
        write_path(folder / f"drone{k}.csv", path)
    return folder


def _at_rest(x_m: float, y_m: float, z_m: float) -> Array:
    return np.array([[x_m, y_m, z_m, 0.0], [0.0] * 4, [0.0] * 4])


def test_corners_of_csvs_with_pieces_are_smoothed_and_jumps_are_refused(tmp_path: Path) -> None:
    mission = imported(_piece_csvs(tmp_path / "corners", 0.0), tmp_path / "out")
    for path in mission.paths.values():
        assert jumps(path)[1].max() < 0.05

    with pytest.raises(ConfigError, match=r"drone0\.csv: its position jumps by 1\.50 m"):
        read_folder(_piece_csvs(tmp_path / "jumps", 1.5))


def test_csvs_share_one_clock(tmp_path: Path) -> None:
    folder = csvs(tmp_path / "csvs", list(line_of(2).values()), 12.0)
    file = folder / "Drone 2.csv"
    text = file.read_text(encoding="utf-8")

    def begins_at(seconds: int) -> None:
        head, *lines = text.splitlines()
        later = []
        for line in lines:
            time_ms, _, rest = line.partition(",")
            later.append(f"{int(time_ms) + 1000 * seconds},{rest}")
        file.write_text("\n".join([head, *later]), encoding="utf-8")

    begins_at(10)
    first, second = read_folder(folder).drones
    assert second.begin_s - first.begin_s == pytest.approx(10.0)
    assert second.lights[0][0] == 10.0

    begins_at(4000)
    with pytest.raises(ConfigError, match=r"Drone 2\.csv begins 4000 s after the first drone"):
        read_folder(folder)


def test_a_colour_that_is_held_does_not_fade_before_it_switches(tmp_path: Path) -> None:
    # red until 4.9 s, blue from 5.0 s on
    (drone,) = read_folder(csvs(tmp_path / "csvs", list(line_of(1).values()), 12.0)).drones
    assert [light[0] for light in drone.lights] == pytest.approx([0.0, 4.9, 5.0, 12.0])
    assert colour_at(drone.lights, 4.8) == (255, 0, 0)
    assert colour_at(drone.lights, 5.1) == (0, 0, 255)


@pytest.mark.parametrize("wrong", ["256,0,0", "0.9,0.5,0.1", "-1,0,0"])
def test_a_colour_that_is_none_is_refused_with_the_file_that_has_it(
    tmp_path: Path, wrong: str
) -> None:
    folder = csvs(tmp_path / "csvs", list(line_of(2).values()), 12.0)
    file = folder / "Drone 2.csv"
    file.write_text(file.read_text(encoding="utf-8").replace("255,0,0", wrong))
    with pytest.raises(ConfigError, match=r"Drone 2\.csv: colours are whole numbers from 0 to 255"):
        read_folder(folder)


def test_types_and_endpoints_come_from_the_fleet_that_is_named(tmp_path: Path) -> None:
    own = load_fleet(ROOT / "configs" / "fleets" / "paper.toml")
    show = write_skyc(tmp_path / "line.skyc", line_of(2, metres=0.5), 12.0)
    mission = imported(show, tmp_path / "out", own)
    assert mission.fleet.enabled_names == ("mav0", "mav1")
    assert mission.fleet.vehicles["mav1"].agent == own.vehicles["mav1"].agent
    assert mission.fleet.vehicles["mav1"].type == own.vehicles["mav1"].type
    assert mission.fleet.vehicles["mav1"].start_enu_m[0] == 1.6
    with pytest.raises(ConfigError, match="4 drones"):
        imported(write_skyc(tmp_path / "four.skyc", line_of(4), 12.0), tmp_path / "four", own)


_HERE = Origin(47.397742, 8.545594, 489.4)


def _outdoors(fleet_origin: Origin) -> FleetConfig:
    """A fleet of two with an origin on Earth, and a fence of 200 m around it."""
    data = tomllib.loads((ROOT / "configs" / "fleets" / "paper.toml").read_text())
    data["fleet"]["origin"] = msgspec.to_builtins(fleet_origin)
    data["fleet"]["geofence_m"] = {"x": [-200.0, 200.0], "y": [-200.0, 200.0], "z": [-1.0, 9.0]}
    return fleet_from_mapping(data, text=tomli_w.dumps(data))


def _show_at(origin: Origin, file: Path) -> Path:
    location = {"origin": [origin.latitude_deg, origin.longitude_deg, origin.altitude_m]}
    environment = {"type": "outdoor", "location": location}
    ways = line_of(2, metres=0.5)
    return write_skyc(file, ways, 12.0, show={"environment": environment})


def test_a_show_stays_at_its_place_on_earth_in_a_fleet_with_another_origin(
    tmp_path: Path,
) -> None:
    latitude_deg, longitude_deg = latitude_longitude_deg(_HERE, 50.0, -100.0)
    show = _show_at(Origin(latitude_deg, longitude_deg, 520.0), tmp_path / "show.skyc")

    mission = imported(show, tmp_path / "out", _outdoors(_HERE))

    assert mission.fleet.fleet.global_origin == _HERE
    assert mission.fleet.vehicles["mav1"].start_enu_m == pytest.approx((51.6, -100.0, 0.0))
    begin_enu_m = point_at(mission.paths["paths/mav1.csv"], 0.0).position_enu_m
    assert begin_enu_m == pytest.approx((51.6, -100.0, 1.0), abs=0.06)
    text = (tmp_path / "out" / "fleet.toml").read_text()
    assert "50.00 m east and -100.00 m north of the fleet's" in text


def test_a_refusal_of_an_outdoor_show_names_the_accuracy_and_what_helps(tmp_path: Path) -> None:
    advice = r"more accurate positions, .* less is enough: --fleet names such a fleet\.$"
    homes = r"The law needs 2\.40 m with positions as accurate as 'gps'\. Move them apart\. With "
    with pytest.raises(ConfigError, match=homes + advice):
        imported(_show_at(_HERE, tmp_path / "homes.skyc"), tmp_path / "homes")

    file = tmp_path / "paths.skyc"
    environment = {"type": "outdoor"}
    write_skyc(file, crossing(), 16.0, show={"environment": environment})
    paths = r"nearer than 2\.30 m, which the law needs with positions as accurate as 'gps' at any "
    with pytest.raises(ConfigError, match=f"{paths}.* With {advice}"):
        imported(file, tmp_path / "paths")


def test_a_show_far_from_the_origin_of_its_fleet_is_refused(tmp_path: Path) -> None:
    show = _show_at(msgspec.structs.replace(_HERE, latitude_deg=48.0), tmp_path / "show.skyc")
    with pytest.raises(ConfigError, match=r"67 km from the fleet's origin; 10 km are the most"):
        imported(show, tmp_path / "out", _outdoors(_HERE))


def _on_a_slope(folder: Path, top_m: float) -> Path:
    """Places on Earth of three drones whose homes lie 3 m above each other, up to one altitude."""
    folder.mkdir()
    for k in range(3):
        home_m = 40.0 + 3.0 * k
        lines = ["time,latitude,longitude,altitude"]
        for tick in range(61):
            latitude_deg, longitude_deg = latitude_longitude_deg(_HERE, 5.0 * k, 0.0)
            share = eased(tick / 15) * eased((60 - tick) / 15)
            altitude_m = home_m + (top_m - home_m) * share
            lines.append(f"{tick},{latitude_deg:.9f},{longitude_deg:.9f},{altitude_m:.4f}")
        (folder / f"d{k}.csv").write_text("\n".join(lines))
    return folder


def test_homes_of_a_show_keep_their_heights(tmp_path: Path) -> None:
    mission = imported(_on_a_slope(tmp_path / "show", 50.0), tmp_path / "out")

    starts_m = [vehicle.start_enu_m[2] for vehicle in mission.fleet.vehicles.values()]
    assert starts_m == pytest.approx([0.0, 3.0, 6.0], abs=0.01)
    (takeoff,) = (step for step in mission.steps if isinstance(step, Takeoff))
    assert takeoff.height_m == 7.0  # a metre above the highest home
    for path in mission.paths.values():
        heights_m = [point_at(path, float(t)).position_enu_m.z for t in range(60)]
        assert max(heights_m) == pytest.approx(10.0, abs=0.02)
    assert "from 0.0 to 6.0 m" in (tmp_path / "out" / "fleet.toml").read_text()

    with pytest.raises(ConfigError, match=r"does not rise to 6\.62 m, 0\.62 m above the highest"):
        imported(_on_a_slope(tmp_path / "low", 46.5), tmp_path / "no")


def _yaws_deg(tmp_path: Path, setpoints: list[list[float]], times_s: list[float]) -> list[float]:
    """Yaw at some times of a show of one drone, of which one piece lasts from 2 s to 14 s."""
    points = [[0, [0, 0, 0], []], [2, [0, 0, 2], []], [14, [0.2, 0, 2], []], [16, [0.2, 0, 0], []]]
    for k in range(1, len(points)):  # at rest at each point
        points[k][2] = [points[k - 1][1], points[k][1]]
    show = _one({"version": 1, "points": points}, yawControl={"setpoints": setpoints})
    path = read_skyc(_with_show(tmp_path, show)).drones[0].path
    return [math.degrees(point_at(path, time_s).yaw_rad) for time_s in times_s]


def test_yaw_is_that_of_each_setpoint_also_within_a_piece(tmp_path: Path) -> None:
    """Clockwise in the file, counterclockwise in a path."""
    setpoints = [[2.0, 0.0], [8.0, 90.0], [14.0, 0.0]]
    yaws_deg = _yaws_deg(tmp_path, setpoints, [2.0, 5.0, 8.0, 11.0, 14.0])
    assert yaws_deg == pytest.approx([0.0, -45.0, -90.0, -45.0, 0.0], abs=0.01)


@pytest.mark.parametrize("turn_deg", [270.0, 360.0, -720.0])
def test_long_turns_of_yaw_are_flown_as_they_are_written(tmp_path: Path, turn_deg: float) -> None:
    yaws_deg = _yaws_deg(tmp_path, [[2.0, 0.0], [14.0, turn_deg]], [2.0, 8.0, 14.0])
    assert yaws_deg == pytest.approx([0.0, -0.5 * turn_deg, -turn_deg], abs=0.01)


@pytest.mark.parametrize(("quick_s", "is_noted"), [(0.5, True), (8.0, False)])
def test_an_import_says_whose_yaw_is_quicker_than_it_is_flown(
    tmp_path: Path, quick_s: float, is_noted: bool
) -> None:
    yaw = {"setpoints": [[6.0, 0.0], [6.0 + quick_s, 170.0]]}
    show = write_skyc(tmp_path / "show.skyc", line_of(2), 20.0, yawControl=yaw)
    imported(show, tmp_path / "out")
    text = (tmp_path / "out" / "mission.toml").read_text(encoding="utf-8")
    assert ("behind that of mav0's path" in text) is is_noted


@pytest.mark.parametrize(
    ("orientation_deg", "turn_deg"),
    [(None, 0.0), (90.0, 0.0), (0.0, 90.0), (180.0, -90.0), (60, 30.0)],
)
def test_the_x_axis_of_an_outdoor_show_points_where_its_location_says(
    tmp_path: Path, orientation_deg: float | None, turn_deg: float
) -> None:
    location = {"origin": [474000000, 85000000], "orientation": orientation_deg}
    environment = {"type": "outdoor", "location": location}
    ways = {"D1": up_and_down(lambda _: 2.0, lambda _: 1.0, 12.0)}
    yaw = {"setpoints": [[0.0, 0.0]]}
    file = write_skyc(
        tmp_path / "show.skyc", ways, 12.0, show={"environment": environment}, yawControl=yaw
    )

    show = read_skyc(file)

    (drone,) = show.drones
    turn_rad = math.radians(turn_deg)
    east_m = 2.0 * math.cos(turn_rad) - math.sin(turn_rad)
    north_m = 2.0 * math.sin(turn_rad) + math.cos(turn_rad)
    middle = point_at(drone.path, 6.0)
    assert drone.home_enu_m == pytest.approx((east_m, north_m, 0.0))
    assert middle.position_enu_m == pytest.approx((east_m, north_m, 1.6), abs=1e-4)
    assert math.degrees(middle.yaw_rad) == pytest.approx(turn_deg, abs=1e-4)
    assert len(show.notes) == (turn_deg != 0.0)

    write_show(show, tmp_path / "out", file.name, None, None)
    for name in ("fleet.toml", "paths/mav0.csv"):
        text = (tmp_path / "out" / name).read_text(encoding="utf-8")
        assert f"turned by {turn_deg:g} degrees counterclockwise" in text or not turn_deg


@pytest.mark.parametrize(
    ("written", "altitude_m"),
    [
        ([473977420, 85455940, 489400], 489.4),
        ([473977420, 85455940], 0.0),
        ([47.397742, 8.545594, 489.4], 489.4),
    ],
)
def test_the_origin_of_a_show_is_read_in_skybrushs_units_or_in_degrees(
    tmp_path: Path, written: list[float], altitude_m: float
) -> None:
    environment = {"type": "outdoor", "location": {"origin": written}}
    file = write_skyc(tmp_path / "s.skyc", line_of(1), 12.0, show={"environment": environment})
    origin = read_skyc(file).origin
    assert origin == Origin(47.397742, 8.545594, altitude_m)


def test_indoors_the_orientation_of_a_location_turns_nothing(tmp_path: Path) -> None:
    environment = {"type": "indoor", "location": {"origin": [0, 0], "orientation": 0}}
    file = write_skyc(tmp_path / "s.skyc", line_of(2), 12.0, show={"environment": environment})
    assert read_skyc(file).drones[1].home_enu_m == (1.6, 0.0, 0.0)


def test_a_heading_along_the_flight_is_not_read_and_a_note_says_so(tmp_path: Path) -> None:
    file = write_skyc(tmp_path / "s.skyc", line_of(2), 12.0, yawControl={"autoYaw": True})
    (note,) = read_skyc(file).notes
    assert "'autoYaw' is not read" in note
    assert ", ".join(drone.name for drone in read_skyc(file).drones) in note

    file = write_skyc(tmp_path / "t.skyc", line_of(2), 12.0, yawControl={"autoYaw": False})
    assert not read_skyc(file).notes


def test_more_yaw_setpoints_than_a_vehicle_can_hold_are_refused(tmp_path: Path) -> None:
    many = [[2.0 + 0.001 * k, 0.0] for k in range(5000)]
    with pytest.raises(ConfigError, match=r"5000 yaw setpoints; \d+ are the most"):
        _yaws_deg(tmp_path, many, [])
    just_too_many = [[2.0 + 0.006 * k, 0.0] for k in range(1985)]
    with pytest.raises(ConfigError, match="with an end of a piece at each yaw setpoint"):
        _yaws_deg(tmp_path, just_too_many, [])


def _with_show(tmp_path: Path, data: object) -> Path:
    path = tmp_path / "broken.skyc"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("show.json", data if isinstance(data, str) else json.dumps(data))
    return path


def _one(trajectory: object, **settings: object) -> dict[str, object]:
    return {
        "version": 1,
        "swarm": {"drones": [{"settings": {"trajectory": trajectory, **settings}}]},
    }


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"version": 2}, "version 2"),
        ({"version": 1}, "swarm.drones"),
        ({"version": 1, "swarm": {"drones": []}}, "swarm.drones"),
        ("{", "no JSON"),
        ("[" * 100_000, "nested too deeply"),
        (_one({"$ref": "none.json"}), "no member 'none.json'"),
        (_one({"$ref": "show.json"}), "without end|no member|no JSON|version"),
        (_one({"version": 3, "points": []}), "version 3"),
        (_one({"version": 1, "points": [[0, [0, 0, 1], []]]}), "fewer than two points"),
        (
            _one({"version": 1, "points": [[0, [0, 0, 1], []], [0, [1, 0, 1], []]]}),
            "its time does not rise",
        ),
        (
            _one({"version": 1, "points": [[0, [0, 0, 1], []], [1, [1, "a", 1], []]]}),
            "finite number",
        ),
        (_one({"version": 1, "points": [[0, [0, 0], []], [1, [1, 0, 1], []]]}), r"\[x, y, z\]"),
        (
            _one({"version": 1, "points": [[0, [0, 0, 1500], []], [9, [9000, 0, 1500], []]]}),
            "not metres",
        ),
        (
            _one({"version": 1, "points": [[0, [0, 0, -2], []], [9, [1, 0, -2], []]]}),
            "z points down",
        ),
        (_one({"version": 1, "points": [[0, [0, 0, 2], []], [1e9, [1, 0, 2], []]]}), "no path"),
    ],
)
def test_a_broken_show_is_refused_in_words(tmp_path: Path, data: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read_skyc(_with_show(tmp_path, data))


def test_what_is_no_zip_or_too_large_or_truncated_is_refused(tmp_path: Path) -> None:
    whole = write_skyc(tmp_path / "line.skyc", line_of(3), 12.0).read_bytes()
    (tmp_path / "cut.skyc").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.skyc").write_text("no zip", encoding="utf-8")
    with (
        zipfile.ZipFile(tmp_path / "bomb.skyc", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("show.json", "w") as s,
    ):
        for _ in range(300):
            s.write(bytes(1 << 20))
    for name, words in (
        ("cut", "truncated"),
        ("text", "no .skyc"),
        ("bomb", "unpacks to more"),
        ("none", "no such show"),
    ):
        with pytest.raises(ConfigError, match=words):
            read_skyc(tmp_path / f"{name}.skyc")
    assert main(["import", str(tmp_path / "show.vviz")]) == 2


def test_light_programs_become_colours_at_times() -> None:
    # white for 1 s, fade to red in 2 s, twice black for 0.5 s
    program = bytes([7, 50, 8, 255, 0, 0, 100, 12, 2, 6, 25, 13, 0])
    lights = colours(program, 60.0)
    assert (1.0, 255, 255, 255) in lights
    assert (3.0, 255, 0, 0) in lights
    assert lights[-1] == (4.0, 0, 0, 0)
    for broken in (bytes([4, 1]), bytes([99]), bytes([13])):
        with pytest.raises(ValueError, match=r"it |its |loop"):
            colours(broken, 60.0)


def test_an_endless_loop_of_lights_ends_with_the_path(tmp_path: Path) -> None:
    blinking = bytes([12, 0, 7, 25, 6, 25, 13, 7, 50])  # white and black, for 0.5 s each
    program = {"version": 1, "data": base64.b64encode(blinking).decode()}
    show = write_skyc(tmp_path / "show.skyc", line_of(1), 12.0, lights=program)
    (drone,) = read_skyc(show).drones
    assert colour_at(drone.lights, 10.7) == (0, 0, 0)
    assert colour_at(drone.lights, 11.3) == (255, 255, 255)
    assert drone.lights[-1] == (12.0, 0, 0, 0)

    flicker = bytes([12, 0, 7, 2, 6, 2, 13])  # white and black, for 40 ms each
    assert colours(flicker, 1200.0)[-1][0] == pytest.approx(1200.0, abs=0.1)

    without_time = bytes([12, 0, 7, 0, 13])
    assert colours(without_time, 12.0)[-1] == (0.0, 255, 255, 255)


def _crossing_above(folder: Path) -> Path:
    """Two drones that cross 6 m above each other, east to west and north to south."""
    across = crossing(seconds=40.0)
    low = across["east"]
    high = across["north"]

    def raised(t: float) -> tuple[float, float, float]:
        x, y, z = high(t)
        return x, y, 6.0 * z

    return csvs(folder, [low, raised], 40.0)


def test_a_show_that_passes_above_itself_says_how_and_is_flown_with_heights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    show = _crossing_above(tmp_path / "above")
    out = tmp_path / "out"
    assert main(["import", str(show), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "(times of the show)" in said
    assert "--vertical" in said

    assert main(["import", str(show), "--out", str(out), "--vertical", "2.5"]) == 0
    assert "vertical_separation_m = 2.5" in (out / "fleet.toml").read_text()
    assert "the paths take" in capsys.readouterr().out


def test_times_of_a_refusal_are_those_of_the_show(tmp_path: Path) -> None:
    made = Converted(takeoff_m=1.0, homes={}, paths={}, lights={}, begin_s=3.0, slowing=2.0)
    assert made.show_s(20.0) == 13.0
    assert "3.0 + T / 2.000 s of the show" in made.own_time_words()
    assert Converted(1.0, {}, {}, {}).own_time_words() == ""  # the same clock needs no words


def test_csvs_with_z_down_are_refused_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(2):
        x = 3 * number
        lines = f"t,x,y,z\n0,{x},0,0\n5,{x},0,-3\n10,{x + 1},0,-3\n15,{x + 1},0,0\n"
        (tmp_path / f"drone{number}.csv").write_text(lines)

    assert main(["import", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "z points down" in capsys.readouterr().err


def test_a_single_csv_is_no_show(tmp_path: Path) -> None:
    one = tmp_path / "one.csv"
    one.write_text("t,x,y,z\n0,0,0,1\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"path of one drone.*name the folder"):
        read_show(one)


def test_the_ending_of_a_csv_may_be_in_capital_letters(tmp_path: Path) -> None:
    folder = csvs(tmp_path / "plain", list(line_of(2).values()), 12.0)
    show = tmp_path / "show.zip"
    with zipfile.ZipFile(show, "w") as archive:
        for file in folder.glob("*.csv"):
            archive.write(file, f"{file.stem}.CSV")
    assert len(read_show(show).drones) == 2


def test_hidden_files_beside_csvs_are_left_out(tmp_path: Path) -> None:
    folder = csvs(tmp_path / "plain", list(line_of(2).values()), 12.0)
    show = tmp_path / "show.zip"
    with zipfile.ZipFile(show, "w") as archive:
        for file in folder.glob("*.csv"):
            archive.write(file, f"some/folder/{file.name}")
            archive.writestr(f"some/folder/._{file.name}", b"\x00\x05\x16\x07")
    (folder / "._Drone 1.csv").write_bytes(b"\x00\x05\x16\x07")
    (folder / ".hidden.csv").write_text("no path")
    for source in (folder, show):
        assert [drone.name for drone in read_show(source).drones] == ["Drone 1", "Drone 2"]


def test_a_zip_of_csvs_is_a_show_and_a_bomb_or_an_empty_one_is_none(tmp_path: Path) -> None:
    folder = csvs(tmp_path / "plain", list(line_of(2).values()), 12.0)
    show = tmp_path / "show.zip"
    with zipfile.ZipFile(show, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in folder.iterdir():
            archive.write(file, f"some/folder/{file.name}")
            archive.writestr(f"__MACOSX/{file.name}", "no show")
    read = read_show(show)
    assert [drone.name for drone in read.drones] == ["Drone 1", "Drone 2"]
    assert read.title == "show"

    with zipfile.ZipFile(show, "w") as archive:
        archive.writestr("Dröhne.csv", "t,x,y,z")
    show.write_bytes(show.read_bytes().replace("ö".encode(), b"\xff\xff"))
    with pytest.raises(ConfigError, match="this is no zip, or it is truncated"):
        read_show(show)

    with zipfile.ZipFile(show, "w") as archive:
        archive.writestr("readme.txt", "")
    with pytest.raises(ConfigError, match=r"0 members that end in \.csv"):
        read_show(show)
    with zipfile.ZipFile(show, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("../../Drone 1.csv", b"0" * (1 << 20))
        archive.writestr("x/Drone 1.csv", b"0")
    with pytest.raises(ConfigError, match=r"two of its members are named Drone 1\.csv"):
        read_show(show)
    assert not (tmp_path.parent / "Drone 1.csv").exists()


def test_latitudes_and_longitudes_become_metres_across_the_date_line_too(tmp_path: Path) -> None:
    folder = tmp_path / "earth"
    folder.mkdir()
    head = "Name,Latitude,Longitude,Altitude_MSL_m,TimeFromStart_s,HeadingMode\n"
    for k, longitude in enumerate((179.99999, -179.9999)):
        lines = []
        for tick in range(60):
            altitude_m = 20.0 + 5.0 * math.sin(tick / 20)
            lines.append(f"Waypoint {tick},0.0,{longitude:.7f},{altitude_m:.4f},{tick},auto")
        (folder / f"d{k}.csv").write_text(head + "\n".join(lines))
    show = read_show(folder)
    assert show.is_outdoors
    assert show.origin is not None
    assert show.origin.longitude_deg == pytest.approx(179.99999)
    east_m = show.drones[1].home_enu_m[0] - show.drones[0].home_enu_m[0]
    assert east_m == pytest.approx(math.radians(0.00011) * 6_371_000, rel=1e-3)
    assert "lowest altitude" in show.notes[0]
    assert len(show.notes) == 1

    coloured = (folder / "d1.csv").read_text().replace("HeadingMode", "HeadingMode,Red,Green,Blue")
    (folder / "d1.csv").write_text(coloured.replace(",auto", ",auto,255,0,0"))
    assert "the colours of d1.csv could not be read" in read_show(folder).notes[1]

    bad = (folder / "d0.csv").read_text().replace("Waypoint 9,0.0", "Waypoint 9,north")
    (folder / "d0.csv").write_text("# one\n# two\n" + bad)
    with pytest.raises(ConfigError, match="line 13: it has no number as its latitude"):
        read_show(folder)

    (folder / "d0.csv").write_text("Latitude,Longitude,time\n1,2,3\n")
    with pytest.raises(ConfigError, match="no column of altitude"):
        read_show(folder)


def test_what_skybrush_loads_onto_one_drone_is_refused_with_what_to_export(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"Export the whole show as \.skyc"):
        read_show(tmp_path / "drone.skyb")
