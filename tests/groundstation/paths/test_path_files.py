"""Files of paths: three kinds, and everything that is none."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest

from groundstation.paths.path_files import load_path, write_path
from onboard.config.fleet import ConfigError
from onboard.control.path import point_at, sampled


def csv(folder: FilePath, text: str) -> str:
    path = folder / "path.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_timed_positions_are_passed_at_their_times(tmp_path: FilePath) -> None:
    lines = [f"{0.1 * k:.1f},{np.sin(0.05 * k):.3f},0.5,1.2,{9 * k / 10}" for k in range(101)]
    path = load_path(csv(tmp_path, "# made by hand\nt,x,y,z,yaw\n" + "\n".join(lines)))
    times_s = np.arange(1.0, 9.0, 0.1)
    values = sampled(path, times_s + 0.25)[0]
    assert np.abs(values[:, 0] - np.sin(0.5 * times_s)).max() < 0.02
    assert values[-1, 3] == pytest.approx(np.radians(9 * times_s[-1]), abs=0.02)
    assert len(path.pieces) < 40


def test_units_in_brackets_are_converted(tmp_path: FilePath) -> None:
    path = load_path(
        csv(tmp_path, "Time [msec];x [cm];y [m];z [m]\n0;0;0;1\n2000;100;0;1\n4000;100;2;1")
    )
    assert point_at(path, 2.25).position_enu_m == pytest.approx((1.0, 0.0, 1.0), abs=0.02)
    assert path.duration_s == pytest.approx(4.5, abs=0.01)


@pytest.mark.parametrize("name", ["yaw", "yaw_deg", "yaw_rad", "yaw [rad]"])
def test_yaw_is_read_in_the_unit_of_its_column(tmp_path: FilePath, name: str) -> None:
    yaw = 0.5 if "rad" in name else np.degrees(0.5)
    path = load_path(csv(tmp_path, f"t,x,y,z,{name}\n0,0,0,1,{yaw}\n5,1,0,1,{yaw}"))
    assert sampled(path, np.array([2.0]))[0][0, 3] == pytest.approx(0.5, abs=1e-3)


def test_columns_of_pieces_may_name_their_units(tmp_path: FilePath) -> None:
    plain = [f"{axis}^{power}" for axis in ("x", "y", "z", "yaw") for power in range(8)]
    units = [f"{column} [{'rad' if 'yaw' in column else 'm'}]" for column in plain]
    numbers = ",".join(["4.0", "0,1,0,0,0,0,0,0", "0,0,0,0,0,0,0,0"] + ["1,0,0,0,0,0,0,0"] * 2)
    path = load_path(csv(tmp_path, f"duration,{','.join(plain)}\n{numbers}"))
    assert load_path(csv(tmp_path, f"duration [s],{','.join(units)}\n{numbers}")) == path


def test_pieces_are_written_and_read_again(tmp_path: FilePath) -> None:
    path = load_path(csv(tmp_path, "t,x,y,z\n0,0,0,1\n2,1,0,1\n4,1,2,1"))
    write_path(tmp_path / "pieces.csv", path, ["slowed by 1.0"])
    again = load_path(tmp_path / "pieces.csv")
    assert again == path
    assert (
        (tmp_path / "pieces.csv")
        .read_text(encoding="utf-8")
        .startswith("# slowed by 1.0\nduration,x^0")
    )


def test_waypoints_are_flown_through_at_their_speeds(tmp_path: FilePath) -> None:
    path = load_path(csv(tmp_path, "x,y,z,speed\n0,0,1,0\n2,0,1,0.8\n4,0,1,0.8\n6,0,1,0"))
    times_s = np.linspace(0.0, path.duration_s, 2000)
    values, rates, _ = sampled(path, times_s)
    middle = np.abs(values[:, 0] - 3.0).argmin()
    assert rates[middle, 0] == pytest.approx(0.8, abs=0.15)
    assert abs(rates[0, 0]) + abs(rates[-1, 0]) < 1e-6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,x,y,z\n0,0,0,1", "one position is no path"),
        ("t,x,y,z\n0,0,0,1\n0,1,0,1", "time does not rise"),
        ("t,x,y,z\n0,0,0,1\n1,zero,0,1", "line 3"),
        ("t,x,y,z\n0,0,0,1\n1,nan,0,1", "line 3"),
        ("t,x,y,z\n0,0,0,1\n1,0", "line 3"),
        ("t,x [ft],y,z\n0,0,0,1\n1,0,0,1", "unit that is not known"),
        ("t,x [rad],y,z\n0,0,0,1\n1,0,0,1", "'x .rad.' is in a unit .* Use m or cm or mm"),
        ("t [cm],x,y,z\n0,0,0,1\n1,0,0,1", "'t .cm.' is in a unit .* Use s or sec or ms or msec"),
        ("x,y,z,speed [m]\n0,0,1,1\n1,0,1,0", "'speed .m.' is in a unit .* Use m/s"),
        ("t,x,y,z,yaw [m]\n0,0,0,1,0\n1,0,0,1,0", "'yaw .m.' is in a unit .* Use deg or rad"),
        ("t,x,y,z,x\n0,0,0,1,5\n1,0,0,1,5", "more than one column is 'x'"),
        ("t,x,y,z,yaw,yaw_deg\n0,0,0,1,5,5\n1,0,0,1,5,5", "more than one column is 'yaw'"),
        ("t,x,y,z,heading\n0,0,0,1,90\n1,0,0,1,90", "headings often count clockwise from north"),
        ("t,x,y,z,psi\n0,0,0,1,90\n1,0,0,1,90", "a column 'psi' is not read"),
        ("t,x,y,z,v,yaw_cw\n0,0,0,1,1,9\n1,0,0,1,1,9", "a column 'yaw_cw' is not read"),
        ("x,y,z,speed,hdg [deg]\n0,0,1,1,90\n1,0,1,1,90", "a column 'hdg' is not read"),
        ("north,east,down\n0,0,0\n1,0,0", "are no path"),
        ("0,0,0,1\n1,0,0,1\n2,0,0,1", "name the columns"),
        ("x,y,z,speed\n0,0,1,1\n1,0,1,0\n2,0,1,1", "speed above 0"),
        ("x,y,z,speed\n0,0,1,1\n0,0,1,1\n2,0,1,1", "each away from"),
        ("", "are no path"),
    ],
)
def test_what_is_no_path_is_refused_with_its_line(
    tmp_path: FilePath, text: str, words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        load_path(csv(tmp_path, text))


def test_a_file_that_is_missing_or_no_text_is_refused(tmp_path: FilePath) -> None:
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x01" * 50)
    for name in ("none.csv", "bytes.csv"):
        with pytest.raises(ConfigError, match=name):
            load_path(tmp_path / name)
