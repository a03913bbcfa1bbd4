"""Makes the page of a report: one file with its scripts, its styles and its data. Pure.

The page's content security policy allows exactly these scripts and styles, by their hashes, and no
loading from anywhere. So no text of a record can be executed. The data are base64 in an element
that is not a script.
"""

from __future__ import annotations

import base64
import hashlib
import html
from importlib.resources import files
from string import Template

from groundstation.scene.static_files import LICENCE_OF_UPLOT, SCRIPTS, STYLES, text_of

OWN_SCRIPTS = (
    "payload.js",
    "player.js",
    "flight_scene.js",
    "flight_charts.js",
    "views.js",
    "report.js",
)
OWN_STYLE = "report.css"
_TEMPLATE = "report.html"


def page(title: str, data: bytes, *, has_pictures: bool = False) -> str:
    """Return the text of the page.

    Args:
        title: the flight's title.
        data: the result of :func:`groundstation.report.payload.payload`.
        has_pictures: whether the data contain pictures of the ground, which the browser may show.
    """
    scripts = [text_of(name) for name in SCRIPTS] + [_own(name) for name in OWN_SCRIPTS]
    styles = [text_of(name) for name in STYLES] + [_own(OWN_STYLE)]
    # the template holds the licence in an HTML comment, which must not contain "--"
    licence = html.escape(text_of(LICENCE_OF_UPLOT)).replace("--", "- -")
    return Template(_own(_TEMPLATE)).substitute(
        policy=html.escape(policy(scripts, styles, has_pictures=has_pictures), quote=True),
        title=html.escape(title),
        licence=licence,
        styles="\n".join(f"<style>{text}</style>" for text in styles),
        data=base64.b64encode(data).decode("ascii"),
        scripts="\n".join(f"<script>{text}</script>" for text in scripts),
    )


def policy(scripts: list[str], styles: list[str], *, has_pictures: bool = False) -> str:
    """Return the content security policy, which allows only these scripts and styles."""
    pictures = []
    if has_pictures:
        pictures.append("img-src data:")
    return "; ".join(
        [
            "default-src 'none'",
            *pictures,
            f"script-src {' '.join(map(_hash, scripts))}",
            f"style-src {' '.join(map(_hash, styles))}",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


def _own(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
