"""Results of an order: one per vehicle, which replies and events of the vehicles fill in."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from groundstation.orders.intents import Intent
from groundstation.orders.plan import PlannedOrder

Phase = Literal[
    "sent",
    "accepted",
    "direct",
    "done",
    "refused",
    "no answer",
    "superseded",
    "failed",
    "timed out",
    "unfinished",
    "cancelled",
]
OPEN_PHASES: tuple[Phase, ...] = ("sent", "accepted", "direct")


@dataclass(frozen=True, slots=True)
class VehicleResult:
    """Progress of an order with one vehicle.

    Phases: sent -> accepted -> done | superseded | failed | timed out; or refused; or no answer.
    ``direct``: the order goes straight to PX4. ``unfinished``: the wait ended before the order.
    ``cancelled``: whoever gave the order has ended the wait, and the order stays in force.
    """

    vehicle: str
    order_id: str
    phase: Phase
    sentence: str  # reason that the agent, PX4 or the ground gives
    is_silent: bool = False  # whether neither the agent nor PX4, on the direct path, has answered
    ended_before: int = 0  # number of vehicles whose order had ended before this one's

    @property
    def is_final(self) -> bool:
        """Whether the phase can no longer change."""
        return self.phase not in OPEN_PHASES

    @property
    def is_done(self) -> bool:
        """Whether the vehicle did what was ordered."""
        return self.phase == "done"

    @property
    def reason(self) -> str:
        """The sentence without the vehicle's name, with which a sentence of the ground begins."""
        return self.sentence.removeprefix(f"{self.vehicle}: ")

    @property
    def words(self) -> str:
        """The vehicle, the phase and the reason."""
        return f"{self.vehicle} {self.phase}: {self.reason}"

    def with_more(self, words: str) -> VehicleResult:
        """Return the same result with more words in its sentence."""
        return replace(self, sentence=f"{self.sentence} {words}".strip())


Results = dict[str, VehicleResult]


class OrderFailed(RuntimeError):
    """At least one vehicle did not do what was ordered; ``results`` says which and why."""

    def __init__(self, intent: Intent, results: Results) -> None:
        self.results = results

        not_done = [result for result in results.values() if not result.is_done]
        # The failure that came first is named first, because it may be the cause of the others.
        not_done.sort(key=lambda result: result.ended_before)
        names_by_reason: dict[tuple[Phase, str], list[str]] = {}
        for result in not_done:
            # Who has only accepted it, and says nothing, is no reason.
            if result.sentence or result.phase != "accepted":
                names_by_reason.setdefault((result.phase, result.reason), []).append(result.vehicle)

        reasons = [
            f"{', '.join(names)} {phase}: {reason}"
            for (phase, reason), names in names_by_reason.items()
        ]
        super().__init__(f"'{intent}' failed. {' '.join(reasons)}")


class OrderResult:
    """Results of one order that has been sent; for the event loop's thread only.

    Args:
        planned: the order as it was sent.
        is_by_mission: whether a mission, not a person, has given it.
    """

    def __init__(self, planned: PlannedOrder, *, is_by_mission: bool = False) -> None:
        self.planned = planned
        self.is_by_mission = is_by_mission
        self.results: Results = {}
        for name in planned.intent.names:
            order = planned.orders.get(name)
            if order is not None:
                result = VehicleResult(name, order.order_id, "sent", "")
            elif planned.orders and name not in planned.refusals:
                # the vehicle that a spare replaces, if it is silent
                result = VehicleResult(name, "", "done", "It is not heard, so it gets no order.")
            else:
                result = VehicleResult(name, "", "refused", planned.refusals.get(name, ""))
            self.results[name] = result

        self._changed = asyncio.Event()
        self._listeners: list[Callable[[VehicleResult], None]] = []

    @property
    def intent(self) -> Intent:
        """The order, with every number filled in."""
        return self.planned.intent

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

    def update(self, vehicle: str, phase: Phase, sentence: str, *, is_silent: bool = False) -> None:
        """Set a vehicle's phase.

        A final phase does not change, except that a late reply of the agent replaces ``no answer``.

        Args:
            vehicle: name of the vehicle.
            phase: the new phase.
            sentence: the reason.
            is_silent: whether neither the agent nor PX4 has answered.
        """
        before = self.results[vehicle]
        if before.is_final and before.phase != "no answer":
            return
        # PX4 has the order already, so an agent that accepts it later changes nothing
        if phase == "accepted" and before.phase == "direct":
            return

        result = VehicleResult(
            vehicle=vehicle,
            order_id=before.order_id,
            phase=phase,
            sentence=sentence,
            is_silent=is_silent or phase == "no answer",
            ended_before=sum(1 for other in self.results.values() if other.is_final),
        )
        self.results[vehicle] = result
        self._changed.set()
        for listener in self._listeners:
            listener(result)

    async def wait(self, timeout_s: float | None = None) -> Results:
        """Wait until every vehicle's order has ended.

        Args:
            timeout_s: longest wait [s]; None waits for ever.

        Returns:
            One result per vehicle. An order that is open at the end of the wait is ``unfinished``.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while not self.is_final:
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            assert timeout_s is not None
            return self.unfinished_after(timeout_s)
        return dict(self.results)

    def unfinished_after(self, timeout_s: float) -> Results:
        """Return the results after a wait: an order that is still open is ``unfinished``.

        Args:
            timeout_s: duration of the wait [s].
        """
        return {
            name: _unfinished(result, f"not finished within {timeout_s:g} s")
            for name, result in self.results.items()
        }

    def cancelled(self) -> Results:
        """Return the results after a cancelled wait: an order still open is ``cancelled``."""
        return {name: _cancelled(result) for name, result in self.results.items()}


def _cancelled(result: VehicleResult) -> VehicleResult:
    """Return the result of an order after the wait for its end was cancelled."""
    if result.is_final:
        return result
    sentence = f"no longer waited for (the order was {result.phase}). {result.sentence}"
    return replace(result, phase="cancelled", sentence=sentence.strip())


def _unfinished(result: VehicleResult, limit: str) -> VehicleResult:
    """Return the result of an order after the wait for its end has timed out."""
    if result.is_final:
        return result
    return VehicleResult(
        vehicle=result.vehicle,
        order_id=result.order_id,
        phase="unfinished",
        sentence=f"{limit} (the order was {result.phase}).",
    )
