"""The reference of the Python API, printed from the code: each verb with its arguments, in its
docstring's words.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

from groundstation.missions import conditions
from groundstation.missions.api import Fleet
from groundstation.missions.blocking import BlockingFleet
from groundstation.missions.group import Group
from groundstation.missions.vehicle import LawValues, MissionVehicle

_SECTIONS = ("Args:", "Returns:", "Raises:", "Yields:")


def _words(docstring: str, section: str = "") -> str:
    """Return one section of a docstring on one line; of none, what stands before the sections."""
    parts = re.split(rf"^({'|'.join(_SECTIONS)})$", inspect.cleandoc(docstring), flags=re.MULTILINE)
    text = (
        parts[0]
        if not section
        else dict(zip(parts[1::2], parts[2::2], strict=True)).get(section, "")
    )
    lines = [line.strip() for line in text.strip().splitlines() if line.strip()]

    joined = ""
    for line in lines:
        starts_anew = section and re.match(r"\w+: ", line)
        if not joined:
            joined = line
        elif starts_anew:
            joined += f" · {line}"
        else:
            joined += f" {line}"

    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", joined).replace("``", "`")


def _call(name: str, function: Callable[..., Any]) -> str:
    """Return how a function is called."""
    signature = inspect.signature(function)
    left = [
        one.replace(annotation=one.empty)
        for one in signature.parameters.values()
        if one.name not in ("self", "cls")
    ]
    return f"{name}{signature.replace(parameters=left, return_annotation=signature.empty)}"


def _lines(owner: type, *, but: type | None = None) -> Iterator[str]:
    for name, value in vars(owner).items():
        if name.startswith("_") or (but is not None and name in vars(but)):
            continue
        function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
        if not callable(function) or not function.__doc__:
            continue
        call = name if isinstance(value, property) else _call(name, inspect.unwrap(function))
        more = _words(function.__doc__, "Args:")
        waits = "await " if inspect.iscoroutinefunction(inspect.unwrap(function)) else ""
        yield f"* `{waits}{call}`: {_words(function.__doc__)}" + (f" *{more}*" if more else "")


def python_api() -> str:
    """Print the reference of the Python API."""
    functions = [
        value
        for name, value in vars(conditions).items()
        if inspect.isfunction(value)
        and not name.startswith("_")
        and value.__module__ == conditions.__name__
    ]
    listed = "\n".join(
        f"* `{_call(one.__name__, one)}`: {_words(str(one.__doc__))}"
        + (f" *{args}*" if (args := _words(str(one.__doc__), "Args:")) else "")
        for one in functions
    )
    parts = [
        ("The whole fleet, a group, one vehicle", "\n".join(_lines(Group))),
        ("The whole fleet only: `Fleet`", "\n".join(_lines(Fleet))),
        ('One vehicle only: `fleet["mav1"]`', "\n".join(_lines(MissionVehicle))),
        ("Values of the law", ", ".join(f"`{name}`" for name in LawValues._fields)),
        ("Without `await`: `BlockingFleet`", "\n".join(_lines(BlockingFleet))),
        ("Conditions: `groundstation.missions.conditions`", listed),
    ]
    return "\n\n".join(f"### {title}\n\n{text}" for title, text in parts)
