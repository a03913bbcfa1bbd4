"""One look for all figures: a colour per vehicle that the common kinds of colour blindness tell apart."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7A5230", "#000000")
SOFT = "#8a939c"
LIMIT = "#B00020"
RC: dict[Any, Any] = {
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.grid": True,
    "grid.color": "#e3e7ea",
    "grid.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#5a646d",
    "axes.axisbelow": True,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.dpi": 150,
    "svg.hashsalt": "covey",
}


def colour(index: int) -> str:
    """Colour of the vehicle at this place in the record."""
    return COLOURS[index % len(COLOURS)]


def styled() -> AbstractContextManager[None]:
    """Draw and save within this context to get the look; matplotlib's settings stay as they were outside."""
    return matplotlib.rc_context(RC)


def new_figure(width_in: float, height_in: float, title: str) -> Any:
    """An empty figure with its title; drawn without any window system."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(title, fontsize=13, fontweight="bold", x=0.01, ha="left")
    return figure


def save(figure: Any, folder: Path, name: str) -> list[Path]:
    """Write PNG and SVG; returns their paths."""
    paths = [folder / f"{name}.png", folder / f"{name}.svg"]
    figure.savefig(paths[0])
    figure.savefig(paths[1], metadata={"Date": None})
    return paths
