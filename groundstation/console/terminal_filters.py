"""Adapts the console to every kind of terminal: light or dark, with or without colour, in ASCII.

Widgets draw in one way only: dark, in colour, in Unicode. Filters adapt each line when it is
written, so that no widget can forget it. Every sign keeps its width in cells, so the layout does
not change.
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
    "…": "~", "○": "o", "◎": "@", "●": "*", "■": "=", "▲": "^", "▼": "v", "✖": "X", "✔": "+",
    "✓": "*", "·": ".", "→": ">", "←": "<", "↑": "^", "↓": "v", "↗": "/", "↖": "\\", "↙": "/",
    "↘": "\\", "↷": "/", "▸": ">", "✛": "+", "▌": ">", "█": "#", "▏": "-", "▎": "-", "▍": "-",
    "▋": "=", "▊": "=", "▉": "=", "▮": "|", "▯": ".", "–": "-", "—": "-", "×": "x", "°": "o",
    "²": "2", "±": "~", "µ": "u", "≥": ">", "≤": "<", "‖": "|", "▶": ">", "⏸": "=", "▁": "_",
    "▂": ".", "▃": "-", "▄": "=", "▅": "+", "▆": "*", "▇": "%", "▔": "-", "▕": "|", "▐": "|",
    "▀": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "↻": "@", "⚠": "!", "☠": "X", "◀": "<",
    "⋯": "~", "∞": "8", "•": "o",
}  # fmt: skip


def is_ascii_wanted(
    environ: Mapping[str, str], *, is_utf8_forced: bool = bool(sys.flags.utf8_mode)
) -> bool:
    """Whether the terminal gets ASCII only: COVEY_ASCII decides, or else the locale.

    Without any locale, as in many containers, Unicode is assumed.

    Args:
        environ: the process's environment.
        is_utf8_forced: whether Python runs in its UTF-8 mode. Then it may have written an LC_CTYPE
            of its own into the environment, which the user has not set.
    """
    own_choice = environ.get("COVEY_ASCII", "").strip().lower()
    if own_choice:
        return own_choice not in ("0", "no", "off", "false")

    locale = _locale(environ, is_utf8_forced=is_utf8_forced)
    return bool(locale) and "utf8" not in locale.lower().replace("-", "")


def _locale(environ: Mapping[str, str], *, is_utf8_forced: bool) -> str:
    """Return the locale for characters, by the rules of POSIX; empty if there is none."""
    if environ.get("LC_ALL"):
        return environ["LC_ALL"]

    ctype = environ.get("LC_CTYPE", "")
    is_pythons_own = is_utf8_forced and ctype.upper().replace("-", "") in ("C.UTF8", "UTF8")
    if ctype and not is_pythons_own:
        return ctype

    return environ.get("LANG", "")


def is_light_wanted(environ: Mapping[str, str]) -> bool:
    """Whether the terminal's background is light: COVEY_THEME decides, or else COLORFGBG.

    COLORFGBG is ``foreground;background``, in numbers of the ANSI colours.
    """
    own_choice = environ.get("COVEY_THEME", "").strip().lower()
    if own_choice in ("light", "dark"):
        return own_choice == "light"

    _, _, background = environ.get("COLORFGBG", "").rpartition(";")
    return background in ("7", "15")  # the two whites of the ANSI colours


def to_ascii(text: str) -> str:
    """Return ``text`` in printable ASCII, with the same number of cells."""
    if text.isascii():
        return text
    return text.translate(_ASCII)


class Ascii(LineFilter):
    """Replaces signs, borders and braille by ASCII characters."""

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the same line in ASCII."""
        plain = []
        for segment in segments:
            if not segment.text.isascii():
                segment = Segment(to_ascii(segment.text), segment.style, segment.control)
            plain.append(segment)
        return plain


class LightGround(LineFilter):
    """Replaces colours by colours for a light background.

    The console's own colours are in a table; the lightness of other colours is inverted.
    """

    def apply(self, segments: list[Segment], background: Color) -> list[Segment]:
        """Return the same line in light colours."""
        light = []
        for segment in segments:
            style = None if segment.style is None else _light(segment.style)
            light.append(Segment(segment.text, style, segment.control))
        return light


