"""Takes orders. Each order gets a reply, and is either started or refused with a reason.

A vehicle that begins a move announces its goal in its telemetry. A moment later it compares this
goal with the goals that other vehicles have announced in the meantime.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

from onboard.agent.order_gate import OrderGate
from onboard.bus.control_token import ORDER_STAYS, ControlTokens
from onboard.bus.order_answers import ORDER_ANSWER, order_answer_sentence
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import (
    BESIDE,
    BY_MISSION,
    LOCATE,
    ON_PATHS,
    SERVICE,
    Order,
    OrderReply,
    Telemetry,
)
from onboard.flight import order_checks, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.order_checks import OrderFacts
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import Action
from onboard.supervision.failsafe_supervisor import FailsafeSupervisor

_MAX_REPLIES = 200  # number of replies that are remembered

# time from the start of a move until its goal is compared; by then all vehicles of a common order
# have usually announced their goals
_CONFLICT_CHECK_NS = 600_000_000
# a conflict ends the move only if it lasts for this time, because announcements may be delayed
_CONFLICT_STAYS_NS = 1_000_000_000

_SAY_AGAIN_NS = 1_000_000_000  # shortest time between two events about the same kind of refusal
_ALLOWED_WHILE_STOPPING = ("kill", "land", "disarm")


class TakenOrder(NamedTuple):
    """The newest order that a vehicle has taken."""

    order: Order
    taken_ns: int  # on this agent's clock


class OrderIntake:
    """Takes the orders of one vehicle.

    Args:
        flight, failsafes, roles: parts of the vehicle's agent.
        boot_id: number of this start of the agent, as in its telemetry.
        gate: checks that signed orders are new; None in a fleet without keys.
    """

    def __init__(
        self,
        flight: FlightContext,
        failsafes: FailsafeSupervisor,
        roles: ControlTokens,
        *,
        boot_id: int,
        gate: OrderGate | None = None,
    ) -> None:
        self.taken: TakenOrder | None = None  # newest accepted order; None before the first
        # newest accepted order from a person; all other orders come from missions
        self._taken_of_person: TakenOrder | None = None
        # reason -> number of orders refused because of their signature or their sender
        self.refused: Counter[str] = Counter()
        self._flight = flight
        self._failsafes = failsafes
        self._roles = roles
        self._boot_id = boot_id
        self._gate = gate
        self._reported_ns: dict[str, int] = {}  # kind of refusal -> time of its last event
        self._replies: dict[str, OrderReply] = {}  # order id -> reply; the oldest first
        # the same for parts of paths, which are many
        self._path_replies: dict[str, OrderReply] = {}
        self._conflict_check_ns = 0  # time at which the goal is compared; 0: none is due

    # -- taking an order ---------------------------------------------------------------------------

    def take(self, order: Order, facts: OrderFacts, *, is_stopping: bool) -> OrderReply:
        """Start an order or refuse it, and return the reply.

        An order that was sent twice gets the same reply and starts once.
        """
        replies = self._replies
        if order.kind == "load_path":
            replies = self._path_replies
        earlier_reply = replies.get(order.order_id)
        is_answered = earlier_reply is not None
        if self._gate is not None:
            untrusted = self._gate.refusal(order, facts.view.now_ns, is_answered=is_answered)
            if untrusted is not None:
                return self.refuse(untrusted, facts.view)

        if earlier_reply is not None:
            return earlier_reply

        refusal = self._refusal(order, facts, is_stopping=is_stopping)
        is_accepted = refusal is None
        if refusal is None:
            note = order_checks.acceptance(order, self._flight, facts.view)
            answer = f"accepted. {note}".strip()
        else:
            note = refusal
            answer = f"refused: {refusal}"

        reply = OrderReply(
            order_id=order.order_id,
            vehicle=self._flight.vehicle.name,
            is_accepted=is_accepted,
            reason=note,
        )
        _keep(reply, replies)

        # only the sender sees the reply, so the record gets an event with the answer
        if order.kind != "load_path":
            sentence = order_answer_sentence(order, answer)
            self._flight.say(facts.view, "debug", ORDER_ANSWER, sentence)

        if is_accepted:
            self._begin(order, facts.view)
        return reply

    def refuse(self, order: UntrustedOrder, view: FlightView) -> OrderReply:
        """Count an order that is not trusted, and return the reply.

        An event reports it to the ground, at most once a second for each reason.
        """
        self.refused[order.code] += 1

        reported_ns = self._reported_ns.get(order.code)
        if reported_ns is None or view.now_ns - reported_ns >= _SAY_AGAIN_NS:
            self._reported_ns[order.code] = view.now_ns
            self._flight.say(view, "warning", "order-refused", order.sentence)

        return OrderReply(
            order_id=order.order_id,
            vehicle=self._flight.vehicle.name,
            is_accepted=False,
            reason=order.sentence,
        )

    def _refusal(self, order: Order, facts: OrderFacts, *, is_stopping: bool) -> str | None:
        """Return the first reason to refuse an order: its sender, the flight or a failsafe."""
        not_operator = self._roles.refusal(order)
        if not_operator is not None:
            self.refused["operator"] += 1
            return not_operator

        reason = self._refusal_of_late_mission(order)
        if reason is not None:
            return reason

        reason = order_checks.refusal(order, self._flight, facts)
        if reason is not None:
            return reason

        if order.kind in ("move", "follow_path"):
            reason = self._failsafes.move_refusal()
            if reason is not None:
                return reason

        if is_stopping and order.kind not in _ALLOWED_WHILE_STOPPING:
            return "This agent has been asked to stop: start it again."
        return None

    def _refusal_of_late_mission(self, order: Order) -> str | None:
        """Return why a mission's order must not replace a person's order, or None if it may.

        A mission learns of a person's order from the telemetry, and then ends. Until then its
        orders must not replace the person's order.
        """
        taken = self._taken_of_person
        if taken is None or order.reason != BY_MISSION:
            return None
        if order.kind in BESIDE or order.kind == "kill":  # does not replace the order in progress
            return None

        # the order names the newest telemetry that the mission had received from this agent
        is_of_this_start = order.heard_boot_id == self._boot_id
        if is_of_this_start and order.heard_ns >= taken.taken_ns:
            return None
        return (
            f"{taken.order.author[:60]} has ordered {taken.order.kind}, which this mission had not "
            f"heard of: {ORDER_STAYS}"
        )

    def _begin(self, order: Order, view: FlightView) -> None:
        if order.kind in LOCATE:
            state_machine.locate(self._flight, view, order)
            return
        if order.kind == "load_path":
            state_machine.load_path(self._flight, view, order)
            return
        if order.kind in ON_PATHS:
            state_machine.change_path(self._flight, view, order)
            return
        if order.kind in SERVICE:
            state_machine.change_service(self._flight, view, order)
            return

        self.taken = TakenOrder(order, view.now_ns)
        if order.reason != BY_MISSION:
            self._taken_of_person = self.taken

        self._failsafes.begin_order()
        state_machine.begin_order(self._flight, view, order)
        if order.kind == "move":
            self._conflict_check_ns = view.now_ns + _CONFLICT_CHECK_NS

    # -- a tick ------------------------------------------------------------------------------------

    def check_conflict(
        self, view: FlightView, telemetries: Callable[[], Mapping[str, Telemetry]]
    ) -> None:
        """End a move if its goal stays too near another vehicle's goal.

        The goals are compared some time after the start of the move. When a swap starts, each
        vehicle's new goal is still the announced goal of the other.
        """
        if not self._conflict_check_ns or view.now_ns < self._conflict_check_ns:
            return

        flight = self._flight
        conflict = None
        if flight.step is FlightStep.LEG and flight.order is not None:
            conflict = order_checks.goal_conflict(
                flight.goal_position_enu_m, telemetries(), flight.fleet.fleet
            )

        if conflict is None:
            self._conflict_check_ns = 0
        elif view.now_ns >= self._conflict_check_ns + _CONFLICT_STAYS_NS:
            self._conflict_check_ns = 0
            state_machine.begin_failsafe(flight, view, Action.HOLD, conflict, "refused")


def _keep(reply: OrderReply, replies: dict[str, OrderReply]) -> None:
    """Remember a reply, and forget the oldest one if there are too many."""
    replies[reply.order_id] = reply
    if len(replies) > _MAX_REPLIES:
        oldest = next(iter(replies))
        replies.pop(oldest)
