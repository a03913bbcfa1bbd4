"""NamedTuples as rows of floats: where each number stands, and how to read and write a value.

A batch holds one row per vehicle. The layout of a row is a numpy dtype, so that
``rows["law"]["status"]`` is an array over all vehicles; the functions turn one row into the
NamedTuple that a stage takes, and back. Their text is made from the types once, since compiled code
cannot walk over fields.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from onboard.arrays import Array
from onboard.vectors import Vec2, Vec3

Rows = NDArray[np.void]  # structured: one row per vehicle
_UNROLLED = 4  # tuples longer than this are written in a loop


class Layout:
    """Layout of the rows that hold values of one NamedTuple type.

    Args:
        example: a value of the type; the lengths of its lists and tuples are those of all values.

    Attributes:
        dtype: names and shapes of the numbers; every number is a float.
        width: numbers in a row.
        read: function (row of floats) -> value.
        write: function (value, row of floats).
    """

    def __init__(self, example: Any) -> None:
        self.dtype = np.dtype(_dtype(example))
        self.width = self.dtype.itemsize // 8

        types: dict[str, Any] = {}  # that the text names
        expression, _ = _expression(example, 0, "", types)
        lines, _ = _written(example, "value", 0, "")
        text = "\n".join(
            [
                "def read(row):",
                f"    return {expression}",
                "",
                "def write(value, row):",
                *(f"    {line}" for line in lines),
                "",
            ]
        )

        # the functions find the types among their globals
        exec(compile(text, f"<rows of {type(example).__name__}>", "exec"), types)
        self.read: Callable[[Sequence[float]], Any] = types["read"]
        self.write: Callable[[Any, Any], None] = types["write"]

    def rows(self, shape: int | tuple[int, ...]) -> Rows:
        """Return rows of zeros."""
        return np.zeros(shape, self.dtype)

    def packed(self, values: Sequence[Any]) -> Rows:
        """Return one row for each value."""
        out = np.zeros((len(values), self.width))
        for value, row in zip(values, out, strict=True):
            self.write(value, row)
        rows: Rows = out.view(self.dtype)[:, 0]
        return rows

    def values(self, rows: Rows) -> list[Any]:
        """Return the value of each row (n,)."""
        return [self.read(row) for row in floats(rows).tolist()]


def floats(rows: Rows) -> Array:
    """Return the numbers (..., width) of rows (...).

    They are the same memory where the rows are contiguous and writable.
    """
    whole = np.require(rows, requirements=["C", "W"])
    return whole.view(np.float64).reshape(*whole.shape, whole.dtype.itemsize // 8)


def zero(kind: Any) -> Any:
    """Return the value of a NamedTuple type (of fixed length) whose numbers are all zero."""
    if get_origin(kind) is tuple:
        return tuple(zero(part) for part in get_args(kind))
    if not issubclass(kind, tuple):
        return kind(0)

    fields = [zero(part) for part in get_type_hints(kind).values()]
    return kind(*fields)


def _is_number(example: Any) -> bool:
    return isinstance(example, (bool, int, float))


def _is_plain_sequence(example: Any) -> bool:
    """Whether it is a list, or a tuple without names."""
    return isinstance(example, (list, tuple)) and not hasattr(example, "_fields")


def _parts(example: Any) -> dict[str, Any]:
    """Return the parts of a value by the text that reaches them."""
    if hasattr(example, "_fields"):
        return {f".{name}": getattr(example, name) for name in example._fields}
    return {f"[{index}]": part for index, part in enumerate(example)}


def _dtype(example: Any) -> Any:
    """Return the numpy dtype of a value, as ``np.dtype`` takes it."""
    if _is_number(example):
        return np.float64

    parts = list(_parts(example).values())
    if _is_plain_sequence(example) or isinstance(example, (Vec2, Vec3)):
        return (_dtype(parts[0]), (len(parts),))
    return [(name, _dtype(part)) for name, part in zip(example._fields, parts, strict=True)]


def _width(example: Any) -> int:
    """Return how many numbers a value has."""
    return int(np.dtype(_dtype(example)).itemsize) // 8


def _expression(example: Any, at: int, offset: str, types: dict[str, Any]) -> tuple[str, int]:
    """Return the text that makes a value of ``row[at + offset]`` and of what follows.

    Args:
        example: of the value.
        at: number of the row with which the value begins.
        offset: text that is added to that within a loop.
        types: is given the types that the text names.
    Returns:
        Text, and the number of the row after the value's last one.
    """
    if _is_number(example):
        return _number_expression(example, f"row[{at}{offset}]"), at + 1

    if isinstance(example, list):
        text, end = _expression(example[0], at, " + k", types)
        width = end - at
        total = len(example) * width
        return f"[{text} for k in range(0, {total}, {width})]", at + total

    texts = []
    for part in _parts(example).values():
        text, at = _expression(part, at, offset, types)
        texts.append(text)

    kind = type(example)
    if kind is tuple:
        return f"({', '.join(texts)},)", at
    types[kind.__name__] = kind
    return f"{kind.__name__}({', '.join(texts)})", at


def _number_expression(example: bool | int | float, number: str) -> str:
    """Return the text that makes a number of the example's type of a float."""
    if isinstance(example, bool):
        return f"{number} != 0.0"
    if isinstance(example, int):
        return f"int({number})"
    return number


def _written(example: Any, value: str, at: int, offset: str) -> tuple[list[str], int]:
    """Return the lines that write ``value`` to ``row[at + offset]`` and behind.

    Args:
        example: of the value.
        value: text that reaches it.
        at: number of the row with which the value begins.
        offset: text that is added to that within a loop.
    Returns:
        Lines, and the number of the row after the value's last one.
    """
    if _is_number(example):
        return [f"row[{at}{offset}] = {value}"], at + 1

    if _is_plain_sequence(example) and len(example) > _UNROLLED:
        width = _width(example[0])
        inner, _ = _written(example[0], f"{value}[k]", at, f" + {width} * k")
        loop = [f"for k in range({len(example)}):", *(f"    {line}" for line in inner)]
        return loop, at + len(example) * width

    lines: list[str] = []
    for name, part in _parts(example).items():
        part_lines, at = _written(part, value + name, at, offset)
        lines.extend(part_lines)
    return lines, at
