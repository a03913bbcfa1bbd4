"""The failsafe half of a tick: what holds, what the table says to that, and obeying and saying it."""

from __future__ import annotations

import math

from onboard.agent.flight import Flight
from onboard.agent.neighbours import NeighbourTable
from onboard.agent.own_state import OwnState
from onboard.agent.steps import View
from onboard.agent.watch import Watch
from onboard.bus.schema import Severity
from onboard.config import FleetConfig
from onboard.safety.failsafe import TABLE, WORDS, Action, Condition, Situation, decide, in_order, latched, needs_level

_QUIET = {Condition.LOOP_LATE, Condition.GROUND_LOST, Condition.NOT_FINITE, Condition.SHUTDOWN}


class Guard:
    """Watches one vehicle and obeys the failsafe table.

    conditions: what holds as of the last :meth:`tick`. action: the strongest that was taken since the last order, or on
    the ground what holds now. must_be_level: whether the setpoint of this tick must be level.
    """

    def __init__(self, fleet: FleetConfig, own: OwnState, neighbours: NeighbourTable, flight: Flight) -> None:
        self._own, self._neighbours, self._flight = own, neighbours, flight
        self._watch = Watch(fleet)
        self.conditions: set[Condition] = set()
        self.action = Action.GO_ON
        self.must_be_level = False
        self._offboard_since_ns = 0

    def tick(
        self,
        view: View,
        *,
        period_s: float,
        is_last_tick_finite: bool,
        bus_age_s: float,
        has_ground: bool,
        nearest_m: float,
        is_stopping: bool,
    ) -> None:
        """Find what holds now, decide, and let the flight do it."""
        flight = self._flight
        if not flight.must_be_offboard:
            self._offboard_since_ns = view.now_ns
        before = self.conditions
        self.conditions = self._watch.conditions(
            view,
            period_s=period_s,
            position_age_s=self._own.age_s,
            is_last_tick_finite=is_last_tick_finite,
            must_be_offboard=flight.must_be_offboard,
            offboard_since_ns=self._offboard_since_ns,
            bus_age_s=bus_age_s,
            has_ground=has_ground,
            nearest_m=nearest_m,
            silent_neighbours=bool(self._neighbours.silent(view.now_ns)),
            should_be_up=flight.state in ("flying", "holding"),
            is_stopping=is_stopping,
        )
        situation = flight.situation
        asked, condition = decide(situation, self.conditions)
        self.must_be_level = needs_level(situation, self.conditions)
        if situation is Situation.GROUND:
            self.action = asked
            return
        self.action = latched(self.action, asked)
        if situation is Situation.SILENT:
            return
        for new in in_order(self.conditions - before - _QUIET):
            answer = TABLE[situation, new]
            severity: Severity = "critical" if answer >= Action.LEVEL else "warning"
            flight.say(view, severity, new.name.lower().replace("_", "-"), self._sentence(view, new, answer))
        if condition is not None:
            self._obey(view, asked, self._sentence(view, condition, asked))

    def ordered(self) -> None:
        """An operator's order begins: it decides how the vehicle flies from here on."""
        self.action = Action.GO_ON

    def told(self) -> tuple[tuple[str, ...], str]:
        """Conditions and action in words, for telemetry."""
        return tuple(condition.value for condition in in_order(self.conditions)), WORDS[self.action]

    def _obey(self, view: View, action: Action, sentence: str) -> None:
        flight = self._flight
        if action is Action.SLOW:
            flight.slow_down(view, sentence)
        elif action in (Action.HOLD, Action.LEVEL) and flight.situation is Situation.FLYING:
            if flight.state != "holding":
                flight.begin_hold(view, None, sentence)
        elif action is Action.LAND and flight.state != "landing":
            flight.begin_land(view, None, sentence)
        elif action is Action.PX4_LAND:
            flight.begin_px4_land(view, sentence)
        elif action is Action.DISARM:
            flight.disarm(view, sentence)
        elif action is Action.STOP:
            flight.stop(view, sentence)

    def _sentence(self, view: View, condition: Condition, action: Action) -> str:
        what = condition.value[0].upper() + condition.value[1:]
        if condition is Condition.LEFT_OFFBOARD:
            what += f" (now {view.snapshot.mode})"
        if condition is Condition.NEIGHBOUR_SILENT:
            what += f" ({', '.join(self._neighbours.silent(view.now_ns))})"
        return f"{what}: {WORDS[action]}."


def nearest_m(distances_m: dict[str, float], is_airborne: bool) -> float:
    """Distance to the nearest neighbour, while it matters."""
    return min(distances_m.values(), default=math.inf) if is_airborne else math.inf
