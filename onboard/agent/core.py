"""The agent without I/O: events in, commands out, time passed in. The shell in run.py moves bytes and time.

One tick: estimate, conditions, failsafe, state machine, pipeline, the last check before the wire, messages.
"""

from __future__ import annotations

import math

from msgspec import Struct
from msgspec.structs import replace

from onboard.agent.telemetry import Report
from onboard.autopilot import Landed, Snapshot
from onboard.avoidance.params import LAW_NAMES, obstacles
from onboard.bus.authority import Roles
from onboard.bus.schema import LOCATE, Order, OrderReply, StateMessage
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline
from onboard.control.pipeline import Phase, PipelineMemory
from onboard.events import (
    AutopilotHeard,
    Command,
    DiskChecked,
    EventIn,
    Exit,
    Follow,
    LoopTimed,
    MessageMalformed,
    NeighbourHeard,
    NodeSeen,
    OrderArrived,
    PoseArrived,
    Publish,
    Reply,
    SendAttitude,
    ShutdownAsked,
    SourceTold,
    TickFailed,
    WatchBodies,
)
from onboard.feasibility.bounds import TICK_S
from onboard.flight import order_checks, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView, Step
from onboard.localization.odometry_forwarding import OdometryForwarder
from onboard.localization.own_state import OwnState
from onboard.neighbours.subscription import CHOOSE_TICKS
from onboard.neighbours.table import NeighbourTable
from onboard.px4.required_params import required_params
from onboard.safety.failsafe_table import Action, Situation
from onboard.safety.limits import POSITION_LOST_S
from onboard.safety.setpoint_check import is_sendable
from onboard.supervision.conditions import TickContext
from onboard.supervision.failsafe_executor import FailsafeExecutor
from onboard.supervision.model_mismatch_reporter import ModelMismatchReporter
from onboard.supervision.preflight_reporter import PreflightReporter
from onboard.types import AttitudeSetpoint, Goal, Neighbour, State, Tick
from onboard.vectors import ZERO_3, Vec3

_CONFLICT_CHECK_S = 0.6
_FARTHEST_M2, _FASTEST_M2_S2 = 1e10, 1e6
# PX4 speaks at least every 30 ms: setpoints are for an attitude that is known now, and a thread that hangs is not known
_HEARD_NS = 80_000_000


class Pass(Struct, frozen=True):
    """One pass of the pipeline that is due: its arguments, without a batch axis; the others as of ``now_ns``."""

    memory: PipelineMemory
    state: State
    goal: Goal
    table: NeighbourTable
    now_ns: int
    dt_s: float
    phase: Phase

    @property
    def neighbours(self) -> list[Neighbour]:
        """The frozen picture of the others."""
        return self.table.snapshot(self.now_ns)


