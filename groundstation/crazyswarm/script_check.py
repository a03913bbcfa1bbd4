"""What a Crazyswarm script would find out in the air, found before it connects.

Some of Crazyswarm's commands are not flown here. A script that calls one of them usually does so
after its take-off; so the script that makes a ``Crazyswarm`` is read first, and refused with the
line of the call.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from onboard.config.file_reading import SCRIPT, python_tree, read_text
from onboard.config.fleet import ConfigError, FleetConfig

_STREAMED = (
    "setpoints that are streamed from the ground pass by the law, and when the program hangs the "
    "vehicle flies on with the last one. Use goTo, or a trajectory."
)
NOT_FLOWN = {
    "cmdFullState": _STREAMED,
    "cmdVelocityWorld": _STREAMED,
    "cmdPosition": _STREAMED,
    "cmdVel": _STREAMED,
    "cmdHover": _STREAMED,
    "cmdStop": "without motors a vehicle falls. Use land, and stop on the ground.",
    "get_status": (
        "PX4 does not say whether it is being charged, which scripts wait for that ask for it. "
        "Batteries are judged by the failsafe table: a vehicle at its landing level lands."
    ),
}
_MOST_CALLS_NAMED = 3
_ID_LINE = re.compile(r"^\s*-?\s*id\s*:", re.MULTILINE)


def refuse_what_is_not_flown(script: str) -> None:
    """Refuse a script that calls what is not flown, before it connects.

    Args:
        script: path of the Python file; what is no file is not read.

    Raises:
        ConfigError: it calls such a command.
    """
    if not Path(script).is_file():
        return

    tree = python_tree(read_text(script, SCRIPT), script)
    calls = sorted(_calls(tree))
    if not calls:
        return

    named = ", ".join(f"{name} (line {line})" for line, name in calls[:_MOST_CALLS_NAMED])
    if len(calls) > _MOST_CALLS_NAMED:
        named += f" and {len(calls) - _MOST_CALLS_NAMED} more"
    _, first = calls[0]
    raise ConfigError(f"{script} calls {named}, which is not flown: {NOT_FLOWN[first]}")


def refuse_too_small_a_fleet(crazyflies_yaml: str | None, fleet: FleetConfig) -> None:
    """Refuse a fleet with fewer vehicles than the script describes in its own text.

    Args:
        crazyflies_yaml: as the script gives it; a text in YAML has an id for each vehicle.
        fleet: that is flown.

    Raises:
        ConfigError: the script wants more vehicles.
    """
    wanted = len(_ID_LINE.findall(crazyflies_yaml or ""))
    count = len(fleet.enabled_names)
    if wanted > count:
        raise ConfigError(
            f"The script describes {wanted} vehicles in its crazyflies_yaml, and fleet "
            f"'{fleet.fleet.name}' has {count}. Make a fleet file for {wanted}: "
            f"covey init DIR --vehicles {wanted}"
        )


def _calls(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of each call of a method that is not flown."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        if node.func.attr in NOT_FLOWN:
            yield node.lineno, node.func.attr
