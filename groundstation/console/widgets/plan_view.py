"""The plan: the fleet from above, with the keys that change the visible part."""

from __future__ import annotations

import math
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.strip import Strip

from groundstation.console.canvas import DOTS_ACROSS, DOTS_DOWN, Canvas
from groundstation.console.history import FAR_M, History
from groundstation.console.plan_drawing import (
    PlanScene,
    PointEnu,
    Window,
    draw_background,
    draw_fleet,
    drawn_position,
)
from groundstation.console.theme import clean
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState, PersonView, VehicleView
from onboard.config.fleet import FleetConfig

_Span = tuple[float, float]  # least and greatest coordinate in metres
_Middle = tuple[float, float]  # x and y in metres, ENU
_MARGIN_M = 1.0  # margin around the outermost vehicle, up to the fence
_MIN_SPAN_M = 2.0
_PAN = 0.15  # share of the picture by which a key moves it
_WHOLE_FLEET = "*"  # value of `follows` for the middle of the fleet
_MIN_ZOOM = 0.25
_LARGEST_ZOOM = 64.0
_WHEEL_ZOOM = 1.25  # factor for a step of the mouse wheel
_MIN_SCALE = 1e-3  # dots per metre, in a picture that is too small for its border
_WIDTH_OF_WORDS = 44  # width from which the circles are explained in words


