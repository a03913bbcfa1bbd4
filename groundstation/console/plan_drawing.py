"""Draws the plan layer by layer, in braille dots.

The background (grid, fence, obstacles) is drawn once for each visible part of the world. Everything
that moves is drawn over it: trails, goals and setpoints, safety circles, and arrows of avoidance.
The numbers come last, so that nothing covers them. Every kind of object has its own shape, so that
the plan can be read without colours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from rich.cells import cell_len

from groundstation.console import theme
from groundstation.console.canvas import DOTS_ACROSS, DOTS_DOWN, Canvas, Label
from groundstation.console.history import FAR_M, History
from groundstation.console.theme import BAD, FAINT, RULE, TEXT, WARN
from groundstation.fleet.state import PersonView, VehicleView
from onboard.arrays import Array
from onboard.config.areas import edges_of
from onboard.config.fleet import FleetConfig
from onboard.config.flight_space import flight_space_of
from onboard.config.obstacles import Obstacle

PointEnu = tuple[float, float, float]  # metres
Dot = tuple[float, float]  # x to the right, y down, from the upper left corner of the picture

# possible distances between two lines of the grid
_STEPS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
_ARROWS = "→↗↑↖←↙↓↘"  # from east, counterclockwise
_NEAR_M = 0.12  # distance below which a vehicle hides its goal
_NAMES_WIDTH = 90  # width from which names are written beside the numbers
_LABEL_WIDTH = 12  # most cells of a name
_FEW = 12  # largest number of vehicles whose names are written
_DENSE = 40  # cells per vehicle below which only numbers are written
_OUTSIDE = -1000  # column and row of a point that cannot be drawn
_MAX_HATCHED = 200_000  # dots of the box around an obstacle above which it is not hatched
_HATCH_DOTS = 4  # distance between two strokes of the hatching
_MAX_LINES = 200  # lines of the grid in one direction
_ARROW_SHARE = 0.36  # place of the arrow along the line to the avoided vehicle
_SAME_COORDINATE = 1e-9  # coordinates of a line's ends that differ by less [dots] count as equal


@dataclass(frozen=True, slots=True)
class Window:
    """The visible part of the world.

    A cell is two dots wide and four high (see canvas.py).
    """

    x_m: float  # middle of the window, ENU
    y_m: float
    scale: float  # dots per metre
    width: int  # in cells
    height: int

    @property
    def dots_across(self) -> int:
        """Width of the picture in dots."""
        return DOTS_ACROSS * self.width

    @property
    def dots_down(self) -> int:
        """Height of the picture in dots."""
        return DOTS_DOWN * self.height

    def dots(self, points_enu_m: Array) -> Array:
        """Return points (n, 2) [m], ENU, in dots of the picture."""
        middle_enu_m = np.array([self.x_m, self.y_m])
        scales = np.array([self.scale, -self.scale])
        middle = np.array([self.dots_across / 2, self.dots_down / 2])
        dots: Array = (points_enu_m - middle_enu_m) * scales + middle
        return dots

    def dot(self, x_m: float, y_m: float) -> Dot:
        """Return one point in dots of the picture."""
        x = self.dots_across / 2 + (x_m - self.x_m) * self.scale
        y = self.dots_down / 2 - (y_m - self.y_m) * self.scale
        return x, y

    def point_enu_m(self, dot: Dot) -> tuple[float, float]:
        """Return the point of a dot [m], ENU."""
        x, y = dot
        x_m = self.x_m + (x - self.dots_across / 2) / self.scale
        y_m = self.y_m - (y - self.dots_down / 2) / self.scale
        return x_m, y_m

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Return the cell (column, row) of a point; one far outside if it is not plausible."""
        x, y = self.dot(x_m, y_m)
        is_drawable = abs(x) < FAR_M and abs(y) < FAR_M  # false for NaN
        if not is_drawable:
            return _OUTSIDE, _OUTSIDE
        return math.floor(x / DOTS_ACROSS), math.floor(y / DOTS_DOWN)

    @property
    def step_m(self) -> float:
        """Distance between two lines of the grid."""
        least_dots = max(12.0, self.dots_across / 9)  # room for numbers; nine columns at most
        for step_m in _STEPS_M:
            if step_m * self.scale >= least_dots:
                return step_m
        return _STEPS_M[-1]


