"""NamedTuples as rows of floats: where each number stands, and functions that read and write a
whole value.

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
        names: dict[str, Any] = {}
        lines, _ = _written(example, "value", 0, "")
        body = "\n".join(f"    {line}" for line in lines)
        text = f"def read(row):\n    return {_expression(example, 0, '', names)[0]}\n\ndef write(value, row):\n{body}\n"
        exec(compile(text, f"<rows of {type(example).__name__}>", "exec"), names)
        self.read: Callable[[Sequence[float]], Any] = names["read"]
        self.write: Callable[[Any, Any], None] = names["write"]

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
        return list(map(self.read, floats(rows).tolist()))


def floats(rows: Rows) -> Array:
    """Return the numbers (..., width) of rows (...): the same memory where the rows are contiguous
    and writable.
    """
    whole = np.require(rows, requirements=["C", "W"])
    return whole.view(np.float64).reshape(*whole.shape, whole.dtype.itemsize // 8)


def zero(kind: Any) -> Any:
    """Return the value of a NamedTuple type (of fixed length) whose numbers are all zero."""
    if get_origin(kind) is tuple:
        return tuple(zero(part) for part in get_args(kind))
    if not issubclass(kind, tuple):
        return kind(0)
    return kind(*(zero(part) for part in get_type_hints(kind).values()))


def _is_number(example: Any) -> bool:
    return isinstance(example, (bool, int, float))


def _parts(example: Any) -> dict[str, Any]:
    """Parts of a value by the text that reaches them."""
    if hasattr(example, "_fields"):
        return {f".{name}": getattr(example, name) for name in example._fields}
    return {f"[{index}]": part for index, part in enumerate(example)}


def _dtype(example: Any) -> Any:
    if _is_number(example):
        return np.float64
    parts = list(_parts(example).values())
    if not hasattr(example, "_fields") or isinstance(example, (Vec2, Vec3)):
        return (_dtype(parts[0]), (len(parts),))
    return [(name, _dtype(part)) for name, part in zip(example._fields, parts, strict=True)]


def _expression(example: Any, at: int, offset: str, names: dict[str, Any]) -> tuple[str, int]:
    """The text that makes a value of ``row[at + offset]`` and of what follows, and the number after
    its last one.
    """
    if _is_number(example):
        number = f"row[{at}{offset}]"
        text = (
            f"{number} != 0.0"
            if isinstance(example, bool)
            else f"int({number})"
            if isinstance(example, int)
            else number
        )
        return text, at + 1
    if isinstance(example, list):
        text, end = _expression(example[0], at, " + k", names)
        width = end - at
        return f"[{text} for k in range(0, {len(example) * width}, {width})]", at + len(
            example
        ) * width
    texts = []
    for part in _parts(example).values():
        text, at = _expression(part, at, offset, names)
        texts.append(text)
    kind = type(example)
    if kind is tuple:
        return f"({', '.join(texts)},)", at
    names[kind.__name__] = kind
    return f"{kind.__name__}({', '.join(texts)})", at


def _written(example: Any, value: str, at: int, offset: str) -> tuple[list[str], int]:
    """The lines that write ``value`` to ``row[at + offset]`` and behind, and the number after its
    last one.
    """
    if _is_number(example):
        return [f"row[{at}{offset}] = {value}"], at + 1
    lines: list[str] = []
    if (
        isinstance(example, (list, tuple))
        and not hasattr(example, "_fields")
        and len(example) > _UNROLLED
    ):
        inner, end = _written(example[0], f"{value}[k]", at, f" + {_width(example[0])} * k")
        return [f"for k in range({len(example)}):", *(f"    {line}" for line in inner)], at + len(
            example
        ) * (end - at)
    for name, part in _parts(example).items():
        more, at = _written(part, value + name, at, offset)
        lines += more
    return lines, at


def _width(example: Any) -> int:
    return int(np.dtype(_dtype(example)).itemsize) // 8
