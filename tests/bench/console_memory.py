"""Half an hour of the console in fast motion: does its memory grow? Run by ``make bench-console``.

The real app without a terminal, a client whose clock the run turns: telemetry of every vehicle ten
times a simulated second, an event and an alarm that comes and goes now and then.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import sys
import tracemalloc
from collections import deque

import msgspec

from groundstation.console.app import ConsoleApp
from groundstation.fleet import state as fleet_state
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import KEPT
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Intent
from groundstation.orders.result import OrderResult
from onboard.bus.schema import Event, TickSample
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from tests.bench.fixture import fleet_data
from tests.bench.process_usage import usage
from tests.bench.telemetry_source import telemetry

SIZE = (180, 50)
STEP_NS = 100_000_000
SPACING_M = 3.0
SETTLED_SHARE = 1.0 / 6.0  # of the time, until everything that is bounded is full


class NoTicks:
    """Nobody's pipeline values."""

    def __init__(self) -> None:
        self.values: deque[TickSample] = deque(maxlen=KEPT)

    def follow(self, vehicle: str | None) -> None:
        """Nothing comes."""


class FastClient:
    """Follows a made-up fleet on a clock of its own."""

    def __init__(self, fleet: FleetConfig) -> None:
        self.fleet = fleet
        self.state: FleetState = fleet_state.initial(fleet)
        self.tick_stream = NoTicks()
        self._now_ns = STEP_NS
        self._step = 0

    def now_ns(self) -> int:
        """The turned clock."""
        return self._now_ns

    async def submit(self, order: Intent | str) -> OrderResult:
        """Nothing flies here.

        Raises:
            OrderError: always.
        """
        raise OrderError("Nothing flies here.")

    def step(self) -> None:
        """A tenth of a second on."""
        self._now_ns += STEP_NS
        self._step += 1
        heard = []
        for place, name in enumerate(self.fleet.enabled_names):
            start = self.fleet.vehicles[name].start_enu_m
            told = telemetry(name, place, start, self._now_ns * 1e-9, self._step)
            if place == 0 and self._step // 100 % 2:
                told = msgspec.structs.replace(told, conditions=("loop late",))
            heard.append((told, self._now_ns))
        state = fleet_state.fold_telemetry(self.state, heard)
        if self._step % 5 == 0:
            name = self.fleet.enabled_names[self._step % len(self.fleet.enabled_names)]
            event = Event(
                vehicle=name,
                stamp_ns=self._now_ns,
                severity="info",
                code="order-move",
                sentence=f"At place {self._step}.",
                order_id=str(self._step),
                order_outcome="done",
            )
            state = fleet_state.fold(state, event, self._now_ns)
        self.state = state


async def run(vehicles: int, minutes: float) -> dict[str, float]:
    """Memory in MiB, as the kernel and as Python count it, when settled and at the end."""
    client = FastClient(fleet_from_mapping(dict(fleet_data(vehicles, SPACING_M, "bench"))))
    app = ConsoleApp(client.fleet, client)
    steps = max(12, int(minutes * 600))
    found: dict[str, float] = {}
    async with app.run_test(size=SIZE) as pilot:
        for step in range(steps):
            client.step()
            app.refresh_fleet()
            await asyncio.sleep(0)
            if step % 3000 == 1500:
                await pilot.press("enter", "escape", "A", "escape", "question_mark", "escape")
            if step == int(steps * SETTLED_SHARE):
                await pilot.pause(0.2)
                found |= _memory("settled")
        await pilot.pause(0.2)
        found |= _memory("end")
    return {
        **found,
        "growth_mib": found["end_own_mib"] - found["settled_own_mib"],
        "steps": float(steps),
    }


def _memory(moment: str) -> dict[str, float]:
    gc.collect()
    used = usage(os.getpid())
    own_mib = used.own_mib if used is not None else float("nan")
    found = {f"{moment}_own_mib": own_mib}
    if tracemalloc.is_tracing():
        found[f"{moment}_python_mib"] = tracemalloc.get_traced_memory()[0] / (1 << 20)
    return found


def main(argv: list[str]) -> int:
    """``python -m tests.bench.console_memory VEHICLES MINUTES``: one line of JSON."""
    print(json.dumps(asyncio.run(run(int(argv[0]), float(argv[1])))))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