def drawn_position(view: VehicleView, now_ns: int) -> PointEnu | None:
    """Return the position at which a vehicle is drawn; None if no plausible one is known.

    A fresh position is extrapolated to now; otherwise it is the last reported position.
    """
    position = view.position_enu_m(now_ns)
    if position is None and view.telemetry is not None and view.telemetry.is_position_valid:
        position = view.telemetry.position_enu_m

    if position is None or not _is_plausible(position):
        return None
    return position


def _is_plausible(point: Sequence[float]) -> bool:
    return all(abs(axis) < FAR_M for axis in point)


# -- the background --------------------------------------------------------------------------------


def draw_background(window: Window, fleet: FleetConfig) -> Canvas:
    """Draw the grid with its metres, the fence and the obstacles."""
    canvas = Canvas(window.width, window.height)
    west, east = fleet.fleet.geofence_m.x
    south, north = fleet.fleet.geofence_m.y

    half_x_m = window.dots_across / 2 / window.scale
    half_y_m = window.dots_down / 2 / window.scale
    grid_xs_m = _grid_lines(
        max(west, window.x_m - half_x_m), min(east, window.x_m + half_x_m), window.step_m
    )
    grid_ys_m = _grid_lines(
        max(south, window.y_m - half_y_m), min(north, window.y_m + half_y_m), window.step_m
    )
    for x_m in grid_xs_m:
        canvas.line(window.dot(x_m, south), window.dot(x_m, north), RULE, gap=4)
    for y_m in grid_ys_m:
        canvas.line(window.dot(west, y_m), window.dot(east, y_m), RULE, gap=4)

    for obstacle in fleet.obstacles:
        _draw_obstacle(canvas, window, obstacle)

    # Areas that the fleet may not leave are faint, areas that it may not enter are marked.
    for outline in flight_space_of(fleet).outlines():
        colour = FAINT if outline.keeps_in else WARN
        for begin, end in edges_of(outline.corners_enu_m):
            _draw_clipped_line(canvas, window.dot(*begin), window.dot(*end), colour)

    corners_m = ((west, south), (west, north), (east, north), (east, south))
    corners = [window.dot(x_m, y_m) for x_m, y_m in corners_m]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        _draw_clipped_line(canvas, start, end, FAINT)

    # The metres of each line of the grid, at the southern and at the western side of the fence.
    for x_m in grid_xs_m:
        column, row = window.cell(x_m, south)
        label = f"{x_m:g}"
        if 2 < column < canvas.width - len(label) - 2:
            if label.startswith("-"):
                column -= 1  # the digits, not the sign, stand at the line
            canvas.text(column, max(0, min(canvas.height - 1, row)), label, FAINT)

    for y_m in grid_ys_m:
        column, row = window.cell(west, y_m)
        label = f"{y_m:g}"
        if 0 < row < canvas.height - 1:
            canvas.text(max(0, min(column, canvas.width) - len(label)), row, label, FAINT)

    is_wide = canvas.width > 30  # in a narrower picture the compass would be in the way
    if is_wide and canvas.is_free(canvas.width - 2, 0, 2):
        canvas.text(canvas.width - 2, 0, "↑N", FAINT)
    return canvas


def _grid_lines(low_m: float, high_m: float, step_m: float) -> list[float]:
    """Return the coordinates of the grid's lines between two limits [m]."""
    first = math.ceil(low_m / step_m)
    last = min(math.floor(high_m / step_m), first + _MAX_LINES - 1)
    return [round(number * step_m, 6) for number in range(first, last + 1)]


