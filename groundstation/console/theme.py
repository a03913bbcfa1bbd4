"""Colours, signs and numbers of the console. Pure.

The palette is Okabe and Ito's, lightened for a dark background; it is safe for the common kinds of
colour blindness. No colour carries a meaning alone; a sign or a word always says the same.
`terminal_filters` adapts colours and signs to the terminal.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from functools import lru_cache

from rich.cells import cell_len, chop_cells, get_character_cell_size, set_cell_size
from rich.style import Style

GROUND = "#0f141a"  # background
TEXT = "#d5dde6"
FAINT = "#7b8896"  # text of less importance
RULE = "#2b3641"  # borders and grid
GOOD = "#2fc29a"
WARN = "#e8a61c"
BAD = "#f0722d"
KILL = "#dd8fbc"
CALM = "#63bdf0"  # information that needs no reaction

VEHICLE_COLOURS = (CALM, WARN, GOOD, KILL, "#f0e442", BAD, "#8f9df5", "#c3c9d0")
# From low to high: from blue to yellow, which people with the common kinds of colour blindness can
# distinguish, and from dark to bright.
HEIGHT_COLOURS = ("#6c7fd8", "#7ba6c9", "#a9b7a0", "#d3c46a", "#f7e03c")

# Every colour that is drawn -> its counterpart on a light background.
LIGHT = {
    GROUND: "#f8fafc", TEXT: "#17202a", FAINT: "#596673", RULE: "#c5ced7", GOOD: "#00734f",
    WARN: "#8f5a00", BAD: "#b93a06", KILL: "#9c2a73", CALM: "#0a5f9e", "#f0e442": "#6a6400",
    "#8f9df5": "#4347bd", "#c3c9d0": "#4d5863", "#6c7fd8": "#2b3f9e", "#7ba6c9": "#2c6489",
    "#a9b7a0": "#4f6147", "#d3c46a": "#746200", "#f7e03c": "#8a4a00", "#1b2530": "#e3e9ef",
    "#151c24": "#edf1f5", "#1d2833": "#dfe6ec", "#131a22": "#ffffff", "#4b6173": "#6f8292",
    "#56636f": "#6d7a86",
}  # fmt: skip

STATE_SIGNS: dict[str, tuple[str, str]] = {
    "waiting": ("…", FAINT),
    "ready": ("○", CALM),
    "armed": ("◎", WARN),
    "taking off": ("▲", GOOD),
    "flying": ("●", GOOD),
    "holding": ("■", CALM),
    "landing": ("▼", WARN),
    "landed": ("○", CALM),
    "failed": ("✖", BAD),
    "killed": ("✖", BAD),
}
SEVERITY_SIGNS: dict[str, tuple[str, str]] = {
    "debug": ("·", FAINT),
    "info": ("·", TEXT),
    "warning": ("▲", WARN),
    "critical": ("✖", BAD),
}
PHASE_SIGNS: dict[str, tuple[str, str]] = {
    "sent": ("→", FAINT),
    "accepted": ("▸", CALM),
    "direct": ("▸", WARN),
    "done": ("✔", GOOD),
    "superseded": ("↷", FAINT),
    "refused": ("✖", BAD),
    "failed": ("✖", BAD),
    "timed out": ("✖", BAD),
    "no answer": ("✖", BAD),
    "unfinished": ("✖", WARN),
    "cancelled": ("↷", FAINT),
}

_DARK = 40  # a light whose red, green and blue are all below this counts as off
_FADED_SHARE = 0.45  # share of a colour in its faded version; the rest is the background
_SPARK_STEPS = "▁▂▃▄▅▆▇█"
_UNPRINTABLE = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")  # categories of Unicode
_STYLES: dict[tuple[str, bool, bool], Style] = {}


def style(colour: str = TEXT, *, bold: bool = False, dim: bool = False) -> Style:
    """Return a style, which is created only once.

    ``dim`` replaces the colour by the faint one in italics, since terminals show dim differently.
    """
    key = (colour, bold, dim)
    if key not in _STYLES:
        _STYLES[key] = Style(color=FAINT if dim else colour, bold=bold, italic=dim)
    return _STYLES[key]


@lru_cache(256)
def faded(colour: str) -> str:
    """Return a colour about half way to the background."""
    faded_parts = []
    for start in (1, 3, 5):
        own_part = int(colour[start : start + 2], 16)
        ground_part = int(GROUND[start : start + 2], 16)
        faded_parts.append(round(_FADED_SHARE * own_part + (1.0 - _FADED_SHARE) * ground_part))
    return "#" + "".join(f"{part:02x}" for part in faded_parts)


def light_colour(light: tuple[int, int, int]) -> str:
    """Return the colour of a light; a light that is off is faint, so that it stays visible."""
    if max(light) < _DARK:
        return FAINT
    red, green, blue = light
    return f"#{red:02x}{green:02x}{blue:02x}"


def vehicle_colour(index: int) -> str:
    """Return the colour of the vehicle with this index in the fleet file."""
    return VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)]


def height_colour(height_m: float, span_m: tuple[float, float]) -> str:
    """Return the colour of a height within the heights of the fence [m]."""
    low_m, high_m = span_m
    share = 0.0
    if high_m > low_m and math.isfinite(height_m):
        share = (height_m - low_m) / (high_m - low_m)

    index = int(share * len(HEIGHT_COLOURS))
    return HEIGHT_COLOURS[min(len(HEIGHT_COLOURS) - 1, max(0, index))]


# -- text ------------------------------------------------------------------------------------------


def clean(text: object, limit: int = 400) -> str:
    """Return a received text as one printable line.

    Control characters and escape sequences are left out, and long texts are cut.
    """
    return _cleaned(str(text)[:limit])


@lru_cache(8192)
def _cleaned(line: str) -> str:
    if line.isascii() and line.isprintable():
        return line

    printable = []
    for char in line:
        if char in "\n\r\t" or unicodedata.category(char) == "Zs":
            printable.append(" ")
        elif unicodedata.category(char) not in _UNPRINTABLE:
            printable.append(char)
    text = "".join(printable)

    width_by_signs = sum(get_character_cell_size(char) for char in text)
    if cell_len(text) != width_by_signs:
        # Terminals disagree about the width of flags and joined signs, so each part is shown alone.
        parts = [char for char in text if get_character_cell_size(char)]
        text = "".join("?" if _joins(char) else char for char in parts)
    return text


def _joins(char: str) -> bool:
    """Whether a character joins others into one sign: regional indicators and skin tones."""
    is_regional = "\U0001f1e6" <= char <= "\U0001f1ff"
    is_shade = "\U0001f3fb" <= char <= "\U0001f3ff"
    return is_regional or is_shade


def number(
    value: object, digits: int = 1, *, sign: bool = False, unit: str = "", limit: float = 99_999.0
) -> str:
    """Return a number as text, or ``-`` if it is not finite or not plausible; never ``-0.0``."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "-"
    if not math.isfinite(value) or abs(value) > limit:
        return "-"

    rounded = round(float(value), digits) + 0.0  # the sum turns -0.0 into 0.0
    if sign:
        return f"{rounded:+.{digits}f}{unit}"
    return f"{rounded:.{digits}f}{unit}"


