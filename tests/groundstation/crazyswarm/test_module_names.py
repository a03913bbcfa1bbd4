"""Scripts of Crazyswarm import its modules under their own names while they are run."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

from groundstation.crazyswarm import Crazyswarm, uav_trajectory
from groundstation.crazyswarm.module_names import crazyswarm_names
from onboard.config.fleet import ConfigError

NAMES = ("pycrazyswarm", "crazyflie_py", "crazyflie_py.uav_trajectory", "uav_trajectory")


def test_the_names_are_there_while_a_script_runs_and_gone_after_it(tmp_path: Path) -> None:
    script = str(tmp_path / "show.py")
    with crazyswarm_names(script):
        for name in NAMES[:2]:
            assert importlib.import_module(name).Crazyswarm is Crazyswarm
        for name in NAMES[2:]:
            assert importlib.import_module(name).Trajectory is uav_trajectory.Trajectory
    assert not set(NAMES) & sys.modules.keys()


def test_a_package_of_the_same_name_beside_the_script_is_not_taken_and_its_trajectories_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pycrazyswarm").mkdir()
    (tmp_path / "pycrazyswarm" / "__init__.py").write_text("import rospy\n")
    (tmp_path / "uav_trajectory.py").write_text("Trajectory = 'of the script'\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        with crazyswarm_names(str(tmp_path / "show.py")):
            assert importlib.import_module("pycrazyswarm").Crazyswarm is Crazyswarm
            own = importlib.import_module("uav_trajectory")
            assert own.Trajectory == "of the script"
    finally:
        sys.modules.pop("uav_trajectory", None)


def test_a_script_that_is_run_without_covey_names_its_fleet() -> None:
    with pytest.raises(ConfigError, match='with fleet="FILE" in the parentheses'):
        Crazyswarm()
    with pytest.raises(ConfigError, match=r"lab\.toml: there is no such fleet file"):
        Crazyswarm(fleet="lab.toml")