class _Box(NamedTuple):
    """A part of the picture, in dots; the last column and row do not belong to it."""

    left: int
    right: int
    top: int
    bottom: int

    @property
    def size(self) -> int:
        """Number of its dots; 0 if it is empty."""
        return max(0, self.right - self.left) * max(0, self.bottom - self.top)


def _draw_obstacle(canvas: Canvas, window: Window, obstacle: Obstacle) -> None:
    """Draw an obstacle's outline and hatching, and its name if there is room."""
    for x1_m, y1_m, x2_m, y2_m, radius_m in obstacle.capsules_enu_m:
        if radius_m > 0.0:
            centre = window.dot(x1_m, y1_m)
            canvas.circles(np.array([centre]), radius_m * window.scale, WARN)
        else:
            _draw_clipped_line(canvas, window.dot(x1_m, y1_m), window.dot(x2_m, y2_m), WARN)

    box = _box_around(window, obstacle)
    if 0 < box.size <= _MAX_HATCHED:
        _hatch(canvas, window, obstacle, box)
        _write_name(canvas, obstacle.name, box)


def _box_around(window: Window, obstacle: Obstacle) -> _Box:
    """Return the part of the box around an obstacle that lies in the picture.

    The first ends of the capsules are enough, because each corner of a polygon is the first end of
    one capsule.
    """
    ends = np.array([(x_m, y_m, radius_m) for x_m, y_m, _, _, radius_m in obstacle.capsules_enu_m])
    low = window.dots(ends[:, :2] - ends[:, 2:])
    high = window.dots(ends[:, :2] + ends[:, 2:])
    x, y = np.concatenate([low, high]).T
    return _Box(
        left=max(0, int(x.min())),
        right=min(window.dots_across, int(x.max()) + 1),
        top=max(0, int(y.min())),
        bottom=min(window.dots_down, int(y.max()) + 1),
    )


def _hatch(canvas: Canvas, window: Window, obstacle: Obstacle, box: _Box) -> None:
    """Draw diagonal strokes inside an obstacle."""
    inside = []
    for y in range(box.top, box.bottom):
        first_x = box.left + (y + box.left) % _HATCH_DOTS
        for x in range(first_x, box.right, _HATCH_DOTS):
            if obstacle.distance_m(window.point_enu_m((x, y))) < 0.0:
                inside.append((x, y))
    if inside:
        dots = np.array(inside, float)
        canvas.dots(dots[:, 0], dots[:, 1], WARN)


def _write_name(canvas: Canvas, name: str, box: _Box) -> None:
    """Write an obstacle's name in the middle of the box around it, if there is room."""
    name = theme.clean(name, 24)
    name_width = cell_len(name)
    column = (box.left + box.right) // 2 // DOTS_ACROSS - name_width // 2
    row = (box.top + box.bottom) // 2 // DOTS_DOWN
    has_room = (box.right - box.left) / DOTS_ACROSS > name_width
    if has_room and canvas.is_free(column, row, name_width):
        canvas.text(column, row, name, WARN)


def _draw_clipped_line(canvas: Canvas, start: Dot, end: Dot, colour: str) -> None:
    """Draw the part of a line that lies in the picture.

    If the plan is zoomed in, the whole line may have millions of dots. The line is
    ``begin + share * along``; each axis narrows the range of shares that lie in the picture.
    """
    size = np.array([DOTS_ACROSS * canvas.width, DOTS_DOWN * canvas.height], float)
    begin = np.array(start)
    along = np.array(end) - np.array(start)

    first_share = 0.0
    last_share = 1.0
    for axis in (0, 1):
        if abs(along[axis]) >= _SAME_COORDINATE:
            share_at_0 = -begin[axis] / along[axis]
            share_at_size = (size[axis] - begin[axis]) / along[axis]
            first_share = max(first_share, min(share_at_0, share_at_size))
            last_share = min(last_share, max(share_at_0, share_at_size))
        elif not 0.0 <= begin[axis] <= size[axis]:
            return  # parallel to a border of the picture, and outside

    if first_share <= last_share:
        x1, y1 = begin + first_share * along
        x2, y2 = begin + last_share * along
        canvas.line((float(x1), float(y1)), (float(x2), float(y2)), colour)


