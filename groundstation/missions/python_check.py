"""Checks a Python mission before it flies.

A mistake in it would otherwise be found in flight, when the mission comes to its line.
"""

from __future__ import annotations

import ast
import inspect
from typing import Any

from groundstation.mission_files.mission import Mission
from groundstation.mission_files.python_file import load_function
from groundstation.missions.api import Fleet
from groundstation.missions.group import Group
from groundstation.missions.vehicle import MissionVehicle
from onboard.config.file_reading import MISSION_FILE, python_tree, read_text
from onboard.config.fleet import ConfigError
from onboard.plain_text import listed, meant_words


def check_python(mission: Mission) -> None:
    """Check a Python mission: its verbs, vehicles and arguments, and whether it can be imported.

    Verbs, their arguments' names, reactions and vehicles are read from its text. Only calls on its
    function's first argument, on ``fleet["mav0"]`` and on ``fleet.group(...)`` are checked, and
    none if the function assigns something else to that name. Then the file is imported, so its code
    at the top level runs.

    Args:
        mission: Python mission, loaded and checked, with its arguments.

    Raises:
        ConfigError: a verb or a vehicle does not exist, a verb does not take an argument, or a
            reaction is called where it is given (the message names its line), or see
            :func:`load_function`.
    """
    tree = python_tree(read_text(mission.path, MISSION_FILE), mission.path)
    for function in tree.body:
        if isinstance(function, ast.AsyncFunctionDef) and function.name == "mission":
            _refuse_unknown_names(function, mission)

    load_function(mission)


def _refuse_unknown_names(function: ast.AsyncFunctionDef, mission: Mission) -> None:
    """Refuse verbs that the fleet, a vehicle of it or a group does not have, arguments that a verb
    does not take, reactions that are called, and vehicles that the fleet does not have.
    """
    parameters = [*function.args.posonlyargs, *function.args.args]
    if not parameters:
        return

    fleet_name = parameters[0].arg
    if _is_assigned(fleet_name, function):
        return

    for node in ast.walk(function):
        if isinstance(node, ast.Subscript) and _owner(node.value, fleet_name) is Fleet:
            _refuse_unknown_vehicle(node, mission)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            owner = _owner(node.func.value, fleet_name)
            if owner is not None:
                _refuse_unknown_verb(node.func, owner, mission.path)
                _refuse_wrong_arguments(node, getattr(owner, node.func.attr), mission.path)
                if node.func.attr == "reacting":
                    _refuse_called_reaction(node, fleet_name, function, mission.path)


def _refuse_unknown_vehicle(item: ast.Subscript, mission: Mission) -> None:
    """Refuse ``fleet["mav9"]`` if the fleet has no such vehicle."""
    if not isinstance(item.slice, ast.Constant):
        return

    known = mission.fleet.vehicles
    if item.slice.value not in known:
        raise ConfigError(
            f"{mission.path}: line {item.lineno}: {ast.unparse(item)} does not exist."
            f" Vehicles of this fleet: {listed(list(known))}."
        )


def _refuse_unknown_verb(verb: ast.Attribute, owner: type[Group], path: str) -> None:
    """Refuse a verb that its owner does not have."""
    if not hasattr(owner, verb.attr):
        known = [name for name in dir(owner) if not name.startswith("_")]
        raise ConfigError(
            f"{path}: line {verb.lineno}: {ast.unparse(verb)} does not exist."
            f"{meant_words(verb.attr, known)} docs/python-api.md lists all."
        )


def _refuse_wrong_arguments(call: ast.Call, function: Any, path: str) -> None:
    """Refuse a call whose arguments do not fit its verb; ``*`` and ``**`` are not looked into."""
    names = [keyword.arg for keyword in call.keywords if keyword.arg is not None]
    is_known = len(names) == len(call.keywords)
    if any(isinstance(argument, ast.Starred) for argument in call.args):
        is_known = False
    if not inspect.isfunction(function) or not is_known:
        return

    signature = inspect.signature(function)
    _, *taken = signature.parameters.values()  # without ``self``
    taken_names = [parameter.name for parameter in taken]
    takes_any = any(parameter.kind is inspect.Parameter.VAR_KEYWORD for parameter in taken)
    begin = f"{path}: line {call.lineno}: {ast.unparse(call.func)}"
    end = f"It takes: {', '.join(taken_names) or 'none'}."
    for name in names:
        if name not in taken_names and not takes_any:
            raise ConfigError(
                f"{begin} takes no argument '{name}'.{meant_words(name, taken_names)} {end}"
            )
    try:
        signature.bind(None, *call.args, **dict.fromkeys(names))
    except TypeError as error:
        raise ConfigError(f"{begin}: {error}. {end}") from None


def _refuse_called_reaction(
    call: ast.Call, fleet_name: str, function: ast.AsyncFunctionDef, path: str
) -> None:
    """Refuse a reaction that is called where it is given, instead of when its condition holds."""
    reactions = [keyword.value for keyword in call.keywords if keyword.arg == "reaction"]
    for reaction in [*call.args[1:2], *reactions]:
        if isinstance(reaction, ast.Call) and _is_coroutine(reaction, fleet_name, function):
            raise ConfigError(
                f"{path}: line {reaction.lineno}: {ast.unparse(reaction)} is called at once, and "
                "not as the reaction. Write the function without parentheses: "
                f"{ast.unparse(reaction.func)}"
            )


def _is_coroutine(call: ast.Call, fleet_name: str, function: ast.AsyncFunctionDef) -> bool:
    """Whether a call is surely of a coroutine function: a verb, or one inside the mission."""
    if isinstance(call.func, ast.Attribute):
        owner = _owner(call.func.value, fleet_name)
        return inspect.iscoroutinefunction(getattr(owner, call.func.attr, None))

    coroutines = [
        node.name for node in ast.walk(function) if isinstance(node, ast.AsyncFunctionDef)
    ]
    return isinstance(call.func, ast.Name) and call.func.id in coroutines


def _owner(expression: ast.expr, fleet_name: str) -> type[Group] | None:
    """The class of an expression; None: it is not surely the fleet, a vehicle or a group."""
    if isinstance(expression, ast.Name) and expression.id == fleet_name:
        return Fleet
    if isinstance(expression, ast.Subscript) and _owner(expression.value, fleet_name) is Fleet:
        return MissionVehicle
    if isinstance(expression, ast.Call) and isinstance(expression.func, ast.Attribute):
        method = expression.func
        if method.attr == "group" and _owner(method.value, fleet_name) is Fleet:
            return Group
    return None


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
