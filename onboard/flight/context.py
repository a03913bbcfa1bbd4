"""The flight of one vehicle as a state machine: what it does now, towards which goal, for which order.

``begin_*`` start something, ``advance`` moves on by what the telemetry confirms. Nothing counts as armed, in
OFFBOARD, landed or disarmed before PX4 says so. Commands and events collect in ``out``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from onboard import vectors
from onboard.autopilot import Vec3
from onboard.bus.schema import AgentState, Order, OrderOutcome
from onboard.control.pipeline import Phase
from onboard.events import Arm, Command, Disarm, Kill, PlayTune, Px4Land, SetOffboard
from onboard.flight.arrival import is_at_rest, is_there, place, stop_point
from onboard.flight.events import Telling
from onboard.flight.types import FlightView, Step, phase_of, situation_of
from onboard.safety.failsafe_table import Situation
from onboard.types import Goal

CONFIRM_TIMEOUT_S = 5.0
_STREAM_BEFORE_OFFBOARD_S = 0.3
_RETRY_S = 1.2
_LIFTED_M = 0.12
_LIFTOFF_TIMEOUT_S = 6.0
_GIVES_WAY_ABOVE_M = 0.5  # some second before touching down: friction ends what was promised of going aside
_CLIMB_SPEED_M_S = 0.45
_CLIMB_TIMEOUT_S = 40.0
_ARRIVED_S = 0.5
_SINK_SPEED_M_S = 0.4
_SLOW_SHARE = 0.25  # of the top speed on average; a quintic's peak is 1.9 times that
_UNDER_GROUND_M = 0.10
_CONTACT_HEIGHT_M, _CONTACT_M_S, _CONTACT_S = 0.06, 0.10, 0.3
_STALLED_M, _STALLED_M_S, _STALLED_S = 0.30, 0.05, 1.5
_DISARM_AFTER_S = 4.0
_LEG_LIMIT_S, _LANDING_LIMIT_S, _CONTACT_LIMIT_S, _PX4_LIMIT_S, _HOLD_LIMIT_S = 30.0, 20.0, 8.0, 60.0, 15.0
_RISEN_M = 0.5  # of a landing: more than giving way, or the end of a climb, takes it up
_PATIENCE = 3.0  # times the duration that a way would take alone
_REST_S = 0.3


@dataclass(slots=True)
class FlightContext(Telling):
    """State of one vehicle's flight."""

    state: AgentState = "waiting"
    step: Step = Step.IDLE
    reason: str = ""
    goal_position_enu_m: Vec3 = (0.0, 0.0, 0.0)
    is_streaming: bool = False
    is_slow: bool = False
    ground_z_m: float = 0.0
    leg: int = 0  # counts orders to move
    _since_ns: int = 0
    _limit_s: float = 0.0
    _is_disarming: bool = False
    _goal_duration_s: float = 0.0
    _goal_sequence: int = 0
    _lowest_m: float = math.inf
    _step_ns: int = 0
    _steady_ns: int = 0
    _last_ask_ns: int = 0
    _takeoff_height_m: float | None = None
    _wanted: tuple[Vec3, float, int] | None = None
    _goal: Goal = field(init=False)

    # -- what it is --------------------------------------------------------------------------------------------------

    @property
    def situation(self) -> Situation:
        """For the failsafe table."""
        return situation_of(self.state, self.step)

    @property
    def phase(self) -> Phase:
        """For the pipeline."""
        return phase_of(self.state, self.step)

    @property
    def is_under_law(self) -> bool:
        """Whether what is flown is the pipeline's output."""
        return self.is_streaming and self.phase is not Phase.GROUND

    def gives_way(self, view: FlightView) -> bool:
        """Whether the others may count on it to go aside; who is about to touch down, or has not lifted off, cannot."""
        is_low = view.position_enu_m[2] - self.ground_z_m < _GIVES_WAY_ABOVE_M
        return self.is_under_law and not (is_low and self.step in (Step.LIFTOFF, Step.DESCENT))

    @property
    def must_be_offboard(self) -> bool:
        """Whether a heartbeat with another mode means that somebody took the vehicle away."""
        return self.is_streaming and self.step not in (Step.OFFBOARD, Step.TAKEOVER)

    @property
    def must_be_armed(self) -> bool:
        """Whether a heartbeat without the armed flag means that somebody stopped the motors in the air."""
        return self.step in (Step.LIFTOFF, Step.CLIMB, Step.LEG, Step.ARRIVED)

    def overdue(self, view: FlightView) -> str | None:
        """What shows that a move or a landing does not get on, or "" when only the time does; None while it does."""
        risen_m = view.position_enu_m[2] - self._lowest_m
        if self.step in (Step.DESCENT, Step.CONTACT) and view.has_position and risen_m > _RISEN_M:
            return f"it has risen by {risen_m:.2f} m"
        if self.step is Step.CONTACT and self._seconds(view) > _CONTACT_LIMIT_S:
            return "PX4 does not see that it is down"
        is_late = (view.now_ns - self._since_ns) * 1e-9 > self._limit_s
        return "" if self.step in (Step.LEG, Step.DESCENT) and is_late else None

    def goal(self) -> Goal:
        """For guidance; the same value as long as nothing has changed."""
        wanted = self.goal_position_enu_m, self._goal_duration_s, self._goal_sequence
        if wanted != self._wanted:
            self._wanted = wanted
            position_enu_m, duration_s, sequence = wanted
            self._goal = Goal(vectors.Vec3(*position_enu_m), duration_s, sequence)
        return self._goal

    # -- orders and failsafes begin something ------------------------------------------------------------------------

    def begin_start(self, view: FlightView, order: Order | None, takeoff_height_m: float | None) -> None:
        """Stream, enter OFFBOARD, arm; with a height also take off."""
        self._replace_order(view, order)
        self._takeoff_height_m = takeoff_height_m
        self.reason = ""
        if self.state == "armed" and self.is_streaming and takeoff_height_m is not None:
            self._lift(view)
            return
        self.is_streaming = True
        self.ground_z_m = view.position_enu_m[2]
        self.goal_position_enu_m = view.position_enu_m
        self.state = "taking off" if takeoff_height_m is not None else "ready"
        self._enter(Step.OFFBOARD, view)

    def begin_move(self, view: FlightView, order: Order, position_enu_m: Vec3, duration_s: float) -> None:
        """Fly to a point."""
        self._replace_order(view, order)
        self.state, self.reason = "flying", ""
        self._set_goal(position_enu_m, duration_s)
        self._enter(Step.LEG, view)
        self.leg += 1
        way_m = math.dist(position_enu_m, view.position_enu_m)
        self._limit(view, _LEG_LIMIT_S, max(duration_s, 1.9 * way_m / self.vehicle.max_speed_m_s))

    def slow_down(self, view: FlightView, reason: str) -> None:
        """Fly the rest of the way at reduced speed, once for each order; whoever stands, sinks or climbs is slow."""
        if self.step is not Step.LEG or self.is_slow:
            return
        self.is_slow, self.reason = True, reason
        left_m = math.dist(self.goal_position_enu_m, view.position_enu_m)
        duration_s = left_m / (_SLOW_SHARE * self.vehicle.max_speed_m_s)
        self._set_goal(self.goal_position_enu_m, duration_s)
        self._limit_s += _PATIENCE * duration_s

    def begin_hold(self, view: FlightView, order: Order | None, reason: str, outcome: OrderOutcome = "failed") -> None:
        """Stop as soon as the acceleration allows, and stay there, inside the fence.

        Without an order it is a failsafe's, and the order in progress ends with ``outcome`` for ``reason``.
        """
        self._replace_order(view, order, reason, outcome)
        self.state, self.reason = "holding", reason
        self._set_goal(stop_point(view, self.vehicle, self.fleet), 0.0)
        self._enter(Step.ARRIVED, view)

    def begin_takeover(self, view: FlightView, order: Order) -> None:
        """Fly on from PX4's hold: stream setpoints for this place until PX4 says that it follows them."""
        self._replace_order(view, order)
        self.state, self.reason, self.is_streaming = "holding", Step.TAKEOVER.value, True
        self.ground_z_m = self.vehicle.start_enu_m[2]
        self._set_goal(stop_point(view, self.vehicle, self.fleet), 0.0)
        self._enter(Step.TAKEOVER, view)

    def begin_land(self, view: FlightView, order: Order | None, reason: str) -> None:
        """Descend where it is, under the law; what PX4 is landing already, it lands."""
        self._replace_order(view, order, reason)
        if self.step is Step.PX4:
            return
        self.state, self.reason, self._lowest_m = "landing", reason, math.inf
        x, y, _ = stop_point(view, self.vehicle, self.fleet)
        height_m = max(0.0, view.position_enu_m[2] - self.ground_z_m)
        braking_s = 2.0 * math.hypot(*view.velocity_enu_m_s) / self.vehicle.max_acceleration_m_s2
        duration_s = max(1.0, height_m / _SINK_SPEED_M_S) + braking_s
        self._set_goal((x, y, self.ground_z_m - _UNDER_GROUND_M), duration_s)
        self._enter(Step.DESCENT, view)
        self._limit(view, _LANDING_LIMIT_S, self._goal_duration_s)

    def begin_px4_land(
        self, view: FlightView, reason: str, order: Order | None = None, outcome: OrderOutcome = "failed"
    ) -> None:
        """Leave the landing to PX4 and be silent."""
        self._replace_order(view, order, reason, outcome)
        self.state, self.reason, self.is_streaming = "landing", reason, False
        self._enter(Step.PX4, view)
        self._ask(view, Px4Land(), now=True)

    def stop(self, view: FlightView, reason: str) -> None:
        """Give up: silence on the wire."""
        self.is_streaming = False
        self.finish(view, "failed", reason)
        self.state, self.reason = "failed", reason
        self._enter(Step.IDLE, view)

    def disarm(self, view: FlightView, reason: str) -> None:
        """Give up on the ground; PX4 is asked until it says that it is disarmed."""
        self.finish(view, "failed", reason)
        self._to_ground(view, "waiting", reason)
        self._is_disarming = True
        self._ask(view, Disarm(), now=True)

    def begin_disarm(self, view: FlightView, order: Order) -> None:
        """The order to disarm, on the ground."""
        self._replace_order(view, order)
        if self.state != "failed":
            self._to_ground(view, "armed" if view.snapshot.is_armed else "ready", "")
        self._enter(Step.IDLE, view)
        self._ask(view, Disarm(), now=True)

    def kill(self, view: FlightView, order: Order) -> None:
        """Motors off, wherever it is."""
        self._replace_order(view, order)
        self.is_streaming = False
        self.state, self.reason = "failed", f"Killed by order of {order.author}."
        self._enter(Step.IDLE, view)
        self._ask(view, Kill(), now=True)

    def locate(self, view: FlightView, order: Order) -> None:
        """Show which vehicle this is; whatever it does goes on."""
        self.out.append(PlayTune())
        # PX4 acknowledges no tune, so nobody can say that it was heard.
        sentence = "The tune was sent to PX4, which does not confirm it: listen, or look at the row that blinks."
        self.say(view, "info", "identify", sentence, order.order_id, "done")

    # -- every tick --------------------------------------------------------------------------------------------------

    def advance(self, view: FlightView) -> None:
        """Move on by what telemetry and estimate say now."""
        _HANDLERS[self.step](self, view)

    def _idle(self, view: FlightView) -> None:
        armed = view.snapshot.is_armed
        if self.order is not None and self.order.kind in ("kill", "disarm"):
            self._await_disarmed(view, self.order)
        elif self._is_disarming:
            if not armed and self._told(view):
                self._is_disarming = False
            elif view.is_on_ground:
                self._ask(view, Disarm())
        if self.state == "armed" and not armed and self._told(view):
            self.say(view, "warning", "auto-disarmed", "PX4 disarmed by itself before take-off.")
            self._to_ground(view, "ready", "")
        elif self.state == "failed" and not armed and view.is_on_ground:
            self.say(view, "info", "landed", "On the ground and disarmed.")
            self.state = "landed"
        elif self.state in ("waiting", "ready", "landed") and armed and not view.is_on_ground and self.order is None:
            self.stop(view, "PX4 flies without this agent: order land or kill, or hold when PX4 holds its place.")

    def _await_disarmed(self, view: FlightView, order: Order) -> None:
        if not view.snapshot.is_armed and self._told(view):
            self.finish(view, "done", "PX4 is disarmed.")
            if self.state == "armed":
                self._to_ground(view, "ready", "")
        elif self._seconds(view) > CONFIRM_TIMEOUT_S:
            sentence = "PX4 is still armed" if view.snapshot.is_armed else "PX4 has not said that it is disarmed"
            sentence = f"{sentence}. {view.snapshot.status_text}".strip()
            self.finish(view, "timed out", sentence)
            if self.state == "armed":
                self.stop(view, sentence)
        elif view.snapshot.is_armed:
            self._ask(view, Kill() if order.kind == "kill" else Disarm())

    def _come_to_rest(self, view: FlightView) -> None:
        if self.order is None:
            return
        if not is_at_rest(view, self.vehicle):
            self._steady_ns = view.now_ns
        if (view.now_ns - self._steady_ns) * 1e-9 > _REST_S:
            self.finish(view, "done", f"Holding at {place(view)}.")
        elif self._seconds(view) > _HOLD_LIMIT_S:
            self.finish(view, "timed out", f"Not at rest after {_HOLD_LIMIT_S:.0f} s; still trying to hold.")

    def _await_offboard(self, view: FlightView) -> None:
        if view.snapshot.is_offboard and view.snapshot.heartbeat_ns > self._step_ns and self._seconds(view) > 0.1:
            self._enter(Step.ARMING, view)
        elif self._seconds(view) > CONFIRM_TIMEOUT_S:
            self._give_up_start(view, f"PX4 did not enter OFFBOARD within {CONFIRM_TIMEOUT_S:.0f} s.")
        elif self._seconds(view) > _STREAM_BEFORE_OFFBOARD_S:
            self._ask(view, SetOffboard())

    def _await_arming(self, view: FlightView) -> None:
        if view.snapshot.is_armed and view.snapshot.heartbeat_ns > self._step_ns:
            if self._takeoff_height_m is not None:
                self._lift(view)
            else:
                self.state = "armed"
                self._enter(Step.IDLE, view)
                self.finish(view, "done", "Armed.")
        elif self._seconds(view) > CONFIRM_TIMEOUT_S:
            text = view.snapshot.status_text if view.snapshot.status_text_ns > self._step_ns else ""
            self._give_up_start(view, f"PX4 did not arm within {CONFIRM_TIMEOUT_S:.0f} s. {text}".strip())
        else:
            self._ask(view, Arm())

    def _take_over(self, view: FlightView) -> None:
        if view.snapshot.is_offboard and self._told(view):
            self._enter(Step.ARRIVED, view)
            self.reason = "ordered"
            self.finish(view, "done", "Taken over from PX4's hold; holding.")
        elif self._seconds(view) > CONFIRM_TIMEOUT_S:
            self.stop(
                view, f"PX4 did not enter OFFBOARD within {CONFIRM_TIMEOUT_S:.0f} s: it flies without this agent."
            )
        elif self._seconds(view) > _STREAM_BEFORE_OFFBOARD_S:
            self._ask(view, SetOffboard())

    def _give_up_start(self, view: FlightView, sentence: str) -> None:
        self.disarm(view, sentence)

    def _lift(self, view: FlightView) -> None:
        self.state = "taking off"
        x, y, z = view.position_enu_m
        self.ground_z_m = z
        top = self._takeoff_height_m if self._takeoff_height_m is not None else 1.0
        # height counts from the fleet's origin; the leg needs longer than its mean speed says, being a quintic
        self._set_goal((x, y, top), max(1.5, (top - z) / _CLIMB_SPEED_M_S))
        self._enter(Step.LIFTOFF, view)

    def _lift_off(self, view: FlightView) -> None:
        if view.position_enu_m[2] > self.ground_z_m + _LIFTED_M:
            self._enter(Step.CLIMB, view)
        elif self._seconds(view) > _LIFTOFF_TIMEOUT_S:
            sentence = "The vehicle did not leave the ground: check propellers, battery and hover_thrust_frac."
            self.finish(view, "failed", sentence)
            self.say(view, "critical", "no-liftoff", sentence)
            self.state, self.reason, self._lowest_m = "landing", sentence, math.inf
            self._enter(Step.CONTACT, view)

    def _climb(self, view: FlightView) -> None:
        if self._is_steady(view):
            self.state = "flying"
            self._enter(Step.ARRIVED, view)
            self.finish(view, "done", f"At {view.position_enu_m[2]:.2f} m.")
        elif self._seconds(view) > _CLIMB_TIMEOUT_S:
            self.finish(view, "timed out", f"Not at its height after {_CLIMB_TIMEOUT_S:.0f} s; holding.")
            self.begin_hold(view, None, "the climb took too long")

    def _fly_leg(self, view: FlightView) -> None:
        if self._is_steady(view):
            self._enter(Step.ARRIVED, view)
            self.finish(view, "done", f"At {place(view)}.")

    def _descend(self, view: FlightView) -> None:
        height, sink = view.position_enu_m[2] - self.ground_z_m, abs(view.velocity_enu_m_s[2])
        self._lowest_m = min(self._lowest_m, view.position_enu_m[2])
        low = height < _CONTACT_HEIGHT_M and sink < _CONTACT_M_S
        overdue = self._seconds(view) > self._goal_duration_s + 1.0
        stalled = overdue and sink < _STALLED_M_S and height < _STALLED_M
        if not (low or stalled):
            self._steady_ns = view.now_ns
        steady_s = (view.now_ns - self._steady_ns) * 1e-9
        if steady_s > (_CONTACT_S if low else _STALLED_S) or (view.is_on_ground and self._seconds(view) > 1.0):
            self._enter(Step.CONTACT, view)
        elif overdue and height > _CONTACT_HEIGHT_M and self._seconds(view) > self._goal_duration_s + 3.0:
            # the floor is lower here than where it took off: go on down slowly
            x, y, z = self.goal_position_enu_m
            self._set_goal((x, y, min(z, view.position_enu_m[2]) - 0.3), 1.0)
            self._step_ns = view.now_ns

    def _await_landed(self, view: FlightView) -> None:
        if not view.snapshot.is_armed and self._told(view) and view.is_on_ground:
            self._landed(view)
            return
        self._lowest_m = min(self._lowest_m, view.position_enu_m[2])
        if self._seconds(view) > _DISARM_AFTER_S:
            self._ask(view, Disarm())

    def _await_px4_landing(self, view: FlightView) -> None:
        snapshot = view.snapshot
        if not snapshot.is_armed and view.is_on_ground and self._told(view):
            self._landed(view)
        elif snapshot.mode != "LAND" and not view.is_on_ground:
            self._ask(view, Px4Land())
            if self._seconds(view) > CONFIRM_TIMEOUT_S:
                self.finish(view, "failed", f"PX4 does not land, it is in {snapshot.mode}: take it by radio control.")
        elif self._seconds(view) > _PX4_LIMIT_S:
            self.finish(view, "timed out", f"PX4 has not landed after {_PX4_LIMIT_S:.0f} s: take it by radio control.")

    def _landed(self, view: FlightView) -> None:
        reason = self.reason
        if self.order is not None and self.order.kind == "land":
            self.finish(view, "done", "Landed and disarmed.")
        else:
            self.finish(view, "failed", reason or "Landed.")
            self.say(view, "info", "landed", "Landed and disarmed.")
        self._to_ground(view, "landed", reason)

    # -- helpers -----------------------------------------------------------------------------------------------------

    def _replace_order(
        self, view: FlightView, order: Order | None, reason: str = "", outcome: OrderOutcome = "failed"
    ) -> None:
        if order is not None:
            self.finish(view, "superseded", f"Ended by order {order.kind} of {order.author}.")
        else:
            self.finish(view, outcome, reason or "Ended by a failsafe.")
        self._is_disarming = False
        self.order, self.is_slow = order, False

    def _limit(self, view: FlightView, least_s: float, alone_s: float) -> None:
        self._since_ns, self._limit_s = view.now_ns, least_s + _PATIENCE * alone_s

    def _enter(self, step: Step, view: FlightView) -> None:
        self.step, self._step_ns, self._steady_ns, self._last_ask_ns = step, view.now_ns, view.now_ns, 0

    def _to_ground(self, view: FlightView, state: AgentState, reason: str) -> None:
        self.is_streaming = False
        self.state, self.reason = state, reason
        self._enter(Step.IDLE, view)

    def _ask(self, view: FlightView, command: Command, *, now: bool = False) -> None:
        if now or (view.now_ns - self._last_ask_ns) * 1e-9 > _RETRY_S:
            self._last_ask_ns = view.now_ns
            self.out.append(command)

    def _seconds(self, view: FlightView) -> float:
        return (view.now_ns - self._step_ns) * 1e-9

    def _told(self, view: FlightView) -> bool:
        """Whether a heartbeat has come since this step began; the one before it may be a second old."""
        return view.snapshot.heartbeat_ns > self._step_ns

    def _set_goal(self, position_enu_m: Vec3, duration_s: float) -> None:
        self.goal_position_enu_m, self._goal_duration_s = position_enu_m, duration_s
        self._goal_sequence += 1

    def _is_steady(self, view: FlightView) -> bool:
        if not is_there(view, self.goal_position_enu_m, self.vehicle):
            self._steady_ns = view.now_ns
        return (view.now_ns - self._steady_ns) * 1e-9 > _ARRIVED_S


_HANDLERS: dict[Step, Callable[[FlightContext, FlightView], None]] = {
    Step.IDLE: FlightContext._idle,
    Step.OFFBOARD: FlightContext._await_offboard,
    Step.ARMING: FlightContext._await_arming,
    Step.LIFTOFF: FlightContext._lift_off,
    Step.CLIMB: FlightContext._climb,
    Step.LEG: FlightContext._fly_leg,
    Step.ARRIVED: FlightContext._come_to_rest,
    Step.DESCENT: FlightContext._descend,
    Step.CONTACT: FlightContext._await_landed,
    Step.PX4: FlightContext._await_px4_landing,
    Step.TAKEOVER: FlightContext._take_over,
}