# -- what moves ------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PlanScene:
    """Everything that the moving part of the plan depends on."""

    window: Window
    fleet: FleetConfig
    numbers: Mapping[str, int]  # number of each vehicle in the fleet file, which gives its colour
    labels: Mapping[str, str]  # what orders take for each vehicle: its number, or its name
    history: History
    views: Sequence[VehicleView]
    people: Sequence[PersonView]
    # results of :func:`drawn_position`; a vehicle without a position is not drawn
    positions_enu_m: Mapping[str, PointEnu]
    now_ns: int
    selected: str | None
    marked: frozenset[str]

    @property
    def places_of_people(self) -> dict[str, PointEnu]:
        """Where each person was seen last."""
        places = {}
        for person in self.people:
            if person.position_enu_m is not None and _is_plausible(person.position_enu_m):
                places[person.name] = person.position_enu_m
        return places

    @property
    def is_dense(self) -> bool:
        """Whether there is room for numbers only."""
        return self.window.width * self.window.height < _DENSE * len(self.views)

    def number_of(self, view: VehicleView) -> int:
        """Return the number of a vehicle in the fleet file."""
        return self.numbers.get(view.name, 0)

    def label_of(self, view: VehicleView) -> str:
        """Return the text for a vehicle, which means it in an order as well."""
        return theme.fit_name(theme.clean(self.labels.get(view.name, "?")), _LABEL_WIDTH).rstrip()

    def is_stale(self, view: VehicleView) -> bool:
        """Whether a vehicle is silent."""
        return not view.is_fresh(self.now_ns)

    def is_emphasised(self, name: str) -> bool:
        """Whether a vehicle is drawn with all details, even in a dense fleet."""
        return not self.is_dense or name == self.selected or name in self.marked

    def too_close(self) -> set[str]:
        """Return the vehicles that are nearer to another one than the safety distance."""
        limit_m = self.fleet.fleet.safety_distance_m
        names: set[str] = set()
        for pair in self.history.pairs:
            if pair.is_flying and pair.distance_m < limit_m:
                names.update((pair.first, pair.second))
        return names


def draw_fleet(canvas: Canvas, scene: PlanScene) -> None:
    """Draw trails, goals and setpoints, avoidance, safety circles, numbers and heights."""
    too_close = scene.too_close()
    _draw_trails(canvas, scene)

    for view in scene.views:
        if scene.is_emphasised(view.name):
            position = scene.positions_enu_m.get(view.name)
            colour = theme.vehicle_colour(scene.number_of(view))
            _draw_goal(canvas, scene.window, view, position, colour)

    _draw_circles(canvas, scene, too_close)
    _draw_people(canvas, scene)
    _draw_avoidance(canvas, scene)
    _draw_labels(canvas, scene, too_close)


def _draw_trails(canvas: Canvas, scene: PlanScene) -> None:
    """Draw the trails; all trails of one colour are drawn together."""
    trails_by_colour: dict[str, list[Array]] = {}
    for view in scene.views:
        trail_enu_m = scene.history.trails.get(view.name)
        if trail_enu_m is not None:
            colour = theme.faded(theme.vehicle_colour(scene.number_of(view)))
            trails_by_colour.setdefault(colour, []).append(trail_enu_m)

    for colour, trails_enu_m in trails_by_colour.items():
        dots = scene.window.dots(np.concatenate(trails_enu_m))
        canvas.dots(dots[:, 0], dots[:, 1], colour)


