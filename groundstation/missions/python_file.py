"""Python missions as text: read without being run."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

from onboard.config.fleet import ConfigError


def read_python(name: str) -> tuple[str, dict[str, Any]]:
    """Read a Python mission: ``async def mission(fleet)``, and the literals ``FLEET``, ``EXPECT``, ``FORMATIONS``.

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
        raise ConfigError(f"{name}: this mission cannot be read ({error}). Check the path.") from None
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{name}: not valid Python: {error}. Correct that line.") from None
    if not any(isinstance(node, ast.AsyncFunctionDef) and node.name == "mission" for node in tree.body):
        raise ConfigError(
            f"{name}: a Python mission needs 'async def mission(fleet):' at its top level. Add it; "
            f"or start a script that connects by itself with: covey run {name} --fleet FILE"
        )
    constants: dict[str, Any] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            target = node.targets[0].id
            if target in ("FLEET", "EXPECT", "FORMATIONS"):
                try:
                    constants[target] = ast.literal_eval(node.value)
                except ValueError:
                    raise ConfigError(f"{name}: '{target}' must be a plain literal. Write its value out.") from None
    return text, constants
