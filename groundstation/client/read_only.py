"""A client that only watches: no order leaves this process."""

from __future__ import annotations

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import TickStream
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Intent
from groundstation.orders.result import OrderResult

REFUSAL = (
    "This console only watches (--readonly): no order leaves it. Order from the operator's console."
)


class ReadOnlyClient:
    """A client for a console that only watches: it refuses every order, even land and kill.

    Args:
        client: fleet client that has been started.
    """

    def __init__(self, client: FleetClient) -> None:
        self._client = client

    @property
    def tick_stream(self) -> TickStream:
        """The ticks of the vehicle whose page is open."""
        return self._client.tick_stream

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""
        return self._client.state

    def now_ns(self) -> int:
        """Return the present time of the clock from which ages are computed [ns]."""
        return self._client.now_ns()

    async def submit(self, order: Intent | str) -> OrderResult:
        """Refuse an order.

        Args:
            order: any order.

        Raises:
            OrderError: always.
        """
        raise OrderError(REFUSAL)
