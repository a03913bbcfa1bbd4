"""Checks a Crazyswarm script before it connects, so that it does not fail in the air.

Covey refuses some of Crazyswarm's commands. A script usually calls them after its take-off. So the
source of the script is read first, and the script is refused with the line of the call. A method
that a class of the script defines may have the name of such a command: its calls are left out. A
script that uses vehicles with ids that the fleet does not have is also refused.

Only numbers that stand in the source are known: in the call itself, or in a name that the script
assigns once. Code below an `if` or in a `try` is not checked for ids, because a script may check
that way whether the fleet has a vehicle. Other errors appear when the script reaches them.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
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
    "getParam": (
        "parameters of a Crazyflie mean nothing to PX4. PX4's are read with: "
        "covey px4 params --fleet FILE"
    ),
    "get_status": (
        "PX4 does not say whether it is being charged, which scripts wait for that ask for it. "
        "Batteries are judged by the failsafe table: a vehicle at its landing level lands."
    ),
}
_CLOCK = "time"  # Python's own module
_SLEEP = "sleep"
_CLOCK_SLEEP = f"{_CLOCK}.{_SLEEP}"
_REFUSED = {
    **NOT_FLOWN,
    _CLOCK_SLEEP: (
        "commands are sent by timeHelper.sleep, so with this nothing flies until then, and each "
        "vehicle gets only its last command. Use timeHelper.sleep."
    ),
}
_PACKAGES = ("pycrazyswarm", "crazyflie_py")
_OWN_PACKAGE = "groundstation.crazyswarm"
_MAX_CALLS_NAMED = 3
_BY_ID = "crazyfliesById"
_START = "startTrajectory"
_DEEPEST = 20  # longest chain of names and lists that is followed to find a number
_TIMESCALE_INDEX = 1  # index of the timescale among the arguments of startTrajectory
_ID_LINE = re.compile(r"^\s*-?\s*id\s*:", re.MULTILINE)


def is_of_crazyswarm(script: str) -> bool:
    """Return whether a script imports Crazyswarm's names, from Covey or from Crazyswarm itself.

    Args:
        script: path of the Python file; if there is no such file, the result is False.
    """
    if not Path(script).is_file():
        return False

    for node in ast.walk(python_tree(read_text(script, SCRIPT), script)):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            modules = [node.module or ""]
        for module in modules:
            package, _, _ = module.partition(".")
            if package in _PACKAGES or module.startswith(_OWN_PACKAGE):
                return True
    return False


def refuse_what_is_not_flown(script: str) -> None:
    """Refuse a script that calls a command which Covey does not fly, before it connects.

    ``time.sleep`` is refused as well.

    Args:
        script: path of the Python file; if there is no such file, nothing is checked.

    Raises:
        ConfigError: the script calls such a command.
    """
    tree = _tree_of(script)
    if tree is None:
        return

    calls = sorted(_calls(tree))
    if not calls:
        return

    named = ", ".join(f"{name} (line {line})" for line, name in calls[:_MAX_CALLS_NAMED])
    if len(calls) > _MAX_CALLS_NAMED:
        named += f" and {len(calls) - _MAX_CALLS_NAMED} more"
    _, first = calls[0]
    raise ConfigError(f"{script} calls {named}, which is refused: {_REFUSED[first]}")


def refuse_unknown_ids(script: str, fleet: FleetConfig) -> None:
    """Refuse a script that uses vehicles with ids that the fleet does not have.

    Args:
        script: path of the Python file; if there is no such file, nothing is checked.
        fleet: fleet that is flown.

    Raises:
        ConfigError: the script names such an id.
    """
    tree = _tree_of(script)
    if tree is None:
        return

    fleet_ids = {fleet.vehicles[name].system_id for name in fleet.enabled_names}
    missing = sorted(
        {(line, wanted_id) for line, wanted_id in _wanted_ids(tree) if wanted_id not in fleet_ids}
    )
    if not missing:
        return

    first_line, _ = missing[0]
    missing_ids = sorted({wanted_id for _, wanted_id in missing})
    ids = ", ".join(map(str, missing_ids))
    known = ", ".join(map(str, sorted(fleet_ids)))
    raise ConfigError(
        f"{script} wants vehicles with id {ids} (line {first_line}), and fleet "
        f"'{fleet.fleet.name}' has {known}. Write these in the script, or give them as system_id of"
        " vehicles in the fleet file."
    )


def longest_timescale(script: str) -> float | None:
    """Return the largest timescale with which a script starts trajectories.

    Args:
        script: path of the Python file.

    Returns:
        The timescale; None if there is no such file, if the script starts no trajectory, or if a
        timescale is not a number in the source.
    """
    tree = _tree_of(script)
    if tree is None:
        return None

    known = _known_values(tree)
    timescales = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        if node.func.attr != _START:
            continue
        timescale = _timescale_of(node)
        if timescale is None:
            return None
        numbers = _numbers(timescale, known)
        if not numbers:
            return None
        timescales += numbers
    return max(timescales, default=None)


def refuse_too_small_a_fleet(crazyflies_yaml: str | None, fleet: FleetConfig) -> None:
    """Refuse a fleet with fewer vehicles than the script describes in its own text.

    Args:
        crazyflies_yaml: argument of the script; a text in YAML has an id for each vehicle.
        fleet: fleet that is flown.

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
    """Yield line and name of each call that Covey does not fly, and of each ``time.sleep``.

    The names of the script's own methods are left out: the call may be one of them.
    """
    own_methods = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            own_methods |= {part.name for part in node.body if isinstance(part, ast.FunctionDef)}

    clocks, sleeps = _names_of_clock(tree)
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        function = node.func
        if isinstance(function, ast.Name) and function.id in sleeps:
            yield node.lineno, _CLOCK_SLEEP
        if not isinstance(function, ast.Attribute):
            continue
        if function.attr in NOT_FLOWN and function.attr not in own_methods:
            yield node.lineno, function.attr
        is_of_clock = isinstance(function.value, ast.Name) and function.value.id in clocks
        if is_of_clock and function.attr == _SLEEP:
            yield node.lineno, _CLOCK_SLEEP


