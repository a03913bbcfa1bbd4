"""The console on terminals of every kind: light or dark, with colour or without, in Unicode or in
ASCII.

Widgets draw one way only: dark, in colour, in Unicode. What a terminal needs otherwise is changed
on the way out, line by line, so that no widget can forget it. Every sign keeps its width in cells,
so nothing moves.
"""

from __future__ import annotations

import colorsys
import os
import sys
import unicodedata
from collections.abc import Mapping, Sequence
from functools import lru_cache

from rich.cells import get_character_cell_size
from rich.color import Color as RichColor
from rich.segment import Segment
from rich.style import Style
from textual.color import Color
from textual.filter import LineFilter, NoColor

from groundstation.console.theme import LIGHT

_SIGNS = {
    "…": "~", "○": "o", "◎": "@", "●": "*", "■": "=", "▲": "^", "▼": "v", "✖": "X", "✔": "+", "✓": "*", "·": ".",
    "→": ">", "←": "<", "↑": "^", "↓": "v", "↗": "/", "↖": "\\", "↙": "/", "↘": "\\", "↷": "/", "▸": ">", "✛": "+",
    "▌": ">", "█": "#", "▏": "-", "▎": "-", "▍": "-", "▋": "=", "▊": "=", "▉": "=", "▮": "|", "▯": ".", "–": "-",
    "—": "-", "×": "x", "°": "o", "²": "2", "±": "~", "µ": "u", "≥": ">", "≤": "<", "‖": "|", "▶": ">", "⏸": "=",
    "▁": "_", "▂": ".", "▃": "-", "▄": "=", "▅": "+", "▆": "*", "▇": "%", "▔": "-", "▕": "|", "▐": "|", "▀": "-",
    "‘": "'", "’": "'", "“": '"', "”": '"', "↻": "@", "⚠": "!", "☠": "X", "◀": "<", "⋯": "~", "∞": "8",
}  # fmt: skip


def is_ascii_wanted(
    environ: Mapping[str, str], *, is_utf8_forced: bool = bool(sys.flags.utf8_mode)
) -> bool:
    """Whether the terminal is to get ASCII only: set by COVEY_ASCII, or by a locale that is not
    UTF-8.

    Without any locale, as in many containers, Unicode is assumed. ``is_utf8_forced``: Python found
    the plain C locale and wrote its own LC_CTYPE into the environment, which nobody has set.
    """
    own_choice = environ.get("COVEY_ASCII", "").strip().lower()
    if own_choice:
        return own_choice not in ("0", "no", "off", "false")
    is_pythons = is_utf8_forced and environ.get("LC_CTYPE", "").upper().replace("-", "") in (
        "C.UTF8",
        "UTF8",
    )
    named = (
        environ.get("LC_ALL")
        or ("" if is_pythons else environ.get("LC_CTYPE"))
        or environ.get("LANG")
        or ""
    )
    return bool(named) and "utf8" not in named.lower().replace("-", "")


def is_light_wanted(environ: Mapping[str, str]) -> bool:
    """Whether the terminal's ground is light: set by COVEY_THEME, else by COLORFGBG
    (``foreground;background``).
    """
    own_choice = environ.get("COVEY_THEME", "").strip().lower()
    if own_choice in ("light", "dark"):
        return own_choice == "light"
    ground = environ.get("COLORFGBG", "").rpartition(";")[2]
    return ground in ("7", "15")


def to_ascii(text: str) -> str:
    """Return ``text`` in printable ASCII, with the same number of cells."""
    return text if text.isascii() else text.translate(_ASCII)


class Ascii(LineFilter):
    """Signs, borders and braille become ASCII characters."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the same line in ASCII."""
        return [
            segment
            if segment.text.isascii()
            else Segment(to_ascii(segment.text), segment.style, segment.control)
            for segment in segments
        ]


class LightGround(LineFilter):
    """Colours for a light ground: the console's own by a table, others with their lightness turned
    around.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the same line in light colours."""
        return [
            Segment(
                segment.text,
                None if segment.style is None else _light(segment.style),
                segment.control,
            )
            for segment in segments
        ]


class TerminalFilters:
    """The filters that this terminal needs, from its environment."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        self.is_light = is_light_wanted(environ)
        self.is_ascii = is_ascii_wanted(environ)
        self._light, self._ascii, self._no_colour = LightGround(), Ascii(), NoColor()

    def active(self, *, has_colour: bool) -> Sequence[LineFilter]:
        """Return the filters that every line passes on its way out.

        Textual's own filters are not among them: they would cost a tenth of all drawing, and the
        console names no colour by its ANSI number.
        """
        colour: list[LineFilter] = (
            [self._no_colour] if not has_colour else [self._light] if self.is_light else []
        )
        return [*colour, self._ascii] if self.is_ascii else colour


@lru_cache(4096)
def _light(style: Style) -> Style:
    return style + Style(color=_light_colour(style.color), bgcolor=_light_colour(style.bgcolor))


@lru_cache(4096)
def _light_colour(colour: RichColor | None) -> RichColor | None:
    if colour is None or colour.is_default or colour.triplet is None:
        return None
    own = LIGHT.get(colour.triplet.hex)
    if own is not None:
        return RichColor.parse(own)
    hue, lightness, saturation = colorsys.rgb_to_hls(*colour.triplet.normalized)
    red, green, blue = (
        round(255 * part) for part in colorsys.hls_to_rgb(hue, 1.0 - lightness, saturation)
    )
    return RichColor.from_rgb(red, green, blue)


class _Table(dict[int, str]):
    """Grows with the characters that come: accents are dropped, a character without likeness
    becomes question marks.
    """

    def __missing__(self, code: int) -> str:
        char = chr(code)
        if code < 0x80:
            self[code] = char
        elif 0x2800 <= code <= 0x28FF:
            self[code] = _braille(code - 0x2800)
        elif 0x2500 <= code <= 0x257F:
            self[code] = "-" if char in "─━╌╍┄┅┈┉═╴╶╸╺" else "|" if char in "│┃╎╏┆┇┊┋║╵╷╹╻" else "+"
        else:
            width = get_character_cell_size(char)
            plain = unicodedata.normalize("NFKD", char).encode("ascii", "ignore").decode()
            self[code] = plain if len(plain) == width and plain.isprintable() else "?" * width
        return self[code]


def _braille(bits: int) -> str:
    """Return the ASCII character that is most like these dots (Unicode's order of bits)."""
    left = [bool(bits & bit) for bit in (0x01, 0x02, 0x04, 0x40)]
    right = [bool(bits & bit) for bit in (0x08, 0x10, 0x20, 0x80)]
    count = sum(left) + sum(right)
    upper, lower = any(left[:2] + right[:2]), any(left[2:] + right[2:])
    if count >= 6:
        return "#"
    if count >= 3 and (not any(left) or not any(right)):
        return "|"
    if count <= 2 and not (upper and lower):
        pair = any(left) and any(right)
        return " " if not count else ("-" if pair and (left[1] or left[2]) else '"' if pair else "'") if upper else (
            "_" if pair and left[3] else "-" if pair else "."
        )  # fmt: skip
    if not (upper and lower):
        return "="
    falls = any(left[:2]) and any(right[2:]) and not (any(left[2:]) or any(right[:2]))
    rises = any(right[:2]) and any(left[2:]) and not (any(right[2:]) or any(left[:2]))
    return "\\" if falls else "/" if rises else ":" if count <= 2 else "+"


_ASCII = _Table({ord(sign): plain for sign, plain in _SIGNS.items()})
