"""What a console requires of its client.

A client reads a live fleet or a recorded flight. Some clients can also give orders.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from groundstation.fleet.operator_control import Control
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import TickStream
from groundstation.orders.intents import Intent
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import OrderResult


class ConsoleClient(Protocol):
    """The part of :class:`groundstation.client.client.FleetClient` that every console uses.

    A client for records has this part, too.
    """

    @property
    def tick_stream(self) -> TickStream:
        """The values of the pipeline of the vehicle whose page is open."""

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""

    def now_ns(self) -> int:
        """Return the present time of the clock from which ages are computed [ns]."""

    async def submit(self, order: Intent | str) -> OrderResult:
        """Send an order; its results are filled in later."""


@runtime_checkable
class OrderingClient(ConsoleClient, Protocol):
    """A client that can give orders; a record's client and a read-only client cannot."""

    control: Control

    def forget_silent(self, name: str) -> bool:
        """Forget a silent vehicle that the fleet file lacks; return whether there was one."""

    def plan(self, order: Intent | str) -> PlannedOrder:
        """Plan an order and check it; nothing is sent."""

    def check_again(self, planned: PlannedOrder) -> PlannedOrder:
        """Check a planned order against the present fleet."""

    def is_of_mission(self, order_id: str) -> bool:
        """Whether a mission of this ground has given an order."""

    def is_own(self, order_id: str) -> bool:
        """Whether this ground has given an order."""

    def newest_order(self, vehicle: str) -> OrderResult | None:
        """Return the newest order that this ground has given a vehicle."""

    def send(self, planned: PlannedOrder) -> OrderResult:
        """Send a planned order from any thread; its results are filled in later."""

    def submit_now(self, order: Intent | str) -> OrderResult:
        """Send an order from any thread; its results are filled in later."""
