"""Drawing of the plan, layer by layer, in braille.

Every kind of thing has its own shape: colour only helps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich.cells import cell_len

from groundstation.console import theme
from groundstation.console.canvas import Canvas
from groundstation.console.history import FAR_M, History
from groundstation.console.theme import BAD, FAINT, RULE, TEXT, WARN
from groundstation.fleet.state import VehicleView
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig
from onboard.config.obstacles import Obstacle

Spot = tuple[float, float, float]
_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_ARROWS = "→↗↑↖←↙↓↘"
_NEAR_M = 0.12  # nearer goals are hidden by their vehicle
_NAMES_WIDTH = 90  # cells from which on names stand beside few vehicles
_FEW = 12
_DENSE = 40  # cells a vehicle, below which only numbers are written


@dataclass(frozen=True, slots=True)
class Window:
    """The visible part of the world."""

    x_m: float  # its middle, ENU
    y_m: float
    scale: float  # dots per metre
    width: int  # in cells
    height: int

    def dots(self, points_enu_m: Array) -> Array:
        """Return points (n, 2) [m] ENU in dots."""
        middle = np.array([self.x_m, self.y_m])
        shift = np.array([self.width, 2 * self.height], float)
        dots: Array = (points_enu_m - middle) * np.array([self.scale, -self.scale]) + shift
        return dots

    def dot(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return one point in dots."""
        return self.width + (x_m - self.x_m) * self.scale, 2 * self.height - (
            y_m - self.y_m
        ) * self.scale

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return one point in cells (column, row); far outside where it is not finite."""
        x, y = self.dot(x_m, y_m)
        if not (abs(x) < FAR_M and abs(y) < FAR_M):
            return -1000, -1000
        return math.floor(x / 2), math.floor(y / 4)

    @property
    def step_m(self) -> float:
        """Distance between two lines of the grid."""
        return next(
            (s for s in _STEPS_M if s * self.scale >= max(12.0, 2 * self.width / 9)), _STEPS_M[-1]
        )


def spot_of(view: VehicleView, now_ns: int) -> Spot | None:
    """Return the point to draw a vehicle at: predicted to now while fresh, else its last position."""
    spot = view.position_enu_m(now_ns)
    if spot is None and view.telemetry is not None and view.telemetry.is_position_valid:
        spot = view.telemetry.position_enu_m
    return spot if spot is not None and all(abs(axis) < FAR_M for axis in spot) else None


def draw_background(window: Window, fleet: FleetConfig) -> Canvas:
    """Draw grid with metres, fence and obstacles."""
    canvas = Canvas(window.width, window.height)
    fence, step_m = fleet.fleet.geofence_m, window.step_m
    half_x, half_y = window.width / window.scale, 2 * window.height / window.scale
    xs = _grid_lines(
        max(fence.x[0], window.x_m - half_x), min(fence.x[1], window.x_m + half_x), step_m
    )
    ys = _grid_lines(
        max(fence.y[0], window.y_m - half_y), min(fence.y[1], window.y_m + half_y), step_m
    )
    for x_m in xs:
        canvas.line(window.dot(x_m, fence.y[0]), window.dot(x_m, fence.y[1]), RULE, gap=4)
    for y_m in ys:
        canvas.line(window.dot(fence.x[0], y_m), window.dot(fence.x[1], y_m), RULE, gap=4)
    for obstacle in fleet.obstacles:
        _draw_obstacle(canvas, window, obstacle)
    (west, east), (south, north) = fence.x, fence.y
    corners = [
        window.dot(x, y) for x, y in ((west, south), (west, north), (east, north), (east, south))
    ]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        _clipped(canvas, start, end, FAINT)
    for x_m in xs:
        column, row = window.cell(x_m, fence.y[0])
        label = f"{x_m:g}"
        if 2 < column < canvas.width - len(label) - 2:
            canvas.text(
                column - (label[0] == "-"), max(0, min(canvas.height - 1, row)), label, FAINT
            )
    for y_m in ys:
        column, row = window.cell(fence.x[0], y_m)
        if 0 < row < canvas.height - 1:
            canvas.text(max(0, min(column, canvas.width) - len(f"{y_m:g}")), row, f"{y_m:g}", FAINT)
    if canvas.is_free(canvas.width - 2, 0, 2) and canvas.width > 30:
        canvas.text(canvas.width - 2, 0, "↑N", FAINT)
    return canvas


@dataclass(frozen=True, slots=True)
class PlanScene:
    """Everything that the moving part of the plan is drawn from."""

    window: Window
    fleet: FleetConfig
    history: History
    views: Sequence[VehicleView]
    spots: Mapping[str, Spot]  # of :func:`spot_of`; a vehicle without one is not drawn
    now_ns: int
    selected: str | None
    marked: frozenset[str]

    @property
    def is_dense(self) -> bool:
        """Whether there is room for numbers only."""
        return self.window.width * self.window.height < _DENSE * len(self.views)

    def is_stale(self, view: VehicleView) -> bool:
        """Whether a vehicle is silent."""
        return not view.is_fresh(self.now_ns)

    def is_emphasised(self, name: str) -> bool:
        """Whether a vehicle is drawn in full even in a dense crowd."""
        return not self.is_dense or name == self.selected or name in self.marked

    def too_close(self) -> set[str]:
        """Return the vehicles below the safety distance."""
        limit_m = self.fleet.fleet.safety_distance_m
        pairs = [
            pair for pair in self.history.pairs if pair.is_flying and pair.distance_m < limit_m
        ]
        return {name for pair in pairs for name in (pair.first, pair.second)}


def draw_fleet(canvas: Canvas, scene: PlanScene) -> None:
    """Draw trails, goals and setpoints, avoidance, safety circles, numbers and heights."""
    too_close = scene.too_close()
    _draw_trails(canvas, scene)
    for index, view in enumerate(scene.views):
        if scene.is_emphasised(view.name):
            _draw_goal(
                canvas, scene.window, view, scene.spots.get(view.name), theme.vehicle_colour(index)
            )
    _draw_circles(canvas, scene, too_close)
    _draw_avoidance(canvas, scene)
    _draw_labels(canvas, scene, too_close)


def _draw_trails(canvas: Canvas, scene: PlanScene) -> None:
    """Draw the trails; those of one colour together."""
    trails, colours = scene.history.trails, len(theme.VEHICLE_COLOURS)
    for first in range(min(colours, len(scene.views))):
        points = [trails[view.name] for view in scene.views[first::colours] if view.name in trails]
        if points:
            dots = scene.window.dots(np.concatenate(points))
            canvas.dots(dots[:, 0], dots[:, 1], theme.faded(theme.vehicle_colour(first)))


def _draw_goal(
    canvas: Canvas, window: Window, view: VehicleView, spot: Spot | None, colour: str
) -> None:
    """Draw ✛ at the goal, × at the trajectory's setpoint, and a dashed line to the goal."""
    last = view.telemetry
    if (
        last is None
        or not view.is_airborne
        or not all(abs(axis) < FAR_M for axis in last.goal_position_enu_m)
    ):
        return
    goal, setpoint = last.goal_position_enu_m, last.setpoint_position_enu_m
    if spot is not None and math.dist(goal[:2], spot[:2]) > _NEAR_M:
        canvas.line(window.dot(*spot[:2]), window.dot(*goal[:2]), colour, gap=5)
    if (
        spot is not None
        and all(map(math.isfinite, setpoint))
        and math.dist(setpoint[:2], spot[:2]) > _NEAR_M
    ):
        canvas.text(*window.cell(*setpoint[:2]), "×", colour)
    canvas.text(*window.cell(*goal[:2]), "✛", colour)


