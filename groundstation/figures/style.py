"""The style of all figures, with a colour for each vehicle.

People with the common kinds of colour blindness can tell the colours apart.
"""

from __future__ import annotations

import math
import textwrap
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from groundstation.recording.output_file import refuse_other_file, written_beside
from onboard.arrays import Array

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7A5230", "#000000")
SOFT = "#8a939c"
LIMIT = "#B00020"
_PANELS_IN_A_ROW = 4  # vehicles beside each other; more of them stand in rows below
_LINE_STYLES: tuple[Any, ...] = ("-", (0, (6, 1.2)), (0, (2, 1)), (0, (1, 1)))
_TITLE_LETTERS_PER_INCH = 9.0  # of its bold font
_SETTINGS = Path(__file__).with_name("covey.mplstyle")
# how a PNG, an SVG and a PDF begin, and what Matplotlib writes near the beginning of each
_MARKS = (
    (b"\x89PNG", b"Software\0Matplotlib"),
    (b"<?xml", b"<dc:title>Matplotlib"),
    (b"%PDF", b"%\xac\xdc \xab\xba"),
)


def colour(index: int) -> str:
    """Return the colour of the vehicle with this index in the record."""
    return COLOURS[index % len(COLOURS)]


def line_style(index: int) -> Any:
    """Return the line style of the vehicle with this index: a new one where colours begin again."""
    return _LINE_STYLES[index // len(COLOURS) % len(_LINE_STYLES)]


def panel_grid(count: int) -> tuple[int, int]:
    """Return the number of columns, and of rows, of the panels of this many vehicles."""
    columns = min(count, _PANELS_IN_A_ROW)
    return columns, math.ceil(count / columns)


def limit_around_zero(values: Array, *, least: float, most: float, unit: str) -> tuple[float, str]:
    """Return the end of an axis around 0 that shows all values up to a bound.

    In a long flight what a figure is about may last for a few of many thousand samples. Only what
    no vehicle does in flight, and what would flatten the curves, is beyond the axis.

    Args:
        values: values of any shape; NaN is left out.
        least: the smallest end of the axis.
        most: its largest end.
        unit: unit of the values.

    Returns:
        The end of the axis, and words for the title about values beyond it; empty if there are
        none.
    """
    sizes = np.abs(values[np.isfinite(values)])
    largest = float(sizes.max(initial=0.0))
    limit = min(max(least, 1.1 * largest), most)
    if largest > limit:
        return limit, f"; the axes end below the largest value, {largest:.1f} {unit}"
    return limit, ""


def styled() -> AbstractContextManager[None]:
    """Return a context with the settings of this style; outside of it matplotlib's remain."""
    return matplotlib.rc_context(fname=_SETTINGS)


def new_figure(width_in: float, height_in: float, title: str) -> Any:
    """Return an empty figure with its title, drawn without any window system."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    lines = title_lines(title, width_in)
    figure.suptitle(lines, fontsize=13, fontweight="bold", x=0.01, ha="left")
    return figure


def title_lines(title: str, width_in: float) -> str:
    """Return a title in as many lines as it needs in a figure of this width."""
    letters = int(_TITLE_LETTERS_PER_INCH * width_in)
    return textwrap.fill(title, width=letters, break_on_hyphens=False)


def save(figure: Any, folder: Path, name: str) -> list[Path]:
    """Write PNG and SVG, and return their paths."""
    png, svg = saved_paths(folder, name)
    write_figure(figure, png)

    # The first savefig has computed the layout. Computing it again would take as long as drawing.
    figure.set_layout_engine("none")
    write_figure(figure, svg)
    return [png, svg]


def saved_paths(folder: Path, name: str) -> list[Path]:
    """Return the paths that :func:`save` writes: PNG and SVG."""
    return [folder / f"{name}.png", folder / f"{name}.svg"]


def write_figure(figure: Any, path: Path) -> None:
    """Write a figure whole or not at all; the suffix of the path decides its format.

    Raises:
        OSError: the file cannot be written.
    """
    metadata = None
    if path.suffix == ".svg":
        metadata = {"Date": None}  # without a date, so that the same flight gives the same file
    with written_beside(path) as part:
        figure.savefig(part, format=path.suffix.removeprefix("."), metadata=metadata)


def refuse_other_picture(path: Path, *, option: str) -> None:
    """Refuse to write over a picture that was not drawn with Matplotlib, or over another file.

    Args:
        path: file of the figure to be written.
        option: the option that names another place.

    Raises:
        ConfigError: there is such a file.
    """
    refuse_other_file(path, _is_figure, other="is no figure of Matplotlib", option=option)


def _is_figure(begin: bytes) -> bool:
    """Return whether a file that begins with these bytes was drawn with Matplotlib."""
    return any(begin.startswith(kind) and mark in begin for kind, mark in _MARKS)
