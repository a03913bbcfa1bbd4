"""The failsafe part of a tick. It decides from the facts what the vehicle does and what is
reported.

The observer collects the facts, the monitor finds the conditions that hold, and the failsafe table
gives the action. The core passes the decision to the flight, which carries it out.
"""

from __future__ import annotations

from typing import NamedTuple

from onboard.bus.schema import OrderOutcome, Severity
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.localization.own_state import OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.plain_text import capitalised
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
from onboard.supervision.condition_monitor import ConditionMonitor
from onboard.supervision.condition_table import ROWS
from onboard.supervision.tick_context import TickContext
from onboard.supervision.tick_observer import TickObserver

_QUIET = frozenset(row.condition for row in ROWS if row.is_quiet)  # never reported
# reported again if their detail names other vehicles than before
_NAMING = frozenset(row.condition for row in ROWS if row.names_vehicles)
# a condition that holds again within this time is not reported again
_PAUSE_NS = 3_000_000_000


class ConditionReport(NamedTuple):
    """An event about a condition, for people and programs."""

    severity: Severity
    code: str
    sentence: str


class FailsafeDecision(NamedTuple):
    """Consequence of the conditions of one tick."""

    action: Action = Action.GO_ON
    cause: str = ""  # sentence about the condition that requires the action; empty if none does
    outcome: OrderOutcome = "failed"  # outcome of the order in progress, if the action ends it
    reports: tuple[ConditionReport, ...] = ()


_NOTHING = FailsafeDecision()


class _Reported(NamedTuple):
    """Last event of a condition."""

    detail: str
    action: Action  # strongest action that the condition has required
    held_ns: int  # when the condition last held


class FailsafeSupervisor:
    """Applies the failsafe table to one vehicle; call :meth:`decide` at every tick."""

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle: Vehicle,
        own: OwnState,
        neighbours: NeighbourTable,
        flight: FlightContext,
    ) -> None:
        self._observer = TickObserver(
            fleet=fleet, vehicle=vehicle, own=own, flight=flight, neighbours=neighbours
        )
        self._monitor = ConditionMonitor(fleet.fleet)
        self.reports = self._observer.reports  # confirmation of PX4's reports

        self.conditions: set[Condition] = set()  # conditions that held at the last tick
        # strongest action since the last order; on the ground, the action of the last tick
        self.action = Action.GO_ON
        # condition for which PX4 lands the vehicle; None: PX4 does not, or for no condition
        self._px4_lands_for: Condition | None = None
        self.must_be_level = False  # whether the setpoint of this tick must be level
        self._details: dict[Condition, str] = {}  # details of the conditions that hold
        self._reported: dict[Condition, _Reported] = {}

    def decide(
        self, view: FlightView, context: TickContext, situation: Situation
    ) -> FailsafeDecision:
        """Return the decision for the conditions of this tick.

        Args:
            view: what the flight knows of its vehicle.
            context: what the agent knows about itself.
            situation: situation of the flight.
        """
        facts = self._observer.update(view, context)
        self._details = self._monitor.update(facts)
        self.conditions = set(self._details)

        demanded, condition = decide(situation, self.conditions)
        self.must_be_level = bool(self.conditions) and needs_level(situation, self.conditions)
        if situation is Situation.GROUND:
            self.action = demanded
            self._px4_lands_for = None
            self._reported.clear()
            return _NOTHING

        self.action = latched(self.action, demanded)
        if demanded is Action.PX4_LAND:
            self._px4_lands_for = condition
        if situation is Situation.SILENT:
            return _NOTHING

        reports = self._due_reports(view.now_ns, situation)
        if condition is None:
            return FailsafeDecision(reports=reports)
        outcome: OrderOutcome = "failed"
        if condition is Condition.ORDER_OVERDUE:
            outcome = "timed out"
        return FailsafeDecision(
            action=demanded,
            cause=self._sentence(condition, demanded),
            outcome=outcome,
            reports=reports,
        )

    @property
    def is_law_followed(self) -> bool:
        """Whether the vehicle follows the law's commands, so that others may rely on them."""
        return not self.must_be_level and Condition.ATTITUDE_NOT_FOLLOWED not in self.conditions

    def begin_order(self) -> None:
        """Forget the action, because an operator's order decides from here on."""
        self.action = Action.GO_ON
        self._px4_lands_for = None

    def move_refusal(self) -> str | None:
        """Return a sentence about the condition that refuses a move; None if none does.

        A condition refuses a move if it requires more than slow flight.
        """
        conditions = self.conditions - {Condition.ORDER_OVERDUE}  # a new move ends an overdue order
        demanded, condition = decide(Situation.FLYING, conditions)
        if condition is None or demanded < Action.HOLD:
            return None
        sentence = self._sentence(condition, demanded)
        return f"{sentence} Order it again when this condition has ended."

    def in_words(self) -> tuple[tuple[str, ...], str]:
        """Return conditions and action in words, for telemetry.

        While PX4 lands the vehicle, the condition that made it do so is one of them, also when it
        has ended: a stall of the loop holds for one tick, and often no ground hears this tick.
        """
        told = self.conditions
        if self._px4_lands_for is not None and self.action is Action.PX4_LAND:
            told = told | {self._px4_lands_for}
        conditions = tuple(condition.value for condition in in_order(told))
        return conditions, WORDS[self.action]

    def _due_reports(self, now_ns: int, situation: Situation) -> tuple[ConditionReport, ...]:
        """Return the events of this tick.

        A condition is reported if it is new, requires a stronger action than before, or names other
        vehicles than before.
        """
        reported = self._reported
        if not self.conditions and not reported:
            return ()

        due = []
        for condition in in_order(self.conditions - _QUIET):
            detail = ""
            if condition in _NAMING:
                detail = self._details[condition]
            action = TABLE[situation, condition]
            previous = reported.get(condition)
            if previous is None:
                is_due = True
                strongest = action
            else:
                is_due = action > previous.action or detail != previous.detail
                strongest = max(action, previous.action)

            reported[condition] = _Reported(detail, strongest, now_ns)
            if is_due:
                due.append(self._report(condition, action))

        for condition in reported.keys() - self.conditions:
            if now_ns - reported[condition].held_ns > _PAUSE_NS:
                del reported[condition]
        return tuple(due)

    def _report(self, condition: Condition, action: Action) -> ConditionReport:
        severity: Severity = "warning"
        if action >= Action.LEVEL:
            severity = "critical"
        return ConditionReport(
            severity=severity,
            code=condition.name.lower().replace("_", "-"),
            sentence=self._sentence(condition, action),
        )

    def _sentence(self, condition: Condition, action: Action) -> str:
        name = capitalised(condition.value)
        detail = self._details.get(condition)
        if detail:
            return f"{name} ({detail}): {WORDS[action]}."
        return f"{name}: {WORDS[action]}."
