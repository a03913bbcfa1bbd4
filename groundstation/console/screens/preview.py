"""The question before arm, take-off, move and formation: who, where to, how close, how long. Enter sends, escape drops.

What is shown is computed again as soon as the fleet is not any more where it was, and only what was shown is sent.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.strip import Strip
from textual.widget import Widget
from textual.widgets import Static

from groundstation.console import theme
from groundstation.console.canvas import Canvas
from groundstation.console.plan_drawing import Window
from groundstation.console.screens.live import Dialog
from groundstation.console.theme import FAINT, clean
from groundstation.fleet.state import FleetState
from groundstation.orders.forecast import Forecast, objections
from groundstation.orders.forecast_process import Forecaster, ForecastFailed
from groundstation.orders.grammar import Intent
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.preview import OrderPreview, changed, preview_order
from onboard.config.fleet import FleetConfig

CHECK_S = 0.2
SETTLE_S = 0.3  # a key that was meant for the order line must not answer the question that opened under it
_MOST_NAMED = 8
_ROUND_M = 0.7


class Planner(Protocol):
    """What the dialog needs of the client."""

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""

    def now_ns(self) -> int:
        """The clock that ages are counted on."""

    def plan(self, order: Intent | str) -> PlannedOrder:
        """Plan an order and check it; nothing is sent."""

    def check_again(self, planned: PlannedOrder) -> PlannedOrder:
        """Check a planned order against the fleet as it is now."""


class PathPlan(Widget):
    """The predicted ways from above: a number where each begins, a cross where it ends."""

    def __init__(self, fleet: FleetConfig) -> None:
        super().__init__(id="paths")
        self.fleet = fleet
        self._preview: OrderPreview | None = None
        self._forecast: Forecast | None = None
        self._lines: list[Strip] = []

    def show(self, preview: OrderPreview | None, forecast: Forecast | None) -> None:
        """Draw these."""
        self._preview, self._forecast, self._lines = preview, forecast, []
        self.refresh()

    def on_resize(self) -> None:
        """Draw anew."""
        self._lines = []

    def render_line(self, y: int) -> Strip:
        """One line of the picture."""
        if not self._lines:
            self._lines = self._draw(self.size.width, self.size.height).strips()
        line = self._lines[y] if y < len(self._lines) else Strip.blank(self.size.width)
        return line.apply_style(self.rich_style)

    def _draw(self, width: int, height: int) -> Canvas:
        canvas = Canvas(width, height)
        preview = self._preview
        if preview is None or not preview.legs:
            return canvas
        ways = {name: np.array([leg.start_enu_m, leg.goal_enu_m])[:, :2] for name, leg in preview.legs.items()}
        if self._forecast is not None and self._forecast.paths_enu_m:
            ways = {name: np.array(path)[:, :2] for name, path in self._forecast.paths_enu_m.items()}
        ends = np.concatenate([*ways.values(), *(np.array([leg.goal_enu_m])[:, :2] for leg in preview.legs.values())])
        low, high = ends.min(axis=0) - _ROUND_M, ends.max(axis=0) + _ROUND_M
        scale = float(min(2 * width / (high[0] - low[0]), 4 * height / (high[1] - low[1])))
        middle = (low + high) / 2.0
        window = Window(float(middle[0]), float(middle[1]), scale, canvas.width, canvas.height)
        places = {name: place for place, name in enumerate(self.fleet.enabled_names)}
        radius = self.fleet.fleet.safety_distance_m / 2.0 * scale
        for name, way in ways.items():
            leg, colour = preview.legs[name], theme.vehicle_colour(places.get(name, 0))
            dots = window.dots(way)
            for start, end in itertools.pairwise(dots):
                canvas.line((start[0], start[1]), (end[0], end[1]), colour if leg.is_ordered else FAINT)
            goal = window.dots(np.array([leg.goal_enu_m])[:, :2])
            canvas.circles(goal, radius, colour if leg.is_ordered else FAINT, gap=2)
        for name, leg in preview.legs.items():
            colour = theme.vehicle_colour(places.get(name, 0))
            if leg.is_ordered:
                canvas.text(*window.cell(*leg.goal_enu_m[:2]), "✛", colour, bold=True)
            canvas.text(*window.cell(*leg.start_enu_m[:2]), str(places.get(name, "?")), colour, bold=True)
        return canvas


class PreviewScreen(Dialog[PlannedOrder | None]):
    """Closes with the planned order that passed the check at Enter, or with nothing.

    Args:
        forecaster: computes the paths; without one only what is known at once is checked.
        short: shortens lists of names for the title.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "send", "send", show=False),
        Binding("escape,q,n", "drop", "drop", show=False),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        client: Planner,
        intent: Intent,
        forecaster: Forecaster | None,
        short: Callable[[str], str],
    ) -> None:
        super().__init__()
        self.fleet, self.client, self.intent = fleet, client, intent
        self._forecaster, self._short = forecaster, short
        self.preview: OrderPreview | None = None
        self.forecast: Forecast | None = None
        self.reasons: tuple[str, ...] = ()
        self.is_computing = True
        self._why = ""
        self._opened_ns = client.now_ns()
        self._paths = PathPlan(fleet)
        self._words = Static(id="who", markup=False)
        self._answer = Static(id="answer", markup=False)

    def compose(self) -> ComposeResult:
        """Paths beside words, the answer below."""
        with Vertical(id="preview") as box:
            box.border_title = self._short(str(self.intent)).replace("[", "\\[")
            with Horizontal(id="preview_body"):
                yield self._paths
                yield self._words
            yield self._answer
        yield from super().compose()

    def on_mount(self) -> None:
        """Look, compute, and go on looking whether it is still true."""
        self._begin("")
        self.set_interval(CHECK_S, self._check)

    @property
    def is_sendable(self) -> bool:
        """Whether Enter would send it now."""
        return not self.is_computing and not self.reasons and self.preview is not None

    def _begin(self, why: str) -> None:
        state, now_ns = self.client.state, self.client.now_ns()
        self.preview = preview_order(self.client.plan(self.intent), state, now_ns)
        self.intent = self.preview.intent  # from now on with the numbers that were left open
        self.forecast, self.reasons, self.is_computing, self._why = None, self.preview.reasons, True, why
        if self.reasons or self.intent.verb == "arm" or self._forecaster is None:
            self.is_computing = False
        else:
            self.run_worker(self._compute(self._forecaster, self.preview), group="forecast", exclusive=True)
        self._show()

    async def _compute(self, forecaster: Forecaster, preview: OrderPreview) -> None:
        try:
            found = await forecaster.forecast(self.fleet, preview.legs, is_takeoff=preview.intent.verb == "takeoff")
        except ForecastFailed as error:
            self.reasons, self.is_computing = (str(error),), False
            self._show()
            return
        if preview is self.preview:
            self.forecast, self.is_computing = found, False
            self.reasons = (*preview.reasons, *objections(found, preview.intent, self.fleet))
            self._show()

    def _check(self) -> PlannedOrder | None:
        """Check the shown order against the fleet as it is now; compute again when something has changed."""
        if self.preview is None:
            return None
        checked = self.client.check_again(self.preview.planned)
        why = changed(self.preview, checked, self.client.state, self.client.now_ns())
        if why is None:
            return checked
        self._begin(f"{why}: computed again")
        return None

    def action_send(self) -> None:
        """Send what is shown, if it is still true and nothing speaks against it."""
        is_early = self.client.now_ns() - self._opened_ns < SETTLE_S * 1e9
        checked = None if is_early else self._check()
        if checked is not None and self.is_sendable:
            self.dismiss(checked)

    def action_drop(self) -> None:
        """Send nothing."""
        self.dismiss(None)

    def _show(self) -> None:
        preview = self.preview
        if preview is None or not self.is_running:
            return
        self._paths.show(preview, self.forecast)
        lines = [clean(line, 200) for line in (*self._who(preview), "", *self._figures(), *preview.notes, self._why)]
        self._words.update("\n".join(lines))
        box = self._answer
        box.set_class(bool(self.reasons), "bad")
        if self.reasons:
            text = "\n".join(f"✖ {clean(reason, 300)}" for reason in self.reasons[:4]) + "\nNot sent. esc drops it"
        elif self.is_computing:
            text = "… flying it ahead; esc drops it, ctrl+l lands all"
        else:
            text = "✔ enter sends it    esc drops it"
        box.update(text)

    def _who(self, preview: OrderPreview) -> list[str]:
        places = {name: place for place, name in enumerate(self.fleet.enabled_names)}
        lines = []
        for name in preview.intent.vehicles[:_MOST_NAMED]:
            leg = preview.legs.get(name)
            line = f"{places.get(name, '?')} {name}"
            if leg is not None and leg.is_ordered:
                x, y, z = leg.goal_enu_m
                line += f"  → {x:.2f} {y:.2f} {z:.2f} m  ({math.dist(leg.start_enu_m, leg.goal_enu_m):.1f} m away)"
            lines.append(line)
        hidden = len(preview.intent.vehicles) - _MOST_NAMED
        return [*lines, f"and {hidden} more"] if hidden > 0 else lines

    def _figures(self) -> list[str]:
        limit_m, found = self.fleet.fleet.safety_distance_m, self.forecast
        if self.intent.verb == "arm":
            pair = self.client.state.closest(self.client.now_ns())
            near = "" if pair is None else f"closest now: {pair.distance_m:.2f} m, {pair.first} and {pair.second}"
            return ["The propellers turn. Keep clear.", near]
        if found is None:
            return []
        lines = []
        if math.isfinite(found.closest_m):
            lines.append(f"closest: {found.closest_m:.2f} m, {' and '.join(found.pair)}, after {found.closest_s:.1f} s")
            lines.append(f"limit:   {limit_m:.2f} m    now: {found.now_m:.2f} m")
        if math.isfinite(found.duration_s):
            lines.append(f"takes about {found.duration_s:.0f} s")
        return lines
