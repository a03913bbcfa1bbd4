"""The agent without I/O: inputs and time come in, commands go out.

The shell in loop.py moves bytes and time. It passes every input on as it arrives (``handle``), and
calls ``tick`` 50 times a second. A tick asks, in this order:

    Where are we?          localization: mocap samples, attitude and thrust -> State
    Where are the others?  neighbours: their newest states as of now, and their distances
    Are corrections fresh? corrections: the age of the RTK corrections, and their base station
    What is wrong?         supervision: conditions, and the failsafe table's action
    What do we do?         flight: the step of the flight, and the goal of its order
    How do we fly that?    control: the pipeline, with the avoidance law -> attitude setpoint
    May we send it?        the last check before the wire
    Is the goal free?      a move ends if its goal stays too near to another vehicle's
    Who needs to know?     state for the neighbours, telemetry for people, samples for the record

Every vehicle decides for itself, from what it knows at this tick. Nothing here waits: anything that
takes longer than a tick is requested by a command, and its result arrives later as an input.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from onboard.agent.control_step import ControlStep, PipelineStep
from onboard.agent.messages import AgentIdentity, TelemetrySources, TickResult
from onboard.agent.order_gate import OrderGate
from onboard.agent.order_intake import OrderIntake
from onboard.agent.peers import BusNodes, NeighbourFollower
from onboard.agent.setpoint_output import SetpointOutput
from onboard.agent.telemetry import TelemetryPublisher
from onboard.agent_commands import (
    Command,
    Exit,
    Publish,
    Reply,
    RequestHeartbeat,
    SendCorrections,
    WatchBodies,
)
from onboard.agent_inputs import (
    AgentInput,
    AllPosesReceived,
    CertificateChecked,
    ClocksCompared,
    CorrectionsReceived,
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
    SetpointDropped,
    ShutdownRequested,
    SnapshotReceived,
    TickFailed,
)
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import StateMessage
from onboard.bus.topics import Topic
from onboard.config.fleet import CorrectionsConfig, FleetConfig
from onboard.config.ground import ground_at_m, is_level
from onboard.config.wind_limit import wind_limit_m_s
from onboard.control import pipeline, router
from onboard.control.control_mode import ControlMode
from onboard.control.pipeline import PipelineParams
from onboard.corrections.status import CorrectionsStatus
from onboard.flight import predicates, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.order_checks import OrderFacts
from onboard.flight.path_flight import OtherClock, other_clocks
from onboard.flight.types import FlightStep, FlightView
from onboard.localization.odometry_forwarding import OdometryForwarder
from onboard.localization.own_state import OwnEstimate, OwnState, normalised
from onboard.message_counts import MessageCounts
from onboard.neighbours.people import People
from onboard.neighbours.table import NeighbourTable
from onboard.neighbours.touchdowns import stop_at_touchdown
from onboard.neighbours.wind import wind_felt_by
from onboard.preflight.preflight_reporter import PreflightReporter
from onboard.safety.failsafe_table import Situation
from onboard.safety.geofence import fence_of
from onboard.safety.limits import POSITION_KNOWN_S
from onboard.safety.snapshot_check import nonsense
from onboard.supervision.failsafe_supervisor import FailsafeSupervisor
from onboard.supervision.model_mismatch_reporter import ModelMismatchReporter
from onboard.supervision.own_law_faults import fault_of_law
from onboard.supervision.tick_context import TickContext
from onboard.types import TICK_S, LawStatus, Tick
from onboard.vectors import ZERO_3, Vec3, scaled, subtract

if TYPE_CHECKING:
    from onboard.corrections.intake import CorrectionsIntake

# bounds of the time step that one tick integrates over
_SHORTEST_S = 0.005
_LONGEST_S = 0.1

_ZERO = (0.0, 0.0, 0.0)
_IN_AIR = (Landed.IN_AIR, Landed.TAKING_OFF, Landed.LANDING)
# the process may end in these situations: on the ground, and after it has given up a flight
# steps in which a user's law decides how the vehicle flies
_BY_OWN_LAW = frozenset(
    step
    for step in FlightStep
    if step.control_mode in (ControlMode.FLYING, ControlMode.LANDING)
    and step is not FlightStep.TAKEOVER
)
_MAY_END = (Situation.GROUND, Situation.SILENT)
# steps in which the process waits for PX4 to report that it has disarmed
_DISARMING_STEPS = (
    FlightStep.DISARMED,
    FlightStep.FAILSAFE_DISARMING,
    FlightStep.FAILED_DISARMING,
    FlightStep.KILLING,
)


class AgentCore:
    """One vehicle's agent.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        boot_id: number of this start of the process; each start has a different number.
        clock: returns the time [s]; it measures how long a user's own law takes. None in simulated
            time.
        pipeline_step: ``pipeline.step``, or the same function compiled.
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
        vehicle = fleet.vehicles[vehicle_name]
        self.fleet = fleet
        self.vehicle = vehicle
        self.identity = AgentIdentity(
            vehicle=vehicle,
            boot_id=boot_id,
            config_hash=fleet.config_hash,
            law=fleet.law.name,
            max_wind_m_s=wind_limit_m_s(fleet, vehicle),
        )

        # what the agent knows
        taken_corrections: CorrectionsConfig | None = None  # None: the vehicle uses none
        if fleet.takes_corrections(vehicle):
            taken_corrections = fleet.corrections
        self.own = OwnState(
            vehicle,
            fleet.fleet.global_origin,
            taken_corrections,
            uses_heights=fleet.fleet.height_share > 0.0,
            ground_at=_ground_at(fleet),
        )
        self.neighbours = NeighbourTable(fleet, vehicle_name)
        self.people = People(fleet, first_index=len(self.neighbours.names))
        self.nodes = BusNodes(fleet, vehicle_name)
        self.corrections = _intake_of(taken_corrections)
        self._corrections_status: CorrectionsStatus | None = None  # at the newest tick
        self._snapshot = Snapshot()  # newest snapshot of PX4, with confirmed reports only

        # what the agent decides
        self.control = ControlStep(fleet, vehicle_name, clock=clock, pipeline_step=pipeline_step)
        self.flight = FlightContext(fleet, vehicle, self.control.surroundings)
        self._fence = fence_of(fleet.fleet.geofence_m, vehicle)
        self.failsafes = FailsafeSupervisor(
            fleet=fleet,
            vehicle=vehicle,
            own=self.own,
            neighbours=self.neighbours,
            flight=self.flight,
        )
        self.preflight = PreflightReporter(
            fleet,
            vehicle,
            boot_id=boot_id,
            own=self.own,
            neighbours=self.neighbours,
            flight=self.flight,
        )
        gate = OrderGate(boot_id) if fleet.has_keys else None
        self._orders = OrderIntake(
            self.flight, self.failsafes, self.nodes.roles, boot_id=boot_id, gate=gate
        )
        self._mismatch = ModelMismatchReporter(vehicle)

        # what leaves the agent
        self.odometry = OdometryForwarder()
        self._setpoints = SetpointOutput(vehicle, self.own, self.flight, self.failsafes)
        self._follower = NeighbourFollower(self.neighbours)
        counts: list[MessageCounts] = []
        if self.corrections is not None:
            counts.append(self.corrections.counts)
        sources = TelemetrySources(
            own=self.own,
            neighbours=self.neighbours,
            flight=self.flight,
            failsafes=self.failsafes,
            roles=self.nodes.roles,
            duplicates=self.preflight.inputs.duplicates,
            orders=self._orders,
            corrections_counts=tuple(counts),
        )
        self._publisher = TelemetryPublisher(self.identity, sources, fleet.state_ticks)

        # from the newest inputs
        self._is_stopping = False  # a shutdown was requested
        self._is_disk_full = False
        self._battery_floor_frac = 0.0  # charge at which a simulated battery stops emptying
        self._clock_jump_ns = 0  # time of the last jump of our clock; 0: none yet

        # mocap bodies of other vehicles whose poses are needed
        self._watched_vehicles: tuple[str, ...] = ()
        # mocap bodies of vehicles and persons that were requested last
        self._requested_bodies: tuple[str, ...] = ()

        # from the newest tick
        self._period_s = TICK_S  # time since the previous tick
        self._ages_s: dict[str, float] = {}  # age of the state of each followed neighbour
        self._distances_m: dict[str, float] = {}  # separation from each neighbour and person
        self._people_m: dict[str, float] = {}  # separation from each person
        self._view = FlightView(
            now_ns=0,
            position_enu_m=_ZERO,
            velocity_enu_m_s=_ZERO,
            has_position=False,
            snapshot=self._snapshot,
        )

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
        """Whether a shutdown of this agent was requested."""
        return self._is_stopping

    # -- a tick ------------------------------------------------------------------------------------

    def tick(self, now_ns: int) -> list[Command]:
        """Run one pass; return its commands in the order of execution."""
        dt_s = self._measure_period(now_ns)

        # Where are we?
        own = self._estimate(now_ns, dt_s)
        view = self._build_view(now_ns, own)

        # Where are the others?
        self.neighbours.note_own_position(view.position_enu_m if view.has_position else None)
        self.neighbours.forget_replaced(self.flight.slot_owner, now_ns)
        self.neighbours.reposition_contradicted(view.position_enu_m, now_ns)
        self._ages_s = self.neighbours.followed_ages_s(now_ns)
        self._distances_m = self.neighbours.distances_m(view.position_enu_m, now_ns)
        if self.people.names:
            self._people_m = self.people.distances_m(view.position_enu_m, now_ns)
            self._distances_m |= self._people_m

        # Are corrections fresh?
        if self.corrections is not None:
            self._corrections_status = self.corrections.status(self._snapshot, now_ns)

        # What is wrong? And on the ground: may we take off?
        self._supervise(view, own)
        step_before = self.flight.step
        was_on_ground = step_before.situation is Situation.GROUND
        if was_on_ground or step_before is FlightStep.ARMED:
            self._check_preflight(view)

        # Is a user's law at fault?
        if self.control.flies_own_law and step_before in _BY_OWN_LAW:
            self._replace_faulty_law(view)

        # What do we do?
        state_machine.advance(self.flight, view)

        # How do we fly that?
        neighbours = self.neighbours.snapshot(now_ns)
        stop_at_touchdown(neighbours.rows, view.position_enu_m, self.neighbours)
        if self.people.names:
            neighbours = self.people.added_to(neighbours, now_ns)
        flight = self.flight
        if flight.step is FlightStep.LIFTOFF and step_before is not FlightStep.LIFTOFF:
            self._mismatch.begin_flight()
            self.control.expect_push(self._expected_push(now_ns))
        tick = self.control.run(own.state, flight.goal, flight.step.control_mode, neighbours, dt_s)
        if flight.step.control_mode is ControlMode.FLYING and self._mismatch.is_due():
            self._report_mismatch(view)

        # May we send it?
        setpoint = self._setpoints.commands(view, self.control)

        # Is the goal free?
        self._orders.check_conflict(view, self.neighbours.telemetries)

        # Who needs to know?
        messages = self._publisher.publish(self._result(tick, view))
        events = self.nodes.missed_events.pass_on(flight.take_commands(), now_ns)
        requests = self._requests(view, was_on_ground=was_on_ground)
        return [*messages.telemetry, *events, *setpoint, *messages.others, *requests]

    def _measure_period(self, now_ns: int) -> float:
        """Measure the time since the last tick; return it within the bounds for integration [s]."""
        last_tick_ns = self._view.now_ns
        self._period_s = TICK_S
        if last_tick_ns:
            self._period_s = (now_ns - last_tick_ns) * 1e-9
        if now_ns < last_tick_ns:
            self._clock_jump_ns = now_ns
        return min(max(self._period_s, _SHORTEST_S), _LONGEST_S)

    def _estimate(self, now_ns: int, dt_s: float) -> OwnEstimate:
        """Return the estimate of our own motion for this tick."""
        step = self.flight.step
        is_on_ground = step.control_mode is ControlMode.GROUND or step is FlightStep.LIFTOFF
        may_stand = predicates.may_have_ground_contact_without_poses(self.flight, self._view)

        self.own.is_flown = step.is_streaming
        return self.own.update(
            now_ns=now_ns,
            dt_s=dt_s,
            snapshot=self._snapshot,
            thrust_frac=self._setpoints.sent_thrust_frac,
            hover_frac=self.control.hover_frac,
            is_on_ground=is_on_ground or may_stand,
        )

    def _expected_push(self, now_ns: int) -> Vec3:
        """Return the push of the wind that neighbours in the air feel [m/s^2], ENU; zero if nobody
        knows it.
        """
        east_m_s, north_m_s = wind_felt_by(self.neighbours.telemetries().values(), now_ns)
        if not math.isfinite(east_m_s + north_m_s):
            return ZERO_3
        return scaled(self.vehicle.drag_1_s, Vec3(east_m_s, north_m_s, 0.0))

    def _build_view(self, now_ns: int, own: OwnEstimate) -> FlightView:
        """Store and return what the flight knows about its vehicle at this tick."""
        state = own.state
        if state is None:
            self._view = FlightView(
                now_ns=now_ns,
                position_enu_m=self._view.position_enu_m,
                velocity_enu_m_s=_ZERO,
                has_position=False,
                snapshot=self._snapshot,
                position_age_s=own.age_s,
                attitude_wxyz=own.attitude_wxyz,
            )
        else:
            self._view = FlightView(
                now_ns=now_ns,
                position_enu_m=state.position_enu_m,
                velocity_enu_m_s=state.velocity_enu_m_s,
                has_position=own.age_s < POSITION_KNOWN_S or own.is_dead_reckoned,
                snapshot=self._snapshot,
                thrust_share=self._setpoints.sent_thrust_frac / self.control.hover_frac,
                lift_share=self._setpoints.sent_lift_frac / self.control.hover_frac,
                other_clocks=self._other_clocks(now_ns),
                period_s=self._period_s,
                is_dead_reckoned=own.is_dead_reckoned,
                yaw_rad=state.yaw_rad,
                position_age_s=own.age_s,
                attitude_wxyz=own.attitude_wxyz,
                gust_m_s2=own.gust_m_s2,
                expected_gust_m_s2=own.expected_gust_m_s2,
            )
        return self._view

    def _other_clocks(self, now_ns: int) -> tuple[OtherClock, ...] | None:
        """Return the clocks of the other vehicles of the show; None if no comparison is due."""
        path = self.flight.path
        if not path.show_id or now_ns < path.compare_ns:
            return None
        telemetries = self.neighbours.telemetries().values()
        return tuple(other_clocks(telemetries, path.show_id, now_ns))

    def _supervise(self, view: FlightView, own: OwnEstimate) -> None:
        """Find the conditions that hold, and begin the action of the failsafe table."""
        context = self._tick_context(view, own)
        flight = self.flight
        decision = self.failsafes.decide(view, context, flight.step.situation)
        for report in decision.reports:
            flight.say(view, report.severity, report.code, report.sentence)
        if decision.cause:
            state_machine.begin_failsafe(
                flight, view, decision.action, decision.cause, decision.outcome
            )

    def _tick_context(self, view: FlightView, own: OwnEstimate) -> TickContext:
        """Return the values that the failsafes need besides the view and the flight."""
        control = self.control
        last_pass = control.tick

        # values before the first pass of the pipeline
        law_status = 0
        active_neighbour = router.NOBODY
        is_law_active = False
        setpoint_miss_m = 0.0  # horizontal distance from the setpoint to the predicted position

        if last_pass is not None:
            law = last_pass.law
            setpoint_enu_m = last_pass.setpoint.position_enu_m
            is_law_active = law.status != LawStatus.INACTIVE
            law_status = law.status
            active_neighbour = law.active_neighbour
            if control.waits_for != router.NOBODY:
                active_neighbour = control.waits_for

            miss = subtract(setpoint_enu_m, law.predicted_position_enu_m)
            setpoint_miss_m = math.hypot(miss.x, miss.y)

        unseen_people: tuple[str, ...] = ()
        if self.people.names:
            unseen_people = self.people.unseen(view.now_ns)

        return TickContext(
            own=own,
            # own process
            period_s=self._period_s,
            is_last_tick_finite=control.is_finite,
            law_refusal=control.law_refusal,
            is_stopping=self._is_stopping,
            has_duplicate=self.preflight.inputs.has_duplicate(view.now_ns),
            is_disk_full=self._is_disk_full,
            clock_jump_ns=self._clock_jump_ns,
            corrections=self._corrections_status,
            # bus
            has_ground=self.nodes.has_ground,
            bus_age_s=self.nodes.silence_s(self.neighbours.last_heard_ns, view.now_ns),
            # the vehicle and the others
            is_airborne=self._is_airborne(),
            battery_floor_frac=self._battery_floor_frac,
            nearest_m=min(self._distances_m.values(), default=math.inf),
            nearest_person=min(self._people_m, key=self._people_m.__getitem__, default=""),
            nearest_person_m=min(self._people_m.values(), default=math.inf),
            unseen_people=unseen_people,
            # the last pass of the pipeline
            law_status=law_status,
            active_neighbour=active_neighbour,
            commanded_wxyz=self._setpoints.quaternion_wxyz,
            thrust_frac=self._setpoints.sent_thrust_frac,
            below_m=self._below_trajectory_m(view),
            is_law_active=is_law_active,
            setpoint_miss_m=setpoint_miss_m,
            disturbance_enu_m_s2=control.observer.disturbance_enu_m_s2,
        )

    def _check_preflight(self, view: FlightView) -> None:
        self.preflight.update(
            view,
            self._period_s,
            is_airborne=self._is_airborne(),
            hover_frac=self.control.flown_hover_frac,
            conditions=self.failsafes.conditions,
            corrections=self._corrections_status,
            people_m=self._people_m,
            slot_owner=self.flight.slot_owner,
        )
        state_machine.preflight_checked(self.flight, view, not self.preflight.not_ready)

    def _replace_faulty_law(self, view: FlightView) -> None:
        """Let Covey's law take over from a user's law that flies the vehicle into something."""
        x, y, z_m = view.position_enu_m
        _, _, climb_m_s = view.velocity_enu_m_s
        ground = self.flight.expected_ground
        height_m = z_m - ground.z_of(float(ground_at_m(self.fleet, x, y)))
        below_m = 0.0  # a vehicle that lands does not stop above the ground
        if self.flight.step.control_mode is ControlMode.FLYING:
            below_m = self._below_trajectory_m(view)
        fault = fault_of_law(
            self.failsafes.conditions,
            self._fence,
            height_m=height_m,
            climb_m_s=climb_m_s,
            below_m=below_m,
        )
        if fault:
            self.control.replace_own_law(fault)

    def _below_trajectory_m(self, view: FlightView) -> float:
        """Return how far the vehicle is below its trajectory; 0 before the first pass."""
        if self.control.tick is None:
            return 0.0
        _, _, z_m = view.position_enu_m
        return self.control.tick.setpoint.position_enu_m.z - z_m

    def _report_mismatch(self, view: FlightView) -> None:
        """Report differences between the vehicle's response and its fleet file."""
        warnings = self._mismatch.update(
            self.control.observer, view.attitude_wxyz, self.control.hover_frac
        )
        for code, sentence in warnings:
            self.flight.say(view, "warning", code, sentence)

    def _result(self, tick: Tick, view: FlightView) -> TickResult:
        is_airborne = self._is_airborne()
        is_avoiding = view.has_position and self.flight.is_avoiding(view)
        return TickResult(
            tick=tick,
            view=view,
            state=self.flight.state,
            may_touch_the_ground=self.flight.may_touch_the_ground(view),
            is_cooperative=is_avoiding and self.failsafes.is_law_followed,
            period_s=self._period_s,
            is_airborne=is_airborne,
            ages_s=self._ages_s,
            distances_m=self._distances_m,
            not_ready=self.preflight.not_ready,
            corrections=self._corrections_status,
            waits_for=self.control.waits_for,
        )

    def _requests(self, view: FlightView, *, was_on_ground: bool) -> list[Command]:
        """Return the least urgent commands, which are due only occasionally."""
        requests: list[Command] = []

        position_enu_m = view.position_enu_m if view.has_position else None
        requests.extend(self._follower.due(position_enu_m, view.now_ns))

        bodies = self.neighbours.bodies_to_watch(view.now_ns, view.position_age_s)
        if bodies is not None:
            self._watched_vehicles = bodies
        watched = (*self.people.bodies, *self._watched_vehicles)
        if watched != self._requested_bodies:
            self._requested_bodies = watched
            requests.append(WatchBodies(watched))

        if self.failsafes.reports.is_heartbeat_due(view.now_ns):
            requests.append(RequestHeartbeat())

        if was_on_ground:
            report = self.preflight.due(view.now_ns)
            if report is not None:
                requests.append(Publish(Topic.PREFLIGHT, report))

        if self.corrections is not None:
            fragment = self.corrections.due(view.now_ns)
            if fragment is not None:
                requests.append(SendCorrections(fragment.flags, fragment.data))

        if self._is_stopping and self._may_end(view):
            requests.append(Exit())

        return requests

    def _may_end(self, view: FlightView) -> bool:
        """Return whether the process may end now.

        After the process has disarmed PX4, it waits at most a few seconds for PX4's confirmation.
        """
        flight = self.flight
        waited_long = predicates.px4_has_not_confirmed_in_time(flight, view)
        is_disarming = flight.step in _DISARMING_STEPS and not waited_long
        return flight.step.situation in _MAY_END and not is_disarming

    def _is_airborne(self) -> bool:
        """Return whether other vehicles must expect this vehicle to be in the air."""
        snapshot = self._snapshot
        if snapshot.is_armed and snapshot.landed in _IN_AIR:
            return True

        step = self.flight.step
        is_flown_by_px4 = step.situation in (Situation.PX4_LANDING, Situation.SILENT)
        if snapshot.is_armed and is_flown_by_px4:
            return not self._view.is_on_ground  # an old report of the ground does not count
        return step.is_under_law and step is not FlightStep.LIFTOFF

    # -- inputs ------------------------------------------------------------------------------------

    def handle(self, agent_input: AgentInput, now_ns: int) -> list[Command]:
        """Take one input; return the commands that follow at once.

        Only orders and poses have such commands. Other inputs take effect at the next tick.
        """
        return _RECEIVERS[type(agent_input)](self, agent_input, now_ns)

    def _snapshot_received(self, received: SnapshotReceived, now_ns: int) -> list[Command]:
        problem = nonsense(received.snapshot)
        if problem:
            self._publisher.counts.malformed += 1
            self.failsafes.reports.drop(problem, now_ns)
            self.preflight.hear(received)
            return []

        reports = self.failsafes.reports
        self._snapshot = reports.believe(received.snapshot, self.flight.expected)
        return []

    def _neighbour_received(self, received: NeighbourReceived, now_ns: int) -> list[Command]:
        message = received.message

        # A message under our own name comes from another agent. The preflight check does not need
        # the states of the others, which come often.
        is_own_name = message.vehicle == self.vehicle.name
        if is_own_name or not isinstance(message, StateMessage):
            self.preflight.hear(received)

        self.neighbours.hear(message, received.received_ns)
        return []

    def _pose_received(self, received: PoseReceived, now_ns: int) -> list[Command]:
        pose = normalised(received.pose)
        if pose is not received.pose:
            received = replace(received, pose=pose)
        self.preflight.hear(received)
        if pose.body != self.vehicle.body:
            if not self.people.hear_pose(pose, received.received_ns):
                self.neighbours.hear_pose(pose, received.received_ns)
            return []

        if not self.own.add_pose(pose, received.received_ns):
            return []

        # a pose shows that the bus works, unless the mocap is read directly
        if not self.fleet.mocap.direct:
            last_heard_ns = max(self.neighbours.last_heard_ns, received.received_ns)
            self.neighbours.last_heard_ns = last_heard_ns
        return list(self.odometry.take(pose, self._snapshot, now_ns))

    def _all_poses_received(self, received: AllPosesReceived, now_ns: int) -> list[Command]:
        for pose in received.poses:
            self.neighbours.note_mocap_position(pose, received.received_ns)
        return []

    def _corrections_received(self, received: CorrectionsReceived, now_ns: int) -> list[Command]:
        if self.corrections is not None:
            is_on_ground = self.flight.step.situation is Situation.GROUND
            self.corrections.hear(received.message, received.received_ns, is_on_ground=is_on_ground)
        return []

    def _order_received(self, received: OrderReceived, now_ns: int) -> list[Command]:
        view = replace(self._view, now_ns=now_ns, snapshot=self._snapshot)
        facts = OrderFacts(
            view=view,
            fleet=self.fleet,
            surroundings=self.control.surroundings,
            others=self.neighbours.telemetries(),
            last_positions_enu_m=self.neighbours.last_positions_enu_m(),
            distances_m=self._distances_m,
            not_ready=self.preflight.not_ready,
            not_ready_in_air=lambda: self.preflight.reasons_in_air(
                view, self.control.flown_hover_frac
            ),
        )
        reply = self._orders.take(received.order, facts, is_stopping=self._is_stopping)
        events = self.nodes.missed_events.pass_on(self.flight.take_commands(), now_ns)
        return [Reply(reply), *events]

    def _order_untrusted(self, received: OrderUntrusted, now_ns: int) -> list[Command]:
        commands: list[Command] = []
        reply = self._orders.refuse(received.order, replace(self._view, now_ns=now_ns))
        if received.order.is_answered:
            commands.append(Reply(reply))
        commands.extend(self.flight.take_commands())
        return commands

    def _node_changed(self, received: NodeChanged, now_ns: int) -> list[Command]:
        self.preflight.hear(received)
        self.nodes.update(received.node, received.is_alive, now_ns)
        return []

    def _params_read(self, received: ParamsRead, now_ns: int) -> list[Command]:
        self.preflight.hear(received)
        self._battery_floor_frac = received.battery_floor_frac
        return []

    def _certificate_checked(self, received: CertificateChecked, now_ns: int) -> list[Command]:
        self.preflight.hear(received)
        return []

    def _clocks_compared(self, received: ClocksCompared, now_ns: int) -> list[Command]:
        self.preflight.hear(received)
        return []

    def _loop_timed(self, received: LoopTimed, now_ns: int) -> list[Command]:
        self.preflight.hear(received)
        self._publisher.loop = received
        return []

    def _messages_counted(self, received: MessagesCounted, now_ns: int) -> list[Command]:
        counts = self._publisher.counts
        counts.malformed += received.malformed
        counts.refused += received.refused
        counts.dropped += received.dropped
        return []

    def _disk_checked(self, received: DiskChecked, now_ns: int) -> list[Command]:
        self._is_disk_full = received.is_full
        return []

    def _mocap_problem_changed(self, received: MocapProblemChanged, now_ns: int) -> list[Command]:
        self.preflight.hear(received)
        if received.sentence:
            self.flight.say(self._view, "warning", "mocap-source", received.sentence)
        return []

    def _setpoint_dropped(self, received: SetpointDropped, now_ns: int) -> list[Command]:
        self._setpoints.forget_last()
        return []

    def _tick_failed(self, received: TickFailed, now_ns: int) -> list[Command]:
        self.control.is_finite = False
        self.flight.say(self._view, "critical", "tick-failed", received.sentence)
        return []

    def _shutdown_requested(self, received: ShutdownRequested, now_ns: int) -> list[Command]:
        self._is_stopping = True
        return []


