"""The fleet from above: fence, grid in metres, trails, goals, safety circles, numbers and heights, in braille."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from textual.strip import Strip
from textual.widget import Widget

from groundstation.fleet import FleetState, VehicleView
from groundstation.tui import look
from groundstation.tui.canvas import Canvas
from groundstation.tui.history import History
from groundstation.tui.look import BAD, CALM, FAINT, RULE, TEXT
from onboard.config import FleetConfig

# The mapping from metres to dots; works on numbers and on arrays.
_Span = tuple[float, float]
_ROUND_M = 1.0  # shown around the outermost vehicle
_At = Callable[..., tuple[Any, Any]]
_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1000.0)


class PlanView(Widget):
    """East to the right, north up. Circles have half the safety distance: where two touch, the limit is reached."""

    def __init__(self, fleet: FleetConfig, history: History) -> None:
        super().__init__(id="plan")
        self.fleet = fleet
        self.history = history
        self.zoom = 1.0
        self.is_whole_fence = False
        self._spans: tuple[_Span, _Span] | None = None
        self._canvas: Canvas | None = None
        self._state: FleetState | None = None
        self._now_ns = 0
        self.border_title = "plan"

    def show(self, state: FleetState, now_ns: int) -> None:
        """Draw this state."""
        self._state, self._now_ns = state, now_ns
        self._canvas = self._draw(self.size.width, self.size.height)
        self.refresh()

    def change_zoom(self, factor: float) -> None:
        """Zoom about the middle of the picture; 0 switches between the fleet's part of the fence and all of it."""
        if factor == 0.0:
            self.is_whole_fence = self.zoom == 1.0 and not self.is_whole_fence
        self.zoom = 1.0 if factor == 0.0 else min(16.0, max(0.25, self.zoom * factor))

    def render_line(self, y: int) -> Strip:
        """One line of the picture."""
        canvas = self._canvas
        if canvas is None or canvas.width != self.size.width or canvas.height != self.size.height:
            canvas = self._canvas = self._draw(self.size.width, self.size.height)
        return Strip(canvas.segments(y)).adjust_cell_length(self.size.width)

    def _draw(self, width: int, height: int) -> Canvas:
        canvas = Canvas(width, height)
        fence = self.fleet.fleet.geofence_m
        box_x, box_y = self._box()
        scale = min((2 * canvas.width - 3) / (box_x[1] - box_x[0]), (4 * canvas.height - 3) / (box_y[1] - box_y[0]))
        middle = (sum(box_x) / 2.0, sum(box_y) / 2.0)
        if self.zoom != 1.0:
            scale, middle = scale * self.zoom, self._fleet_middle(middle)

        def at(x_m: Any, y_m: Any) -> tuple[Any, Any]:
            return (canvas.width + (x_m - middle[0]) * scale, 2 * canvas.height - (y_m - middle[1]) * scale)

        step_m = next((step for step in _STEPS_M if step * scale >= max(12.0, 2 * width / 9)), _STEPS_M[-1])
        self.border_subtitle = (
            f"grid {step_m:g} m · circles touch at {self.fleet.fleet.safety_distance_m:.2f} m"
            if width >= 44
            else f"grid {step_m:g} m · ○○ {self.fleet.fleet.safety_distance_m:.2f} m"
        )
        xs = np.arange(math.ceil(fence.x[0] / step_m), math.floor(fence.x[1] / step_m) + 1)[:200] * step_m
        ys = np.arange(math.ceil(fence.y[0] / step_m), math.floor(fence.y[1] / step_m) + 1)[:200] * step_m
        for x_m in xs:
            canvas.line(at(x_m, fence.y[0]), at(x_m, fence.y[1]), RULE, gap=4)
        for y_m in ys:
            canvas.line(at(fence.x[0], y_m), at(fence.x[1], y_m), RULE, gap=4)
        (west, east), (south, north) = fence.x, fence.y
        corners = [at(west, south), at(west, north), at(east, north), at(east, south)]
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            canvas.line(start, end, FAINT)
        for x_m in xs:
            column, row = _cell(at(x_m, fence.y[0]))
            label = f"{x_m:g}"
            if 2 < column < canvas.width - len(label) - 2:
                canvas.text(column - (label[0] == "-"), min(canvas.height - 1, row), label, FAINT)
        for y_m in ys:
            column, row = _cell(at(fence.x[0], y_m))
            if 0 < row < canvas.height - 1:
                canvas.text(max(0, column - len(f"{y_m:g}")), row, f"{y_m:g}", FAINT)
        if self._state is not None:
            views = list(self._state.vehicles.values())
            spots = {view.name: self._spot(view) for view in views}
            for index, view in enumerate(views):
                self._draw_path(canvas, at, view, index)
            for index, view in enumerate(views):
                self._draw_vehicle(canvas, at, scale, view, index, spots)
        return canvas

    def _box(self) -> tuple[_Span, _Span]:
        """What the picture shows (x, y in metres): the fence, or the part of it that the fleet uses.

        The part only grows: a picture that breathes with every move cannot be read.
        """
        fence = self.fleet.fleet.geofence_m
        if self.is_whole_fence:
            return fence.x, fence.y
        points = [self.fleet.vehicles[name].start_enu_m[:2] for name in self.fleet.enabled_names]
        for view in self._state.vehicles.values() if self._state is not None else ():
            spot, told = self._spot(view), view.telemetry
            points += [spot[:2]] if spot is not None else []
            if told is not None and told.is_airborne and all(map(math.isfinite, told.goal_position_enu_m)):
                points.append(told.goal_position_enu_m[:2])
        spans = []
        for axis, limits in enumerate((fence.x, fence.y)):
            values = [*(point[axis] for point in points if abs(point[axis]) < 1e6)] or list(limits)
            low, high = min(values) - _ROUND_M, max(values) + _ROUND_M
            old = self._spans[axis] if self._spans is not None else (low, high)
            low, high = min(low, old[0]), max(high, old[1])
            # Beyond the fence only what has strayed there widens the picture.
            low, high = max(low, min(limits[0], *values)), min(high, max(limits[1], *values))
            spans.append((low, max(high, low + 2.0)))
        self._spans = (spans[0], spans[1])
        return self._spans

    def _fleet_middle(self, default: tuple[float, float]) -> tuple[float, float]:
        spots = [self._spot(view) for view in self._state.vehicles.values()] if self._state is not None else []
        known = [spot for spot in spots if spot is not None]
        if not known:
            return default
        return (sum(spot[0] for spot in known) / len(known), sum(spot[1] for spot in known) / len(known))

    def _spot(self, view: VehicleView) -> tuple[float, float, float] | None:
        """Where to draw it: carried on to now while fresh, else where it was last heard."""
        spot = view.position_enu_m(self._now_ns)
        if spot is None and view.telemetry is not None and view.telemetry.is_position_valid:
            spot = view.telemetry.position_enu_m
        return spot if spot is not None and all(math.isfinite(axis) and abs(axis) < 1e6 for axis in spot) else None

    def _draw_path(self, canvas: Canvas, at: _At, view: VehicleView, index: int) -> None:
        colour = look.vehicle_colour(index)
        trail = self.history.trails.get(view.name)
        if trail and len(trail) > 1:
            points = np.array(trail, dtype=np.float64)
            x, y = at(points[:, 0], points[:, 1])
            canvas.dots(np.asarray(x), np.asarray(y), colour)
        told = view.telemetry
        if told is None or not told.is_airborne or not all(map(math.isfinite, told.goal_position_enu_m)):
            return
        goal, spot = told.goal_position_enu_m, self._spot(view)
        if spot is not None and math.dist(goal[:2], spot[:2]) > 0.15:
            canvas.line(at(spot[0], spot[1]), at(goal[0], goal[1]), colour, gap=5)
        canvas.text(*_cell(at(goal[0], goal[1])), "✛", colour)

    def _draw_vehicle(
        self,
        canvas: Canvas,
        at: _At,
        scale: float,
        view: VehicleView,
        index: int,
        spots: dict[str, tuple[float, float, float] | None],
    ) -> None:
        spot, told = spots[view.name], view.telemetry
        if spot is None or told is None:
            return
        colour, limit_m = look.vehicle_colour(index), self.fleet.fleet.safety_distance_m
        is_stale = not view.is_fresh(self._now_ns)
        ring = FAINT if is_stale else colour
        for name, other in spots.items():
            if name != view.name and other is not None and told.is_airborne:
                ring = BAD if math.dist(spot[:2], other[:2]) < limit_m else ring
        canvas.circle(at(spot[0], spot[1]), limit_m / 2.0 * scale, ring)
        other = spots.get(told.nearest_vehicle)
        if told.law_status.lower() not in ("", "inactive") and other is not None and not is_stale:
            canvas.line(at(spot[0], spot[1]), at(other[0], other[1]), CALM, gap=3)
        column, row = _cell(at(spot[0], spot[1]))
        canvas.text(column, row, str(index), FAINT if is_stale else colour, bold=True)
        if told.is_airborne:
            height = "?" if is_stale else f"{look.number(spot[2], 1)}m"
            canvas.text(column + len(str(index)) + 1, row, height, FAINT if is_stale else TEXT)


def _cell(dot: tuple[float, float]) -> tuple[int, int]:
    if not (math.isfinite(dot[0]) and math.isfinite(dot[1])) or max(abs(dot[0]), abs(dot[1])) > 1e6:
        return -1000, -1000
    return math.floor(dot[0] / 2), math.floor(dot[1] / 4)
