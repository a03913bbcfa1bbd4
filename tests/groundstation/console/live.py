"""A simulated fleet behind a real client, as fast as it goes, inside the event loop that the
console runs in.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any

from textual.pilot import Pilot

from groundstation.client.client import FleetClient
from groundstation.console.widgets.event_log import EventLog
from groundstation.orders.forecast import Forecast, Leg, forecast
from groundstation.orders.forecast_process import Forecaster
from onboard.config.fleet import FleetConfig
from sitl.lockstep.simulation import Simulation

_STEPS = 25  # of 4 ms between two looks at the keyboard


class LiveFleet:
    """Emulator, agents and one client; time is the simulation's."""

    def __init__(self, fleet: FleetConfig, *, seed: int = 0) -> None:
        self.simulation = Simulation(fleet, seed=seed)
        self.client = self.ground("ground-1", "tester")
        self._turns = asyncio.Event()
        self._turns.set()

    def ground(self, node: str, author: str, **options: Any) -> FleetClient:
        """One more ground of the fleet."""
        bus = self.simulation.bus.node(node)
        return FleetClient(
            self.simulation.fleet,
            author=author,
            bus=bus,
            clock_ns=lambda: self.simulation.now_ns,
            **options,
        )

    @contextlib.asynccontextmanager
    async def flying(self, *more: FleetClient) -> AsyncIterator[LiveFleet]:
        """Let time run."""
        for client in (self.client, *more):
            await client.start()
        task = asyncio.create_task(self._run())
        try:
            yield self
        finally:
            if task.done():
                task.result()  # the world broke down: its exception is the test's
            task.cancel()
            for client in (self.client, *more):
                await client.stop()

    async def _run(self) -> None:
        while True:
            await self._turns.wait()
            for _ in range(_STEPS):
                self.simulation.step()
            await asyncio.sleep(0.001)

    async def press(self, pilot: Pilot[Any], *keys: str) -> None:
        """Press keys while the world stands still: Textual's pilot waits after each for a processor
        that is idle.
        """
        self._turns.clear()
        await pilot.press(*keys)
        self._turns.set()


class ForecasterHere(Forecaster):
    """Computes in this process: no other process has to get its share of a busy machine."""

    async def start(self) -> None:
        return

    async def forecast(
        self, fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False
    ) -> Forecast:
        await asyncio.sleep(0.01)
        return forecast(fleet, legs, is_takeoff=is_takeoff)


async def until(
    pilot: Pilot[Any], condition: Callable[[], object], timeout_s: float = 60.0
) -> None:
    """Wait, by the wall clock, until something is so."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, (
            f"Not in time. Said so far: {pilot.app.screen_stack[0].query_one(EventLog).sentences}"
        )
        await asyncio.sleep(0.02)