def _draw_circles(canvas: Canvas, scene: PlanScene, too_close: set[str]) -> None:
    """Draw half the safety distance about each vehicle; dotted about a silent one."""
    groups: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for index, view in enumerate(scene.views):
        spot = scene.spots.get(view.name)
        if spot is not None:
            is_stale = scene.is_stale(view)
            own = (
                theme.vehicle_colour(index)
                if view.light is None
                else theme.light_colour(view.light)
            )
            colour = FAINT if is_stale else BAD if view.name in too_close else own
            groups.setdefault((colour, 3 if is_stale else 1), []).append(
                scene.window.dot(*spot[:2])
            )
    radius = scene.fleet.fleet.safety_distance_m / 2.0 * scene.window.scale
    for (colour, gap), centres in groups.items():
        canvas.circles(np.array(centres), radius, colour, gap)


def _draw_avoidance(canvas: Canvas, scene: PlanScene) -> None:
    """Draw a line with an arrow from each vehicle that the law holds back to the one that it
    avoids.
    """
    bright: list[tuple[Spot, Spot]] = []
    faint: list[tuple[Spot, Spot]] = []
    window = scene.window
    for view in scene.views:
        last, spot = view.telemetry, scene.spots.get(view.name)
        if last is None or spot is None or not last.is_airborne or scene.is_stale(view):
            continue
        other = scene.spots.get(last.avoids or last.nearest_vehicle)
        if other is not None and last.law_status.lower() not in ("", "inactive"):
            (bright if scene.is_emphasised(view.name) else faint).append((spot, other))
    for pairs, colour in ((faint, FAINT), (bright, TEXT)):
        if pairs:
            ends = np.array(pairs)[:, :, :2]
            canvas.lines(window.dots(ends[:, 0]), window.dots(ends[:, 1]), colour, gap=2)
    for spot, other in bright:
        east_m, north_m = other[0] - spot[0], other[1] - spot[1]
        arrow = _ARROWS[round(math.atan2(north_m, east_m) / (math.pi / 4.0)) % 8]
        # At a third of the line: of two that avoid each other both arrows are visible.
        canvas.text(
            *window.cell(spot[0] + 0.36 * east_m, spot[1] + 0.36 * north_m), arrow, TEXT, bold=True
        )


