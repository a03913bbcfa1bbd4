"""Separation of the vehicles: the closest pairs, the smallest distance so far, a strip chart, the
timing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich.segment import Segment
from textual.strip import Strip

from groundstation.console import theme
from groundstation.console.canvas import Canvas
from groundstation.console.history import ClosePair, History
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, TEXT, WARN, clean, number
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState, Separation
from onboard.config.fleet import FleetConfig

WINDOW_S = 120.0
SOON_S = 3.0
_FORESIGHT_S = 10.0  # velocities do not stay as they are for longer
_MARGIN = 5  # cells for the scale at the left
_LEAST_CHART = 3
# values that fill a spark: two periods, and a message that is too old
_PERIOD_TOP_MS, _AGE_TOP_MS = 40.0, 200.0


class SeparationView(Lines, can_focus=True):
    """Separations of pairs, in metres, as the vehicles report them, and the truth where it is
    known.
    """

    def __init__(self, fleet: FleetConfig, history: History) -> None:
        super().__init__(id="separation")
        self.fleet = fleet
        self.history = history
        self._state: FleetState | None = None
        self._now_s = 0.0
        self._chart: tuple[tuple[int, int, int], list[Strip]] | None = None
        vertical_m = fleet.fleet.vertical_separation_m
        height = (
            f" ({vertical_m:g} m of height count {fleet.fleet.safety_distance_m:g})"
            if vertical_m
            else ""
        )
        self.border_title = f"separation{height}"

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw this state."""
        self._state, self._now_s = state, now_ns * 1e-9
        if self.is_due(now_ns, (state.airborne_names, state.smallest, state.smallest_truth)):
            self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the closest pair now and so far; further pairs, chart and timing as there is room."""
        timing = self._timing(width) if height >= 2 + _LEAST_CHART + 3 else []
        rest = height - 2 - len(timing)
        pairs = self.history.pairs[1 : 1 + max(0, (rest - 5) // 2)]
        lines = [
            self._line("now", self.history.now, width),
            self._line("least", self._smallest(), width),
        ]
        lines += [self._line("", pair, width) for pair in pairs]
        strips = [Strip(line).adjust_cell_length(width) for line in lines[:height]]
        rows = rest - len(pairs)
        if rows > 0:
            strips += self._strip_chart(width, rows)
        return strips + [Strip(line).adjust_cell_length(width) for line in timing]

    def _smallest(self) -> Separation | None:
        return None if self._state is None else self._state.smallest_truth or self._state.smallest

    def _line(self, label: str, pair: ClosePair | Separation | None, width: int) -> list[Segment]:
        start = Segment(f" {label:<6}", theme.style(FAINT))
        if pair is None or not math.isfinite(pair.distance_m):
            return [
                start,
                Segment("-" if label == "now" else "- nobody has flown yet", theme.style(FAINT)),
            ]
        sign, colour = self._judge(pair.distance_m, isinstance(pair, Separation) or pair.is_flying)
        room = max(3, min(24, (width - 24) // 2))
        names = " – ".join(
            theme.fit_name(clean(name, 80), room).rstrip() for name in (pair.first, pair.second)
        )
        segments = [
            start,
            Segment(
                f"{sign} {number(pair.distance_m, 2)} m ", theme.style(colour, bold=label != "")
            ),
            Segment(f" {names}", theme.style(TEXT)),
        ]
        if isinstance(pair, Separation):
            return [
                *segments,
                Segment("  true" if pair.is_truth else "  reported", theme.style(FAINT)),
            ]
        return [*segments, *self._approach(pair)]

    def _approach(self, pair: ClosePair) -> list[Segment]:
        """Return time and distance of their closest approach at their present velocities."""
        if not pair.is_flying:
            return []
        if not math.isfinite(pair.approach_s) or pair.approach_s > _FORESIGHT_S:
            return [
                Segment(
                    "  parting" if math.isinf(pair.approach_s) else "  steady", theme.style(FAINT)
                )
            ]
        is_soon = pair.approach_s < SOON_S and pair.approach_m < self.fleet.fleet.safety_distance_m
        text = f"  {'▲ ' if is_soon else ''}{number(pair.approach_m, 2)} m in {number(pair.approach_s, 1)} s"
        return [Segment(text, theme.style(WARN if is_soon else FAINT))]

    def _judge(self, distance_m: float, is_flying: bool) -> tuple[str, str]:
        limit_m = self.fleet.fleet.safety_distance_m
        if not is_flying:
            return "○", TEXT
        if distance_m < limit_m:
            return "✖", BAD
        return ("▲", WARN) if distance_m < 1.1 * limit_m else ("●", GOOD)

    def _timing(self, width: int) -> list[list[Segment]]:
        """Return the slowest control loop and the oldest message between agents, now and over the
        last minutes.
        """
        lines = []
        for label, values, name, top in (
            ("loop p99", self.history.periods_ms, self.history.slowest, _PERIOD_TOP_MS),
            ("bus age", self.history.ages_ms, self.history.oldest, _AGE_TOP_MS),
        ):
            newest = values[-1] if values else math.nan
            is_high = math.isfinite(newest) and newest > top
            text = f" {'▲' if is_high else ' '}{number(newest, 0, limit=99_999):>4} ms "
            text += theme.fit_name(clean(name, 80), 12).rstrip() if math.isfinite(newest) else ""
            room = max(0, width - 11 - len(text))
            lines.append(
                [
                    Segment(f" {label:<9}", theme.style(FAINT)),
                    Segment(
                        theme.spark(list(values)[-room:] if room else [], room, top),
                        theme.style(CALM),
                    ),
                    Segment(text, theme.style(WARN if is_high else TEXT)),
                ]
            )
        return lines

    def _strip_chart(self, width: int, height: int) -> list[Strip]:
        """Return the chart; drawn twice a second, since nothing in it moves faster."""
        key = (width, height, int(2.0 * self._now_s))
        if self._chart is None or self._chart[0] != key:
            self._chart = key, self._draw_chart(width, height).strips()
        return self._chart[1]

    def _draw_chart(self, width: int, height: int) -> Canvas:
        canvas = Canvas(width, height)
        limit_m = self.fleet.fleet.safety_distance_m
        columns = 2 * (canvas.width - _MARGIN)
        has_axis = height >= 5
        rows = 4 * (canvas.height - has_axis)
        if columns < 4:
            return canvas
        points = [point for point in self.history.distances if point[0] >= self._now_s - WINDOW_S]
        top_m = max(
            2.5 * limit_m,
            min(6.0 * limit_m, max((distance for _, distance in points), default=0.0)),
        )

        def row(distance_m: float) -> float:
            return (rows - 1) * (1.0 - min(distance_m, top_m) / top_m)

        left = 2 * _MARGIN
        canvas.line((left, row(limit_m)), (2 * canvas.width - 1, row(limit_m)), BAD, gap=3)
        previous: tuple[float, float] | None = None
        for column, distance_m in enumerate(self._nearest(points, columns).tolist()):
            if not math.isfinite(distance_m):
                continue
            point = (float(left + column), row(distance_m))
            near = previous is not None and point[0] - previous[0] < 8
            canvas.line(
                previous if near and previous else point,
                point,
                BAD if distance_m < limit_m else CALM,
            )
            previous = point
        for distance_m in {0.0, limit_m, top_m}:
            text = f"{distance_m:.1f}" if distance_m != limit_m else f"{limit_m:.2f}"
            canvas.text(
                0, int(row(distance_m) // 4), f"{text:>4}", BAD if distance_m == limit_m else FAINT
            )
        if has_axis:
            canvas.text(_MARGIN, height - 1, f"{WINDOW_S / 60:g} min ago", FAINT)
            canvas.text(width - 4, height - 1, "now", FAINT)
        if not points:
            canvas.text(
                _MARGIN + 1,
                max(0, (canvas.height - has_axis) // 2 - 1),
                "drawn while they fly",
                FAINT,
            )
        return canvas

    def _nearest(
        self, points: Sequence[tuple[float, float]], columns: int
    ) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Return the closest sample of each column: a near miss must not fall between two dots."""
        nearest = np.full(columns, np.inf)
        if points:
            times_s, distances_m = np.array(points).T
            indices = ((1.0 - (self._now_s - times_s) / WINDOW_S) * (columns - 1)).astype(np.int64)
            np.minimum.at(nearest, np.clip(indices, 0, columns - 1), distances_m)
        return nearest
