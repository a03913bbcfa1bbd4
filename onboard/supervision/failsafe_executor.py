"""The failsafe half of a tick: what holds, what the table says to that, and obeying and saying it."""

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

_QUIET = {Condition.LOOP_LATE, Condition.GROUND_LOST, Condition.NOT_FINITE, Condition.SHUTDOWN}
# told again when it concerns somebody else
_NAMED = {
    Condition.NEIGHBOUR_SILENT,
    Condition.NEIGHBOUR_UNSEEN,
    Condition.NEIGHBOUR_INVALID,
    Condition.NEIGHBOUR_UNCOOPERATIVE,
    Condition.NEIGHBOUR_BACK,
    Condition.CONFIG_DIFFERS,
}


_PAUSE_NS = 3_000_000_000  # what comes and goes within it is told once


class _Told(NamedTuple):
    """What was said of a condition, the strongest action with it, and when it held last."""

    detail: str
    action: Action
    held_ns: int


class FailsafeExecutor:
    """Watches one vehicle and obeys the failsafe table.

    conditions: what holds as of the last :meth:`tick`. action: the strongest that was taken since the last order, or on
    the ground what holds now. must_be_level: whether the setpoint of this tick must be level.
    """

    def __init__(
        self, fleet: FleetConfig, vehicle: Vehicle, own: OwnState, neighbours: NeighbourTable, flight: FlightContext
    ) -> None:
        self._flight = flight
        self.watch = ConditionMonitor(fleet, vehicle, own, flight, neighbours)
        self.conditions: set[Condition] = set()
        self.action = Action.GO_ON
        self.must_be_level = False
        self._told: dict[Condition, _Told] = {}

    def tick(self, view: FlightView, doing: TickContext) -> None:
        """Find what holds now, decide, and let the flight do it."""
        flight = self._flight
        self.conditions = self.watch.conditions(view, doing)
        situation = flight.situation
        asked, condition = decide(situation, self.conditions)
        self.must_be_level = bool(self.conditions) and needs_level(situation, self.conditions)
        if situation is Situation.GROUND:
            self.action = asked
            self._told.clear()
            return
        self.action = latched(self.action, asked)
        if situation is Situation.SILENT:
            return
        self._say_what_is_new(view, situation)
        if condition is not None:
            self._obey(view, asked, condition)

    @property
    def is_obeyed(self) -> bool:
        """Whether what the law commands is what the vehicle does, so that others may count on it."""
        return not self.must_be_level and Condition.ATTITUDE_NOT_FOLLOWED not in self.conditions

    def ordered(self) -> None:
        """An operator's order begins: it decides how the vehicle flies from here on."""
        self.action = Action.GO_ON

    def move_refusal(self) -> str | None:
        """Why nobody is to be sent anywhere now: what holds asks for more than to be slow; None when nothing does."""
        asked, condition = decide(Situation.FLYING, self.conditions - {Condition.ORDER_OVERDUE})
        if condition is None or asked < Action.HOLD:
            return None
        return f"{self._sentence(condition, asked)} Order it again when that is over."

    def told(self) -> tuple[tuple[str, ...], str]:
        """Conditions and action in words, for telemetry."""
        return tuple(condition.value for condition in in_order(self.conditions)), WORDS[self.action]

    def _say_what_is_new(self, view: FlightView, situation: Situation) -> None:
        """Each condition once while it lasts, with pauses; again when it asks for more or concerns somebody else."""
        told, details = self._told, self.watch.details
        spoken = self.conditions - _QUIET if self.conditions else self.conditions
        if not spoken and not told:
            return
        for condition in in_order(spoken):
            detail, action = details.get(condition, "") if condition in _NAMED else "", TABLE[situation, condition]
            known = told.get(condition)
            told[condition] = _Told(detail, action if known is None else max(action, known.action), view.now_ns)
            if known is not None and known.detail == detail and action <= known.action:
                continue
            severity: Severity = "critical" if action >= Action.LEVEL else "warning"
            code = condition.name.lower().replace("_", "-")
            self._flight.say(view, severity, code, self._sentence(condition, action))
        for condition in told.keys() - self.conditions:
            if view.now_ns - told[condition].held_ns > _PAUSE_NS:
                del told[condition]

    def _obey(self, view: FlightView, action: Action, condition: Condition) -> None:
        outcome: OrderOutcome = "timed out" if condition is Condition.ORDER_OVERDUE else "failed"
        begin_failsafe(self._flight, view, action, self._sentence(condition, action), outcome)

    def _sentence(self, condition: Condition, action: Action) -> str:
        what = condition.value[0].upper() + condition.value[1:]
        detail = self.watch.details.get(condition)
        return f"{what} ({detail}): {WORDS[action]}." if detail else f"{what}: {WORDS[action]}."
