"""Many values are given by name: two exchanged numbers pass every other check."""

from __future__ import annotations

import ast
from collections.abc import Iterable

import pytest

from tests.architecture import form

MANY_VALUES = 5  # positional values in one call, from which on they need their names


def unnamed(nodes: Iterable[ast.AST]) -> list[tuple[int, str]]:
    """Return line and class of each call that builds an object of many values without names."""
    found = []
    for node in nodes:
        if not isinstance(node, ast.Call) or len(node.args) < MANY_VALUES:
            continue

        name = ""
        if isinstance(node.func, ast.Name):
            name = node.func.id
        elif isinstance(node.func, ast.Attribute):
            name = node.func.attr

        if name.lstrip("_")[:1].isupper():
            found.append((node.lineno, name))

    return found


def test_an_object_of_many_values_is_built_with_their_names() -> None:
    places = [
        f"{module.path}:{line} {name}"
        for module in form.modules()
        for line, name in unnamed(module.nodes)
    ]
    assert not places, "five or more values without their names:\n" + "\n".join(places)


@pytest.mark.parametrize("call", ["State(1, 2, 3, 4, 5)", "types.State(1, 2, 3, 4, *rest)"])
def test_a_call_with_many_values_and_no_names_is_seen(call: str) -> None:
    assert unnamed(ast.walk(ast.parse(call))) == [(1, "State")]


@pytest.mark.parametrize("call", ["State(1, 2, 3, 4)", "step(1, 2, 3, 4, 5)", "State(1, 2, a=3)"])
def test_few_values_names_and_functions_are_left_alone(call: str) -> None:
    assert unnamed(ast.walk(ast.parse(call))) == []
