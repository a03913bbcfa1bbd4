"""A console with a client that pretends and an oracle for a forecaster."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from textual.pilot import Pilot

from groundstation.console.app import ConsoleApp
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.widgets.event_log import EventLog
from groundstation.orders.forecast import Forecast, Leg
from groundstation.orders.forecast_process import Forecaster
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.seeing import lines, screen

SLOTS = {"mav0": (-1.5, 0.0, 1.0), "mav1": (0.0, 0.0, 1.0), "mav2": (1.5, 0.0, 1.0)}
FINE = Forecast(closest_m=0.95, pair=("mav0", "mav1"), closest_s=2.0, now_m=1.5, duration_s=7.0)


class Oracle(Forecaster):
    """Answers with the forecast that a test sets; waits while it is None."""

    def __init__(self, answer: Forecast | None = FINE) -> None:
        super().__init__()
        self.answer = answer
        self.requested: list[dict[str, Leg]] = []

    async def start(self) -> None:
        return

    async def forecast(
        self, fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False
    ) -> Forecast:
        self.requested.append(dict(legs))
        while self.answer is None:  # noqa: ASYNC110 - tests set it from outside
            await asyncio.sleep(0.01)
        return self.answer


class StillClient(FakeClient):
    """Its clock moves only when a test says so: typing takes long on a busy machine, and silence
    would set in.
    """

    def now_ns(self) -> int:
        return int(1e12) + self.skew_ns


class Rig:
    """A console with a client that pretends and an oracle."""

    def __init__(self, fleet: FleetConfig, answer: Forecast | None = FINE) -> None:
        self.client = StillClient(fleet)
        self.oracle = Oracle(answer)
        self.app = ConsoleApp(fleet, self.client, forecaster=self.oracle)

    def stand(self, **changes: Any) -> None:
        """Everybody on the ground and ready."""
        self._hear(
            {
                "state": "ready",
                "is_airborne": False,
                "is_armed": False,
                "velocity_enu_m_s": (0.0, 0.0, 0.0),
            },
            0.0,
            changes,
        )

    def hover(self, **changes: Any) -> None:
        """Everybody in the air, in a row."""
        self._hear({"state": "flying", "velocity_enu_m_s": (0.0, 0.0, 0.0)}, 1.0, changes)

    def _hear(self, base: dict[str, Any], height_m: float, changes: dict[str, Any]) -> None:
        for name, (x, y, _) in SLOTS.items():
            position = (x, y, height_m)
            self.client.hear(
                name,
                **{**base, "position_enu_m": position, "goal_position_enu_m": position, **changes},
            )

    def line(self, kind: type) -> str:
        return "\n".join(lines(self.app, kind))

    @property
    def screen_text(self) -> str:
        """What the terminal shows."""
        return "\n".join(screen(self.app))

    @property
    def said(self) -> str:
        return "\n".join(self.app.screen_stack[0].query_one(EventLog).sentences)

    async def write(self, pilot: Pilot[int], order: str) -> None:
        """Write an order and press Enter."""
        await pilot.press("colon")
        self.app.panels.order_line.value = order
        await pilot.press("enter")

    async def preview(self, pilot: Pilot[int], order: str) -> PreviewScreen:
        """Write an order, and wait until its question is there and answered by the oracle."""
        await self.write(pilot, order)
        await pilot.pause(0.02)
        front = self.app.screen
        assert isinstance(front, PreviewScreen), self.said
        self.client.skew_ns += int(0.4e9)  # a person reads
        return front
