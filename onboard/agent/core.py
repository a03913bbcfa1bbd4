"""The agent without I/O: events in, commands out, time passed in. The shell in loop.py moves bytes
and time.

One tick: estimate, conditions, failsafe, state machine, pipeline, the last check before the wire,
messages.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from onboard.agent.control_step import ControlStep, PipelineStep
from onboard.agent.messages import AgentIdentity, TelemetrySources, TickResult
from onboard.agent.order_gate import OrderGate
from onboard.agent.order_intake import OrderIntake
from onboard.agent.peers import BusNodes, NeighbourFollower
from onboard.agent.setpoint_output import SetpointOutput
from onboard.agent.telemetry import TelemetryPublisher
from onboard.agent_commands import Command, Exit, Publish, Reply, RequestHeartbeat, WatchBodies
from onboard.agent_inputs import (
    AgentInput,
    AllPosesReceived,
    ClocksCompared,
    DiskChecked,
    LoopTimed,
    MessagesCounted,
    MocapProblemChanged,
    NeighbourReceived,
    NodeChanged,
    OrderReceived,
    OrderUntrusted,
    ParamsRead,
    PoseReceived,
    ShutdownRequested,
    SnapshotReceived,
    TickFailed,
)
from onboard.autopilot import Landed, Snapshot, Vec3
from onboard.bus.schema import StateMessage
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.control.pipeline import PipelineParams
from onboard.flight import state_machine
from onboard.flight.context import FlightContext
from onboard.flight.order_checks import OrderFacts
from onboard.flight.path_flight import OtherClock, other_clocks
from onboard.flight.types import FlightStep, FlightView
from onboard.localization.odometry_forwarding import OdometryForwarder
from onboard.localization.own_state import OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.preflight.preflight_reporter import PreflightReporter
from onboard.safety.failsafe_table import Situation
from onboard.safety.limits import POSITION_LOST_S
from onboard.safety.snapshot_check import nonsense
from onboard.supervision.failsafe_executor import FailsafeExecutor
from onboard.supervision.model_mismatch_reporter import ModelMismatchReporter
from onboard.supervision.tick_context import TickContext
from onboard.types import TICK_S, State

_SHORTEST_S, _LONGEST_S = 0.005, 0.1  # time that one tick integrates over
_ZERO: Vec3 = (0.0, 0.0, 0.0)
_IN_AIR = (Landed.IN_AIR, Landed.TAKING_OFF, Landed.LANDING)


class AgentCore:
    """One vehicle's agent.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        boot_id: differs from one start of the process to the next.
        clock: seconds, by which a law of somebody's own is found slow; None in simulated time.
        pipeline_step: ``pipeline.step``, or the same text compiled.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle_name: str,
        *,
        boot_id: int,
        clock: Callable[[], float] | None = None,
        pipeline_step: PipelineStep = pipeline.step,
    ) -> None:
        self.fleet, self.vehicle = fleet, fleet.vehicles[vehicle_name]
        self.own = OwnState(self.vehicle, fleet.fleet.global_origin)
        self.neighbours = NeighbourTable(fleet, vehicle_name)
        self.flight = FlightContext(fleet, self.vehicle)
        self.control = ControlStep(fleet, vehicle_name, clock=clock, pipeline_step=pipeline_step)
        self.failsafes = FailsafeExecutor(
            fleet, self.vehicle, self.own, self.neighbours, self.flight
        )
        self.preflight = PreflightReporter(
            fleet,
            self.vehicle,
            boot_id=boot_id,
            own=self.own,
            neighbours=self.neighbours,
            flight=self.flight,
        )
        self.nodes = BusNodes(fleet, vehicle_name)
        self.identity = AgentIdentity(self.vehicle, boot_id, fleet.config_hash, fleet.law.name)
        gate = OrderGate(boot_id) if fleet.has_keys else None
        self._orders = OrderIntake(self.flight, self.failsafes, self.nodes.roles, gate)
        self._setpoints = SetpointOutput(self.vehicle, self.own, self.flight, self.failsafes)
        self._publisher = TelemetryPublisher(
            self.identity,
            TelemetrySources(
                self.own,
                self.neighbours,
                self.flight,
                self.failsafes,
                self.nodes.roles,
                self.preflight.duplicates,
                self._orders.refused,
            ),
            fleet.state_ticks,
        )
        self._follower = NeighbourFollower(self.neighbours)
        self.odometry = OdometryForwarder()
        self._mismatch = ModelMismatchReporter(self.vehicle)
        self._context = TickContext()
        self._snapshot = Snapshot()
        self._view = FlightView(0, _ZERO, _ZERO, False, self._snapshot)
        self._distances_m: dict[str, float] = {}

    @property
    def boot_id(self) -> int:
        """Number of this start of the process."""
        return self.identity.boot_id

    @property
    def params(self) -> PipelineParams:
        """Parameters of the pipeline."""
        return self.control.params

    @property
    def is_stopping(self) -> bool:
        """Whether somebody has asked this agent to end."""
        return self._context.is_stopping

    # -- events ------------------------------------------------------------------------------------

    def handle(self, event: AgentInput, now_ns: int) -> list[Command]:
        """Take one event; only orders and poses answer at once."""
        return _RECEIVERS[type(event)](self, event, now_ns)

    def _snapshot_received(self, event: SnapshotReceived, now_ns: int) -> list[Command]:
        sentence = nonsense(event.snapshot)
        if not sentence:
            self._snapshot = self.failsafes.reports.believe(event.snapshot, self.flight.expected)
        else:
            self._publisher.counts.malformed += 1
            self.failsafes.reports.drop(sentence, now_ns)
            self.preflight.hear(event)
        return []

    def _neighbour_received(self, event: NeighbourReceived, now_ns: int) -> list[Command]:
        message = event.message
        if not isinstance(message, StateMessage) or message.vehicle == self.vehicle.name:
            # under our own name it is another agent's; states of the others come too often
            self.preflight.hear(event)
        self.neighbours.hear(message, event.received_ns)
        return []

    def _pose_received(self, event: PoseReceived, now_ns: int) -> list[Command]:
        pose, received_ns = event.pose, event.received_ns
        self.preflight.hear(event)
        if pose.body != self.vehicle.body:
            self.neighbours.hear_pose(pose, received_ns)
            return []
        if not self.own.add_pose(pose, received_ns):
            return []
        if not self.fleet.mocap.direct:  # a mocap that is read directly says nothing of the bus
            self.neighbours.last_heard_ns = max(self.neighbours.last_heard_ns, received_ns)
        return list(self.odometry.take(pose, self._snapshot, now_ns))

    def _all_poses_received(self, event: AllPosesReceived, now_ns: int) -> list[Command]:
        for pose in event.poses:
            self.neighbours.hear_other_pose(pose, event.received_ns)
        return []

    def _order_received(self, event: OrderReceived, now_ns: int) -> list[Command]:
        view = replace(self._view, now_ns=now_ns, snapshot=self._snapshot)
        facts = OrderFacts(
            view,
            self.fleet,
            self.neighbours.telemetries(),
            self._distances_m,
            self.preflight.not_ready,
            lambda: self.preflight.reasons_in_air(view, self.control.hover_frac),
        )
        reply = self._orders.take(event.order, facts, is_stopping=self._context.is_stopping)
        return [Reply(reply), *self.nodes.lost_ends.pass_on(self.flight.take_commands(), now_ns)]

    def _order_untrusted(self, event: OrderUntrusted, now_ns: int) -> list[Command]:
        reply = self._orders.refuse(event.order, replace(self._view, now_ns=now_ns))
        answers = [Reply(reply)] if event.order.is_answered else []
        return [*answers, *self.flight.take_commands()]

    def _node_changed(self, event: NodeChanged, now_ns: int) -> list[Command]:
        self.preflight.hear(event)
        self.nodes.update(event.node, event.is_alive, now_ns)
        return []

    def _loop_timed(self, event: LoopTimed, now_ns: int) -> list[Command]:
        self.preflight.hear(event)
        self._publisher.loop = event
        return []

    def _preflight_input(self, event: AgentInput, now_ns: int) -> list[Command]:
        self.preflight.hear(event)
        return []

    def _params_read(self, event: ParamsRead, now_ns: int) -> list[Command]:
        self._context.battery_floor_frac = event.battery_floor_frac
        return self._preflight_input(event, now_ns)

    def _disk_checked(self, event: DiskChecked, now_ns: int) -> list[Command]:
        self._context.is_disk_full = event.is_full
        return []

    def _messages_counted(self, event: MessagesCounted, now_ns: int) -> list[Command]:
        counts = self._publisher.counts
        counts.malformed += event.malformed
        counts.refused += event.refused
        counts.dropped += event.dropped
        return []

    def _tick_failed(self, event: TickFailed, now_ns: int) -> list[Command]:
        self.control.is_finite = False
        self.flight.say(self._view, "critical", "tick-failed", event.sentence)
        return []

    def _mocap_problem(self, event: MocapProblemChanged, now_ns: int) -> list[Command]:
        self.preflight.hear(event)
        if event.sentence:
            self.flight.say(self._view, "warning", "mocap-source", event.sentence)
        return []

    def _stop_requested(self, event: ShutdownRequested, now_ns: int) -> list[Command]:
        self._context.is_stopping = True
        return []

    # -- a tick ------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> list[Command]:
        """Run one pass, 50 times a second; the commands are to be executed in their order."""
        context, flight, control = self._context, self.flight, self.control
        before_ns = self._view.now_ns
        context.period_s = (now_ns - before_ns) * 1e-9 if before_ns else TICK_S
        if now_ns < before_ns:
            context.clock_jump_ns = now_ns
        dt_s = min(max(context.period_s, _SHORTEST_S), _LONGEST_S)

        on_ground = (
            flight.step.control_mode is ControlMode.GROUND or flight.step is FlightStep.LIFTOFF
        )
        thrust_frac = self._setpoints.sent_thrust_frac
        self.own.is_flown = flight.step.is_streaming
        self.own.update(now_ns, dt_s, self._snapshot, thrust_frac, control.hover_frac, on_ground)

        state = self.own.state
        view = self._new_view(now_ns, state)
        self._view = view
        self.neighbours.place_contradicted(view.position_enu_m, now_ns)
        self._distances_m = self.neighbours.distances_m(view.position_enu_m, now_ns)

        self._supervise()
        state_machine.advance(flight, view)

        neighbours = self.neighbours.snapshot(now_ns)
        tick = control.run(state, flight.goal, flight.step.control_mode, neighbours, dt_s)
        if self.flight.step.control_mode is ControlMode.FLYING and self._mismatch.is_due():
            attitude = self.own.attitude_wxyz(self._snapshot)
            for code, sentence in self._mismatch.follow(
                control.observer, attitude, control.hover_frac
            ):
                self.flight.say(view, "warning", code, sentence)
        setpoint = self._setpoints.commands(view, control)
        self._orders.check_conflict(view, self.neighbours.telemetries)
        result = TickResult(
            tick,
            view,
            self._context.period_s,
            self._is_airborne,
            self._distances_m,
            self.preflight.not_ready,
        )
        messages = self._publisher.every_tick(result)
        told = self.nodes.lost_ends.pass_on(self.flight.take_commands(), view.now_ns)
        out = [*self._publisher.telemetry(result), *told, *setpoint, *messages]
        out.extend(
            self._follower.due(view.position_enu_m if view.has_position else None, view.now_ns)
        )
        bodies = self.neighbours.bodies_to_watch(view.now_ns, self.own.age_s)
        if bodies is not None:
            out.append(WatchBodies(bodies))
        if self.failsafes.reports.is_heartbeat_due(view.now_ns):
            out.append(RequestHeartbeat())
        report = self.preflight.due(view.now_ns)
        if report is not None:
            out.append(Publish(Topic.PREFLIGHT, report))
        if self.is_stopping and self.flight.step.situation in (Situation.GROUND, Situation.SILENT):
            out.append(Exit())
        return out

    def _new_view(self, now_ns: int, state: State | None) -> FlightView:
        if state is None:
            return FlightView(now_ns, self._view.position_enu_m, _ZERO, False, self._snapshot)
        own = self.own
        has_position = own.age_s < POSITION_LOST_S or own.is_reckoned
        thrust_share = self._setpoints.sent_thrust_frac / self.control.hover_frac
        return FlightView(
            now_ns,
            own.position_enu_m,
            own.velocity_enu_m_s,
            has_position,
            self._snapshot,
            thrust_share,
            self._other_clocks(now_ns),
            self._context.period_s,
            own.is_reckoned,
            state.yaw_rad,
        )

    def _other_clocks(self, now_ns: int) -> tuple[OtherClock, ...] | None:
        path = self.flight.path
        if not path.show_id or now_ns < path.compare_ns:
            return None
        return tuple(other_clocks(self.neighbours.telemetries().values(), path.show_id, now_ns))

    def _supervise(self) -> None:
        """Let the failsafes and, on the ground, the preflight check decide."""
        context, view, control = self._context, self._view, self.control
        context.is_last_tick_finite, context.law_refusal = control.is_finite, control.law_refusal
        context.bus_age_s = self.nodes.silence_s(self.neighbours.last_heard_ns, view.now_ns)
        context.has_ground = self.nodes.has_ground
        context.is_airborne = self._is_airborne
        context.nearest_m = min(self._distances_m.values(), default=math.inf)
        context.has_duplicate = self.preflight.has_duplicate(view.now_ns)
        context.commanded_wxyz = self._setpoints.quaternion_wxyz
        context.thrust_frac = self._setpoints.sent_thrust_frac
        if control.tick is not None:
            law = control.tick.law
            context.law_status, context.active_neighbour = law.status, law.active_neighbour
            context.below_m = control.tick.setpoint.position_enu_m.z - view.position_enu_m[2]

        decision = self.failsafes.decide(view, context, self.flight.step.situation)
        for report in decision.reports:
            self.flight.say(view, report.severity, report.code, report.sentence)
        if decision.cause:
            state_machine.begin_failsafe(
                self.flight, view, decision.action, decision.cause, decision.outcome
            )

        if self.flight.step.situation is Situation.GROUND:
            self.preflight.update(
                view,
                context.period_s,
                is_airborne=self._is_airborne,
                hover_frac=control.hover_frac,
                conditions=self.failsafes.conditions,
            )
            state_machine.preflight_checked(self.flight, view, not self.preflight.not_ready)

    @property
    def _is_airborne(self) -> bool:
        snapshot, flight = self._snapshot, self.flight
        is_reported = snapshot.is_armed and snapshot.landed in _IN_AIR
        return is_reported or (flight.step.is_under_law and flight.step is not FlightStep.LIFTOFF)


_RECEIVERS: dict[type, Callable[[AgentCore, Any, int], list[Command]]] = {
    SnapshotReceived: AgentCore._snapshot_received,
    NeighbourReceived: AgentCore._neighbour_received,
    PoseReceived: AgentCore._pose_received,
    OrderUntrusted: AgentCore._order_untrusted,
    AllPosesReceived: AgentCore._all_poses_received,
    OrderReceived: AgentCore._order_received,
    NodeChanged: AgentCore._node_changed,
    LoopTimed: AgentCore._loop_timed,
    ParamsRead: AgentCore._params_read,
    ClocksCompared: AgentCore._preflight_input,
    DiskChecked: AgentCore._disk_checked,
    MessagesCounted: AgentCore._messages_counted,
    TickFailed: AgentCore._tick_failed,
    MocapProblemChanged: AgentCore._mocap_problem,
    ShutdownRequested: AgentCore._stop_requested,
}
