"""Covey's modules under the names that scripts of Crazyswarm import.

`covey fly script` provides them while a script runs. They take precedence over files beside the
script, because the `pycrazyswarm` of a checkout of Crazyswarm flies Crazyflies. A `uav_trajectory`
beside the script is kept, because it flies nothing.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from groundstation import crazyswarm
from groundstation.crazyswarm import uav_trajectory

_TRAJECTORIES = "uav_trajectory"
PROVIDED = ("pycrazyswarm", "crazyflie_py")  # provided even if such files are beside the script


@contextlib.contextmanager
def crazyswarm_names(script: str) -> Iterator[None]:
    """Let a script import `pycrazyswarm`, `crazyflie_py` and `uav_trajectory` while it runs.

    Args:
        script: path of the Python file.
    """
    names: dict[str, ModuleType] = {
        **dict.fromkeys(PROVIDED, crazyswarm),
        f"crazyflie_py.{_TRAJECTORIES}": uav_trajectory,
    }
    own_trajectories = Path(script).resolve().with_name(f"{_TRAJECTORIES}.py")
    if not own_trajectories.is_file():
        names[_TRAJECTORIES] = uav_trajectory

    former_modules = {name: sys.modules.get(name) for name in names}
    sys.modules.update(names)
    try:
        yield
    finally:
        for name, module in former_modules.items():
            sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module