def fit(text: str, width: int, *, right: bool = False) -> str:
    """Return ``text`` in exactly ``width`` cells; if it is too long, it is cut with an ellipsis."""
    if width <= 0:
        return ""
    cells = cell_len(text)
    if cells > width:
        return set_cell_size(text, width - 1) + "…"

    blanks = " " * (width - cells)
    if right:
        return blanks + text
    return text + blanks


def fit_name(name: str, width: int) -> str:
    """Return a name in exactly ``width`` cells; if it is too long, it is cut in its middle.

    The names of a fleet usually differ at their ends.
    """
    if cell_len(name) <= width or width < 4:
        return fit(name, width)

    tail = name[-1:]
    for start in range(len(name) - 1, 0, -1):
        if cell_len(name[start:]) > (width - 1) // 2:
            break
        tail = name[start:]
    return set_cell_size(name, width - 1 - cell_len(tail)) + "…" + tail


def spark(values: Sequence[float], width: int, top: float) -> str:
    """Return the last ``width`` values as small columns; ``top`` fills a cell, NaN is a gap."""
    if width <= 0:
        return ""

    marks = []
    for value in values[-width:]:
        if math.isfinite(value):
            share = min(max(0.0, float(value) / top), 1.0)
            step = int(len(_SPARK_STEPS) * share)
            marks.append(_SPARK_STEPS[min(len(_SPARK_STEPS) - 1, step)])
        else:
            marks.append(" ")
    return "".join(marks).rjust(width)


def wrap(text: str, width: int, most: int = 6) -> list[str]:
    """Return ``text`` broken at spaces into at most ``most`` lines of ``width`` cells.

    A word that is longer than a line, such as a path in a command, goes on in the next lines. The
    last line gets all the remaining words, and is cut if it is too long.
    """
    # Most texts are ASCII, whose cells are counted faster; hundreds of events may come at once.
    cells = len if text.isascii() else cell_len

    lines: list[str] = []
    line = ""
    for word in text.split(" "):
        joined = f"{line} {word}" if line else word
        if cells(joined) <= width:
            line = joined
            continue

        if line:
            lines.append(line)
        line = word
        if cells(word) > width:
            *whole_lines, line = chop_cells(word, max(1, width))
            lines += whole_lines
    lines.append(line)

    if len(lines) > most:
        last_line = " ".join(lines[most - 1 :])
        return [*lines[: most - 1], fit(last_line, max(1, width))]
    return lines
