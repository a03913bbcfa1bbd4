"""The predicted paths of an order, drawn from above."""

from __future__ import annotations

import itertools

import numpy as np
from textual.strip import Strip

from groundstation.console import theme
from groundstation.console.canvas import DOTS_ACROSS, DOTS_DOWN, Canvas, Label
from groundstation.console.plan_drawing import Window
from groundstation.console.theme import FAINT
from groundstation.console.widgets.lines import Lines
from groundstation.orders.forecast import Forecast
from groundstation.orders.preview import OrderPreview
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig

_MARGIN_M = 0.7  # margin around the outermost points


class PathPlan(Lines):
    """The predicted paths from above: a number at the start of each, a cross at its goal."""

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(id="paths")
        self.fleet = fleet
        self._preview: OrderPreview | None = None
        self._forecast: Forecast | None = None

    def show(self, preview: OrderPreview | None, forecast: Forecast | None) -> None:
        """Draw a preview and its forecast."""
        self._preview = preview
        self._forecast = forecast
        self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the picture."""
        canvas = Canvas(width, height)
        preview = self._preview
        if preview is None or not preview.legs:
            return canvas.strips()

        goals_enu_m = {  # name -> east and north of the goal (1, 2)
            name: np.array([leg.goal_enu_m])[:, :2] for name, leg in preview.legs.items()
        }
        paths_enu_m = self._paths(preview)
        points_enu_m = np.concatenate([*paths_enu_m.values(), *goals_enu_m.values()])
        window = _window_around(points_enu_m, canvas)

        numbers = self.fleet.numbers
        labels = self.fleet.labels
        colours = {
            name: theme.vehicle_colour(numbers.get(name, 0))
            for name in paths_enu_m.keys() | preview.legs.keys()
        }

        radius = self.fleet.fleet.safety_distance_m / 2.0 * window.scale  # in dots
        for name, path_enu_m in paths_enu_m.items():
            colour = colours[name] if preview.legs[name].is_by_this_order else FAINT
            dots = window.dots(path_enu_m)
            for start, end in itertools.pairwise(dots):
                canvas.line((start[0], start[1]), (end[0], end[1]), colour)
            canvas.circles(window.dots(goals_enu_m[name]), radius, colour, gap=2)

        ordered = [name for name, leg in preview.legs.items() if leg.is_by_this_order]
        others = [name for name, leg in preview.legs.items() if not leg.is_by_this_order]
        for name in ordered:
            column, row = window.cell(*preview.legs[name].goal_enu_m[:2])
            canvas.text(column, row, "✛", colours[name], bold=True)

        numbers_at_starts = []
        for name in (*ordered, *others):
            column, row = window.cell(*preview.legs[name].start_enu_m[:2])
            numbers_at_starts.append(Label(column, row, labels.get(name, "?"), colours[name]))
        canvas.labels(numbers_at_starts)
        return canvas.strips()

    def _paths(self, preview: OrderPreview) -> dict[str, Array]:
        """Return the predicted path (n, 2) [m] of each vehicle.

        Without a forecast it is the straight line from the start to the goal.
        """
        if self._forecast is not None and self._forecast.paths_enu_m:
            forecast = self._forecast.paths_enu_m
            return {name: np.array(points)[:, :2] for name, points in forecast.items()}
        return {
            name: np.array([leg.start_enu_m, leg.goal_enu_m])[:, :2]
            for name, leg in preview.legs.items()
        }


def _window_around(points_enu_m: Array, canvas: Canvas) -> Window:
    """Return the window that shows all points (n, 2) [m] with a margin."""
    low_m = points_enu_m.min(axis=0) - _MARGIN_M
    high_m = points_enu_m.max(axis=0) + _MARGIN_M
    middle_x, middle_y = (low_m + high_m) / 2.0

    width_m, height_m = high_m - low_m
    scale_x = DOTS_ACROSS * canvas.width / width_m  # dots for each metre
    scale_y = DOTS_DOWN * canvas.height / height_m
    return Window(
        x_m=float(middle_x),
        y_m=float(middle_y),
        scale=float(min(scale_x, scale_y)),
        width=canvas.width,
        height=canvas.height,
    )