class AgentCore:
    """One vehicle's agent.

    Args:
        fleet: the fleet file. vehicle_name: which of its vehicles this is.
        boot_id: differs from one start of the process to the next.
        law: overrides the fleet file's law.
    """

    def __init__(self, fleet: FleetConfig, vehicle_name: str, *, boot_id: int, law: str | None = None) -> None:
        self.fleet, self.vehicle, self.boot_id = fleet, fleet.vehicles[vehicle_name], boot_id
        self.params = pipeline.pipeline_params(fleet, vehicle_name, law=law)
        self.law, self.obstacles = LAW_NAMES[self.params.law.law], obstacles(fleet)
        self.own = OwnState(self.vehicle, fleet.fleet.global_origin)
        self.neighbours = NeighbourTable(fleet, vehicle_name)
        self.flight = FlightContext(fleet, self.vehicle)
        self.failsafes = FailsafeExecutor(fleet, self.vehicle, self.own, self.neighbours, self.flight)
        self.is_stopping = False
        self.last_tick: Tick | None = None
        self._memory = pipeline.initial(self.params, Vec3(*self.vehicle.start_enu_m))
        self._snapshot = Snapshot()
        self._view = FlightView(0, ZERO_3, ZERO_3, False, self._snapshot)
        self._loop = LoopTimed(0.0, 0.0, 0.0, 0)
        self._nodes: set[str] = set()
        self.roles = Roles()
        self._has_ground = False
        self._has_peers = len(fleet.enabled_names) > 1 or self.vehicle.mocap_required
        self._answered: dict[str, OrderReply] = {}
        self._distances: dict[str, float] = {}
        self._ticks_to_choose = 0
        self._last_ns = self._malformed = self._sent_ns = 0
        self._loss_ns = round(1e9 * float(required_params(self.vehicle).get("COM_OF_LOSS_T", 0.3)))
        self._period_s = TICK_S
        self._doing = TickContext()
        self._odometry = OdometryForwarder()
        self._sent_thrust_frac = 0.0
        self._hover_frac = self.vehicle.hover_thrust_frac
        self._is_last_finite = True
        self._conflict_check_ns = 0
        self._response = ModelMismatchReporter(self.vehicle)
        self.preflight = PreflightReporter(
            fleet,
            self.vehicle,
            boot_id=boot_id,
            law=self.law,
            own=self.own,
            neighbours=self.neighbours,
            flight=self.flight,
        )
        self._report = Report(
            self.vehicle,
            boot_id,
            fleet.config_hash,
            self.law,
            own=self.own,
            neighbours=self.neighbours,
            flight=self.flight,
            failsafes=self.failsafes,
            roles=self.roles,
            duplicates=self.preflight.duplicates,
        )

    # -- events ------------------------------------------------------------------------------------------------------

    def handle(self, event: EventIn, now_ns: int) -> list[Command]:
        """Take one event; only orders and poses answer at once."""
        if isinstance(event, AutopilotHeard):  # once a tick, and nobody else wants to know
            if _is_plausible(event.snapshot):
                self._snapshot = event.snapshot
            else:
                self._malformed += 1  # who tells nonsense counts as silent
            return []
        if (  # fifty a second of each, who only want to be noted; under our own name it is a twin's
            isinstance(event, NeighbourHeard)
            and isinstance(event.message, StateMessage)
            and event.message.vehicle != self.vehicle.name
        ):
            self.neighbours.hear(event.message, event.received_ns)
            return []
        self.preflight.hear(event)
        match event:
            case PoseArrived(pose, received_ns):
                if pose.body != self.vehicle.body:
                    self.neighbours.see(pose, received_ns)
                elif self.own.add_pose(pose, received_ns):
                    if not self.fleet.mocap.direct:  # a mocap that is read directly says nothing of the bus
                        self.neighbours.last_heard_ns = max(self.neighbours.last_heard_ns, received_ns)
                    return list(self._odometry.take(pose, self._snapshot, now_ns))
            case NeighbourHeard(message, received_ns):
                self.neighbours.hear(message, received_ns)
            case NodeSeen(node, is_alive):
                (self._nodes.add if is_alive else self._nodes.discard)(node)
                self._has_ground = any(other.startswith("ground") for other in self._nodes)
                self.roles.see(node, is_alive)
            case OrderArrived(order):
                return self._take_order(order, now_ns)
            case LoopTimed():
                self._loop = event
            case DiskChecked(is_full):
                self._doing.is_disk_full = is_full
            case MessageMalformed(count):
                self._malformed += count
            case TickFailed(sentence):
                self._is_last_finite = False
                self.flight.say(self._view, "critical", "tick-failed", sentence)
            case SourceTold(sentence):
                if sentence:
                    self.flight.say(self._view, "warning", "mocap-source", sentence)
            case ShutdownAsked():
                self.is_stopping = True
        return []

    def _take_order(self, order: Order, now_ns: int) -> list[Command]:
        known = self._answered.get(order.order_id)
        if known is not None:
            return [Reply(known)]  # asked again: same answer, nothing begins twice
        view = replace(self._view, now_ns=now_ns, snapshot=self._snapshot)
        reason = self.roles.refusal(order) or self._refusal(order, view)
        if reason is None and self.is_stopping and order.kind not in ("kill", "land", "disarm"):
            reason = "This agent has been asked to stop: start it again."
        reply = OrderReply(
            order_id=order.order_id, vehicle=self.vehicle.name, is_accepted=reason is None, reason=reason or ""
        )
        self._answered[order.order_id] = reply
        if len(self._answered) > 200:
            self._answered.pop(next(iter(self._answered)))
        if reason is None:
            self._begin(order, view)
        return [Reply(reply), *self._drain()]

    def _refusal(self, order: Order, view: FlightView) -> str | None:
        facts = order_checks.OrderFacts(
            view,
            self.fleet,
            self.neighbours.telemetries(),
            self._distances,
            self.preflight.not_ready,
            lambda: self.preflight.reasons_in_air(view, self._hover_frac),
        )
        refusal = order_checks.refusal(order, self.flight, facts)
        return self.failsafes.move_refusal() if refusal is None and order.kind == "move" else refusal

    def _begin(self, order: Order, view: FlightView) -> None:
        if order.kind in LOCATE:
            state_machine.locate(self.flight, view, order)
            return
        self.failsafes.begin_order()
        state_machine.begin_order(self.flight, view, order)
        if order.kind == "move":
            self._conflict_check_ns = view.now_ns + int(_CONFLICT_CHECK_S * 1e9)

    # -- a tick ------------------------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> list[Command]:
        """One pass at 50 Hz; the commands are to be executed in their order."""
        due = self.begin_tick(now_ns)
        memory, tick = pipeline.step(
            due.memory,
            due.state,
            due.goal,
            due.neighbours,
            self.obstacles,
            due.phase,
            self.params,
            due.dt_s,
        )
        return self.end_tick(memory, tick)

    def begin_tick(self, now_ns: int) -> Pass:
        """The first half of :meth:`tick`: what the pipeline has to compute; who runs many cores computes it at once."""
        self._period_s = (now_ns - self._last_ns) * 1e-9 if self._last_ns else TICK_S
        if now_ns < self._last_ns:
            self._doing.clock_jump_ns = now_ns
        self._last_ns = now_ns
        dt_s = min(max(self._period_s, 0.005), 0.1)
        flight = self.flight
        on_ground = flight.phase is Phase.GROUND or flight.step is Step.LIFTOFF
        self.own.update(now_ns, dt_s, self._snapshot, self._sent_thrust_frac, self._hover_frac, on_ground)
        state = self.own.state
        self._view = self._look(now_ns, state)
        self._distances = self.neighbours.distances_m(self._view.position_enu_m, now_ns)
        self._choose_neighbours(now_ns)
        self._watch_over(now_ns)
        state_machine.advance(flight, self._view)
        phase = flight.phase
        if state is None:
            start = Vec3(*self.vehicle.start_enu_m)
            state, phase = State(start, ZERO_3, ZERO_3, 0.0, 0.0, 0.0, 0.0), Phase.GROUND
        order = flight.goal
        goal = Goal(Vec3(*order.position_enu_m), order.duration_s, order.sequence)
        return Pass(self._memory, state, goal, self.neighbours, now_ns, dt_s, phase)

    def end_tick(self, memory: PipelineMemory, tick: Tick) -> list[Command]:
        """The second half of :meth:`tick`, with what the pipeline made of the pass."""
        self._memory, self.last_tick = memory, tick
        self._hover_frac = tick.hover_thrust_frac
        self._is_last_finite = tick.is_finite and is_sendable(tick.attitude, self.vehicle.max_tilt_deg)
        if self.flight.phase is Phase.FLYING and self._response.is_due():
            attitude = self.own.attitude_wxyz(self._snapshot)
            for code, sentence in self._response.follow(memory.observer, attitude, self._hover_frac):
                self.flight.say(self._view, "warning", code, sentence)
        out = self._to_wire(tick)
        self._check_conflict(self._last_ns)
        self._report.tick(
            out,
            tick,
            self._view,
            period_s=self._period_s,
            is_airborne=self._is_airborne,
            distances_m=self._distances,
            not_ready=self.preflight.not_ready,
            loop=self._loop,
            malformed=self._malformed,
        )
        bodies = self.neighbours.sought(self._last_ns)
        if bodies:
            out.append(WatchBodies(tuple(bodies)))
        report = self.preflight.due(self._last_ns)
        if report is not None:
            out.append(Publish(Topic.PREFLIGHT, report))
        if self.is_stopping and self.flight.situation in (Situation.GROUND, Situation.SILENT):
            out.append(Exit())
        return out

    def _choose_neighbours(self, now_ns: int) -> None:
        """Whom to hear at full rate from now on; all until we know where we are."""
        self._ticks_to_choose -= 1
        if self._ticks_to_choose > 0:
            return
        is_first, self._ticks_to_choose = self._ticks_to_choose < 0, CHOOSE_TICKS
        is_new = self._view.has_position and self.neighbours.choose(self._view.position_enu_m, now_ns)
        if is_new or is_first:
            self.flight.commands.append(Follow(self.neighbours.followed))

    def _look(self, now_ns: int, state: State | None) -> FlightView:
        if state is None:
            return FlightView(now_ns, self._view.position_enu_m, ZERO_3, False, self._snapshot)
        own = self.own
        return FlightView(now_ns, own.position_enu_m, own.velocity_enu_m_s, own.age_s < POSITION_LOST_S, self._snapshot)

    def _watch_over(self, now_ns: int) -> None:
        heard_ns, flight = self.neighbours.last_heard_ns, self.flight
        can_hear = heard_ns and self._has_peers and not self._has_ground
        doing, tick = self._doing, self.last_tick
        doing.period_s, doing.is_last_tick_finite = self._period_s, self._is_last_finite
        doing.bus_age_s = (now_ns - heard_ns) * 1e-9 if can_hear else 0.0
        doing.has_ground, doing.is_stopping = self._has_ground, self.is_stopping
        doing.is_airborne = self._is_airborne
        doing.nearest_m = min(self._distances.values(), default=math.inf)
        doing.has_duplicate = self.preflight.has_duplicate(now_ns)
        if tick is not None:
            doing.law_status, doing.active_neighbour = tick.law.status, tick.law.active_neighbour
            doing.below_m = tick.setpoint.position_enu_m.z - self._view.position_enu_m[2]
        self.failsafes.tick(self._view, doing)
        if flight.situation is Situation.GROUND:
            self.preflight.update(
                self._view,
                self._period_s,
                is_airborne=self._is_airborne,
                hover_frac=self._hover_frac,
                conditions=self.failsafes.conditions,
            )
            state_machine.preflight_checked(flight, self._view, not self.preflight.not_ready)

    def _to_wire(self, tick: Tick) -> list[Command]:
        out = self._drain()
        flight = self.flight
        if not flight.is_streaming:
            self._sent_thrust_frac, self._sent_ns = 0.0, 0
            return out
        setpoint = tick.attitude
        if flight.phase is not Phase.GROUND and (self.failsafes.must_be_level or not self._is_last_finite):
            hover = self._hover_frac if math.isfinite(self._hover_frac) else self.vehicle.hover_thrust_frac
            setpoint = AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), hover)
        now_ns = self._last_ns
        if flight.must_be_offboard and self._sent_ns and now_ns - self._sent_ns > self._loss_ns:
            # PX4 has begun to land meanwhile: setpoints that come back now would take the vehicle from it
            sentence = f"No setpoint has left for {self._loss_ns * 1e-9:.1f} s: PX4 lands."
            flight.say(self._view, "critical", "setpoints-interrupted", sentence)
            state_machine.begin_failsafe(flight, self._view, Action.PX4_LAND, sentence)
            self.failsafes.action = max(self.failsafes.action, Action.PX4_LAND)
            return out + self._drain()
        # last check: finite, bounded, from a fresh position and attitude; else the wire stays silent
        is_fresh = self.own.age_s < POSITION_LOST_S + 0.2 and now_ns - self._snapshot.last_packet_ns < _HEARD_NS
        if is_fresh and is_sendable(setpoint, self.vehicle.max_tilt_deg):
            self._sent_thrust_frac, self._sent_ns = setpoint.thrust_frac, now_ns
            self._doing.commanded_wxyz, self._doing.thrust_frac = (
                setpoint.quaternion_wxyz,
                self._sent_thrust_frac,
            )
            out.append(SendAttitude(self.own.to_px4(setpoint)))
        return out

    def _drain(self) -> list[Command]:
        return self.flight.take_commands()

    # -- what it says ------------------------------------------------------------------------------------------------

    @property
    def _is_airborne(self) -> bool:
        snapshot, flight = self._snapshot, self.flight
        told = snapshot.is_armed and snapshot.landed in (Landed.IN_AIR, Landed.TAKING_OFF, Landed.LANDING)
        return told or (flight.is_under_law and flight.step is not Step.LIFTOFF)

    def _check_conflict(self, now_ns: int) -> None:
        flight = self.flight
        if not self._conflict_check_ns or now_ns < self._conflict_check_ns:
            return
        self._conflict_check_ns = 0
        if flight.step is not Step.LEG or flight.order is None:
            return
        # By now all vehicles of the same order have announced their goals; before, a swap looked like a conflict.
        sentence = order_checks.goal_conflict(
            flight.goal_position_enu_m, self.neighbours.telemetries(), self.fleet.fleet.safety_distance_m
        )
        if sentence is not None:
            state_machine.begin_failsafe(flight, self._view, Action.HOLD, sentence, "refused")


def _is_plausible(snapshot: Snapshot) -> bool:
    """Whether attitude and motion that PX4 tells can be calculated with."""
    w, x, y, z = snapshot.quaternion_enu_flu_wxyz
    a, b, c = snapshot.position_local_ned_m
    d, e, f = snapshot.velocity_local_ned_m_s
    # comparisons with what is no number are false
    is_unit = 0.9 < w * w + x * x + y * y + z * z < 1.1
    return is_unit and a * a + b * b + c * c < _FARTHEST_M2 and d * d + e * e + f * f < _FASTEST_M2_S2
