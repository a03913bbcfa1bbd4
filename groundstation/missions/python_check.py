"""Checks a Python mission before it flies.

A mistake in it would otherwise be found in flight, when the mission comes to its line.
"""

from __future__ import annotations

import ast

from groundstation.mission_files.mission import Mission
from groundstation.mission_files.python_file import load_function
from groundstation.missions.api import Fleet
from onboard.config.file_reading import MISSION_FILE, python_tree, read_text
from onboard.config.fleet import ConfigError
from onboard.plain_text import meant_words


def check_python(mission: Mission) -> None:
    """Check a Python mission: its verbs, its arguments, and whether it can be imported.

    Its verbs are read from its text. Only calls on its function's first argument are checked, and
    none if the function assigns something else to that name. Then the file is imported, so its code
    at the top level runs.

    Args:
        mission: Python mission, loaded and checked, with its arguments.

    Raises:
        ConfigError: a verb does not exist (the message names its line), or see
            :func:`load_function`.
    """
    tree = python_tree(read_text(mission.path, MISSION_FILE), mission.path)
    for function in tree.body:
        if isinstance(function, ast.AsyncFunctionDef) and function.name == "mission":
            _refuse_unknown_verbs(function, mission.path)

    load_function(mission)


def _refuse_unknown_verbs(function: ast.AsyncFunctionDef, path: str) -> None:
    """Refuse a call of a verb that :class:`Fleet` does not have."""
    parameters = [*function.args.posonlyargs, *function.args.args]
    if not parameters:
        return

    fleet_name = parameters[0].arg
    if _is_assigned(fleet_name, function):
        return

    for node in ast.walk(function):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        verb = node.func
        is_of_fleet = isinstance(verb.value, ast.Name) and verb.value.id == fleet_name
        if is_of_fleet and not hasattr(Fleet, verb.attr):
            known = [name for name in dir(Fleet) if not name.startswith("_")]
            raise ConfigError(
                f"{path}: line {node.lineno}: '{fleet_name}' has no '{verb.attr}'."
                f"{meant_words(verb.attr, known)} docs/python-api.md lists all."
            )


def _is_assigned(name: str, function: ast.AsyncFunctionDef) -> bool:
    """Whether a function assigns to a name or to one of its attributes, or has it as another's."""
    for node in ast.walk(function):
        if isinstance(node, ast.arg) and node.arg == name and node not in function.args.args:
            return True
        if not isinstance(node, ast.Name | ast.Attribute) or isinstance(node.ctx, ast.Load):
            continue

        target: ast.expr = node
        if isinstance(node, ast.Attribute):
            target = node.value
        if isinstance(target, ast.Name) and target.id == name:
            return True
    return False
