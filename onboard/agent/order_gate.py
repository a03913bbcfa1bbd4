"""Whether an order of a fleet with keys is new. Pure.

Its signature says who has given it, not when. So an order repeats the stamp of the newest telemetry
that its sender had of this vehicle. That stamp is of this agent's own clock and start, nobody can
know one before its time, and it is signed along: an order that was held back, kept for a later
flight, or sent twice is found out by no other clock.
"""

from __future__ import annotations

from onboard.bus.control_token import EMERGENCY
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import Order
from onboard.flight.order_checks import late_sentence

FRESH_S = 5.0  # longest time from that telemetry to the order's arrival
# the same of land, hold and kill: in need the ground may have heard nothing for a while
FRESH_EMERGENCY_S = 30.0
_MAX_SEEN = 10_000


class OrderGate:
    """Remembers the orders of the last time.

    Args:
        boot_id: number of this start of the agent, as in its telemetry.
    """

    def __init__(self, boot_id: int) -> None:
        self._boot_id = boot_id
        self._seen: dict[str, int] = {}  # order id -> when it came; the oldest first

    def refusal(self, order: Order, now_ns: int) -> UntrustedOrder | None:
        """Judge an order whose signature is right.

        Args:
            order: its deadline is on this agent's clock.
            now_ns: this agent's clock.
        Returns:
            None for a new order; otherwise what is wrong.
        """
        what, own_id = f"Order {order.text}", order.order_id
        if order.heard_boot_id != self._boot_id:
            return UntrustedOrder(
                "other start", f"{what} is not for this start of the agent: send it again.", own_id
            )
        age_s = 1e-9 * (now_ns - order.heard_ns)
        if not 0.0 <= age_s <= (FRESH_EMERGENCY_S if order.kind in EMERGENCY else FRESH_S):
            return UntrustedOrder(
                "late", f"{what} was given {age_s:.1f} s ago: send it again.", own_id
            )
        late = None if order.kind == "kill" else late_sentence(order, now_ns)
        if late is not None:
            return UntrustedOrder("late", late, own_id)
        while self._seen and (
            len(self._seen) >= _MAX_SEEN or self._oldest_s(now_ns) > FRESH_EMERGENCY_S
        ):
            del self._seen[next(iter(self._seen))]
        if order.order_id in self._seen:
            return UntrustedOrder(
                "replayed", f"{what} was received before, and is obeyed once.", own_id
            )
        self._seen[order.order_id] = now_ns
        return None

    def _oldest_s(self, now_ns: int) -> float:
        return 1e-9 * (now_ns - self._seen[next(iter(self._seen))])
