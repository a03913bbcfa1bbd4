"""Python missions as text: read without being run."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from onboard.config.fleet import ConfigError


def read_python(name: str) -> tuple[str, dict[str, Any]]:
    """Read a Python mission: ``async def mission(fleet)``, and the literals ``FLEET``, ``EXPECT``,
    ``FORMATIONS``.

    Args:
        name: path of the file.

    Returns:
        Its text and its literals by name.

    Raises:
        ConfigError: it cannot be read, is not Python, or has no such coroutine.
    """
    try:
        text = Path(name).read_text(encoding="utf-8")
        tree = ast.parse(text, name)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{name}: this mission cannot be read ({error}). Check the path."
        ) from None
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{name}: not valid Python: {error}. Correct that line.") from None
    if not any(
        isinstance(node, ast.AsyncFunctionDef) and node.name == "mission" for node in tree.body
    ):
        raise ConfigError(
            f"{name}: a Python mission needs 'async def mission(fleet):' at its top level. Add it; "
            f"or start a script that connects by itself with: covey fly script {name} --fleet FILE"
        )
    constants: dict[str, Any] = {}
    for node in tree.body:
        if (
            isinstance(node, ast.Assign)
            and len(node.targets) == 1
            and isinstance(node.targets[0], ast.Name)
        ):
            target = node.targets[0].id
            if target in ("FLEET", "EXPECT", "FORMATIONS"):
                try:
                    constants[target] = ast.literal_eval(node.value)
                except ValueError:
                    raise ConfigError(
                        f"{name}: '{target}' must be a plain literal. Write its value out."
                    ) from None
    return text, constants


def arguments_of(
    function: Callable[..., Any], given: Mapping[str, str], where: str
) -> dict[str, Any]:
    """Return the arguments of a mission's function, each of the kind of its default.

    Args:
        function: ``mission(fleet, height_m=1.0, ...)``.
        given: as they were written.
        where: the file, for the sentences.

    Returns:
        Their values by name.

    Raises:
        ConfigError: it has no such argument, a value is of another kind, or one that has no default
            is missing.
    """
    known = dict(list(inspect.signature(function).parameters.items())[1:])
    for name in given:
        if name not in known:
            raise ConfigError(
                f"{where}: 'mission' has no argument '{name}'; it has {', '.join(known) or 'none'}."
            )
    missing = [
        name for name, one in known.items() if one.default is one.empty and name not in given
    ]
    if missing:
        raise ConfigError(
            f"{where}: 'mission' needs {missing[0]}. Give it: --arg {missing[0]}=VALUE"
        )
    return {
        name: _value(text, known[name].default, f"{where}: '{name}'")
        for name, text in given.items()
    }


def _value(text: str, default: Any, where: str) -> Any:
    """Return a written value as the kind of its default; without a default as a number, or else as
    text.
    """
    if isinstance(default, str):
        return text
    words = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
    if isinstance(default, bool):
        if text.lower() not in words:
            raise ConfigError(f"{where} is {text!r}; it must be true or false.")
        return words[text.lower()]
    try:
        value = ast.literal_eval(text)
    except (ValueError, SyntaxError):
        value = text
    is_number = isinstance(default, int | float)
    if is_number and (
        isinstance(value, bool)
        or not isinstance(value, int if isinstance(default, int) else int | float)
    ):
        kind = "a whole number" if isinstance(default, int) else "a number"
        raise ConfigError(f"{where} is {text!r}; it must be {kind}, as its default {default!r} is.")
    return value