class PlanView(Lines, can_focus=True):
    """The plan, with east to the right and north up.

    The radius of the circles is half the safety distance, so two circles that touch show the limit.
    At first the plan shows the part of the fence that the fleet uses.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left,h", "pan(-1, 0)", "west", show=False),
        Binding("right,l", "pan(1, 0)", "east", show=False),
        Binding("up,k", "pan(0, 1)", "north", show=False),
        Binding("down,j", "pan(0, -1)", "south", show=False),
        Binding("f", "follow", "follow", show=False),
        Binding("0", "whole", "whole fence", show=False),
    ]

    def __init__(self, fleet: FleetConfig, history: History) -> None:
        super().__init__(id="plan")
        self.fleet = fleet
        self._numbers = fleet.numbers
        self._labels = fleet.labels
        self.history = history
        self.zoom = 1.0
        self.is_whole_fence = False
        self.follows = ""  # name of the followed vehicle, "*" for the fleet's middle, or empty

        self._middle: _Middle | None = None  # chosen by panning or dragging
        starts_enu_m = [fleet.vehicles[name].start_enu_m for name in fleet.enabled_names]
        if not starts_enu_m:
            starts_enu_m = [(0.0, 0.0, 0.0)]
        # the part of the world that the fleet uses
        fence = fleet.fleet.geofence_m
        self._span_x = _span([x_m for x_m, _, _ in starts_enu_m], fence.x)
        self._span_y = _span([y_m for _, y_m, _ in starts_enu_m], fence.y)

        self._backdrop: Canvas | None = None
        self._backdrop_window: Window | None = None  # window that the backdrop shows
        self._views: list[VehicleView] = []
        self._people: tuple[PersonView, ...] = ()
        self._positions_enu_m: dict[str, PointEnu] = {}
        self._selected: str | None = None
        self._marked: tuple[str, ...] = ()
        self._now_ns = 0
        self._titles = ("", "")  # in the upper and in the lower border

    def show(
        self,
        state: FleetState,
        now_ns: int,
        selected: str | None = None,
        marked: tuple[str, ...] = (),
    ) -> None:
        """Draw this state of the fleet, with the selected vehicle and the marked ones."""
        views = list(state.vehicles.values())
        freshness = [view.is_fresh(now_ns) for view in views]
        if not self.is_due(now_ns, (selected, marked, state.airborne_names, freshness)):
            return

        self._views = views
        self._people = state.people
        self._now_ns = now_ns
        self._selected = selected
        self._marked = marked

        self._positions_enu_m = {}
        for view in views:
            position = drawn_position(view, now_ns)
            if position is not None:
                self._positions_enu_m[view.name] = position

        self._widen()
        self.redraw()

    def redraw(self) -> None:
        """Draw now, and update the titles for the visible part."""
        self._update_titles(self._window(*self.size))
        super().redraw()

    # -- keys and mouse ----------------------------------------------------------------------------

    def change_zoom(self, factor: float) -> None:
        """Zoom by a factor."""
        self.zoom = min(_LARGEST_ZOOM, max(_MIN_ZOOM, self.zoom * factor))
        self.redraw()

    def action_whole(self) -> None:
        """Show the fleet's part of the fence without zoom, or the whole fence at the next press."""
        is_moved = self.zoom != 1.0 or self._middle is not None
        shows_fleets_part = not is_moved and not self.is_whole_fence
        self.is_whole_fence = shows_fleets_part
        self._middle = None
        self.follows = ""
        self.zoom = 1.0
        self.redraw()

    def action_pan(self, east: int, north: int) -> None:
        """Move the window east or north, and follow no vehicle."""
        window = self._window(*self.size)
        self.follows = ""

        dots_across = DOTS_ACROSS * window.width
        dots_down = DOTS_DOWN * window.height
        step_m = _PAN * min(dots_across, dots_down) / window.scale
        x_m = window.x_m + east * step_m
        y_m = window.y_m + north * step_m
        fence = self.fleet.fleet.geofence_m
        self._middle = (_within(x_m, fence.x), _within(y_m, fence.y))
        self.redraw()

    def action_follow(self) -> None:
        """Follow the vehicle under the table's cursor; then the fleet's middle; then nothing."""
        selected = self._selected or _WHOLE_FLEET
        if self.follows == _WHOLE_FLEET:
            self.follows = ""
        elif self.follows == selected:
            self.follows = _WHOLE_FLEET
        else:
            self.follows = selected

        self._middle = None
        self.redraw()

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        """Zoom in."""
        event.stop()
        self.change_zoom(_WHEEL_ZOOM)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        """Zoom out."""
        event.stop()
        self.change_zoom(1.0 / _WHEEL_ZOOM)

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Drag the picture."""
        if event.button == 1 and self.size.width:
            window = self._window(*self.size)
            self.follows = ""
            self._middle = (
                window.x_m - DOTS_ACROSS * event.delta_x / window.scale,
                window.y_m + DOTS_DOWN * event.delta_y / window.scale,
            )
            self.redraw()

    # -- the picture -------------------------------------------------------------------------------

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the picture; the background is drawn once for each window."""
        if width < 1 or height < 1:
            return []

        window = self._window(width, height)
        if self._backdrop is None or self._backdrop_window != window:
            self._backdrop = draw_background(window, self.fleet)
            self._backdrop_window = window

        canvas = self._backdrop.copy()
        scene = PlanScene(
            window=window,
            fleet=self.fleet,
            numbers=self._numbers,
            labels=self._labels,
            history=self.history,
            views=self._views,
            people=self._people,
            positions_enu_m=self._positions_enu_m,
            now_ns=self._now_ns,
            selected=self._selected,
            marked=frozenset(self._marked),
        )
        draw_fleet(canvas, scene)
        return canvas.strips()

    def _update_titles(self, window: Window) -> None:
        upper = "plan"
        if self.follows == _WHOLE_FLEET:
            upper += " · follows the fleet"
        elif self.follows:
            upper += f" · follows {clean(self.follows, 40)}"
        if self.zoom != 1.0:
            upper += f" · {self.zoom:.2g}×"

        limit_m = self.fleet.fleet.safety_distance_m
        touching = f"○○ {limit_m:.2f} m"
        if window.width >= _WIDTH_OF_WORDS:
            touching = f"circles touch at {limit_m:.2f} m"
        lower = f"grid {window.step_m:g} m · {touching}"

        if self._titles != (upper, lower):
            self._titles = (upper, lower)
            self.border_title = upper
            self.border_subtitle = lower

    def _window(self, width: int, height: int) -> Window:
        """Return the visible part of the world in a picture of this size, in cells."""
        width = max(1, width)
        height = max(1, height)

        west_m, east_m = self._span_x
        south_m, north_m = self._span_y
        if self.is_whole_fence:
            west_m, east_m = self.fleet.fleet.geofence_m.x
            south_m, north_m = self.fleet.fleet.geofence_m.y

        # A dot is left free at each side: a span reaches from the middle of the second dot to the
        # middle of the last but one, three dots less than the whole picture.
        scale_x = (DOTS_ACROSS * width - 3) / (east_m - west_m)
        scale_y = (DOTS_DOWN * height - 3) / (north_m - south_m)
        scale = max(_MIN_SCALE, min(scale_x, scale_y))

        middle = self._middle
        if middle is None:
            middle = self._followed_point()
        if middle is None:
            middle = ((west_m + east_m) / 2.0, (south_m + north_m) / 2.0)
        x_m, y_m = middle
        return Window(x_m=x_m, y_m=y_m, scale=scale * self.zoom, width=width, height=height)

    def _widen(self) -> None:
        """Widen the visible part to all vehicles and goals.

        It never becomes smaller, because a picture whose scale changes with every move is hard to
        read.
        """
        points_enu_m = list(self._positions_enu_m.values())
        for view in self._views:
            if view.telemetry and view.is_airborne:
                points_enu_m.append(view.telemetry.goal_position_enu_m)

        fence = self.fleet.fleet.geofence_m
        self._span_x = _widened(self._span_x, fence.x, [x_m for x_m, _, _ in points_enu_m])
        self._span_y = _widened(self._span_y, fence.y, [y_m for _, y_m, _ in points_enu_m])

    def _followed_point(self) -> _Middle | None:
        """Return the position of the followed vehicle, or the middle of the fleet.

        A zoomed plan that follows nothing shows the middle of the fleet. The result is None for a
        plan that neither follows nor is zoomed, and without any known position.
        """
        is_following = self.follows or self.zoom != 1.0
        if not is_following or not self._positions_enu_m:
            return None

        positions = list(self._positions_enu_m.values())
        if self.follows in self._positions_enu_m:
            positions = [self._positions_enu_m[self.follows]]

        middle_x_m = math.fsum(x_m for x_m, _, _ in positions) / len(positions)
        middle_y_m = math.fsum(y_m for _, y_m, _ in positions) / len(positions)
        return middle_x_m, middle_y_m


def _widened(span: _Span, fence: _Span, coordinates_m: list[float]) -> _Span:
    """Return a span of one axis, widened to all coordinates that are plausible."""
    plausible_m = [value for value in coordinates_m if abs(value) < FAR_M]
    if not plausible_m:
        return span

    low_m, high_m = span
    needed_low_m, needed_high_m = _span(plausible_m, fence)
    return min(low_m, needed_low_m), max(high_m, needed_high_m)


def _span(coordinates_m: list[float], fence: _Span) -> _Span:
    """Return the span of these coordinates, with a margin at each end.

    The margin ends at the fence. An end that lies beyond the fence gets no margin.
    """
    fence_low_m, fence_high_m = fence
    low_m = min(coordinates_m)
    if low_m > fence_low_m:
        low_m = max(fence_low_m, low_m - _MARGIN_M)

    high_m = max(coordinates_m)
    if high_m < fence_high_m:
        high_m = min(fence_high_m, high_m + _MARGIN_M)
    return low_m, max(high_m, low_m + _MIN_SPAN_M)


def _within(value_m: float, span: _Span) -> float:
    low_m, high_m = span
    return min(high_m, max(low_m, value_m))
