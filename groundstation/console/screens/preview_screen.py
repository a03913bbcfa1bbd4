"""The question before arm, take-off, move and formation: paths, least distance and time. Enter
sends, escape drops.

The preview is computed again as soon as the fleet has moved, and only what was shown is sent: the
order is planned when the question opens, checked against the fleet as it is at Enter, and what
passed that check leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Static

from groundstation.console.clients import OrderingClient
from groundstation.console.screens.live import Dialog
from groundstation.console.theme import clean
from groundstation.console.widgets.path_plan import PathPlan
from groundstation.orders.forecast import Forecast, objections
from groundstation.orders.forecast_process import Forecaster, ForecastFailed
from groundstation.orders.grammar import Intent
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.preview import OrderPreview, changed, preview_order
from onboard.config.fleet import FleetConfig

CHECK_S = 0.2
# a key that was meant for the order line must not answer the question that opened under it
SETTLE_S = 0.3
_MOST_NAMED = 8


class PreviewScreen(Dialog[PlannedOrder | None]):
    """Closes with the planned order that passed the check at Enter, or with nothing.

    Args:
        forecaster: computes the paths.
        short: shortens lists of names for the title.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("enter", "send", "send", show=False),
        Binding("escape,q,n", "drop", "drop", show=False),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        client: OrderingClient,
        intent: Intent,
        forecaster: Forecaster,
        short: Callable[[str], str],
    ) -> None:
        super().__init__()
        self.fleet, self.client, self.intent = fleet, client, intent
        self._forecaster, self._short = forecaster, short
        self.preview: OrderPreview | None = None
        self.forecast: Forecast | None = None
        self.reasons: tuple[str, ...] = ()
        self.is_computing = True
        self._note = ""  # why it was computed again
        self._opened_ns = self._begun_ns = client.now_ns()
        self._paths = PathPlan(fleet)
        self._vehicles = Static(id="vehicles", markup=False)
        self._answer = Static(id="answer", markup=False)

    def compose(self) -> ComposeResult:
        """Paths beside words, the answer below."""
        with Vertical(id="preview") as box:
            box.border_title = self._short(str(self.intent)).replace("[", "\\[")
            with Horizontal(id="preview_body"):
                yield self._paths
                yield self._vehicles
            yield self._answer
        yield from super().compose()

    def on_mount(self) -> None:
        """Compute the preview, and go on checking whether it still holds."""
        self._begin()
        self.set_interval(CHECK_S, self._check)

    @property
    def is_sendable(self) -> bool:
        """Whether Enter would send it now."""
        return not self.is_computing and not self.reasons and self.preview is not None

    def _begin(self, note: str = "") -> None:
        state, now_ns = self.client.state, self.client.now_ns()
        self._begun_ns = now_ns
        self.preview = preview_order(self.client.plan(self.intent), state, now_ns)
        self.intent = self.preview.intent  # from now on with the numbers that were left open
        self.forecast, self.reasons, self.is_computing, self._note = (
            None,
            self.preview.reasons,
            True,
            note,
        )
        if self.reasons or self.intent.verb == "arm":
            self.is_computing = False
        else:
            self.run_worker(self._compute(self.preview), group="forecast", exclusive=True)
        self._show()

    async def _compute(self, preview: OrderPreview) -> None:
        try:
            is_takeoff = preview.intent.verb == "takeoff"
            forecast = await self._forecaster.forecast(
                self.fleet, preview.legs, is_takeoff=is_takeoff
            )
        except ForecastFailed as error:
            self.reasons, self.is_computing = (str(error),), False
            self._show()
            return
        if preview is self.preview:
            self.forecast, self.is_computing = forecast, False
            self.reasons = (*preview.reasons, *objections(forecast, preview.intent, self.fleet))
            self._show()

    def _check(self) -> PlannedOrder | None:
        """Check the shown order against the fleet as it is now; compute again when something has
        changed.
        """
        if self.preview is None:
            return None
        checked = self.client.check_again(self.preview.planned)
        change = changed(self.preview, checked, self.client.state, self.client.now_ns())
        if change is None:
            if self.is_computing:
                self._show()  # counts the seconds
            return checked
        self._begin(f"{change}: computed again")
        return None

    def action_send(self) -> None:
        """Send the order that is shown, if it still holds and nothing speaks against it."""
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
        lines = [
            clean(line, 200)
            for line in (*self._goals(preview), "", *self._figures(), *preview.notes, self._note)
        ]
        self._vehicles.update("\n".join(lines))
        box = self._answer
        box.set_class(bool(self.reasons), "bad")
        if self.reasons:
            text = (
                "\n".join(f"✖ {clean(reason, 300)}" for reason in self.reasons[:4])
                + "\nNot sent. esc drops it"
            )
        elif self.is_computing:
            waited_s = (self.client.now_ns() - self._begun_ns) * 1e-9
            text = f"… flying it ahead, {waited_s:.0f} s: enter waits for the paths; esc drops it, ctrl+l lands all."
            if waited_s > 5.0:
                text += " The first one on a machine takes up to a minute."
        else:
            text = "✔ enter sends it    esc drops it"
        box.update(text)

    def _goals(self, preview: OrderPreview) -> list[str]:
        indices = {name: index for index, name in enumerate(self.fleet.enabled_names)}
        lines = []
        for name in preview.intent.vehicles[:_MOST_NAMED]:
            leg = preview.legs.get(name)
            line = f"{indices.get(name, '?')} {name}"
            if leg is not None and leg.is_ordered:
                x, y, z = leg.goal_enu_m
                line += f"  → {x:.2f} {y:.2f} {z:.2f} m  ({math.dist(leg.start_enu_m, leg.goal_enu_m):.1f} m away)"
            lines.append(line)
        hidden = len(preview.intent.vehicles) - _MOST_NAMED
        return [*lines, f"and {hidden} more"] if hidden > 0 else lines

    def _figures(self) -> list[str]:
        limit_m, forecast = self.fleet.fleet.safety_distance_m, self.forecast
        if self.intent.verb == "arm":
            now = self.client.state.closest(self.client.now_ns())
            near = (
                ""
                if now is None
                else f"closest now: {now.distance_m:.2f} m, {now.first} and {now.second}"
            )
            return ["The propellers turn. Keep clear.", near]
        if forecast is None:
            return []
        lines = []
        if math.isfinite(forecast.closest_m):
            lines.append(
                f"closest: {forecast.closest_m:.2f} m, {' and '.join(forecast.pair)}, after {forecast.closest_s:.1f} s"
            )
            lines.append(f"limit:   {limit_m:.2f} m    now: {forecast.now_m:.2f} m")
        if math.isfinite(forecast.duration_s):
            lines.append(f"takes about {forecast.duration_s:.0f} s")
        return lines
