"""The scripts and styles of the scene, as they are sent or written into a page. Pure.

They are plain files without any build: a page loads the scripts in the order of ``SCRIPTS``, and
each adds its part to one global object ``Covey``. Only uPlot, which draws curves, is of others; it
lies here unchanged, with its licence, and a test compares its hash.
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
        name: one of ``SCRIPTS``, ``STYLES`` or ``LICENCE_OF_UPLOT``.
    """
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
