"""Python missions: they are first read as text without being run, and then imported.

``FLEET``, ``EXPECT`` and ``FORMATIONS`` are read as literals, so reading them runs no code. The
import runs the module, for a flight and for ``covey check``: :func:`load_function` returns the
mission function.
"""

from __future__ import annotations

import ast
import importlib.util
import inspect
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from groundstation.mission_files.mission import Mission
from onboard.config.file_reading import MISSION_FILE, check_values, python_tree, read_text
from onboard.config.fleet import ConfigError

# a coroutine function that is called with the Fleet of groundstation.missions
MissionFunction = Callable[[Any], Awaitable[None]]

_CONSTANTS = ("FLEET", "EXPECT", "FORMATIONS")
_TRUTH_WORDS = {
    "true": True,
    "yes": True,
    "on": True,
    "false": False,
    "no": False,
    "off": False,
}


def read_python(name: str) -> tuple[str, dict[str, Any]]:
    """Read a Python mission: its text, and the literals ``FLEET``, ``EXPECT``, ``FORMATIONS``.

    Args:
        name: path of the file.

    Returns:
        Its text and its literals by name.

    Raises:
        ConfigError: the file cannot be read, is not Python, or has no
            ``async def mission(fleet)``.
    """
    text = read_text(name, MISSION_FILE)
    tree = python_tree(text, name)
    if not any(_is_mission(node) for node in tree.body):
        raise ConfigError(
            f"{name}: a Python mission needs 'async def mission(fleet):' at its top level. Add it; "
            f"or start a script that connects by itself with: covey fly script {name} --fleet FILE"
        )

    constants: dict[str, Any] = {}
    for node in tree.body:
        constant, value = _assigned(node)
        if constant not in _CONSTANTS or value is None:
            continue
        try:
            constants[constant] = ast.literal_eval(value)
        except (ValueError, TypeError, RecursionError, MemoryError):
            raise ConfigError(
                f"{name}: '{constant}' must be a plain literal. Write its value out."
            ) from None
        check_values(constants[constant], name)
    return text, constants


def load_function(mission: Mission) -> MissionFunction:
    """Load the coroutine function ``mission`` of a Python mission.

    Args:
        mission: mission file, loaded and checked.

    Returns:
        The function, with the mission's arguments.

    Raises:
        ConfigError: the module cannot be run, or the function does not take these arguments.
    """
    spec = importlib.util.spec_from_file_location(f"covey_mission_{mission.name}", mission.path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{mission.path}: this file cannot be loaded as a Python module.")

    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # the user's code can raise anything
        raise ConfigError(
            f"{mission.path}: running it failed: {type(error).__name__}: {error}."
        ) from error

    function = module.mission
    if not inspect.iscoroutinefunction(function):
        raise ConfigError(
            f"{mission.path}: 'mission' must be written as 'async def mission(fleet):'."
        )
    arguments = arguments_of(function, mission.arguments, mission.path)
    return lambda fleet: function(fleet, **arguments)


def arguments_of(
    function: Callable[..., Any], given: Mapping[str, str], where: str
) -> dict[str, Any]:
    """Return the arguments of a mission's function, each converted to the type of its default.

    Args:
        function: a function such as ``mission(fleet, height_m=1.0, ...)``.
        given: arguments as they were written.
        where: the file, for the sentences.

    Returns:
        name -> value.

    Raises:
        ConfigError: the function has no such argument, a value has the wrong type, or an argument
            without a default is missing.
    """
    parameters = list(inspect.signature(function).parameters.items())
    known = dict(parameters[1:])  # without the first one, which is the fleet

    for name in given:
        if name not in known:
            raise ConfigError(
                f"{where}: 'mission' has no argument '{name}'; it has {', '.join(known) or 'none'}."
            )
    for name, parameter in known.items():
        if parameter.default is parameter.empty and name not in given:
            raise ConfigError(f"{where}: 'mission' needs {name}. Give it: --arg {name}=VALUE")

    return {
        name: _value(text, known[name].default, f"{where}: '{name}'")
        for name, text in given.items()
    }


def _assigned(node: ast.stmt) -> tuple[str, ast.expr | None]:
    """Return the name to which a statement assigns, and the value.

    The name is empty for any other statement, and for one that assigns to several targets.
    """
    target: ast.expr | None = None
    value: ast.expr | None = None
    if isinstance(node, ast.Assign) and len(node.targets) == 1:
        target = node.targets[0]
        value = node.value
    elif isinstance(node, ast.AnnAssign):  # with a type: EXPECT: dict[str, object] = {...}
        target = node.target
        value = node.value

    if isinstance(target, ast.Name):
        return target.id, value
    return "", None


def _is_mission(node: ast.stmt) -> bool:
    """Whether a statement is ``async def mission``."""
    return isinstance(node, ast.AsyncFunctionDef) and node.name == "mission"


def _value(text: str, default: Any, subject: str) -> Any:
    """Return a written value converted to the type of its default.

    For an argument without a default, the text is read as a Python literal; a text that is not a
    literal is returned unchanged.
    """
    if isinstance(default, str):
        return text

    if isinstance(default, bool):
        if text.lower() not in _TRUTH_WORDS:
            raise ConfigError(f"{subject} is {text!r}; it must be true or false.")
        return _TRUTH_WORDS[text.lower()]

    try:
        value = ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
        value = text

    if isinstance(default, int):
        is_good = isinstance(value, int) and not isinstance(value, bool)
        kind = "a whole number"
    elif isinstance(default, float):
        is_good = isinstance(value, int | float) and not isinstance(value, bool)
        kind = "a number"
    else:
        return value

    if not is_good:
        raise ConfigError(
            f"{subject} is {text!r}; it must be {kind}, as its default {default!r} is."
        )
    return value