def _ground_at(fleet: FleetConfig) -> Callable[[float, float], float] | None:
    """Return a function from a point to the height of its ground by the fleet file; None: level."""
    if is_level(fleet):
        return None
    return lambda x_m, y_m: float(ground_at_m(fleet, x_m, y_m))


def _intake_of(corrections: CorrectionsConfig | None) -> CorrectionsIntake | None:
    """Return the intake of corrections; None for a vehicle that uses none."""
    if corrections is None:
        return None

    # imported here, because most fleets do not need it
    from onboard.corrections.intake import CorrectionsIntake

    return CorrectionsIntake(corrections)


_RECEIVERS: dict[type, Callable[[AgentCore, Any, int], list[Command]]] = {
    SnapshotReceived: AgentCore._snapshot_received,
    SetpointDropped: AgentCore._setpoint_dropped,
    NeighbourReceived: AgentCore._neighbour_received,
    PoseReceived: AgentCore._pose_received,
    AllPosesReceived: AgentCore._all_poses_received,
    CorrectionsReceived: AgentCore._corrections_received,
    OrderReceived: AgentCore._order_received,
    OrderUntrusted: AgentCore._order_untrusted,
    NodeChanged: AgentCore._node_changed,
    ParamsRead: AgentCore._params_read,
    CertificateChecked: AgentCore._certificate_checked,
    ClocksCompared: AgentCore._clocks_compared,
    LoopTimed: AgentCore._loop_timed,
    MessagesCounted: AgentCore._messages_counted,
    DiskChecked: AgentCore._disk_checked,
    MocapProblemChanged: AgentCore._mocap_problem_changed,
    TickFailed: AgentCore._tick_failed,
    ShutdownRequested: AgentCore._shutdown_requested,
}
