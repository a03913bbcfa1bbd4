"""Scripts of Crazyswarm that would fail in the air are refused before they connect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.crazyswarm.script_check import (
    longest_timescale,
    refuse_too_small_a_fleet,
    refuse_unknown_ids,
    refuse_what_is_not_flown,
)
from groundstation.crazyswarm.uav_trajectory import refuse_unflyable_trajectory
from groundstation.flights.script_flight import missing_module_words
from groundstation.orders.grammar import OrderError
from groundstation.paths.pieces import quintic, resting
from onboard.config.fleet import ConfigError, load_fleet
from onboard.control.path import path_of

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"


def test_a_script_that_streams_setpoints_is_refused_with_its_lines(tmp_path: Path) -> None:
    script = tmp_path / "circle.py"
    script.write_text("one.takeoff(1.0, 2.0)\none.cmdHover(0, 0, 0, 1)\none.cmdVel(0, 0, 0, 0)\n")
    with pytest.raises(ConfigError, match=r"calls cmdHover \(line 2\), cmdVel \(line 3\)"):
        refuse_what_is_not_flown(str(script))

    script.write_text("one.takeoff(1.0, 2.0)\none.notifySetpointsStop()\n")
    refuse_what_is_not_flown(str(script))
    refuse_what_is_not_flown("<stdin>")


def test_a_script_that_waits_for_a_charger_is_refused(tmp_path: Path) -> None:
    script = tmp_path / "infinite.py"
    script.write_text("while cf.get_status()['pm_state'] != 1:\n    pass\n")
    with pytest.raises(ConfigError, match="whether it is being charged"):
        refuse_what_is_not_flown(str(script))


def test_a_method_of_a_scripts_own_class_may_have_the_name_of_a_refused_command(
    tmp_path: Path,
) -> None:
    script = tmp_path / "camera.py"
    own_class = "class Camera:\n    def get_status(self):\n        return 'ok'\n"
    script.write_text(f"{own_class}print(Camera().get_status())\n")
    refuse_what_is_not_flown(str(script))

    script.write_text(f"{own_class}one.cmdHover(0, 0, 0, 1)\n")
    with pytest.raises(ConfigError, match=r"calls cmdHover \(line 4\)"):
        refuse_what_is_not_flown(str(script))


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("import time\ntime.sleep(2)\ntime.time()\ntime.sleep(1)", (2, 4)),
        ("import math, time as clock\nclock.sleep(2)", (2,)),
        ("from time import sleep, time\nsleep(2)", (2,)),
        ("from time import sleep as wait\nwait(2)", (2,)),
        ("import time\nswarm.timeHelper.sleep(2)", ()),
        ("time = swarm.timeHelper\ntime.sleep(2)", ()),
        ("import time\ntime = swarm.timeHelper\ntime.sleep(2)", ()),
        ("def sleep(s):\n    timeHelper.sleep(s)\nsleep(2)", ()),
        ("import time\ndef fly(time):\n    time.sleep(2)", ()),
    ],
)
def test_a_script_that_sleeps_without_the_fleet_is_refused_with_its_lines(
    tmp_path: Path, text: str, lines: tuple[int, ...]
) -> None:
    script = tmp_path / "sloppy.py"
    script.write_text(text)
    if not lines:
        refuse_what_is_not_flown(str(script))
        return

    named = ", ".join(rf"time\.sleep \(line {line}\)" for line in lines)
    with pytest.raises(ConfigError, match=rf"calls {named}, which .* Use timeHelper\.sleep\.$"):
        refuse_what_is_not_flown(str(script))


def test_a_script_for_more_vehicles_than_the_fleet_has_is_refused() -> None:
    fleet = load_fleet(str(PAPER))
    three = "crazyflies:\n- id: 1\n  channel: 110\n- channel: 2\n  id: 2\n- {}\n"
    refuse_too_small_a_fleet(three, fleet)
    refuse_too_small_a_fleet(None, fleet)
    with pytest.raises(ConfigError, match=r"describes 4 vehicles .* has 3"):
        refuse_too_small_a_fleet("crazyflies:\n" + "- id: 7\n" * 4, fleet)


@pytest.mark.parametrize(
    ("module", "words"),
    [
        ("crazyflie_py", "from groundstation.crazyswarm import Crazyswarm"),
        ("uav_trajectory", "import uav_trajectory"),
        ("pycrazyswarm.cfsim.cffirmware", "firmware"),
        ("geometry_msgs", "ROS"),
        ("scipy", "not installed"),
    ],
)
def test_an_import_that_is_missing_says_what_to_write(module: str, words: str) -> None:
    assert words in missing_module_words(module)


@pytest.mark.parametrize(
    ("text", "missing"),
    [
        ("first = 5\nsecond = 231\nallcfs.crazyfliesById[first]\ncrazy.crazyfliesById[second]", 2),
        ("ids = [15, 1]\ncfs = [allcfs.crazyfliesById[i] for i in ids]", 1),
        ("for i in (1, 2, 9):\n    allcfs.crazyfliesById[i].land(0.0, 1.0)", 1),
        ("allcfs.crazyfliesById[1]\nn = 9\nn = 2\nallcfs.crazyfliesById[n]", 0),
        ("allcfs.crazyfliesById[int(row[0])]\na = b\nb = a\nallcfs.crazyfliesById[a]", 0),
        ("def one(n=3):\n    return allcfs.crazyfliesById[n]", 0),
        ("if 9 in allcfs.crazyfliesById:\n    allcfs.crazyfliesById[9].land(0.0, 1.0)", 0),
        ("cfs = [allcfs.crazyfliesById[i] for i in (1, 9) if i in there_are]", 0),
        ("match n:\n    case 9:\n        allcfs.crazyfliesById[9].land(0.0, 1.0)", 0),
        ("one = allcfs.crazyfliesById[9] if len(allcfs.crazyflies) > 8 else None", 0),
        ("try:\n    allcfs.crazyfliesById[9]\nexcept KeyError:\n    pass", 0),
        ("if __name__ == '__main__':\n    allcfs.crazyfliesById[9]", 1),
    ],
)
def test_a_script_that_wants_ids_that_the_fleet_lacks_is_refused(
    text: str, missing: int, tmp_path: Path
) -> None:
    script = tmp_path / "swap.py"
    script.write_text(text)
    fleet = load_fleet(str(PAPER))
    if not missing:
        refuse_unknown_ids(str(script), fleet)
        return

    with pytest.raises(ConfigError, match=r"has 1, 2, 3\. Write these in the script") as refusal:
        refuse_unknown_ids(str(script), fleet)
    ids = str(refusal.value).partition("with id ")[2].partition(" (")[0]
    assert len(ids.split(",")) == missing


@pytest.mark.parametrize(
    ("text", "timescale"),
    [
        ("T = 1.5\nall.startTrajectory(0, timescale=T)\nall.startTrajectory(0, 2)", 2.0),
        ("all.startTrajectory(0, reverse=True)", 1.0),
        ("all.startTrajectory(0, timescale=float(argv[1]))", None),
        ("slow = {'timescale': 2.0}\nall.startTrajectory(0, **slow)", None),
        ("both = 0, 2.0\nall.startTrajectory(*both)", None),
        ("all.takeoff(1.0, 2.0)", None),
    ],
)
def test_the_longest_timescale_of_a_script_is_read(
    text: str, timescale: float | None, tmp_path: Path
) -> None:
    script = tmp_path / "figure8.py"
    script.write_text(text)
    assert longest_timescale(str(script)) == timescale


def test_a_script_that_reads_a_crazyflies_parameters_is_refused(tmp_path: Path) -> None:
    script = tmp_path / "set_param.py"
    script.write_text("cf.setParam('led', 1)\ncf.getParam('led')\n")
    with pytest.raises(ConfigError, match=r"getParam \(line 2\).*covey px4 params"):
        refuse_what_is_not_flown(str(script))


def test_a_trajectory_that_no_timescale_of_the_script_slows_enough_is_refused() -> None:
    fleet = load_fleet(str(PAPER))
    begin, end = np.zeros((3, 4)), np.zeros((3, 4))
    end[0] = [2.0, 0.0, 0.0, 0.0]
    quick = path_of([quintic(2.0, begin, end).tolist()])

    with pytest.raises(OrderError, match=r"too fast for mav1.*timescale of ([\d.]+)") as refusal:
        refuse_unflyable_trajectory(quick, 1.0, "mav1", fleet)
    enough = float(str(refusal.value).partition("A timescale of ")[2].partition(" ")[0])
    assert 1.2 < enough < 4.0
    refuse_unflyable_trajectory(quick, enough, "mav1", fleet)


def test_a_trajectory_that_jumps_between_two_pieces_is_refused() -> None:
    fleet = load_fleet(str(PAPER))
    pieces = [resting(2.0, np.array([x_m, 0.0, 1.0, 0.0])).tolist() for x_m in (0.0, 1.0)]
    with pytest.raises(OrderError, match=r"on mav1's path the position jumps by 1 m at 4\.0 s"):
        refuse_unflyable_trajectory(path_of(pieces), 2.0, "mav1", fleet)


def test_an_import_below_a_missing_package_is_named_as_the_script_writes_it(tmp_path: Path) -> None:
    script = tmp_path / "swap6v.py"
    script.write_text("import numpy\nimport pycrazyswarm.cfsim.cffirmware as firm\n")
    words = missing_module_words("pycrazyswarm", str(script))
    assert words.startswith("It imports pycrazyswarm.cfsim.cffirmware, which")
    assert "remove that import" in words

    # what is there under that name is not called missing
    script.write_text("from pycrazyswarm import *\nfrom pycrazyswarm.util import grid_yaml\n")
    words = missing_module_words("pycrazyswarm", str(script))
    assert words.startswith("It imports pycrazyswarm.util, which")
    assert "pycrazyswarm.util" in words
    assert "functions return" in words
