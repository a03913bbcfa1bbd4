"""The preview of arm, take-off, move and formation: paths, smallest distance and duration.

Enter sends the order, escape drops it. The order is planned when the preview opens, and its paths
are computed again when the fleet has moved. At Enter the shown order is checked against the present
fleet, and only an order that passes this check is sent.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Static

from groundstation.console.clients import OrderingClient
from groundstation.console.screens.live import Dialog
from groundstation.console.theme import clean
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.path_plan import PathPlan
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.intents import Intent
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.prepared_order import PreparedOrder
from groundstation.orders.preview import OrderPreview
from onboard.config.fleet import FleetConfig

CHECK_S = 0.2  # period at which the shown order is checked
# Time for which keys are ignored after the preview has opened: they were meant for the order line.
SETTLE_S = 0.3
_MAX_NAMED = 8
_MAX_BODY = 16  # largest height of paths and words, in rows
_MIN_BODY = 3
_ANSWER_ROWS = 5  # rows of the answer and of the border around everything


class PreviewScreen(Dialog[PlannedOrder | None]):
    """Dialog whose result is the planned order that passed the check at Enter, or None.

    Args:
        fleet: the fleet file.
        client: client that plans and checks the order.
        intent: order that is previewed.
        forecaster: computes the paths.
        shorten: function that shortens lists of names for the title.
        table: table of the fleet, which stays in sight.
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
        shorten: Callable[[str], str],
        table: FleetTable | None = None,
    ) -> None:
        super().__init__(table)
        self.client = client
        self._shorten = shorten
        self._opened_ns = client.now_ns()
        self.prepared = PreparedOrder(
            fleet,
            client,
            intent,
            forecaster,
            start=self._start_computing,
            on_change=self._show,
        )

        self._paths = PathPlan(fleet)
        self._vehicles = Static(id="vehicles", markup=False)
        self._body = Horizontal(id="preview_body")
        self._answer = Static(id="answer", markup=False)

    def boxes(self) -> ComposeResult:
        """Yield the box with paths and words side by side, and the answer below."""
        with Vertical(id="preview") as box:
            box.border_title = self._shorten(str(self.prepared.intent)).replace("[", "\\[")
            with self._body:
                yield self._paths
                yield self._vehicles
            yield self._answer

    def on_mount(self) -> None:
        """Compute the preview, and check several times a second whether it is still right."""
        self.prepared.begin()
        self.set_interval(CHECK_S, self._check)

    def on_resize(self, event: events.Resize) -> None:
        """Leave room for the answer; Textual also calls the dialog's own ``on_resize``."""
        most_rows = max(_MIN_BODY, self.room_height(event.size.height) - _ANSWER_ROWS)
        self._body.styles.max_height = min(most_rows, _MAX_BODY)
        self._paths.styles.max_height = most_rows

    def _start_computing(self, preview: OrderPreview) -> None:
        self.run_worker(self.prepared.compute(preview), group="forecast", exclusive=True)

    def _check(self) -> PlannedOrder | None:
        """Return the shown order if it passes the check now; None if it is computed again."""
        checked = self.prepared.check()
        if checked is not None and self.prepared.is_computing:
            self._show()  # updates the shown seconds of the computation
        return checked

    def action_send(self) -> None:
        """Send the shown order, if it is still right and there is no reason against it."""
        if self.client.now_ns() - self._opened_ns < SETTLE_S * 1e9:
            return

        checked = self._check()
        if checked is not None and self.prepared.is_sendable:
            self.dismiss(checked)

    def action_drop(self) -> None:
        """Close without sending the order."""
        self.dismiss(None)

    # -- content -----------------------------------------------------------------------------------

    def _show(self) -> None:
        prepared = self.prepared
        preview = prepared.preview
        if preview is None or not self.is_running:
            return

        self._paths.show(preview, prepared.forecast)

        lines = [*self._goals(preview), "", *prepared.figures(), *preview.notes, prepared.note]
        self._vehicles.update("\n".join(clean(line, 200) for line in lines))

        self._answer.set_class(bool(prepared.reasons), "bad")
        self._answer.update(self._answer_text())

    def _answer_text(self) -> str:
        prepared = self.prepared
        if prepared.reasons:
            lines = [f"✖ {clean(reason, 300)}" for reason in prepared.reasons[:4]]
            return "\n".join([*lines, "Not sent. esc drops it"])

        if prepared.is_computing:
            waited_s = (self.client.now_ns() - prepared.begun_ns) * 1e-9
            return (
                f"… flying it ahead, {waited_s:.0f} s: enter waits for the paths; "
                "esc drops it, ctrl+l lands all."
            )

        return "✔ enter sends it    esc drops it"

    def _goals(self, preview: OrderPreview) -> list[str]:
        """Return a line for each vehicle: its label in the picture, its name, its goal."""
        labels = self.prepared.fleet.labels

        lines = []
        for name in preview.intent.names[:_MAX_NAMED]:
            label = labels.get(name, "?")
            line = name if label == name else f"{label} {name}"
            leg = preview.legs.get(name)
            if leg is not None and leg.is_by_this_order:
                x_m, y_m, z_m = leg.goal_enu_m
                distance_m = math.dist(leg.start_enu_m, leg.goal_enu_m)
                line += f"  → {x_m:.2f} {y_m:.2f} {z_m:.2f} m  ({distance_m:.1f} m away)"
            lines.append(line)

        hidden = len(preview.intent.names) - _MAX_NAMED
        if hidden > 0:
            lines.append(f"and {hidden} more")
        return lines
