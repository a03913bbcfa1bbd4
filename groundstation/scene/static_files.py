"""Reads the scripts and styles of the scene, which pages load or contain. Pure.

They are plain files without any build: a page loads the scripts in the order of ``SCRIPTS``, and
each adds its part to one global object ``Covey``. Only uPlot, which draws curves, is third-party
code; its files are unchanged, with their licence, and a test compares their hash.
"""

from __future__ import annotations

from importlib.resources import files

SCRIPTS = (
    "uplot/uPlot.iife.min.js",
    "elements.js",
    "colours.js",
    "camera.js",
    "scene.js",
    "ground.js",
    "charts.js",
)
STYLES = ("uplot/uPlot.min.css", "page.css")
LICENCE_OF_UPLOT = "uplot/LICENSE"


def text_of(name: str) -> str:
    """Return the text of one file of this folder.

    Args:
        name: a name in ``SCRIPTS`` or ``STYLES``, or ``LICENCE_OF_UPLOT``.
    """
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