def _draw_goal(
    canvas: Canvas, window: Window, view: VehicleView, position: PointEnu | None, colour: str
) -> None:
    """Draw ✛ at the goal, × at the trajectory's setpoint, and a dashed line to the goal."""
    telemetry = view.telemetry
    if telemetry is None or not view.is_airborne:
        return
    goal = telemetry.goal_position_enu_m
    if not _is_plausible(goal):
        return

    if position is not None:
        if math.dist(goal[:2], position[:2]) > _NEAR_M:
            canvas.line(window.dot(*position[:2]), window.dot(*goal[:2]), colour, gap=5)

        setpoint = telemetry.setpoint_position_enu_m
        is_finite = all(map(math.isfinite, setpoint))
        if is_finite and math.dist(setpoint[:2], position[:2]) > _NEAR_M:
            canvas.text(*window.cell(*setpoint[:2]), "×", colour)

    canvas.text(*window.cell(*goal[:2]), "✛", colour)


def _draw_circles(canvas: Canvas, scene: PlanScene, too_close: set[str]) -> None:
    """Draw a circle of half the safety distance around each vehicle; dotted if it is silent."""
    groups: dict[tuple[str, int], list[Dot]] = {}  # colour and gap between dots -> centres
    for view in scene.views:
        position = scene.positions_enu_m.get(view.name)
        if position is None:
            continue

        gap = 1
        if scene.is_stale(view):
            colour = FAINT
            gap = 3
        elif view.name in too_close:
            colour = BAD
        elif view.light is not None:
            colour = theme.light_colour(view.light)
        else:
            colour = theme.vehicle_colour(scene.number_of(view))

        centres = groups.setdefault((colour, gap), [])
        centres.append(scene.window.dot(*position[:2]))

    radius = scene.fleet.fleet.safety_distance_m / 2.0 * scene.window.scale
    for (colour, gap), centres in groups.items():
        canvas.circles(np.array(centres), radius, colour, gap)


