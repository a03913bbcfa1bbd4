"""The fleet from above: which part of it is seen, and the keys that change that."""

from __future__ import annotations

import math
from typing import ClassVar

from textual import events
from textual.binding import Binding, BindingType
from textual.strip import Strip

from groundstation.fleet import FleetState
from groundstation.tui.canvas import Canvas
from groundstation.tui.history import FAR_M, History
from groundstation.tui.look import clean
from groundstation.tui.plan_picture import Window, draw_fleet, ground, spot_of
from groundstation.tui.widgets.lines import Lines
from onboard.config import FleetConfig

_Span = tuple[float, float]
_ROUND_M = 1.0  # shown around the outermost vehicle
_PAN = 0.15  # of the picture, a key press


class PlanView(Lines, can_focus=True):
    """East to the right, north up. Circles have half the safety distance: where two touch, the limit is reached.

    By itself it shows the part of the fence that the fleet uses. ``follows``: "" nobody, "*" the fleet's middle, else
    the vehicle of this name.
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
        self.follows = ""
        self._middle: tuple[float, float] | None = None
        self._spans: tuple[_Span, _Span] | None = None
        self._ground: tuple[Window, Canvas] | None = None
        self._state: FleetState | None = None
        self._selected: str | None = None
        self._marked: tuple[str, ...] = ()
        self._now_ns = 0
        self._titles = ("", "")

    def show(self, state: FleetState, now_ns: int, selected: str | None = None, marked: tuple[str, ...] = ()) -> None:
        """Draw this state; ``selected`` and ``marked`` are shown as such."""
        self._state, self._now_ns, self._selected, self._marked = state, now_ns, selected, marked
        self.redraw()

    def redraw(self) -> None:
        """Draw now, and say what is seen."""
        self._say(self._window(*self.size))
        super().redraw()

    def change_zoom(self, factor: float) -> None:
        """Zoom; 0 goes back to the fleet's part of the fence, and from there to all of it."""
        if factor == 0.0:
            self.is_whole_fence = self.zoom == 1.0 and self._middle is None and not self.is_whole_fence
            self._middle, self.follows = None, ""
        self.zoom = 1.0 if factor == 0.0 else min(64.0, max(0.25, self.zoom * factor))
        self.redraw()

    def action_whole(self) -> None:
        """Back to the fleet's part of the fence, or all of it."""
        self.change_zoom(0.0)

    def action_pan(self, east: int, north: int) -> None:
        """Look further east or north; nobody is followed any more."""
        window = self._window(*self.size)
        self.follows = ""
        step_m = _PAN * 2.0 * min(window.width, 2 * window.height) / window.scale
        x_m, y_m = window.x_m + east * step_m, window.y_m + north * step_m
        fence = self.fleet.fleet.geofence_m
        self._middle = (_within(x_m, fence.x), _within(y_m, fence.y))
        self.redraw()

    def action_follow(self) -> None:
        """Follow the vehicle under the fleet's cursor; then the middle of the fleet; then nobody."""
        chosen = self._selected or "*"
        self.follows = chosen if self.follows not in (chosen, "*") else "*" if self.follows != "*" else ""
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
        """The picture; what stands still is drawn once for each part that is looked at."""
        if width < 1 or height < 1:
            return []
        window = self._window(width, height)
        if self._ground is None or self._ground[0] != window:
            self._ground = window, ground(window, self.fleet)
        canvas = self._ground[1].copy()
        if self._state is not None:
            draw_fleet(
                canvas, window, self.fleet, self.history, self._state, self._now_ns, self._selected, self._marked
            )
        return canvas.strips()

    def _say(self, window: Window) -> None:
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
        box_x, box_y = self._box()
        width, height = max(1, width), max(1, height)
        scale = max(1e-3, min((2 * width - 3) / (box_x[1] - box_x[0]), (4 * height - 3) / (box_y[1] - box_y[0])))
        middle = self._middle or self._followed() or (sum(box_x) / 2.0, sum(box_y) / 2.0)
        return Window(middle[0], middle[1], scale * self.zoom, width, height)

    def _box(self) -> tuple[_Span, _Span]:
        """What the picture shows (x, y in metres): the fence, or the part of it that the fleet uses.

        The part only grows: a picture that breathes with every move cannot be read.
        """
        fence = self.fleet.fleet.geofence_m
        if self.is_whole_fence:
            return fence.x, fence.y
        points = [self.fleet.vehicles[name].start_enu_m[:2] for name in self.fleet.enabled_names]
        for view in self._state.vehicles.values() if self._state is not None else ():
            spot, told = spot_of(view, self._now_ns), view.telemetry
            points += [spot[:2]] if spot is not None else []
            if told is not None and told.is_airborne:
                points.append(told.goal_position_enu_m[:2])
        spans = []
        for axis, limits in enumerate((fence.x, fence.y)):
            values = [*(point[axis] for point in points if abs(point[axis]) < FAR_M)] or list(limits)
            low, high = min(values) - _ROUND_M, max(values) + _ROUND_M
            old = self._spans[axis] if self._spans is not None else (low, high)
            low, high = min(low, old[0]), max(high, old[1])
            # Beyond the fence only what has strayed there widens the picture.
            low, high = max(low, min(limits[0], *values)), min(high, max(limits[1], *values))
            spans.append((low, max(high, low + 2.0)))
        self._spans = (spans[0], spans[1])
        return self._spans

    def _followed(self) -> tuple[float, float] | None:
        """The place that is followed; zoomed in without a choice it is the fleet's middle."""
        if self._state is None or not (self.follows or self.zoom != 1.0):
            return None
        views = self._state.vehicles
        one = views.get(self.follows)
        chosen = views.values() if one is None else (one,)
        spots = [spot for view in chosen if (spot := spot_of(view, self._now_ns)) is not None]
        if not spots:
            return None
        return (math.fsum(spot[0] for spot in spots) / len(spots), math.fsum(spot[1] for spot in spots) / len(spots))


def _within(value: float, span: _Span) -> float:
    return min(span[1], max(span[0], value))
