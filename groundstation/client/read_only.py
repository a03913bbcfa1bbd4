"""A client that only watches: whatever is pressed, nothing leaves this process."""

from __future__ import annotations

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import Ticks
from groundstation.orders.grammar import Intent, OrderError
from groundstation.orders.result import OrderHandle

REFUSAL = "This console only watches (--readonly): no order leaves it. Order from the operator's console."


class Watching:
    """What the console needs of a fleet's client, without the orders, land and kill included."""

    def __init__(self, client: FleetClient) -> None:
        self._client = client

    @property
    def ticks(self) -> Ticks:
        """The pipeline's values of the vehicle whose page is open."""
        return self._client.ticks

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""
        return self._client.state

    def now_ns(self) -> int:
        """The clock that ages are counted on."""
        return self._client.now_ns()

    async def submit(self, order: Intent | str) -> OrderHandle:
        """Refused.

        Raises:
            OrderError: always.
        """
        raise OrderError(REFUSAL)
