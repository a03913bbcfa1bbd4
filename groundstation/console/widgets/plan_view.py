"""The fleet from above: the visible part, and the keys that change it."""

from __future__ import annotations

import math
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.strip import Strip

from groundstation.console.canvas import Canvas
from groundstation.console.history import FAR_M, History
from groundstation.console.plan_drawing import (
    PlanScene,
    Spot,
    Window,
    draw_background,
    draw_fleet,
    spot_of,
)
from groundstation.console.theme import clean
from groundstation.console.widgets.lines import Lines
from groundstation.fleet.state import FleetState, VehicleView
from onboard.config.fleet import FleetConfig

_Span = tuple[float, float]
_ROUND_M = 1.0  # shown around the outermost vehicle
_PAN = 0.15  # of the picture, a key press


class PlanView(Lines, can_focus=True):
    """East to the right, north up. Circles have half the safety distance: where two touch, the
    limit is reached.

    Without keys it shows the part of the fence that the fleet uses.
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
        self.history = history
        self.zoom = 1.0
        self.is_whole_fence = False
        self.follows = ""  # "*" the middle of the fleet, else the vehicle of this name
        self._middle: tuple[float, float] | None = None
        starts = [fleet.vehicles[name].start_enu_m for name in fleet.enabled_names] or [
            (0.0, 0.0, 0.0)
        ]
        self._spans = (
            _around([start[0] for start in starts]),
            _around([start[1] for start in starts]),
        )
        self._background_picture: tuple[Window, Canvas] | None = None
        self._views: list[VehicleView] = []
        self._spots: dict[str, Spot] = {}
        self._selected: str | None = None
        self._marked: tuple[str, ...] = ()
        self._now_ns = 0
        self._titles = ("", "")

    def show(
        self,
        state: FleetState,
        now_ns: int,
        selected: str | None = None,
        marked: tuple[str, ...] = (),
    ) -> None:
        """Draw this state; ``selected`` and ``marked`` are shown as such."""
        views = list(state.vehicles.values())
        if not self.is_due(
            now_ns,
            (selected, marked, state.airborne_names, [view.is_fresh(now_ns) for view in views]),
        ):
            return
        self._views, self._now_ns, self._selected, self._marked = views, now_ns, selected, marked
        self._spots = {
            view.name: spot for view in views if (spot := spot_of(view, now_ns)) is not None
        }
        self._widen()
        self.redraw()

    def redraw(self) -> None:
        """Draw now, and name the visible part."""
        self._update_titles(self._window(*self.size))
        super().redraw()

    def change_zoom(self, factor: float) -> None:
        """Zoom; 0 goes back to the fleet's part of the fence, and from there to all of it."""
        if factor == 0.0:
            self.is_whole_fence = (
                self.zoom == 1.0 and self._middle is None and not self.is_whole_fence
            )
            self._middle, self.follows = None, ""
        self.zoom = 1.0 if factor == 0.0 else min(64.0, max(0.25, self.zoom * factor))
        self.redraw()

    def action_whole(self) -> None:
        """Back to the fleet's part of the fence, or all of it."""
        self.change_zoom(0.0)

    def action_pan(self, east: int, north: int) -> None:
        """Move the window east or north, and follow no vehicle."""
        window = self._window(*self.size)
        self.follows = ""
        step_m = _PAN * 2.0 * min(window.width, 2 * window.height) / window.scale
        x_m, y_m = window.x_m + east * step_m, window.y_m + north * step_m
        fence = self.fleet.fleet.geofence_m
        self._middle = (_within(x_m, fence.x), _within(y_m, fence.y))
        self.redraw()

    def action_follow(self) -> None:
        """Follow the vehicle under the fleet's cursor; then the middle of the fleet; then none."""
        name = self._selected or "*"
        self.follows = (
            name if self.follows not in (name, "*") else "*" if self.follows != "*" else ""
        )
        self._middle = None
        self.redraw()

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        """Zoom in."""
        event.stop()
        self.change_zoom(1.25)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        """Zoom out."""
        event.stop()
        self.change_zoom(0.8)

    def on_mouse_move(self, event: events.MouseMove) -> None:
        """Drag the picture."""
        if event.button == 1 and self.size.width:
            window = self._window(*self.size)
            self.follows = ""
            self._middle = (
                window.x_m - 2 * event.delta_x / window.scale,
                window.y_m + 4 * event.delta_y / window.scale,
            )
            self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the picture; the background is drawn once for each window."""
        if width < 1 or height < 1:
            return []
        window = self._window(width, height)
        if self._background_picture is None or self._background_picture[0] != window:
            self._background_picture = window, draw_background(window, self.fleet)
        canvas = self._background_picture[1].copy()
        marked = frozenset(self._marked)
        views, spots, now_ns = self._views, self._spots, self._now_ns
        scene = PlanScene(
            window, self.fleet, self.history, views, spots, now_ns, self._selected, marked
        )
        draw_fleet(canvas, scene)
        return canvas.strips()

    def _update_titles(self, window: Window) -> None:
        title = "plan"
        if self.follows:
            title += f" · follows {'the fleet' if self.follows == '*' else clean(self.follows, 40)}"
        if self.zoom != 1.0:
            title += f" · {self.zoom:.2g}×"
        limit_m = self.fleet.fleet.safety_distance_m
        touch = f"circles touch at {limit_m:.2f} m" if window.width >= 44 else f"○○ {limit_m:.2f} m"
        titles = title, f"grid {window.step_m:g} m · {touch}"
        if titles != self._titles:
            self._titles = titles
            self.border_title, self.border_subtitle = titles

    def _window(self, width: int, height: int) -> Window:
        fence = self.fleet.fleet.geofence_m
        box_x, box_y = (fence.x, fence.y) if self.is_whole_fence else self._spans
        width, height = max(1, width), max(1, height)
        scale = max(
            1e-3,
            min((2 * width - 3) / (box_x[1] - box_x[0]), (4 * height - 3) / (box_y[1] - box_y[0])),
        )
        middle = self._middle or self._followed() or (sum(box_x) / 2.0, sum(box_y) / 2.0)
        return Window(middle[0], middle[1], scale * self.zoom, width, height)

    def _widen(self) -> None:
        """Widen the visible part (x, y in metres) to all vehicles and goals.

        It only grows: a picture whose scale changes with every move cannot be read.
        """
        fence = self.fleet.fleet.geofence_m
        points: list[tuple[float, ...]] = [spot[:2] for spot in self._spots.values()]
        points += [
            view.telemetry.goal_position_enu_m[:2]
            for view in self._views
            if view.telemetry and view.is_airborne
        ]
        spans = []
        for axis, limits in enumerate((fence.x, fence.y)):
            values = [point[axis] for point in points if abs(point[axis]) < FAR_M] or [
                sum(self._spans[axis]) / 2.0
            ]
            low, high = (
                min(*values, self._spans[axis][0] + _ROUND_M),
                max(*values, self._spans[axis][1] - _ROUND_M),
            )
            # Beyond the fence only what has strayed there widens the picture.
            low, high = (
                max(low - _ROUND_M, min(limits[0], low)),
                min(high + _ROUND_M, max(limits[1], high)),
            )
            spans.append((low, max(high, low + 2.0)))
        self._spans = (spans[0], spans[1])

    def _followed(self) -> tuple[float, float] | None:
        """Return the followed point; zoomed in without a choice it is the middle of the fleet."""
        if not (self.follows or self.zoom != 1.0) or not self._spots:
            return None
        one = self._spots.get(self.follows)
        spots = list(self._spots.values()) if one is None else [one]
        return (
            math.fsum(spot[0] for spot in spots) / len(spots),
            math.fsum(spot[1] for spot in spots) / len(spots),
        )


def _around(values: list[float]) -> _Span:
    return min(values) - _ROUND_M, max(values) + _ROUND_M


def _within(value: float, span: _Span) -> float:
    return min(span[1], max(span[0], value))
