"""The failsafe part of a tick: check the conditions, decide by the table, execute the action and
report it.
"""

from __future__ import annotations

from typing import NamedTuple

from onboard.bus.schema import OrderOutcome, Severity
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.flight.context import FlightContext
from onboard.flight.state_machine import begin_failsafe
from onboard.flight.types import FlightView
from onboard.localization.own_state import OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.safety.failsafe_table import (
    TABLE,
    WORDS,
    Action,
    Condition,
    Situation,
    decide,
    in_order,
    latched,
    needs_level,
)
from onboard.supervision.conditions import ConditionMonitor, TickContext

# conditions without an event of their own
_QUIET = {Condition.LOOP_LATE, Condition.NOT_FINITE, Condition.SHUTDOWN}
# conditions about other vehicles, reported again when they concern another one
_NAMED = {
    Condition.NEIGHBOUR_SILENT,
    Condition.NEIGHBOUR_UNSEEN,
    Condition.NEIGHBOUR_INVALID,
    Condition.NEIGHBOUR_UNCOOPERATIVE,
    Condition.NEIGHBOUR_IMPLAUSIBLE,
    Condition.NEIGHBOUR_BACK,
    Condition.CONFIG_DIFFERS,
}
_PAUSE_NS = 3_000_000_000  # a condition that comes and goes within it is reported once


class _Reported(NamedTuple):
    """Last event of a condition."""

    detail: str
    action: Action  # the strongest with this condition
    held_ns: int  # when the condition held last


class FailsafeExecutor:
    """Executes the failsafe table for one vehicle."""

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle: Vehicle,
        own: OwnState,
        neighbours: NeighbourTable,
        flight: FlightContext,
    ) -> None:
        self._flight = flight
        self._monitor = ConditionMonitor(fleet, vehicle, own, flight, neighbours)
        self.reports = self._monitor.reports  # of PX4, and which of them are believed
        self.conditions: set[Condition] = set()  # that hold as of the last tick
        # the strongest since the last order; on the ground the one of the last tick
        self.action = Action.GO_ON
        self.must_be_level = False  # the setpoint of this tick
        self._reported: dict[Condition, _Reported] = {}

    def tick(self, view: FlightView, context: TickContext) -> None:
        """Check the conditions, decide by the table, and let the flight execute the action."""
        flight = self._flight
        self.conditions = self._monitor.conditions(view, context)
        situation = flight.situation
        demanded, condition = decide(situation, self.conditions)
        self.must_be_level = bool(self.conditions) and needs_level(situation, self.conditions)
        if situation is Situation.GROUND:
            self.action = demanded
            self._reported.clear()
            return
        self.action = latched(self.action, demanded)
        if situation is Situation.SILENT:
            return
        self._report(view, situation)
        if condition is not None:
            self._execute(view, demanded, condition)

    @property
    def is_law_followed(self) -> bool:
        """Whether the vehicle follows the law's commands, so that others may rely on them."""
        return not self.must_be_level and Condition.ATTITUDE_NOT_FOLLOWED not in self.conditions

    def begin_order(self) -> None:
        """Forget the action: an operator's order decides from here on."""
        self.action = Action.GO_ON

    def move_refusal(self) -> str | None:
        """Return the sentence that refuses a move, while a condition demands more than slow flight;
        else None.
        """
        demanded, condition = decide(Situation.FLYING, self.conditions - {Condition.ORDER_OVERDUE})
        if condition is None or demanded < Action.HOLD:
            return None
        return (
            f"{self._sentence(condition, demanded)} Order it again when this condition has ended."
        )

    def in_words(self) -> tuple[tuple[str, ...], str]:
        """Return conditions and action in words, for telemetry."""
        return tuple(condition.value for condition in in_order(self.conditions)), WORDS[self.action]

    def _report(self, view: FlightView, situation: Situation) -> None:
        """Report each condition once while it lasts; again for a stronger action or another
        vehicle.
        """
        reported, details = self._reported, self._monitor.details
        loud = self.conditions - _QUIET if self.conditions else self.conditions
        if not loud and not reported:
            return
        for condition in in_order(loud):
            detail, action = (
                details.get(condition, "") if condition in _NAMED else "",
                TABLE[situation, condition],
            )
            known = reported.get(condition)
            reported[condition] = _Reported(
                detail, action if known is None else max(action, known.action), view.now_ns
            )
            if known is not None and known.detail == detail and action <= known.action:
                continue
            severity: Severity = "critical" if action >= Action.LEVEL else "warning"
            code = condition.name.lower().replace("_", "-")
            self._flight.say(view, severity, code, self._sentence(condition, action))
        for condition in reported.keys() - self.conditions:
            if view.now_ns - reported[condition].held_ns > _PAUSE_NS:
                del reported[condition]

    def _execute(self, view: FlightView, action: Action, condition: Condition) -> None:
        outcome: OrderOutcome = "timed out" if condition is Condition.ORDER_OVERDUE else "failed"
        begin_failsafe(self._flight, view, action, self._sentence(condition, action), outcome)

    def _sentence(self, condition: Condition, action: Action) -> str:
        name = condition.value[0].upper() + condition.value[1:]
        detail = self._monitor.details.get(condition)
        return f"{name} ({detail}): {WORDS[action]}." if detail else f"{name}: {WORDS[action]}."