def _draw_labels(canvas: Canvas, scene: PlanScene, too_close: set[str]) -> None:
    """Write numbers, then heights, so that no height covers a number.

    ``[1]`` is under the cursor, ``1!`` too close, ``1?`` silent. In a crowd numbers have the colour
    of the height.
    """
    heights_m = scene.fleet.fleet.geofence_m.z
    written: list[tuple[int, int, int, VehicleView]] = []  # column, row, length
    for index, view in enumerate(scene.views):
        spot, is_stale = scene.spots.get(view.name), scene.is_stale(view)
        if spot is None or view.telemetry is None:
            continue
        is_selected, is_marked = view.name == scene.selected, view.name in scene.marked
        sign = "?" if is_stale else "!" if view.name in too_close else ""
        text = f"[{index}]{sign}" if is_selected else f"{'✓' if is_marked else ''}{index}{sign}"
        column, row = scene.window.cell(*spot[:2])
        column -= is_selected or is_marked
        own = (
            theme.height_colour(spot[2], heights_m)
            if scene.is_dense
            else theme.vehicle_colour(index)
        )
        canvas.text(column, row, text, FAINT if is_stale else BAD if sign else own, bold=True)
        if scene.is_emphasised(view.name):
            written.append((column, row, len(text), view))
    has_names = scene.window.width >= _NAMES_WIDTH and len(scene.views) <= _FEW
    for column, row, length, view in written:
        spot, is_stale = scene.spots[view.name], scene.is_stale(view)
        name = f"{theme.fit_name(theme.clean(view.name), 12).rstrip()} " if has_names else ""
        height = (
            f"{theme.number(spot[2], 1)}m"
            if view.telemetry and view.telemetry.is_airborne and not is_stale
            else ""
        )
        width = cell_len(f"{name}{height}".rstrip())
        beside = (
            (column + length + 1, row),
            (column - width - 1, row),
            (column, row - 1),
            (column, row + 1),
        )
        free = next(
            (cell for cell in beside if width and canvas.is_free(cell[0], cell[1], width)), None
        )
        if free is not None:
            canvas.text(*free, name, FAINT if is_stale else TEXT)
            tint = FAINT if is_stale else theme.height_colour(spot[2], heights_m)
            canvas.text(free[0] + cell_len(name), free[1], height, tint)


def _draw_obstacle(canvas: Canvas, window: Window, obstacle: Obstacle) -> None:
    """Draw outline and hatching, and the name where there is room."""
    for x1, y1, x2, y2, radius in obstacle.capsules_enu_m:
        if radius > 0.0:
            canvas.circles(np.array([window.dot(x1, y1)]), radius * window.scale, WARN)
        else:
            _clipped(canvas, window.dot(x1, y1), window.dot(x2, y2), WARN)
    reach = np.array([(x, y, radius) for x, y, _, _, radius in obstacle.capsules_enu_m])
    low = window.dots(reach[:, :2] - reach[:, 2:])
    high = window.dots(reach[:, :2] + reach[:, 2:])
    box = np.concatenate([low, high])
    x0, x1 = max(0, int(box[:, 0].min())), min(2 * window.width, int(box[:, 0].max()) + 1)
    y0, y1 = max(0, int(box[:, 1].min())), min(4 * window.height, int(box[:, 1].max()) + 1)
    if x1 <= x0 or y1 <= y0 or (x1 - x0) * (y1 - y0) > 200_000:
        return
    inside = [
        (x, y)
        for y in range(y0, y1)
        for x in range(x0 + (y + x0) % 4, x1, 4)
        if obstacle.distance_m(
            (
                window.x_m + (x - window.width) / window.scale,
                window.y_m - (y - 2 * window.height) / window.scale,
            )
        )
        < 0.0
    ]
    if inside:
        dots = np.array(inside, float)
        canvas.dots(dots[:, 0], dots[:, 1], WARN)
    name = theme.clean(obstacle.name, 24)
    column, row = math.floor((x0 + x1) / 4) - cell_len(name) // 2, math.floor((y0 + y1) / 8)
    if (x1 - x0) / 2 > cell_len(name) and canvas.is_free(column, row, cell_len(name)):
        canvas.text(column, row, name, WARN)


def _clipped(
    canvas: Canvas, start: tuple[float, float], end: tuple[float, float], colour: str
) -> None:
    """Draw the part of a long line that lies in the picture: zoomed in far it has millions of dots."""
    size = np.array([2.0 * canvas.width, 4.0 * canvas.height])
    begin, along = np.array(start), np.array(end) - np.array(start)
    low, high = 0.0, 1.0
    for axis in (0, 1):
        if abs(along[axis]) < 1e-9:
            if not 0.0 <= begin[axis] <= size[axis]:
                return
            continue
        bounds = sorted((-begin[axis] / along[axis], (size[axis] - begin[axis]) / along[axis]))
        low, high = max(low, bounds[0]), min(high, bounds[1])
    if low <= high:
        one, two = begin + low * along, begin + high * along
        canvas.line((float(one[0]), float(one[1])), (float(two[0]), float(two[1])), colour)


def _grid_lines(low_m: float, high_m: float, step_m: float) -> list[float]:
    count = math.floor(high_m / step_m) - math.ceil(low_m / step_m) + 1
    first = math.ceil(low_m / step_m)
    return [round(step * step_m, 6) for step in range(first, first + min(200, count))]
