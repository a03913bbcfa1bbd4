"""The question before arm, take-off, move and formation: paths, least distance and time.

Enter sends, escape drops. The order is planned when the question opens, and computed again as soon
as the fleet has moved. At Enter it is checked against the fleet as it is then, and what passed that
check leaves: only what was shown is sent.
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
from groundstation.orders.intents import Intent
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.preview import OrderPreview, changed, preview_order
from onboard.config.fleet import FleetConfig

CHECK_S = 0.2
# A key that was meant for the order line must not answer the question that opened under it.
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
        self.fleet = fleet
        self.client = client
        self.intent = intent
        self._forecaster = forecaster
        self._short = short

        self.preview: OrderPreview | None = None
        self.forecast: Forecast | None = None
        self.reasons: tuple[str, ...] = ()  # against sending it
        self.is_computing = True
        self._note = ""  # why it was computed again
        self._opened_ns = client.now_ns()
        self._begun_ns = self._opened_ns  # when the computing began

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

    # -- computing and checking --------------------------------------------------------------------

    def _begin(self, note: str = "") -> None:
        """Plan the order for the fleet as it is now, and compute its paths."""
        state = self.client.state
        now_ns = self.client.now_ns()
        self._begun_ns = now_ns
        self._note = note

        self.preview = preview_order(self.client.plan(self.intent), state, now_ns)
        self.intent = self.preview.intent  # from now on with the numbers that were left open
        self.forecast = None
        self.reasons = self.preview.reasons

        self.is_computing = not self.reasons and self.intent.verb != "arm"
        if self.is_computing:
            self.run_worker(self._compute(self.preview), group="forecast", exclusive=True)
        self._show()

    async def _compute(self, preview: OrderPreview) -> None:
        is_takeoff = preview.intent.verb == "takeoff"
        try:
            forecast = await self._forecaster.forecast(
                self.fleet, preview.legs, is_takeoff=is_takeoff
            )
        except ForecastFailed as error:
            self.reasons = (str(error),)
            self.is_computing = False
            self._show()
            return

        if preview is self.preview:
            self.forecast = forecast
            self.is_computing = False
            self.reasons = (*preview.reasons, *objections(forecast, preview.intent, self.fleet))
            self._show()

    def _check(self) -> PlannedOrder | None:
        """Check the shown order against the fleet as it is now.

        Returns:
            What passed the check; None when something has changed and it is computed again.
        """
        if self.preview is None:
            return None

        checked = self.client.check_again(self.preview.planned)
        change = changed(self.preview, checked, self.client.state, self.client.now_ns())
        if change is not None:
            self._begin(f"{change}: computed again")
            return None

        if self.is_computing:
            self._show()  # counts the seconds
        return checked

    def action_send(self) -> None:
        """Send the order that is shown, if it still holds and nothing speaks against it."""
        if self.client.now_ns() - self._opened_ns < SETTLE_S * 1e9:
            return

        checked = self._check()
        if checked is not None and self.is_sendable:
            self.dismiss(checked)

    def action_drop(self) -> None:
        """Send nothing."""
        self.dismiss(None)

    # -- what is shown -----------------------------------------------------------------------------

    def _show(self) -> None:
        preview = self.preview
        if preview is None or not self.is_running:
            return

        self._paths.show(preview, self.forecast)

        lines = [*self._goals(preview), "", *self._figures(), *preview.notes, self._note]
        self._vehicles.update("\n".join(clean(line, 200) for line in lines))

        self._answer.set_class(bool(self.reasons), "bad")
        self._answer.update(self._answer_text())

    def _answer_text(self) -> str:
        if self.reasons:
            lines = [f"✖ {clean(reason, 300)}" for reason in self.reasons[:4]]
            return "\n".join([*lines, "Not sent. esc drops it"])

        if self.is_computing:
            waited_s = (self.client.now_ns() - self._begun_ns) * 1e-9
            text = (
                f"… flying it ahead, {waited_s:.0f} s: enter waits for the paths; "
                "esc drops it, ctrl+l lands all."
            )
            if waited_s > 5.0:
                text += " The first one on a machine takes up to a minute."
            return text

        return "✔ enter sends it    esc drops it"

    def _goals(self, preview: OrderPreview) -> list[str]:
        """Return a line for each vehicle: its number in the fleet file, its name, its goal."""
        indices = {name: index for index, name in enumerate(self.fleet.enabled_names)}

        lines = []
        for name in preview.intent.names[:_MOST_NAMED]:
            line = f"{indices.get(name, '?')} {name}"
            leg = preview.legs.get(name)
            if leg is not None and leg.is_ordered:
                x_m, y_m, z_m = leg.goal_enu_m
                distance_m = math.dist(leg.start_enu_m, leg.goal_enu_m)
                line += f"  → {x_m:.2f} {y_m:.2f} {z_m:.2f} m  ({distance_m:.1f} m away)"
            lines.append(line)

        hidden = len(preview.intent.names) - _MOST_NAMED
        if hidden > 0:
            lines.append(f"and {hidden} more")
        return lines

    def _figures(self) -> list[str]:
        if self.intent.verb == "arm":
            return ["The propellers turn. Keep clear.", self._closest_now()]

        forecast = self.forecast
        if forecast is None:
            return []

        lines = []
        if math.isfinite(forecast.closest_m):
            pair = " and ".join(forecast.pair)
            limit_m = self.fleet.fleet.safety_distance_m
            lines += [
                f"closest: {forecast.closest_m:.2f} m, {pair}, after {forecast.closest_s:.1f} s",
                f"limit:   {limit_m:.2f} m    now: {forecast.now_m:.2f} m",
            ]
        if math.isfinite(forecast.duration_s):
            lines.append(f"takes about {forecast.duration_s:.0f} s")
        return lines

    def _closest_now(self) -> str:
        now = self.client.state.closest(self.client.now_ns())
        if now is None:
            return ""
        return f"closest now: {now.distance_m:.2f} m, {now.first} and {now.second}"
