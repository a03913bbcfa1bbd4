"""The predicted paths of an order, drawn from above."""

from __future__ import annotations

import itertools

import numpy as np
from textual.strip import Strip

from groundstation.console import theme
from groundstation.console.canvas import Canvas
from groundstation.console.plan_drawing import Window
from groundstation.console.theme import FAINT
from groundstation.console.widgets.lines import Lines
from groundstation.orders.forecast import Forecast
from groundstation.orders.preview import OrderPreview
from onboard.config.fleet import FleetConfig

_MARGIN_M = 0.7  # around the outermost points


class PathPlan(Lines):
    """The predicted paths from above: a number at the start of each, a cross at its goal."""

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(id="paths")
        self.fleet = fleet
        self._preview: OrderPreview | None = None
        self._forecast: Forecast | None = None

    def show(self, preview: OrderPreview | None, forecast: Forecast | None) -> None:
        """Draw these."""
        self._preview, self._forecast = preview, forecast
        self.redraw()

    def draw(self, width: int, height: int) -> list[Strip]:
        """Return the picture."""
        canvas = Canvas(width, height)
        preview = self._preview
        if preview is None or not preview.legs:
            return canvas.strips()
        paths = {
            name: np.array([leg.start_enu_m, leg.goal_enu_m])[:, :2]
            for name, leg in preview.legs.items()
        }
        if self._forecast is not None and self._forecast.paths_enu_m:
            paths = {
                name: np.array(points)[:, :2] for name, points in self._forecast.paths_enu_m.items()
            }
        ends = np.concatenate(
            [*paths.values(), *(np.array([leg.goal_enu_m])[:, :2] for leg in preview.legs.values())]
        )
        low, high = ends.min(axis=0) - _MARGIN_M, ends.max(axis=0) + _MARGIN_M
        scale = float(min(2 * width / (high[0] - low[0]), 4 * height / (high[1] - low[1])))
        middle = (low + high) / 2.0
        window = Window(float(middle[0]), float(middle[1]), scale, canvas.width, canvas.height)
        indices = {name: index for index, name in enumerate(self.fleet.enabled_names)}
        radius = self.fleet.fleet.safety_distance_m / 2.0 * scale
        for name, path in paths.items():
            leg, colour = preview.legs[name], theme.vehicle_colour(indices.get(name, 0))
            dots = window.dots(path)
            for start, end in itertools.pairwise(dots):
                canvas.line(
                    (start[0], start[1]), (end[0], end[1]), colour if leg.is_ordered else FAINT
                )
            goal = window.dots(np.array([leg.goal_enu_m])[:, :2])
            canvas.circles(goal, radius, colour if leg.is_ordered else FAINT, gap=2)
        for name, leg in preview.legs.items():
            colour = theme.vehicle_colour(indices.get(name, 0))
            if leg.is_ordered:
                canvas.text(*window.cell(*leg.goal_enu_m[:2]), "✛", colour, bold=True)
            canvas.text(
                *window.cell(*leg.start_enu_m[:2]), str(indices.get(name, "?")), colour, bold=True
            )
        return canvas.strips()
