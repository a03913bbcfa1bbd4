"""Scripts of Crazyswarm that would fail in the air are refused before they connect."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.crazyswarm.script_check import refuse_too_small_a_fleet, refuse_what_is_not_flown
from groundstation.flights.script_flight import missing_module_words
from onboard.config.fleet import ConfigError, load_fleet

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
