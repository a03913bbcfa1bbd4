"""Packs NamedTuples into rows of floats, and back.

A batch has one row per vehicle. The layout of a row is a numpy dtype, so that
``rows["law"]["status"]`` is an array over all vehicles. A layout has two functions: ``read``
converts one row to a NamedTuple, and ``write`` converts a NamedTuple to a row. Compiled code cannot
loop over fields, so the source text of both functions is generated once from the type.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from onboard.arrays import Array
from onboard.vectors import Vec2, Vec3

Rows = NDArray[np.void]  # structured: one row per vehicle
_UNROLLED = 4  # longer lists and tuples are written in a loop, to keep the text short


class Layout:
    """Layout of the rows that hold values of one NamedTuple type.

    Args:
        example: a value of the type. In all values, lists and tuples must be as long as in the
            example. Lists must not be nested.

    Attributes:
        dtype: names and shapes of the numbers; every number is a float.
        width: number of floats in a row.
        read: function (row of floats) -> value.
        write: function (value, row of floats).
    """

    def __init__(self, example: Any) -> None:
        self.dtype = np.dtype(_dtype(example))
        self.width = self.dtype.itemsize // 8

        types: dict[str, Any] = {}  # name -> type, for all types that the text uses
        expression, _ = _read_expression(example, 0, "", types)
        lines, _ = _write_lines(example, "value", 0, "")
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

        # the types are the globals of the two functions; exec adds the functions to the same dict
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

    The result shares its memory with the rows if these are contiguous and writable.
    """
    whole = np.require(rows, requirements=["C", "W"])
    return whole.view(np.float64).reshape(*whole.shape, whole.dtype.itemsize // 8)


def zero(kind: Any) -> Any:
    """Return a value of a NamedTuple type with all numbers zero.

    The type must have a fixed length.
    """
    if get_origin(kind) is tuple:
        return tuple(zero(part) for part in get_args(kind))
    if not issubclass(kind, tuple):
        return kind(0)

    fields = [zero(part) for part in get_type_hints(kind).values()]
    return kind(*fields)


def _is_number(example: Any) -> bool:
    return isinstance(example, (bool, int, float))


def _is_plain_sequence(example: Any) -> bool:
    """Whether a value is a list, or a tuple without field names."""
    return isinstance(example, (list, tuple)) and not hasattr(example, "_fields")


def _parts(example: Any) -> dict[str, Any]:
    """Return the parts of a value: text that accesses a part (".x" or "[0]") -> part."""
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
    """Return the number of floats of a value."""
    return int(np.dtype(_dtype(example)).itemsize) // 8


def _read_expression(
    example: Any, start: int, offset: str, types: dict[str, Any]
) -> tuple[str, int]:
    """Return the expression that makes a value from a row, starting at ``row[start + offset]``.

    Args:
        example: a value of the same type.
        start: index in the row at which the value begins.
        offset: inside a loop, text that is added to each index, like " + k"; else empty.
        types: name -> type; all types that the text uses are added.
    Returns:
        The text, and the index after the value's last number.
    """
    if _is_number(example):
        return _number_expression(example, f"row[{start}{offset}]"), start + 1

    if isinstance(example, list):
        text, end = _read_expression(example[0], start, " + k", types)
        width = end - start
        total = len(example) * width
        return f"[{text} for k in range(0, {total}, {width})]", start + total

    texts = []
    end = start
    for part in _parts(example).values():
        text, end = _read_expression(part, end, offset, types)
        texts.append(text)

    kind = type(example)
    if kind is tuple:
        return f"({', '.join(texts)},)", end
    types[kind.__name__] = kind
    return f"{kind.__name__}({', '.join(texts)})", end


def _number_expression(example: bool | int | float, number: str) -> str:
    """Return the text that converts a float to a number of the example's type."""
    if isinstance(example, bool):
        return f"{number} != 0.0"
    if isinstance(example, int):
        return f"int({number})"
    return number


def _write_lines(example: Any, value: str, start: int, offset: str) -> tuple[list[str], int]:
    """Return the lines that write ``value`` to a row, starting at ``row[start + offset]``.

    Args:
        example: a value of the same type.
        value: text that accesses the value, like "value.law".
        start: index in the row at which the value begins.
        offset: inside a loop, text that is added to each index, like " + 3 * k"; else empty.
    Returns:
        The lines, and the index after the value's last number.
    """
    if _is_number(example):
        return [f"row[{start}{offset}] = {value}"], start + 1

    if _is_plain_sequence(example) and len(example) > _UNROLLED:
        width = _width(example[0])
        inner, _ = _write_lines(example[0], f"{value}[k]", start, f" + {width} * k")
        loop = [f"for k in range({len(example)}):", *(f"    {line}" for line in inner)]
        return loop, start + len(example) * width

    lines: list[str] = []
    end = start
    for access, part in _parts(example).items():
        part_lines, end = _write_lines(part, value + access, end, offset)
        lines.extend(part_lines)
    return lines, end
