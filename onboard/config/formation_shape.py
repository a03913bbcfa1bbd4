"""Values of formations that are defined by a shape instead of a slot for each vehicle.

The ground station computes the slots from them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import msgspec

from onboard.config.toml_reading import bound_problems, convert

ShapeName = Literal[
    "line", "column", "v", "wedge", "circle", "grid", "polygon", "sphere", "text", "image", "csv"
]
BOUNDS: dict[str, tuple[float, float]] = {
    "spacing_m": (0.05, 1000.0),
    "rotation_deg": (-3600.0, 3600.0),
    "sides": (3, 100),
    "opening_deg": (20.0, 150.0),
    "columns": (1, 255),
    "layers": (1, 20),
    "layer_height_m": (0.0, 50.0),
}


class FormationShape(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[formations.NAME]`` with a ``shape``.

    North is ahead. The position gives the middle and the lowest height of the slots.
    """

    # line: abreast, column: one behind the other, v and wedge: with the tip ahead (wedge is
    # filled), sphere: no slot is above another, text: from a font, image: its dark part, csv:
    # columns x,y[,z]
    shape: ShapeName
    vehicles: str | tuple[str, ...] = "all"  # vehicles that have a slot
    # horizontal distance between the two nearest slots; by default 1.15 times the distance that the
    # law needs; a csv is not scaled by default
    spacing_m: float | None = None
    rotation_deg: float = 0.0  # counterclockwise, seen from above
    columns: int | None = None  # of a grid; by default as many columns as rows
    sides: int = 4  # of a polygon
    opening_deg: float = 90.0  # between the arms of a v or a wedge
    text: str = ""  # of a text
    font: str | None = None  # file of a font, relative to this file; by default DejaVu Sans
    file: str | None = None  # of an image or csv, relative to this file
    layers: int = 1  # number of heights; neighbouring slots alternate between the heights
    layer_height_m: float = 0.5  # from one height to the next
    # true: the layers are above each other, at least fleet.vertical_separation_m + 0.25 m apart
    stacked: bool = False


def split(data: dict[str, Any], path: str) -> tuple[dict[str, Any], dict[str, FormationShape]]:
    """Separate the formations with slots from those with a shape.

    Args:
        data: the tables of ``[formations]``.
        path: path of the file, for messages.
    Returns:
        The tables with slots, and the shapes.
    Raises:
        ConfigError: A shape has a wrong key or value.
    """
    slots: dict[str, Any] = {}
    shapes: dict[str, FormationShape] = {}
    for name, formation in data.items():
        if isinstance(formation, dict) and "shape" in formation:
            shapes[name] = convert(formation, FormationShape, path, f"formations.{name}")
        else:
            slots[name] = formation
    return slots, shapes


def problems(shapes: dict[str, FormationShape]) -> Iterator[str]:
    """Yield a sentence about each mistake in the values of shapes."""
    for name, shape in shapes.items():
        key = f"formations.{name}"
        for field, (low, high) in BOUNDS.items():
            value = getattr(shape, field)
            if value is not None:
                yield from bound_problems(f"{key}.{field}", value, low, high)

        if shape.shape == "text" and not 0 < len(shape.text.strip()) <= 100:
            yield f"'{key}.text' is {shape.text!r}; a text formation needs 1 to 100 letters."
        if shape.shape in ("image", "csv") and not shape.file:
            yield f"'{key}.file' is missing: shape = '{shape.shape}' is read from a file. Name it."