def _names_of_clock(tree: ast.Module) -> tuple[set[str], set[str]]:
    """Return the names that a script gives to Python's module ``time``, and to its ``sleep``.

    A name that the script also assigns, as in ``time = swarm.timeHelper``, is left out.
    """
    clocks = set()
    sleeps = set()
    assigned = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            clocks |= {alias.asname or _CLOCK for alias in node.names if alias.name == _CLOCK}
        elif isinstance(node, ast.ImportFrom) and node.module == _CLOCK:
            sleeps |= {alias.asname or _SLEEP for alias in node.names if alias.name == _SLEEP}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            assigned.add(node.id)
        elif isinstance(node, ast.arg):
            assigned.add(node.arg)
        elif isinstance(node, ast.FunctionDef):
            assigned.add(node.name)
    return clocks - assigned, sleeps - assigned


def _tree_of(script: str) -> ast.Module | None:
    """Return the syntax tree of a script; None if there is no such file."""
    if not Path(script).is_file():
        return None
    return python_tree(read_text(script, SCRIPT), script)


def _known_values(tree: ast.Module) -> dict[str, ast.expr]:
    """Return the expressions of names to which the script assigns exactly once.

    The expression of a loop variable is the sequence of the loop.
    """
    values: dict[str, ast.expr] = {}
    assignments: Counter[str] = Counter()  # name -> number of assignments
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            assignments[node.id] += 1
        elif isinstance(node, ast.arg):
            assignments[node.arg] += 1

        if isinstance(node, ast.Assign):
            target = node.targets[0]
            value = node.value
        elif isinstance(node, ast.For | ast.comprehension):
            target = node.target
            value = node.iter
        else:
            continue
        if isinstance(target, ast.Name):
            values[target.id] = value
    return {name: value for name, value in values.items() if assignments[name] == 1}


def _numbers(node: ast.expr, known: dict[str, ast.expr], depth: int = 0) -> list[float]:
    """Return the numbers that an expression may have as value; empty if they are not known."""
    if depth > _DEEPEST:
        return []
    if isinstance(node, ast.Constant):
        if isinstance(node.value, int | float) and not isinstance(node.value, bool):
            return [float(node.value)]
        return []
    if isinstance(node, ast.Name) and node.id in known:
        return _numbers(known[node.id], known, depth + 1)
    if isinstance(node, ast.List | ast.Tuple):
        all_numbers: list[float] = []
        for element in node.elts:
            element_numbers = _numbers(element, known, depth + 1)
            if not element_numbers:  # one unknown element makes the whole list unknown
                return []
            all_numbers += element_numbers
        return all_numbers
    return []


def _wanted_ids(tree: ast.Module) -> Iterator[tuple[int, int]]:
    """Yield line and id of each vehicle that the script uses by its id."""
    known = _known_values(tree)
    for node in _reached(tree):
        if not isinstance(node, ast.Subscript) or not isinstance(node.value, ast.Attribute):
            continue
        if node.value.attr == _BY_ID:
            for number in _numbers(node.slice, known):
                yield node.lineno, int(number)


def _reached(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes below this one, without those that depend on a condition."""
    for child in ast.iter_child_nodes(node):
        yield child
        if not _is_conditional(child):
            yield from _reached(child)


def _is_conditional(node: ast.AST) -> bool:
    """Return whether code below a node may be skipped, or may fail without harm."""
    if isinstance(node, ast.If):
        return not _is_main(node.test)
    if isinstance(node, ast.comprehension):
        return bool(node.ifs)
    if isinstance(node, ast.GeneratorExp | ast.ListComp):
        return any(generator.ifs for generator in node.generators)
    return isinstance(node, ast.IfExp | ast.Match | ast.Try | ast.BoolOp | ast.While)


def _is_main(test: ast.expr) -> bool:
    """Return whether a condition is that of ``if __name__ == "__main__"``."""
    return any(isinstance(node, ast.Name) and node.id == "__name__" for node in ast.walk(test))


def _timescale_of(call: ast.Call) -> ast.expr | None:
    """Return the expression of the timescale in a call of startTrajectory; by default 1.

    Return None if it may be hidden in an unpacked argument, as in ``startTrajectory(0, **values)``.
    """
    is_unpacked = any(isinstance(argument, ast.Starred) for argument in call.args)
    for keyword in call.keywords:
        if keyword.arg == "timescale":
            return keyword.value
        if keyword.arg is None:
            is_unpacked = True
    if is_unpacked:
        return None
    if len(call.args) > _TIMESCALE_INDEX:
        return call.args[_TIMESCALE_INDEX]
    return ast.Constant(value=1.0)
