"""How close they are: the closest pair now, the smallest distance so far, and a strip chart with the limit."""

from __future__ import annotations

import math

import numpy as np
from rich.segment import Segment
from textual.strip import Strip
from textual.widget import Widget

from groundstation.fleet import FleetState, Separation
from groundstation.tui import look
from groundstation.tui.canvas import Canvas
from groundstation.tui.history import History
from groundstation.tui.look import BAD, CALM, FAINT, GOOD, TEXT, WARN
from onboard.config import FleetConfig

WINDOW_S = 60.0
_MARGIN = 5  # cells for the scale at the left


class SeparationView(Widget):
    """Horizontal distances between centres, in metres, as the vehicles report them, and the truth where told."""

    def __init__(self, fleet: FleetConfig, history: History) -> None:
        super().__init__(id="separation")
        self.fleet = fleet
        self.history = history
        self._state: FleetState | None = None
        self._now_s = 0.0
        self._canvas: Canvas | None = None
        self.border_title = "separation"

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw this state."""
        self._state, self._now_s, self._canvas = state, now_ns * 1e-9, None
        self.refresh()

    def render_line(self, y: int) -> Strip:
        """Two lines of numbers, then the chart."""
        width = self.size.width
        if y < 2:
            is_now = y == 0
            pair = self.history.now if is_now else self._smallest()
            return Strip(self._line("now" if is_now else "least", pair)).adjust_cell_length(width)
        if self._canvas is None or self._canvas.width != width or self._canvas.height != self.size.height - 2:
            self._canvas = self._draw(width, self.size.height - 2)
        return Strip(self._canvas.segments(y - 2)).adjust_cell_length(width)

    def _smallest(self) -> Separation | None:
        return None if self._state is None else self._state.smallest_truth or self._state.smallest

    def _line(self, label: str, pair: Separation | None) -> list[Segment]:
        start = Segment(f" {label:<6}", look.style(FAINT))
        if pair is None or not math.isfinite(pair.distance_m):
            return [start, Segment("-" if label == "now" else "- nobody has flown yet", look.style(FAINT))]
        sign, colour = self._judge(pair.distance_m, is_flying=label != "now" or bool(self._flying()))
        segments = [
            start,
            Segment(f"{sign} {look.number(pair.distance_m, 2)} m ", look.style(colour, bold=True)),
            Segment(f" {pair.first} – {pair.second}", look.style(TEXT)),
        ]
        if label != "now":
            segments.append(Segment("  true" if pair.is_truth else "  reported", look.style(FAINT)))
        return segments

    def _flying(self) -> tuple[str, ...]:
        return () if self._state is None else self._state.airborne_names

    def _judge(self, distance_m: float, *, is_flying: bool) -> tuple[str, str]:
        limit_m = self.fleet.fleet.safety_distance_m
        if not is_flying:
            return "○", TEXT
        if distance_m < limit_m:
            return "✖", BAD
        return ("▲", WARN) if distance_m < 1.1 * limit_m else ("●", GOOD)

    def _draw(self, width: int, height: int) -> Canvas:
        canvas = Canvas(width, height)
        limit_m = self.fleet.fleet.safety_distance_m
        columns = 2 * (canvas.width - _MARGIN)
        points = [point for point in self.history.distances if point[0] >= self._now_s - WINDOW_S]
        top_m = max(2.5 * limit_m, min(6.0 * limit_m, max((distance for _, distance in points), default=0.0)))
        if columns < 4:
            return canvas

        def row(distance_m: float) -> float:
            return (4 * canvas.height - 1) * (1.0 - min(distance_m, top_m) / top_m)

        left = 2 * _MARGIN
        canvas.line((left, row(limit_m)), (2 * canvas.width - 1, row(limit_m)), BAD, gap=2)
        # The closest sample of each column is drawn: a near miss must not fall between two dots.
        nearest = np.full(columns, np.inf)
        for time_s, distance_m in points:
            column = int((1.0 - (self._now_s - time_s) / WINDOW_S) * (columns - 1))
            nearest[min(columns - 1, max(0, column))] = min(nearest[min(columns - 1, max(0, column))], distance_m)
        previous: tuple[float, float] | None = None
        for column, distance_m in enumerate(nearest):
            if not math.isfinite(distance_m):
                continue
            point = (float(left + column), row(float(distance_m)))
            colour = BAD if distance_m < limit_m else CALM
            near = previous is not None and point[0] - previous[0] < 8
            canvas.line(previous if near and previous else point, point, colour)
            previous = point
        for distance_m in {0.0, limit_m, top_m}:
            text = f"{distance_m:.1f}" if distance_m != limit_m else f"{limit_m:.2f}"
            canvas.text(0, int(row(distance_m) // 4), f"{text:>4}", BAD if distance_m == limit_m else FAINT)
        if not points:
            canvas.text(_MARGIN + 1, max(0, canvas.height // 2 - 1), "drawn while they fly", FAINT)
        return canvas
