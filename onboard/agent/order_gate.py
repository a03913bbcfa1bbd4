"""Checks whether a signed order is new, in a fleet with keys. Pure.

The signature of an order shows who gave the order, but not when. So an order repeats the stamp of
the newest telemetry that its sender had received from this vehicle. This stamp cannot be known in
advance, and it is signed with the order. The stamp is a time of this agent's own clock, so the
agent can tell whether an order was delayed, kept for a later flight, or sent twice.

A ground that gets no reply sends its order again, with the same id, a newer stamp of its own, and a
new signature. Nobody else can make such a message, so the agent replies to it as before.
"""

from __future__ import annotations

from onboard.bus.control_token import EMERGENCY
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import Order
from onboard.flight.order_checks import late_sentence

FRESH_S = 5.0  # longest time from the repeated stamp to the order's arrival

# the same for land, hold and kill, because in an emergency the ground's newest telemetry may be old
FRESH_EMERGENCY_S = 30.0
_MAX_SEEN = 10_000  # number of orders that are remembered

# A repeated order has a stamp that is newer by at least this. The margin covers the error in
# converting the sender's clock.
_AGAIN_S = 0.1


class OrderGate:
    """Remembers the recent orders of one vehicle.

    Args:
        boot_id: number of this start of the agent, as in its telemetry.
    """

    def __init__(self, boot_id: int) -> None:
        self._boot_id = boot_id
        self._seen: dict[str, int] = {}  # order id -> time of its arrival; the oldest first
        self._stamps_ns: dict[str, int] = {}  # order id -> newest stamp of the order itself

    def refusal(
        self, order: Order, now_ns: int, *, is_answered: bool = False
    ) -> UntrustedOrder | None:
        """Return why an order with a correct signature is refused, or None if it is accepted.

        Args:
            order: the order, with its deadline on this agent's clock.
            now_ns: this agent's clock.
            is_answered: whether this order already has a reply. Then the order may be sent again:
                it gets the same reply, and is not executed again.
        """
        if order.heard_boot_id != self._boot_id:
            sentence = f"Order {order.text} is not for this start of the agent: send it again."
            return UntrustedOrder("other start", sentence, order.order_id)

        age_s = 1e-9 * (now_ns - order.heard_ns)  # since the repeated stamp
        limit_s = FRESH_EMERGENCY_S if order.kind in EMERGENCY else FRESH_S
        if not 0.0 <= age_s <= limit_s:
            sentence = f"Order {order.text} was given {age_s:.1f} s ago: send it again."
            return UntrustedOrder("late", sentence, order.order_id)

        if order.kind != "kill":  # a kill is obeyed also after its deadline
            late = late_sentence(order, now_ns)
            if late is not None:
                return UntrustedOrder("late", late, order.order_id)

        self._forget_old(now_ns)
        if order.order_id in self._seen:
            newer_s = 1e-9 * (order.stamp_ns - self._stamps_ns[order.order_id])
            if is_answered and newer_s >= _AGAIN_S:
                self._stamps_ns[order.order_id] = order.stamp_ns
                return None

            sentence = f"Order {order.text} was received before, and is obeyed once."
            return UntrustedOrder("replayed", sentence, order.order_id)

        self._seen[order.order_id] = now_ns
        self._stamps_ns[order.order_id] = order.stamp_ns
        return None

    def _forget_old(self, now_ns: int) -> None:
        """Forget orders that are too old to be accepted again, and the oldest if there are many."""
        while self._seen:
            oldest_id, seen_ns = next(iter(self._seen.items()))
            is_old = 1e-9 * (now_ns - seen_ns) > FRESH_EMERGENCY_S
            if not is_old and len(self._seen) < _MAX_SEEN:
                return
            del self._seen[oldest_id]
            del self._stamps_ns[oldest_id]
