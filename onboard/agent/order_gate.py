"""Whether an order of a fleet with keys is new. Pure.

The signature of an order says who has given it, not when. So an order repeats the stamp of the
newest telemetry that its sender had of this vehicle. That stamp is of this agent's own clock and
start, nobody can know one before its time, and it is signed with the order. It shows, without any
other clock, that an order was held back, kept for a later flight, or sent twice.

A ground that gets no answer sends its order again, with the same id and a newer stamp of its own,
signed anew. Nobody else can make such a message, and the agent answers it as it did before.
"""

from __future__ import annotations

from onboard.bus.control_token import EMERGENCY
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import Order
from onboard.flight.order_checks import late_sentence

FRESH_S = 5.0  # longest time from that telemetry to the order's arrival

# The same for land, hold and kill: in an emergency the ground may have heard nothing for a while.
FRESH_EMERGENCY_S = 30.0
_MAX_SEEN = 10_000

# An order that is sent again is this much newer by its stamp, which comes over by an estimate of
# the other clock.
_AGAIN_S = 0.1


class OrderGate:
    """Remembers the orders of the last time.

    Args:
        boot_id: number of this start of the agent, as in its telemetry.
    """

    def __init__(self, boot_id: int) -> None:
        self._boot_id = boot_id
        self._seen: dict[str, int] = {}  # order id -> when it came; the oldest first
        self._stamps_ns: dict[str, int] = {}  # order id -> its newest stamp

    def refusal(
        self, order: Order, now_ns: int, *, is_answered: bool = False
    ) -> UntrustedOrder | None:
        """Judge an order whose signature is right.

        Args:
            order: its deadline is on this agent's clock.
            now_ns: this agent's clock.
            is_answered: whether the answer to this order is known, so that it begins nothing: the
                ground may then send it once more, to be answered once more.
        Returns:
            None for a new order; otherwise what is wrong.
        """
        if order.heard_boot_id != self._boot_id:
            sentence = f"Order {order.text} is not for this start of the agent: send it again."
            return UntrustedOrder("other start", sentence, order.order_id)

        age_s = 1e-9 * (now_ns - order.heard_ns)
        limit_s = FRESH_EMERGENCY_S if order.kind in EMERGENCY else FRESH_S
        if not 0.0 <= age_s <= limit_s:
            sentence = f"Order {order.text} was given {age_s:.1f} s ago: send it again."
            return UntrustedOrder("late", sentence, order.order_id)

        if order.kind != "kill":
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
        """Forget what is too old to be sent again, and the oldest when there are too many."""
        while self._seen:
            oldest_id, seen_ns = next(iter(self._seen.items()))
            is_old = 1e-9 * (now_ns - seen_ns) > FRESH_EMERGENCY_S
            if not is_old and len(self._seen) < _MAX_SEEN:
                return
            del self._seen[oldest_id]
            del self._stamps_ns[oldest_id]
