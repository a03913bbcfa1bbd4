"""An order under way: one result per vehicle, and somebody who waits for them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from groundstation.orders.grammar import Intent, Plan

Phase = Literal[
    "sent", "accepted", "direct", "done", "refused", "no answer", "superseded", "failed", "timed out", "unfinished"
]
OPEN_PHASES: tuple[Phase, ...] = ("sent", "accepted", "direct")


@dataclass(frozen=True, slots=True)
class VehicleResult:
    """How far an order is with one vehicle, and a sentence why.

    sent -> accepted -> done | superseded | failed | timed out; or refused; or no answer; ``direct``: on the second way,
    straight to PX4; ``unfinished``: the waiting ended before the order did.
    """

    vehicle: str
    order_id: str
    phase: Phase
    sentence: str

    @property
    def is_final(self) -> bool:
        """Whether nothing more will come."""
        return self.phase not in OPEN_PHASES

    @property
    def is_done(self) -> bool:
        """Whether the vehicle did what was ordered."""
        return self.phase == "done"


class OrderHandle:
    """Results of one order, filled in as answers and events come; for the event loop's thread only."""

    def __init__(self, intent: Intent, plan: Plan) -> None:
        self.intent = intent
        self.plan = plan
        self.results: dict[str, VehicleResult] = {
            name: VehicleResult(name, plan.orders[name].order_id, "sent", "")
            if name in plan.orders
            else VehicleResult(name, "", "refused", plan.refusals.get(name, ""))
            for name in intent.vehicles
        }
        self._changed = asyncio.Event()
        self._listeners: list[Callable[[VehicleResult], None]] = []

    @property
    def is_final(self) -> bool:
        """Whether every vehicle's order has ended."""
        return all(result.is_final for result in self.results.values())

    @property
    def is_done(self) -> bool:
        """Whether every vehicle did what was ordered."""
        return all(result.is_done for result in self.results.values())

    def add_listener(self, listener: Callable[[VehicleResult], None]) -> None:
        """Call ``listener(result)`` on every change from now on."""
        self._listeners.append(listener)

    def update(self, vehicle: str, phase: Phase, sentence: str) -> None:
        """Take over news; an end stays, except that a late answer of the agent replaces ``no answer``."""
        old = self.results[vehicle]
        if old.is_final and old.phase != "no answer":
            return
        if phase == "accepted" and old.phase == "direct":
            return
        result = VehicleResult(vehicle, old.order_id, phase, sentence)
        self.results[vehicle] = result
        self._changed.set()
        for listener in self._listeners:
            listener(result)

    async def wait(self, timeout_s: float | None = None) -> dict[str, VehicleResult]:
        """Until every vehicle's order has ended, or ``timeout_s``; what is still open then counts as unfinished."""
        try:
            async with asyncio.timeout(timeout_s):
                while not self.is_final:
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            limit = f"not finished within {timeout_s:g} s"
            return {
                name: result
                if result.is_final
                else VehicleResult(name, result.order_id, "unfinished", f"{name}: {limit} ({result.phase}).")
                for name, result in self.results.items()
            }
        return dict(self.results)
