"""Refuses a Python mission that calls a verb which the fleet does not have.

Otherwise the mistake would be found when the mission comes to that line, in flight. The file is
read as text; nothing of it is run.
"""

from __future__ import annotations

import ast

from groundstation.mission_files.mission import Mission
from groundstation.missions.api import Fleet
from onboard.config.file_reading import MISSION_FILE, python_tree, read_text
from onboard.config.fleet import ConfigError
from onboard.plain_text import meant_words


def refuse_unknown_verbs(mission: Mission) -> None:
    """Refuse a Python mission whose function calls a verb that :class:`Fleet` does not have.

    Only calls on the function's first argument are checked, and none if the function assigns
    something else to its name.

    Args:
        mission: Python mission, loaded and checked.

    Raises:
        ConfigError: a verb does not exist; the message names its line.
    """
    tree = python_tree(read_text(mission.path, MISSION_FILE), mission.path)
    for function in tree.body:
        if isinstance(function, ast.AsyncFunctionDef) and function.name == "mission":
            _refuse_in(function, mission.path)


def _refuse_in(function: ast.AsyncFunctionDef, path: str) -> None:
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
