"""Nobody changes between NED and ENU by hand: onboard/frames.py does, and the emulator has frames
of its own.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from pathlib import Path

from tests.architecture import form

ROOT = Path(__file__).parents[2]
ROOMS = ("onboard", "groundstation")
FRAMES = "onboard/frames.py"


def flips(nodes: Sequence[ast.AST]) -> list[int]:
    """Lines that permute and negate the three components of one vector, or add up a quaternion's
    for the same.
    """
    triples = {names for node in nodes for names in _unpacked(node)}
    return sorted(
        {
            node.lineno
            for node in nodes
            if isinstance(node, ast.expr | ast.stmt)
            for parts in _sequences(node)
            if _is_flip(parts, triples)
        }
    )


def _unpacked(node: ast.AST) -> list[tuple[str, ...]]:
    """Names of three components taken apart: ``a, b, c = vector``, also as the last three or as a
    loop's target.
    """
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, (ast.For, ast.comprehension)):
        targets = [node.target]
    tuples = [
        part for target in targets for part in ast.walk(target) if isinstance(part, ast.Tuple)
    ]
    return [
        tuple(ast.unparse(element) for element in part.elts[-3:])
        for part in tuples
        if len(part.elts) >= 3
    ]


def _sequences(node: ast.AST) -> list[list[ast.expr]]:
    """Elements of tuples and lists, positional arguments, and the keyword arguments x, y, z and
    their like.
    """
    if isinstance(node, (ast.Tuple, ast.List)):
        return [node.elts]
    if isinstance(node, ast.Call):
        keywords = [keyword.value for keyword in node.keywords]
        return [
            node.args,
            *(keywords[first : first + 3] for first in range(max(0, len(keywords) - 2))),
        ]
    return []


def _is_flip(parts: list[ast.expr], triples: set[tuple[str, ...]]) -> bool:
    texts = [ast.unparse(part) for part in parts]
    if len(parts) == 3 and isinstance(parts[2], ast.UnaryOp) and isinstance(parts[2].op, ast.USub):
        first = texts[0]
        second = texts[1]
        third = ast.unparse(parts[2].operand)
        is_permuted = (second, first, third) in triples
        is_indexed = first.endswith("1]") and second.endswith("0]") and third.endswith("2]")
        is_named = {"east", "north"} == {first.rsplit("_", 1)[-1], second.rsplit("_", 1)[-1]}
        return is_permuted or is_indexed or is_named or texts == ["1.0", "1.0", "-1.0"]
    if len(parts) == 4:
        pairs = [sum_ for part in parts for sum_ in ast.walk(part) if isinstance(sum_, ast.BinOp)]
        sums = [
            pair
            for pair in pairs
            if isinstance(pair.op, (ast.Add, ast.Sub)) and isinstance(pair.left, ast.Name)
        ]
        signs = [type(pair.op) for pair in sums]
        return signs == [ast.Add, ast.Add, ast.Sub, ast.Sub] and len(sums) == len(parts)
    return False


def _nodes(text: str) -> list[ast.AST]:
    return list(ast.walk(ast.parse(text)))


def test_signs_flipped_by_hand_are_found() -> None:
    for wrong in (
        "def f(v):\n    a, b, c = v\n    return b, a, -c",
        "def f(v):\n    return Vec3(v[1], v[0], -v[2])",
        "def f(v):\n    return [v[..., 1], v[..., 0], -v[..., 2]]",
        "send(x=north, y=east, z=-up)",
        "send(1, 2, q=q, x=v_east, y=v_north, z=-v_down)",
        "p = (east, north, -down)",
        "q = (s * (w + z), s * (x + y), s * (x - y), s * (w - z))",
    ):
        assert flips(_nodes(wrong)), wrong
    for right in (
        "def f(v):\n    a, b, c = v\n    return a, b, -c",
        "conjugate = (w, -x, -y, -z)",
        "p = (x, y, -z)",
        "q = (a + b, c + d)",
    ):
        assert not flips(_nodes(right)), right


def test_no_sign_is_flipped_by_hand_outside_frames() -> None:
    found = [
        f"{module.path}:{line}"
        for module in form.modules()
        if module.path.startswith(ROOMS) and module.path != FRAMES
        for line in flips(module.nodes)
    ]
    assert found == [], "use the conversions of onboard/frames.py"


def test_every_conversion_is_used() -> None:
    names = [node.name for node in ast.parse((ROOT / FRAMES).read_text(encoding="utf-8")).body
             if isinstance(node, ast.FunctionDef)]  # fmt: skip
    text = "\n".join(
        path.read_text(encoding="utf-8")
        for room in (*ROOMS, "sitl")
        for path in (ROOT / room).rglob("*.py")
        if path.relative_to(ROOT).as_posix() != FRAMES
    )
    assert [name for name in names if f"{name}(" not in text] == []
