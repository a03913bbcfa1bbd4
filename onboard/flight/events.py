"""What a flight tells: events for people and programs, and how the order in progress ends."""

from __future__ import annotations

from dataclasses import dataclass, field

from onboard.bus.schema import Event, Order, OrderOutcome, Severity
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.events import Command, Publish
from onboard.flight.types import FlightView


@dataclass(slots=True)
class Telling:
    """Commands and events collect in ``out``; ``order`` is in progress."""

    fleet: FleetConfig
    vehicle: Vehicle
    order: Order | None = None
    out: list[Command] = field(default_factory=list)

    def finish(self, view: FlightView, outcome: OrderOutcome, sentence: str) -> None:
        """End the order in progress, if there is one."""
        order, self.order = self.order, None
        if order is not None:
            severity: Severity = "info" if outcome in ("done", "superseded") else "warning"
            self.say(view, severity, f"order-{order.kind}", sentence, order.order_id, outcome)

    def say(
        self,
        view: FlightView,
        severity: Severity,
        code: str,
        sentence: str,
        order_id: str = "",
        outcome: OrderOutcome | None = None,
    ) -> None:
        """An event for people and programs."""
        event = Event(
            vehicle=self.vehicle.name,
            stamp_ns=view.now_ns,
            severity=severity,
            code=code,
            sentence=sentence,
            order_id=order_id,
            order_outcome=outcome or "",
        )
        self.out.append(Publish(Topic.EVENT, event))
