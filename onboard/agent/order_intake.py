"""Orders as they arrive: each is answered once, refused with a reason or begun, and compared with
the others' goals.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

from onboard.agent.order_gate import OrderGate
from onboard.bus.control_token import ControlTokens
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import LOCATE, Order, OrderReply, Telemetry
from onboard.flight import order_checks, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.order_checks import OrderFacts
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Action
from onboard.supervision.failsafe_supervisor import FailsafeSupervisor

_MOST_REPLIES = 200
# until then all vehicles of the same order have announced their goals
_CONFLICT_CHECK_NS = 600_000_000
_CONFLICT_STAYS_NS = 1_000_000_000  # on a channel that is full the announcements come later
_TELL_AGAIN_NS = 1_000_000_000  # after an event about a refused order, one of the same kind
_ALLOWED_WHILE_STOPPING = ("kill", "land", "disarm")


class OrderIntake:
    """Takes the orders of one vehicle.

    Args:
        flight, failsafes, roles: of the vehicle.
        gate: of a fleet with keys; None without.
    """

    def __init__(
        self,
        flight: FlightContext,
        failsafes: FailsafeSupervisor,
        roles: ControlTokens,
        gate: OrderGate | None = None,
    ) -> None:
        # orders that were not believed, or not the operator's
        self.refused: Counter[str] = Counter()
        self._flight, self._failsafes, self._roles, self._gate = flight, failsafes, roles, gate
        self._told_ns: dict[str, int] = {}  # kind of refusal -> its last event
        self._replies: dict[str, OrderReply] = {}
        self._conflict_check_ns = 0

    def take(self, order: Order, facts: OrderFacts, *, is_stopping: bool) -> OrderReply:
        """Begin an order or refuse it; one that was sent twice gets the same reply and begins once."""
        untrusted = None if self._gate is None else self._gate.refusal(order, facts.view.now_ns)
        if untrusted is not None:
            return self.refuse(untrusted, facts.view)
        known = self._replies.get(order.order_id)
        if known is not None:
            return known
        reason = self._refusal(order, facts, is_stopping=is_stopping)
        reply = OrderReply(
            order_id=order.order_id,
            vehicle=self._flight.vehicle.name,
            is_accepted=reason is None,
            reason=reason or "",
        )
        self._replies[order.order_id] = reply
        if len(self._replies) > _MOST_REPLIES:
            self._replies.pop(next(iter(self._replies)))
        # for the record of whoever records: only its sender sees the reply
        if order.kind != "load_path":
            answer = "accepted." if reason is None else f"refused: {reason}"
            self._flight.say(
                facts.view, "debug", "order", f"{order.order_id[:60]} {order.text} {answer}"
            )
        if reason is None:
            self._begin(order, facts.view)
        return reply

    def refuse(self, order: UntrustedOrder, view: FlightView) -> OrderReply:
        """Answer an order that is not believed, count it, and tell the ground of it, at most once a
        second.
        """
        self.refused[order.code] += 1
        told_ns = self._told_ns.get(order.code)
        if told_ns is None or view.now_ns - told_ns >= _TELL_AGAIN_NS:
            self._told_ns[order.code] = view.now_ns
            self._flight.say(view, "warning", "order-refused", order.sentence)
        vehicle = self._flight.vehicle.name
        return OrderReply(
            order_id=order.order_id, vehicle=vehicle, is_accepted=False, reason=order.sentence
        )

    def _refusal(self, order: Order, facts: OrderFacts, *, is_stopping: bool) -> str | None:
        reason = self._roles.refusal(order)
        if reason is not None:
            self.refused["operator"] += 1
        reason = reason or order_checks.refusal(order, self._flight, facts)
        if reason is None and order.kind in ("move", "follow_path"):
            reason = self._failsafes.move_refusal()
        if reason is None and is_stopping and order.kind not in _ALLOWED_WHILE_STOPPING:
            return "This agent has been asked to stop: start it again."
        return reason

    def _begin(self, order: Order, view: FlightView) -> None:
        if order.kind in LOCATE:
            state_machine.locate(self._flight, view, order)
            return
        if order.kind == "load_path":
            state_machine.load_path(self._flight, view, order)
            return
        self._failsafes.begin_order()
        state_machine.begin_order(self._flight, view, order)
        if order.kind == "move":
            self._conflict_check_ns = view.now_ns + _CONFLICT_CHECK_NS

    def check_conflict(
        self, view: FlightView, telemetries: Callable[[], Mapping[str, Telemetry]]
    ) -> None:
        """Give up a move whose goal is too near to another's: some time after its begin, if that
        does not change.

        At its begin two vehicles that swap would look like a conflict.
        """
        flight = self._flight
        if not self._conflict_check_ns or view.now_ns < self._conflict_check_ns:
            return
        sentence = None
        if flight.step is FlightStep.LEG and flight.order is not None:
            sentence = order_checks.goal_conflict(
                flight.goal_position_enu_m, telemetries(), flight.fleet.fleet
            )
        if sentence is not None and view.now_ns < self._conflict_check_ns + _CONFLICT_STAYS_NS:
            return
        self._conflict_check_ns = 0
        if sentence is not None:
            state_machine.begin_failsafe(flight, view, Action.HOLD, sentence, "refused")