class TerminalFilters:
    """The filters that this terminal needs, by its environment."""

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        self.is_light = is_light_wanted(environ)
        self.is_ascii = is_ascii_wanted(environ)
        self._light = LightGround()
        self._ascii = Ascii()
        self._no_colour = NoColor()

    def active(self, *, has_colour: bool) -> Sequence[LineFilter]:
        """Return the filters that every line passes before it is written, without Textual's own."""
        filters: list[LineFilter] = []
        if not has_colour:
            filters.append(self._no_colour)
        elif self.is_light:
            filters.append(self._light)
        if self.is_ascii:
            filters.append(self._ascii)
        return filters


@lru_cache(4096)
def _light(style: Style) -> Style:
    return style + Style(color=_light_colour(style.color), bgcolor=_light_colour(style.bgcolor))


@lru_cache(4096)
def _light_colour(colour: RichColor | None) -> RichColor | None:
    if colour is None or colour.is_default or colour.triplet is None:
        return None

    counterpart = LIGHT.get(colour.triplet.hex)
    if counterpart is not None:
        return RichColor.parse(counterpart)

    hue, lightness, saturation = colorsys.rgb_to_hls(*colour.triplet.normalized)
    parts = colorsys.hls_to_rgb(hue, 1.0 - lightness, saturation)
    red, green, blue = (round(255 * part) for part in parts)
    return RichColor.from_rgb(red, green, blue)


# -- characters ------------------------------------------------------------------------------------

_BRAILLE = range(0x2800, 0x2900)
_BOX_DRAWING = range(0x2500, 0x2580)
_HORIZONTAL = "─━╌╍┄┅┈┉═╴╶╸╺"
_VERTICAL = "│┃╎╏┆┇┊┋║╵╷╹╻"

# Bits of a braille character in Unicode, from the upper dot to the lower one.
_LEFT_BITS = (0x01, 0x02, 0x04, 0x40)
_RIGHT_BITS = (0x08, 0x10, 0x20, 0x80)


class _Table(dict[int, str]):
    """The ASCII text for each character; an entry is added when a new character occurs.

    Accents are dropped. A character without a similar one becomes question marks.
    """

    def __missing__(self, code: int) -> str:
        char = chr(code)
        if code < 0x80:
            plain = char
        elif code in _BRAILLE:
            plain = _braille(code - _BRAILLE.start)
        elif code in _BOX_DRAWING:
            plain = _box_drawing(char)
        else:
            plain = _without_accents(char)
        self[code] = plain
        return plain


def _box_drawing(char: str) -> str:
    if char in _HORIZONTAL:
        return "-"
    if char in _VERTICAL:
        return "|"
    return "+"


def _without_accents(char: str) -> str:
    width = get_character_cell_size(char)
    plain = unicodedata.normalize("NFKD", char).encode("ascii", "ignore").decode()
    if len(plain) == width and plain.isprintable():
        return plain
    return "?" * width


def _braille(bits: int) -> str:
    """Return the ASCII character that is most similar to these dots.

    Many dots become a filled cell; otherwise the places of the dots decide.
    """
    left = [bool(bits & bit) for bit in _LEFT_BITS]
    right = [bool(bits & bit) for bit in _RIGHT_BITS]
    upper_left = any(left[:2])
    lower_left = any(left[2:])
    upper_right = any(right[:2])
    lower_right = any(right[2:])
    has_upper = upper_left or upper_right
    has_lower = lower_left or lower_right
    has_both_sides = any(left) and any(right)
    count = sum(1 for is_set in left + right if is_set)

    if count >= 6:
        return "#"
    if count >= 3 and not has_both_sides:
        return "|"
    if count == 0:
        return " "

    if not (has_upper and has_lower):
        if count > 2:
            return "="
        if has_upper:
            return _upper_dots(left, has_both_sides=has_both_sides)
        return _lower_dots(left, has_both_sides=has_both_sides)

    if upper_left and lower_right and not (lower_left or upper_right):
        return "\\"
    if upper_right and lower_left and not (lower_right or upper_left):
        return "/"
    return ":" if count <= 2 else "+"


def _upper_dots(left: list[bool], *, has_both_sides: bool) -> str:
    """Return a character for one or two dots in the upper half."""
    if not has_both_sides:
        return "'"
    is_at_middle = left[1]
    return "-" if is_at_middle else '"'


def _lower_dots(left: list[bool], *, has_both_sides: bool) -> str:
    """Return a character for one or two dots in the lower half."""
    if not has_both_sides:
        return "."
    is_at_bottom = left[3]
    return "_" if is_at_bottom else "-"


_ASCII = _Table({ord(sign): plain for sign, plain in _SIGNS.items()})
