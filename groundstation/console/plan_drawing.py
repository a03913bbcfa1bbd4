"""What the plan shows, layer by layer, in braille. Every kind of thing has its own shape: colour only helps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.cells import cell_len

from groundstation.console import theme
from groundstation.console.canvas import Canvas
from groundstation.console.history import FAR_M, History
from groundstation.console.theme import BAD, FAINT, RULE, TEXT, WARN
from groundstation.fleet.state import VehicleView
from onboard.config.fleet import FleetConfig
from onboard.config.obstacles import Obstacle

FloatArray = NDArray[np.float64]
Spot = tuple[float, float, float]
_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_ARROWS = "→↗↑↖←↙↓↘"
_NEAR_M = 0.12  # what is nearer to its vehicle is hidden by it
_NAMES_WIDTH = 90  # cells from which on names stand beside few vehicles
_FEW = 12
_DENSE = 40  # cells a vehicle, below which only numbers are written


@dataclass(frozen=True, slots=True)
class Window:
    """The part of the world that is seen: its middle in metres ENU, dots per metre, size in cells."""

    x_m: float
    y_m: float
    scale: float
    width: int
    height: int

    def dots(self, points_enu_m: FloatArray) -> FloatArray:
        """Places (n, 2) in dots."""
        middle = np.array([self.x_m, self.y_m])
        shift = np.array([self.width, 2 * self.height], float)
        dots: FloatArray = (points_enu_m - middle) * np.array([self.scale, -self.scale]) + shift
        return dots

    def dot(self, x_m: float, y_m: float) -> tuple[float, float]:
        """One place in dots."""
        return self.width + (x_m - self.x_m) * self.scale, 2 * self.height - (y_m - self.y_m) * self.scale

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """One place in cells (column, row); far outside where there is none."""
        x, y = self.dot(x_m, y_m)
        if not (abs(x) < FAR_M and abs(y) < FAR_M):
            return -1000, -1000
        return math.floor(x / 2), math.floor(y / 4)

    @property
    def step_m(self) -> float:
        """Metres between two lines of the grid."""
        return next((s for s in _STEPS_M if s * self.scale >= max(12.0, 2 * self.width / 9)), _STEPS_M[-1])


def spot_of(view: VehicleView, now_ns: int) -> Spot | None:
    """Where to draw a vehicle: carried on to now while fresh, else where it was last heard."""
    spot = view.position_enu_m(now_ns)
    if spot is None and view.telemetry is not None and view.telemetry.is_position_valid:
        spot = view.telemetry.position_enu_m
    return spot if spot is not None and all(abs(axis) < FAR_M for axis in spot) else None


def ground(window: Window, fleet: FleetConfig) -> Canvas:
    """What stands still: grid with metres, fence, obstacles."""
    canvas = Canvas(window.width, window.height)
    fence, step_m = fleet.fleet.geofence_m, window.step_m
    half_x, half_y = window.width / window.scale, 2 * window.height / window.scale
    xs = _ticks(max(fence.x[0], window.x_m - half_x), min(fence.x[1], window.x_m + half_x), step_m)
    ys = _ticks(max(fence.y[0], window.y_m - half_y), min(fence.y[1], window.y_m + half_y), step_m)
    for x_m in xs:
        canvas.line(window.dot(x_m, fence.y[0]), window.dot(x_m, fence.y[1]), RULE, gap=4)
    for y_m in ys:
        canvas.line(window.dot(fence.x[0], y_m), window.dot(fence.x[1], y_m), RULE, gap=4)
    for obstacle in fleet.obstacles:
        _draw_obstacle(canvas, window, obstacle)
    (west, east), (south, north) = fence.x, fence.y
    corners = [window.dot(x, y) for x, y in ((west, south), (west, north), (east, north), (east, south))]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        _clipped(canvas, start, end, FAINT)
    for x_m in xs:
        column, row = window.cell(x_m, fence.y[0])
        label = f"{x_m:g}"
        if 2 < column < canvas.width - len(label) - 2:
            canvas.text(column - (label[0] == "-"), max(0, min(canvas.height - 1, row)), label, FAINT)
    for y_m in ys:
        column, row = window.cell(fence.x[0], y_m)
        if 0 < row < canvas.height - 1:
            canvas.text(max(0, min(column, canvas.width) - len(f"{y_m:g}")), row, f"{y_m:g}", FAINT)
    if canvas.is_free(canvas.width - 2, 0, 2) and canvas.width > 30:
        canvas.text(canvas.width - 2, 0, "↑N", FAINT)
    return canvas


def draw_fleet(
    canvas: Canvas,
    window: Window,
    fleet: FleetConfig,
    history: History,
    views: Sequence[VehicleView],
    spots: Mapping[str, Spot],
    now_ns: int,
    selected: str | None = None,
    marked: Iterable[str] = (),
) -> None:
    """What moves: trails, goals and setpoints, who avoids whom, safety circles, numbers and heights.

    ``spots``: where each vehicle is drawn, of :func:`spot_of`; who has none is not drawn.
    """
    limit_m = fleet.fleet.safety_distance_m
    too_close = {
        name
        for pair in history.pairs
        if pair.is_flying and pair.distance_m < limit_m
        for name in (pair.first, pair.second)
    }
    chosen = {selected, *marked}
    is_dense = window.width * window.height < _DENSE * len(views)
    _draw_trails(canvas, window, history, views)
    for index, view in enumerate(views):
        if not is_dense or view.name in chosen:
            _draw_aims(canvas, window, view, spots.get(view.name), theme.vehicle_colour(index))
    _draw_circles(canvas, window, limit_m / 2.0, views, spots, too_close, now_ns)
    _draw_avoidance(canvas, window, views, spots, now_ns, chosen if is_dense else None)
    _write(canvas, window, fleet, views, spots, too_close, now_ns, selected, set(marked), is_dense)


def _draw_trails(canvas: Canvas, window: Window, history: History, views: Sequence[VehicleView]) -> None:
    """Vehicles that share a colour are drawn together."""
    colours = len(theme.VEHICLE_COLOURS)
    for first in range(min(colours, len(views))):
        trails = [history.trails[view.name] for view in views[first::colours] if view.name in history.trails]
        if trails:
            dots = window.dots(np.concatenate(trails))
            canvas.dots(dots[:, 0], dots[:, 1], theme.faded(theme.vehicle_colour(first)))


def _draw_aims(canvas: Canvas, window: Window, view: VehicleView, spot: Spot | None, colour: str) -> None:
    """✛ where it goes, × where its trajectory is now, a dashed line between."""
    told = view.telemetry
    if told is None or not view.is_airborne or not all(abs(axis) < FAR_M for axis in told.goal_position_enu_m):
        return
    goal, setpoint = told.goal_position_enu_m, told.setpoint_position_enu_m
    if spot is not None and math.dist(goal[:2], spot[:2]) > _NEAR_M:
        canvas.line(window.dot(*spot[:2]), window.dot(*goal[:2]), colour, gap=5)
    if spot is not None and all(map(math.isfinite, setpoint)) and math.dist(setpoint[:2], spot[:2]) > _NEAR_M:
        canvas.text(*window.cell(*setpoint[:2]), "×", colour)
    canvas.text(*window.cell(*goal[:2]), "✛", colour)


def _draw_circles(
    canvas: Canvas,
    window: Window,
    radius_m: float,
    views: Sequence[VehicleView],
    spots: Mapping[str, Spot],
    too_close: set[str],
    now_ns: int,
) -> None:
    """Half the safety distance about each; dotted about a silent one."""
    groups: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for index, view in enumerate(views):
        spot = spots.get(view.name)
        if spot is None:
            continue
        is_stale = not view.is_fresh(now_ns)
        colour = FAINT if is_stale else BAD if view.name in too_close else theme.vehicle_colour(index)
        groups.setdefault((colour, 3 if is_stale else 1), []).append(window.dot(*spot[:2]))
    for (colour, gap), centres in groups.items():
        canvas.circles(np.array(centres), radius_m * window.scale, colour, gap)


def _draw_avoidance(
    canvas: Canvas,
    window: Window,
    views: Sequence[VehicleView],
    spots: Mapping[str, Spot],
    now_ns: int,
    chosen: set[str | None] | None,
) -> None:
    """Lines with an arrow from who avoids to whom it avoids; in a dense crowd faint ones but for the ``chosen``."""
    bright: list[tuple[Spot, Spot]] = []
    faint: list[tuple[Spot, Spot]] = []
    for view in views:
        told, spot = view.telemetry, spots.get(view.name)
        if told is None or spot is None or not told.is_airborne or not view.is_fresh(now_ns):
            continue
        other = spots.get(told.avoids or told.nearest_vehicle)
        if other is not None and told.law_status.lower() not in ("", "inactive"):
            (bright if chosen is None or view.name in chosen else faint).append((spot, other))
    for pairs, colour in ((faint, FAINT), (bright, TEXT)):
        if pairs:
            ends = np.array(pairs)[:, :, :2]
            canvas.lines(window.dots(ends[:, 0]), window.dots(ends[:, 1]), colour, gap=2)
    for spot, other in bright:
        angle = math.atan2(other[1] - spot[1], other[0] - spot[0])
        # At a third of the way: of two that avoid each other both arrows are seen.
        column, row = window.cell(spot[0] + (other[0] - spot[0]) * 0.36, spot[1] + (other[1] - spot[1]) * 0.36)
        canvas.text(column, row, _ARROWS[round(angle / (math.pi / 4.0)) % 8], TEXT, bold=True)


def _write(
    canvas: Canvas,
    window: Window,
    fleet: FleetConfig,
    views: Sequence[VehicleView],
    spots: Mapping[str, Spot],
    too_close: set[str],
    now_ns: int,
    selected: str | None,
    marked: set[str],
    is_dense: bool,
) -> None:
    """Numbers first, so that no height covers one; ``[1]`` under the cursor, ``1!`` too close, ``1?`` silent.

    In a dense crowd there is room for numbers only: they take the colour of the height.
    """
    heights_m = fleet.fleet.geofence_m.z
    written: list[tuple[int, int, int, VehicleView]] = []
    for index, view in enumerate(views):
        if view.name not in spots or view.telemetry is None:
            continue
        is_stale = not view.is_fresh(now_ns)
        sign = "?" if is_stale else "!" if view.name in too_close else ""
        text = f"[{index}]{sign}" if view.name == selected else f"{'✓' if view.name in marked else ''}{index}{sign}"
        column, row = window.cell(*spots[view.name][:2])
        column -= view.name == selected or view.name in marked
        own = theme.height_colour(spots[view.name][2], heights_m) if is_dense else theme.vehicle_colour(index)
        colour = FAINT if is_stale else BAD if sign else own
        canvas.text(column, row, text, colour, bold=True)
        written.append((column, row, len(text), view))
    has_names = window.width >= _NAMES_WIDTH and len(views) <= _FEW
    for column, row, length, view in written:
        told, spot = view.telemetry, spots[view.name]
        if told is None or (is_dense and view.name != selected and view.name not in marked):
            continue
        name = f"{theme.fit_name(theme.clean(view.name), 12).rstrip()} " if has_names else ""
        is_stale = not view.is_fresh(now_ns)
        height = f"{theme.number(spot[2], 1)}m" if told.is_airborne and not is_stale else ""
        label = f"{name}{height}".rstrip()
        width = cell_len(label)
        places = ((column + length + 1, row), (column - width - 1, row), (column, row - 1), (column, row + 1))
        place = next((place for place in places if label and canvas.is_free(place[0], place[1], width)), None)
        if place is not None:
            tint = FAINT if is_stale else theme.height_colour(spot[2], heights_m)
            canvas.text(*place, name, TEXT if not is_stale else FAINT)
            canvas.text(place[0] + cell_len(name), place[1], height, tint)


def _draw_obstacle(canvas: Canvas, window: Window, obstacle: Obstacle) -> None:
    """Outline and hatching; its name where there is room."""
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
            (window.x_m + (x - window.width) / window.scale, window.y_m - (y - 2 * window.height) / window.scale)
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


def _clipped(canvas: Canvas, start: tuple[float, float], end: tuple[float, float], colour: str) -> None:
    """A long line, of which only the part in the picture is drawn: zoomed in far it has millions of dots."""
    size = np.array([2.0 * canvas.width, 4.0 * canvas.height])
    begin, way = np.array(start), np.array(end) - np.array(start)
    low, high = 0.0, 1.0
    for axis in (0, 1):
        if abs(way[axis]) < 1e-9:
            if not 0.0 <= begin[axis] <= size[axis]:
                return
            continue
        bounds = sorted((-begin[axis] / way[axis], (size[axis] - begin[axis]) / way[axis]))
        low, high = max(low, bounds[0]), min(high, bounds[1])
    if low <= high:
        one, two = begin + low * way, begin + high * way
        canvas.line((float(one[0]), float(one[1])), (float(two[0]), float(two[1])), colour)


def _ticks(low_m: float, high_m: float, step_m: float) -> list[float]:
    count = math.floor(high_m / step_m) - math.ceil(low_m / step_m) + 1
    first = math.ceil(low_m / step_m)
    return [round(step * step_m, 6) for step in range(first, first + min(200, count))]
