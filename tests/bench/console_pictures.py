"""Pictures of the console: ``python -m tests.bench.console_pictures`` flies the demo in tmux and
draws what it shows.

Written to ``docs/figures/console_*.png``. Cells are drawn one by one, so that a picture needs no
browser and no font but matplotlib's own. ``--light`` and ``--ascii`` draw the others of
``docs/console.md``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
from PIL import Image, ImageDraw, ImageFont
from rich.ansi import AnsiDecoder
from rich.cells import cell_len
from rich.color import Color
from rich.console import Console
from rich.segment import Segment
from rich.style import Style
from rich.terminal_theme import MONOKAI

FIGURES = Path(__file__).parents[2] / "docs" / "figures"
_FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
_SIZE_PX = 15
_GROUND = "#000000"
_INK = "#d0d0d0"
# column, row of each braille bit
_DOTS = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3))


def paint(
    lines: Iterable[Iterable[Segment]], path: Path, *, ground: str = _GROUND, ink: str = _INK
) -> None:
    """Draw lines of segments as a PNG."""
    regular = ImageFont.truetype(str(_FONTS / "DejaVuSansMono.ttf"), _SIZE_PX)
    bold = ImageFont.truetype(str(_FONTS / "DejaVuSansMono-Bold.ttf"), _SIZE_PX)
    wide = round(regular.getlength("M"))
    high = round(1.2 * _SIZE_PX)
    rows = [list(line) for line in lines]
    columns = max(sum(cell_len(segment.text) for segment in row) for row in rows)
    image = Image.new("RGB", (columns * wide, len(rows) * high), ground)
    pen = ImageDraw.Draw(image)
    for row, segments in enumerate(rows):
        column = 0
        for segment in segments:
            front, back, is_bold = _colours(segment.style, ground, ink)
            for char in segment.text:
                cells = max(1, cell_len(char))
                box = (column * wide, row * high, (column + cells) * wide - 1, (row + 1) * high - 1)
                if back != ground:
                    pen.rectangle(box, fill=back)
                _paint_char(pen, char, box, front, bold if is_bold else regular)
                column += cells
    image.quantize(128).save(path, optimize=True)


def _colours(style: Style | None, ground: str, ink: str) -> tuple[str, str, bool]:
    if style is None:
        return ink, ground, False
    front = _hex(style.color) or ink
    back = _hex(style.bgcolor) or ground
    return (back, front, bool(style.bold)) if style.reverse else (front, back, bool(style.bold))


def _hex(colour: Color | None) -> str | None:
    return None if colour is None or colour.is_default else colour.get_truecolor(MONOKAI).hex


def _paint_char(
    pen: ImageDraw.ImageDraw,
    char: str,
    box: tuple[int, int, int, int],
    ink: str,
    font: ImageFont.FreeTypeFont,
) -> None:
    left, top, right, bottom = box
    wide = right - left + 1
    high = bottom - top + 1
    code = ord(char)
    if 0x2800 <= code <= 0x28FF:
        for bit, (column, row) in enumerate(_DOTS):
            if code >> bit & 1:
                x = left + wide * (2 * column + 1) / 4
                y = top + high * (2 * row + 1) / 8
                pen.ellipse((x - 1.2, y - 1.2, x + 1.0, y + 1.0), fill=ink)
    elif 0x2581 <= code <= 0x2588:
        pen.rectangle((left, bottom + 1 - high * (code - 0x2580) / 8, right, bottom), fill=ink)
    elif 0x2589 <= code <= 0x258F:
        pen.rectangle((left, top, left + wide * (0x2590 - code) / 8 - 1, bottom), fill=ink)
    elif char != " ":
        pen.text((left, top), char, font=font, fill=ink)


def from_ansi(text: str) -> list[list[Segment]]:
    """A terminal's screen, as ``tmux capture-pane -e`` gives it."""
    console = Console(color_system="truecolor", width=400)
    decoder = AnsiDecoder()  # remembers: a colour goes on over the end of a line
    return [
        list(decoder.decode_line(line).render(console)) for line in text.rstrip("\n").split("\n")
    ]


class Terminal:
    """A command in a tmux of its own."""

    def __init__(self, width: int, height: int, command: str, **environ: str) -> None:
        self._socket = f"covey-pictures-{os.getpid()}-{width}"
        told = [
            f"{key}={value}"
            for key, value in {"COLORTERM": "truecolor", "LANG": "C.UTF-8", **environ}.items()
        ]
        self._tmux(
            "new-session",
            "-d",
            "-x",
            str(width),
            "-y",
            str(height),
            "env",
            *told,
            "sh",
            "-c",
            command,
        )

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        subprocess.run(
            ["tmux", "-L", self._socket, "kill-server"], check=False, capture_output=True
        )

    def screen(self) -> str:
        """What it shows now, with colours; nothing when the command has ended."""
        shown = subprocess.run(
            ["tmux", "-L", self._socket, "capture-pane", "-e", "-p", "-N"],
            check=False,
            capture_output=True,
            text=True,
        )
        return shown.stdout if shown.returncode == 0 else ""

    def press(self, *keys: str) -> None:
        """Press keys, in tmux's names."""
        self._tmux("send-keys", *keys)

    def _tmux(self, *words: str) -> None:
        subprocess.run(["tmux", "-L", self._socket, "-f", "/dev/null", *words], check=True)


def fly_demo(
    width: int, height: int, stem: str, *, has_verdict: bool, limit_s: float = 240.0, **environ: str
) -> None:
    """Fly the demo; keep the moment at which the law holds back most, and the end where it is asked
    for.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = f"exec {sys.executable} -m groundstation demo --record {folder}/flight"
        with Terminal(width, height, command, **environ) as terminal:
            best = ""
            most = -1
            end_s = time.monotonic() + limit_s
            while time.monotonic() < end_s:
                time.sleep(0.4)
                shown = terminal.screen()
                if "mission passed" in shown or "mission failed" in shown:
                    time.sleep(1.0)
                    if has_verdict:
                        paint(from_ansi(terminal.screen()), FIGURES / f"{stem}_verdict.png")
                    break
                held_back = shown.count("▮") + shown.count("|||")
                if held_back > most and "flying" in shown:
                    best = shown
                    most = held_back
            if best:
                paint(from_ansi(best), FIGURES / f"{stem}.png")
            terminal.press("q")
            time.sleep(3.0)


def main() -> int:
    """Draw what was asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.console_pictures", description=__doc__
    )
    parser.add_argument(
        "--sizes", default="80x24,120x40,200x60", help="columns x lines, several with commas"
    )
    parser.add_argument("--light", action="store_true", help="on a light ground")
    parser.add_argument("--ascii", action="store_true", help="in ASCII without colour")
    options = parser.parse_args()
    environ: dict[str, Any] = {}
    kind = ""
    if options.light:
        environ = {"COVEY_THEME": "light"}
        kind = "_light"
    elif options.ascii:
        environ = {"COVEY_ASCII": "1", "NO_COLOR": "1"}
        kind = "_ascii"

    for size in options.sizes.split(","):
        width, height = map(int, size.split("x"))
        fly_demo(
            width,
            height,
            f"console_{size}{kind}",
            has_verdict=f"{size}{kind}" == "120x40",
            **environ,
        )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