def _draw_people(canvas: Canvas, scene: PlanScene) -> None:
    """Draw the circle of each person who was seen, with the name; dotted if not seen now."""
    window = scene.window
    places = scene.places_of_people
    for person in scene.people:
        position = places.get(person.name)
        if position is None:
            continue

        gap = 1
        colour = WARN
        if not person.is_fresh(scene.now_ns):
            gap = 3
            colour = FAINT

        radius_m = scene.fleet.people[person.name].radius_m
        centre = window.dot(*position[:2])
        canvas.circles(np.array([centre]), radius_m * window.scale, colour, gap)

        name = theme.clean(person.name, 12)
        column, row = window.cell(*position[:2])
        canvas.text(column - cell_len(name) // 2, row, name, colour)


def _draw_avoidance(canvas: Canvas, scene: PlanScene) -> None:
    """Draw an arrow from each vehicle that the law holds back to the vehicle that it avoids."""
    window = scene.window
    places = {**scene.places_of_people, **scene.positions_enu_m}
    bright: list[tuple[PointEnu, PointEnu]] = []
    faint: list[tuple[PointEnu, PointEnu]] = []
    for view in scene.views:
        telemetry = view.telemetry
        position = scene.positions_enu_m.get(view.name)
        if (
            telemetry is None
            or position is None
            or not telemetry.is_airborne
            or scene.is_stale(view)
        ):
            continue

        # `avoids` names no vehicle if an obstacle, the fence or the tilt limit holds it back.
        other = places.get(telemetry.avoids)
        is_held_back = telemetry.law_status.lower() not in ("", "inactive")
        if other is not None and is_held_back:
            if scene.is_emphasised(view.name):
                bright.append((position, other))
            else:
                faint.append((position, other))

    for pairs, colour in ((faint, FAINT), (bright, TEXT)):
        if pairs:
            ends_enu_m = np.array(pairs)[:, :, :2]
            starts = window.dots(ends_enu_m[:, 0])
            ends = window.dots(ends_enu_m[:, 1])
            canvas.lines(starts, ends, colour, gap=2)

    for (x_m, y_m, _), (other_x_m, other_y_m, _) in bright:
        east_m = other_x_m - x_m
        north_m = other_y_m - y_m
        eighth = round(math.atan2(north_m, east_m) / (math.pi / 4.0))
        arrow = _ARROWS[eighth % 8]

        # Not in the middle, so that both arrows of two vehicles that avoid each other are visible.
        column, row = window.cell(x_m + _ARROW_SHARE * east_m, y_m + _ARROW_SHARE * north_m)
        canvas.text(column, row, arrow, TEXT, bold=True)


@dataclass(frozen=True, slots=True)
class _Number:
    """The place of a vehicle's number in the picture."""

    column: int
    row: int
    length: int
    view: VehicleView


def _draw_labels(canvas: Canvas, scene: PlanScene, too_close: set[str]) -> None:
    """Write numbers, then heights, so that no height covers a number.

    Where a crowd leaves no room for all numbers, the most important ones are written.
    """
    views = [
        view
        for view in scene.views
        if view.name in scene.positions_enu_m and view.telemetry is not None
    ]
    views.sort(
        key=lambda view: (
            view.name != scene.selected,
            view.name not in scene.marked,
            view.name not in too_close,
        )
    )
    labels = [_label(scene, view, is_close=view.name in too_close) for view in views]
    columns = canvas.labels(labels)

    has_names = scene.window.width >= _NAMES_WIDTH and len(scene.views) <= _FEW
    for view, label, column in zip(views, labels, columns, strict=True):
        if column is not None and scene.is_emphasised(view.name):
            number = _Number(column, label.row, cell_len(label.text), view)
            _write_height(canvas, scene, number, has_name=has_names)


def _label(scene: PlanScene, view: VehicleView, *, is_close: bool) -> Label:
    """Return a vehicle's label: ``[1]`` is under the cursor, ``1!`` too close, ``1?`` silent.

    In a dense fleet, labels have the colour of the height.
    """
    position = scene.positions_enu_m[view.name]
    label = scene.label_of(view)
    if scene.is_stale(view):
        sign = "?"
        colour = FAINT
    elif is_close:
        sign = "!"
        colour = BAD
    elif scene.is_dense:
        sign = ""
        colour = theme.height_colour(position[2], scene.fleet.fleet.geofence_m.z)
    else:
        sign = ""
        colour = theme.vehicle_colour(scene.number_of(view))

    column, row = scene.window.cell(*position[:2])
    if view.name == scene.selected:
        return Label(column, row, f"[{label}]{sign}", colour, lead=1)
    if view.name in scene.marked:
        return Label(column, row, f"✓{label}{sign}", colour, lead=1)
    return Label(column, row, f"{label}{sign}", colour)


def _write_height(canvas: Canvas, scene: PlanScene, number: _Number, *, has_name: bool) -> None:
    """Write a vehicle's name and height beside its number, on the first side that is free."""
    view = number.view
    position = scene.positions_enu_m[view.name]
    is_stale = scene.is_stale(view)

    name = ""
    if has_name and scene.labels.get(view.name) != view.name:
        name = f"{theme.fit_name(theme.clean(view.name), _LABEL_WIDTH).rstrip()} "
    height = ""
    if view.telemetry and view.telemetry.is_airborne and not is_stale:
        height = f"{theme.number(position[2], 1)}m"

    width = cell_len(f"{name}{height}".rstrip())
    if not width:
        return

    column = number.column
    row = number.row
    sides = (
        (column + number.length + 1, row),
        (column - width - 1, row),
        (column, row - 1),
        (column, row + 1),
    )
    for side_column, side_row in sides:
        # The cell before it stays free too, so that a height does not go on from a number.
        if canvas.is_free(side_column - 1, side_row, width + 1):
            if is_stale:
                name_colour = FAINT
                height_colour = FAINT
            else:
                name_colour = TEXT
                height_colour = theme.height_colour(position[2], scene.fleet.fleet.geofence_m.z)
            canvas.text(side_column, side_row, name, name_colour)
            canvas.text(side_column + cell_len(name), side_row, height, height_colour)
            return
