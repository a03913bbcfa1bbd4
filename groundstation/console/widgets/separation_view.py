"""Separation of the vehicles: closest pairs, smallest separation so far, strip chart, timing."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich.segment import Segment
from textual.strip import Strip

from groundstation.console import theme
from groundstation.console.canvas import DOTS_ACROSS, DOTS_DOWN, Canvas
from groundstation.console.history import ClosePair, History
from groundstation.console.theme import BAD, CALM, FAINT, GOOD, TEXT, WARN, clean, number
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState, Separation
from onboard.config.fleet import FleetConfig

WINDOW_S = 120.0  # time that the chart shows
SOON_S = 3.0  # a close approach within this time is a warning
_PREDICTION_S = 10.0  # time over which an approach is predicted from the present velocities
_WARNING_FACTOR = 1.1  # a distance below this multiple of the safety distance is a warning
# The top of the chart lies between these multiples of the safety distance.
_LOWEST_TOP_FACTOR = 2.5
_HIGHEST_TOP_FACTOR = 6.0
_MARGIN = 5  # cells for the scale at the left

_MIN_NAME = 3  # cells of a vehicle's name
_LONGEST_NAME = 24
_CELLS_BESIDE_NAMES = 24  # cells of a pair's line before and between its two names
_MIN_WITH_TIMING = 8  # rows from which the timing is shown: with two pairs and a low chart
_CHART_ROWS = 5  # of a chart with its axis
_JOINED_COLUMNS = 8  # a line joins two samples that are less than this apart
# Values that fill a spark: two periods of the control loop, and a message that is too old.
_PERIOD_TOP_MS = 40.0
_AGE_TOP_MS = 200.0


class SeparationView(Lines, can_focus=True):
    """Separations of pairs, in metres, as the vehicles report them.

    The smallest separation so far comes from the ground truth where the ground truth is known.
    """

    def __init__(self, fleet: FleetConfig, history: History) -> None:
        super().__init__(id="separation")
        self.fleet = fleet
        self.history = history
        self._state: FleetState | None = None
        self._now_s = 0.0
        self._chart: list[Strip] = []  # as last drawn
        self._chart_key = (0, 0, 0)  # its width, its height, and its time in half seconds

        self.border_title = "separation"
        vertical_m = fleet.fleet.vertical_separation_m
        if vertical_m:
            distance_m = fleet.fleet.safety_distance_m
            self.border_title += f" ({vertical_m:g} m of height count {distance_m:g})"

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw a state of the fleet."""
        self._state = state
        self._now_s = now_ns * 1e-9
        if self.is_due(now_ns, (state.airborne_names, state.smallest, state.smallest_truth)):
            self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the rows of the view.

        The closest pair at present and the smallest separation so far come first. Further pairs,
        the chart and the timing follow as far as the height allows.
        """
        timing = []
        if height >= _MIN_WITH_TIMING:
            timing = self._timing(width)

        # Half of the rows that a chart with its axis does not need are for further pairs.
        remaining_rows = height - 2 - len(timing)
        further_count = max(0, (remaining_rows - _CHART_ROWS) // 2)
        further_pairs = self.history.pairs[1 : 1 + further_count]
        lines = [
            self._line("now", self.history.closest_now, width),
            self._line("least", self._smallest(), width),
        ]
        lines += [self._line("", pair, width) for pair in further_pairs]
        strips = [Strip(line).adjust_cell_length(width) for line in lines[:height]]

        chart_rows = remaining_rows - len(further_pairs)
        if chart_rows > 0:
            strips += self._strip_chart(width, chart_rows)
        return strips + [Strip(line).adjust_cell_length(width) for line in timing]

    def _smallest(self) -> Separation | None:
        if self._state is None:
            return None
        return self._state.smallest_known

    # -- pairs -------------------------------------------------------------------------------------

    def _line(self, label: str, pair: ClosePair | Separation | None, width: int) -> list[Segment]:
        start = Segment(f" {label:<6}", theme.style(FAINT))
        if pair is None or not math.isfinite(pair.distance_m):
            text = "-"
            if label != "now":
                text = "- no two have flown yet"
            return [start, Segment(text, theme.style(FAINT))]

        is_flying = isinstance(pair, Separation) or pair.is_flying
        sign, colour = self._judge(pair.distance_m, is_flying)
        distance = f"{sign} {number(pair.distance_m, 2)} m "

        name_room = (width - _CELLS_BESIDE_NAMES) // 2
        name_width = max(_MIN_NAME, min(_LONGEST_NAME, name_room))
        first = theme.fit_name(clean(pair.first, 80), name_width).rstrip()
        second = theme.fit_name(clean(pair.second, 80), name_width).rstrip()
        segments = [
            start,
            Segment(distance, theme.style(colour, bold=label != "")),
            Segment(f" {first} – {second}", theme.style(TEXT)),
        ]

        if isinstance(pair, Separation):
            source = "  true" if pair.is_truth else "  reported"
            return [*segments, Segment(source, theme.style(FAINT))]
        return [*segments, *self._approach(pair)]

    def _approach(self, pair: ClosePair) -> list[Segment]:
        """Return time and distance of a pair's closest approach at the present velocities."""
        if not pair.is_flying:
            return []
        if math.isinf(pair.approach_s):
            return [Segment("  parting", theme.style(FAINT))]
        if math.isnan(pair.approach_s) or pair.approach_s > _PREDICTION_S:
            return [Segment("  steady", theme.style(FAINT))]

        text = f"{number(pair.approach_m, 2)} m in {number(pair.approach_s, 1)} s"
        is_soon = pair.approach_s < SOON_S
        if is_soon and pair.approach_m < self.fleet.fleet.safety_distance_m:
            return [Segment(f"  ▲ {text}", theme.style(WARN))]
        return [Segment(f"  {text}", theme.style(FAINT))]

    def _judge(self, distance_m: float, is_flying: bool) -> tuple[str, str]:
        """Return sign and colour of a distance."""
        limit_m = self.fleet.fleet.safety_distance_m
        if not is_flying:
            return "○", TEXT
        if distance_m < limit_m:
            return "✖", BAD
        if distance_m < _WARNING_FACTOR * limit_m:
            return "▲", WARN
        return "●", GOOD

    # -- timing ------------------------------------------------------------------------------------

    def _timing(self, width: int) -> list[list[Segment]]:
        """Return a line for the slowest control loop and one for the oldest message of agents."""
        history = self.history
        return [
            _timing_line("loop p99", history.periods_ms, history.slowest, _PERIOD_TOP_MS, width),
            _timing_line("bus age", history.ages_ms, history.oldest, _AGE_TOP_MS, width),
        ]

    # -- chart -------------------------------------------------------------------------------------

    def _strip_chart(self, width: int, height: int) -> list[Strip]:
        """Return the chart, which is redrawn twice a second."""
        key = (width, height, int(2.0 * self._now_s))
        if self._chart_key != key:
            self._chart_key = key
            self._chart = self._draw_chart(width, height).strips()
        return self._chart

    def _draw_chart(self, width: int, height: int) -> Canvas:
        canvas = Canvas(width, height)
        limit_m = self.fleet.fleet.safety_distance_m

        has_axis = height >= _CHART_ROWS
        chart_height = canvas.height
        if has_axis:
            chart_height -= 1
        dot_columns = DOTS_ACROSS * (canvas.width - _MARGIN)
        dot_rows = DOTS_DOWN * chart_height
        if dot_columns < 4:
            return canvas

        begin_s = self._now_s - WINDOW_S
        points = [
            (time_s, distance_m)
            for time_s, distance_m in self.history.distances
            if time_s >= begin_s
        ]
        furthest_m = max((distance_m for _, distance_m in points), default=0.0)
        top_m = min(_HIGHEST_TOP_FACTOR * limit_m, furthest_m)
        top_m = max(_LOWEST_TOP_FACTOR * limit_m, top_m)

        def dot_row(distance_m: float) -> float:
            return (dot_rows - 1) * (1.0 - min(distance_m, top_m) / top_m)

        left = DOTS_ACROSS * _MARGIN
        right = DOTS_ACROSS * canvas.width - 1
        limit_row = dot_row(limit_m)
        canvas.line((left, limit_row), (right, limit_row), BAD, gap=3)

        # The curve: each point is joined to the one before, unless the gap between them is wide.
        last_x = -math.inf
        last_y = 0.0
        for column, distance_m in enumerate(self._closest_by_column(points, dot_columns)):
            if not math.isfinite(distance_m):
                continue
            x = float(left + column)
            y = dot_row(distance_m)
            colour = BAD if distance_m < limit_m else CALM
            if x - last_x < _JOINED_COLUMNS:
                canvas.line((last_x, last_y), (x, y), colour)
            else:
                canvas.line((x, y), (x, y), colour)
            last_x = x
            last_y = y

        for distance_m in {0.0, limit_m, top_m}:
            row = int(dot_row(distance_m) // DOTS_DOWN)
            if distance_m == limit_m:
                canvas.text(0, row, f"{limit_m:4.2f}", BAD)
            else:
                canvas.text(0, row, f"{distance_m:4.1f}", FAINT)

        if has_axis:
            canvas.text(_MARGIN, height - 1, f"{WINDOW_S / 60:g} min ago", FAINT)
            canvas.text(width - 4, height - 1, "now", FAINT)
        if not points:
            row = max(0, chart_height // 2 - 1)
            canvas.text(_MARGIN + 1, row, "drawn while they fly", FAINT)
        return canvas

    def _closest_by_column(
        self, points: Sequence[tuple[float, float]], columns: int
    ) -> list[float]:
        """Return the smallest distance of each column, so that no near miss is left out."""
        closest_m = np.full(columns, np.inf)
        if points:
            times_s, distances_m = np.array(points).T
            shares = 1.0 - (self._now_s - times_s) / WINDOW_S  # 0 at the left edge, 1 at the right
            indices = (shares * (columns - 1)).astype(np.int64)
            np.minimum.at(closest_m, np.clip(indices, 0, columns - 1), distances_m)
        return closest_m.tolist()


def _timing_line(
    label: str, values_ms: Sequence[float], name: str, top_ms: float, width: int
) -> list[Segment]:
    """Return a label, the values so far as a spark, and the newest value with its vehicle."""
    newest_ms = values_ms[-1] if values_ms else math.nan
    is_known = math.isfinite(newest_ms)
    is_high = is_known and newest_ms > top_ms

    sign = " "
    colour = TEXT
    if is_high:
        sign = "▲"
        colour = WARN
    text = f" {sign}{number(newest_ms, 0, limit=99_999):>4} ms "
    if is_known:
        text += theme.fit_name(clean(name, 80), 12).rstrip()

    room = max(0, width - 11 - len(text))  # the label takes ten cells, and one stays blank
    shown_ms = list(values_ms)[-room:] if room else []
    return [
        Segment(f" {label:<9}", theme.style(FAINT)),
        Segment(theme.spark(shown_ms, room, top_ms), theme.style(CALM)),
        Segment(text, theme.style(colour)),
    ]
