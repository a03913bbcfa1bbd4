"""Colours, signs and numbers of the console. Pure.

The palette is Okabe and Ito's, lightened for a dark ground: safe for the common kinds of colour
blindness. No meaning is carried by colour alone; a sign or a word always says it too.
`terminal_filters` adapts both to the terminal.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from functools import lru_cache

from rich.cells import cell_len, get_character_cell_size, set_cell_size
from rich.style import Style

GROUND = "#0f141a"
TEXT = "#d5dde6"
FAINT = "#7b8896"
RULE = "#2b3641"
GOOD = "#2fc29a"
WARN = "#e8a61c"
BAD = "#f0722d"
KILL = "#dd8fbc"
CALM = "#63bdf0"

VEHICLE_COLOURS = (CALM, WARN, GOOD, KILL, "#f0e442", BAD, "#8f9df5", "#c3c9d0")
# Low to high: from blue to yellow, which every common kind of colour blindness tells apart, and
# from dark to bright.
HEIGHT_COLOURS = ("#6c7fd8", "#7ba6c9", "#a9b7a0", "#d3c46a", "#f7e03c")

# Every colour that is drawn, and its counterpart on a light ground.
LIGHT = {
    GROUND: "#f8fafc", TEXT: "#17202a", FAINT: "#596673", RULE: "#c5ced7", GOOD: "#00734f", WARN: "#8f5a00",
    BAD: "#b93a06", KILL: "#9c2a73", CALM: "#0a5f9e", "#f0e442": "#6a6400", "#8f9df5": "#4347bd", "#c3c9d0": "#4d5863",
    "#6c7fd8": "#2b3f9e", "#7ba6c9": "#2c6489", "#a9b7a0": "#4f6147", "#d3c46a": "#746200", "#f7e03c": "#8a4a00",
    "#1b2530": "#e3e9ef", "#151c24": "#edf1f5", "#1d2833": "#dfe6ec", "#131a22": "#ffffff", "#4b6173": "#6f8292",
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
}

_DARK = 40
_STYLES: dict[tuple[str, bool, bool], Style] = {}


def style(colour: str = TEXT, *, bold: bool = False, dim: bool = False) -> Style:
    """A cached style; ``dim`` swaps the colour for the faint one, since terminals disagree about
    dim.
    """
    key = (colour, bold, dim)
    if key not in _STYLES:
        _STYLES[key] = Style(color=FAINT if dim else colour, bold=bold, italic=dim)
    return _STYLES[key]


@lru_cache(256)
def faded(colour: str) -> str:
    """Return a colour half way to the ground, for the background."""
    parts = (
        round(0.45 * int(colour[i : i + 2], 16) + 0.55 * int(GROUND[i : i + 2], 16))
        for i in (1, 3, 5)
    )
    return "#" + "".join(f"{part:02x}" for part in parts)


def light_colour(light: tuple[int, int, int]) -> str:
    """Return the colour of a light; one that is off is faint, and not invisible."""
    return FAINT if max(light) < _DARK else "#{:02x}{:02x}{:02x}".format(*light)


def vehicle_colour(index: int) -> str:
    """Colour of the vehicle at this place of the fleet file."""
    return VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)]


def clean(text: object, limit: int = 400) -> str:
    """Text from outside as one printable line: no control characters, no escape sequences, no
    endless strings.
    """
    return _cleaned(str(text)[:limit])


@lru_cache(8192)
def _cleaned(line: str) -> str:
    if line.isascii() and line.isprintable():
        return line
    spaced = (
        " " if char in "\n\r\t" or unicodedata.category(char) == "Zs" else char for char in line
    )
    text = "".join(char for char in spaced if _is_printable(char))
    if cell_len(text) != sum(map(get_character_cell_size, text)):
        # Flags and joined signs: terminals disagree about their width, so each part stands for
        # itself.
        text = "".join(
            "?" if _joins(char) else char for char in text if get_character_cell_size(char)
        )
    return text


def _joins(char: str) -> bool:
    """Whether signs melt into one with it: regional indicators and shades of skin."""
    return "\U0001f1e6" <= char <= "\U0001f1ff" or "\U0001f3fb" <= char <= "\U0001f3ff"


def number(
    value: object, digits: int = 1, *, sign: bool = False, unit: str = "", limit: float = 99_999.0
) -> str:
    """Return a number as text, or ``-`` where it is not finite or not plausible; never ``-0.0``."""
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float))
        or not math.isfinite(value)
        or abs(value) > limit
    ):
        return "-"
    rounded = round(float(value), digits) + 0.0
    return f"{rounded:{'+' if sign else ''}.{digits}f}{unit}"


def fit(text: str, width: int, *, right: bool = False) -> str:
    """``text`` in exactly ``width`` cells, cut with an ellipsis where it is too long."""
    if width <= 0:
        return ""
    cells = cell_len(text)
    if cells > width:
        return set_cell_size(text, width - 1) + "…"
    return " " * (width - cells) + text if right else text + " " * (width - cells)


def fit_name(name: str, width: int) -> str:
    """A name in exactly ``width`` cells, cut in its middle where too long: names of a fleet differ
    at their ends.
    """
    cells = cell_len(name)
    if cells <= width or width < 4:
        return fit(name, width)
    tail = name[-1:]
    for start in range(len(name) - 1, 0, -1):
        if cell_len(name[start:]) > (width - 1) // 2:
            break
        tail = name[start:]
    return set_cell_size(name, width - 1 - cell_len(tail)) + "…" + tail


def spark(values: Sequence[float], width: int, top: float) -> str:
    """Return the last ``width`` values as little columns, ``top`` filling a cell; nan is a gap."""
    shown = [float(value) for value in values[-width:]] if width > 0 else []
    steps = "▁▂▃▄▅▆▇█"
    marks = (
        steps[int(8 * min(0.999, max(0.0, value / top)))] if math.isfinite(value) else " "
        for value in shown
    )
    return "".join(marks).rjust(width)


def height_colour(height_m: float, span_m: tuple[float, float]) -> str:
    """Colour of a height within the fence's heights (metres)."""
    low, high = span_m
    share = (height_m - low) / (high - low) if high > low and math.isfinite(height_m) else 0.0
    return HEIGHT_COLOURS[min(len(HEIGHT_COLOURS) - 1, max(0, int(share * len(HEIGHT_COLOURS))))]


def wrap(text: str, width: int, most: int = 6) -> list[str]:
    """``text`` broken at spaces into at most ``most`` lines of ``width`` cells; longer words are
    cut.
    """
    cells = len if text.isascii() else cell_len  # of hundreds of events at once, most are plain
    lines: list[str] = []
    line = ""
    for word in text.split(" "):
        joined = f"{line} {word}" if line else word
        if cells(joined) <= width:
            line = joined
            continue
        if line:
            lines.append(line)
        line = word if cells(word) <= width else fit(word, max(1, width))
    lines.append(line)
    if len(lines) > most:
        return [*lines[: most - 1], fit(" ".join(lines[most - 1 :]), max(1, width))]
    return lines


def _is_printable(char: str) -> bool:
    return unicodedata.category(char) not in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
