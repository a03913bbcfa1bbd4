"""The memory of one vehicle's flight: its step, its order and its goal.

Every part of the agent may read the memory. Only the state machine and its effects write it.
Everything that depends only on the step (situation, control mode, whether setpoints are sent) is a
property of ``flight.step``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from onboard.agent_commands import Command, Publish
from onboard.bus.schema import AgentState, Event, Order, OrderOutcome, Severity
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.config.ground import lowest_ground_m
from onboard.control import path, router
from onboard.control.router import Surroundings
from onboard.flight.contact import LOW_M, ContactSigns
from onboard.flight.expected_ground import ExpectedGround
from onboard.flight.follow_flight import FollowFlight
from onboard.flight.path_flight import PathFlight
from onboard.flight.types import MUST_BE_ARMED, MUST_BE_OFFBOARD, FlightStep, FlightView
from onboard.safety.failsafe_table import Situation
from onboard.safety.report_confirmation import Expected
from onboard.tuples import Xyz
from onboard.types import Goal
from onboard.vectors import ZERO_3

# A vehicle that lands or lifts off below this height above the ground does not promise to avoid
# others, because it can no longer move aside once it touches the ground.
_AVOIDS_ABOVE_M = 0.5

# A vehicle this far below the ground that it expects flies above lower ground.
_UNEVEN_M = 0.1

_CONTACT_LIMIT_S = 8.0  # PX4 must confirm the landing within this time after the contact

# A landing fails if the vehicle rises again by more than this. With a mocap, the limit is more than
# avoidance explains. Without a mocap, it is more than the drift of PX4's height, which may rise
# after the touchdown.
_RISEN_M = 0.5
_PX4_HEIGHT_RISEN_M = 1.5

_MAY_FOLLOW_VEHICLE = (FlightStep.LEG, FlightStep.ARRIVED, FlightStep.HOLDING, FlightStep.COASTING)
_NEAR_THE_GROUND = (FlightStep.LIFTOFF, FlightStep.DESCENT, FlightStep.SINKING)
_NO_GOAL = Goal(position_enu_m=ZERO_3, duration_s=0.0, sequence=0)


class Overdue(NamedTuple):
    """A move or a landing that takes too long."""

    reason: str  # empty: its deadline has passed, without a known reason


@dataclass(slots=True)
class FlightContext:
    """Memory of one flight."""

    fleet: FleetConfig
    vehicle: Vehicle
    surroundings: Surroundings | None = None  # static obstacles; None: there are none

    step: FlightStep = FlightStep.WAITING
    reason: str = ""  # why the step began; shown to people beside the state
    step_ns: int = 0  # time when the step began
    steady_since_ns: int = 0  # since when the vehicle has been steady; now if it is not
    request_ns: int = 0  # time of the last request to PX4 in this step
    deadline_ns: int = 0  # time by which a move or a landing must end

    order: Order | None = None  # the order in progress
    goal: Goal = _NO_GOAL
    is_slow: bool = False  # whether a failsafe has slowed the order down
    leg_count: int = 0  # number of orders to move that have begun
    path: PathFlight = field(default_factory=PathFlight)
    follow: FollowFlight = field(default_factory=FollowFlight)

    expected_ground: ExpectedGround = field(default_factory=ExpectedGround)
    lowest_z_m: float = math.inf  # lowest height since the landing began, or since contact
    # height at which the search for the ground began: at the order to land, or at a contact
    search_began_z_m: float = -math.inf
    # the person who took the vehicle out of flights; empty: it takes part
    disabled_by: str = ""
    stands_in_for: str = ""  # the vehicle that this one replaces in the fleet; empty: none
    has_fallen: bool = False  # whether PX4 disarmed or restarted in this flight
    was_killed: bool = False  # whether a kill order stops, or has stopped, the motors
    contact: ContactSigns = field(default_factory=ContactSigns)
    # goal at the time when the poses stopped; the vehicle returns to its height once poses arrive
    # again
    seen_goal: Goal = _NO_GOAL

    commands: list[Command] = field(default_factory=list)  # commands that the core must take

    @property
    def state(self) -> AgentState:
        """State that is shown to people."""
        if self.step is FlightStep.COASTING and self.order is None:
            return "holding"
        return self.step.state

    @property
    def situation(self) -> Situation:
        """Column of the failsafe table."""
        return self.step.situation

    @property
    def expected(self) -> Expected:
        """Reports that PX4 sends while only this agent controls the vehicle."""
        mode = ""
        if self.step in MUST_BE_OFFBOARD:
            mode = "OFFBOARD"
        elif self.step is FlightStep.PX4_LANDING:
            mode = "LAND"
        return Expected(self.step in MUST_BE_ARMED, mode)

    @property
    def lands_for_a_person(self) -> bool:
        """Whether a person has ordered this vehicle by name to land.

        An order with a ``reason`` comes from a mission, or from a person to all vehicles.
        """
        order = self.order
        return order is not None and order.kind == "land" and not order.reason

    @property
    def slot_owner(self) -> str:
        """Name of the vehicle whose start, slots and paths this one uses: usually its own."""
        if self.stands_in_for:
            return self.stands_in_for
        return self.vehicle.name

    @property
    def followed(self) -> str:
        """Name of the vehicle that this one follows, paused or not; empty: none."""
        if self.follow.is_under_way and self.step in _MAY_FOLLOW_VEHICLE:
            return self.follow.leader
        return ""

    @property
    def is_paused(self) -> bool:
        """Whether an order has paused the path, or the following of a vehicle, until `resume`."""
        if self.path.show_id:
            return self.path.is_paused
        return bool(self.followed) and self.follow.is_paused

    @property
    def lowest_ground_m(self) -> float:
        """Height of the lowest ground that the vehicle may land on [m]."""
        return self.expected_ground.z_of(lowest_ground_m(self.fleet))

    @property
    def goal_position_enu_m(self) -> Xyz:
        """The point to fly to; on a path, the end of the path."""
        if self.step is FlightStep.PATH and self.path.path is not None:
            return path.point_at(self.path.path, math.inf).position_enu_m
        return self.goal.position_enu_m

    def is_avoiding(self, view: FlightView) -> bool:
        """Return whether other vehicles may count on this vehicle to avoid them."""
        if not self.step.is_under_law:
            return False
        is_low = self._height_m(view) < _AVOIDS_ABOVE_M
        touches_the_ground_soon = is_low and self.step in _NEAR_THE_GROUND
        return not touches_the_ground_soon

    def may_touch_the_ground(self, view: FlightView) -> bool:
        """Return whether the vehicle lifts off or lands, and is where it may touch the ground.

        Above lower ground, a vehicle that has passed the height of the expected ground flies again.
        """
        if self.step is FlightStep.CONTACT:
            return True
        if self.step not in _NEAR_THE_GROUND:
            return False

        is_height_exact = self.vehicle.mocap_required and not view.is_dead_reckoned
        if not is_height_exact:
            return self._height_m(view) < LOW_M

        _, _, z_m = view.position_enu_m
        heights_m = (z_m - self.expected_ground.z_m, z_m - self.expected_ground.landing_z_m)
        return any(-_UNEVEN_M < height_m < LOW_M for height_m in heights_m)

    def _height_m(self, view: FlightView) -> float:
        """Return the height above the expected ground [m]."""
        _, _, z_m = view.position_enu_m
        return z_m - self.expected_ground.z_m

    def route_length_m(self, view: FlightView, goal_enu_m: Xyz) -> float:
        """Return the length [m] of the route to a goal, around everything that stands still."""
        if self.surroundings is None:
            return math.dist(view.position_enu_m, goal_enu_m)
        return router.route_length_m(self.surroundings, view.position_enu_m, goal_enu_m)

    def seconds(self, view: FlightView) -> float:
        """Return the time since the step began [s]."""
        return (view.now_ns - self.step_ns) * 1e-9

    def steady_s(self, view: FlightView) -> float:
        """Return the time for which the vehicle has been steady in this step [s]."""
        return (view.now_ns - self.steady_since_ns) * 1e-9

    def overdue(self, view: FlightView) -> Overdue | None:
        """Return why a move or a landing is overdue, or None if it is not overdue."""
        step = self.step
        if step is FlightStep.DESCENT or step is FlightStep.CONTACT:
            is_height_known = view.has_position and not view.is_dead_reckoned
            limit_m = _PX4_HEIGHT_RISEN_M
            if self.vehicle.mocap_required:
                limit_m = _RISEN_M
            _, _, z_m = view.position_enu_m
            risen_m = z_m - self.lowest_z_m
            if is_height_known and risen_m > limit_m:
                return Overdue(f"it has risen by {risen_m:.2f} m")

        if step is FlightStep.CONTACT and self.seconds(view) > _CONTACT_LIMIT_S:
            return Overdue("PX4 does not see that it is down")

        is_timed = step is FlightStep.LEG or step is FlightStep.DESCENT
        if is_timed and view.now_ns > self.deadline_ns:
            return Overdue("")
        return None

    def say(
        self,
        view: FlightView,
        severity: Severity,
        code: str,
        sentence: str,
        order_id: str = "",
        outcome: OrderOutcome | Literal[""] = "",
    ) -> None:
        """Publish an event for people and programs."""
        event = Event(
            vehicle=self.vehicle.name,
            stamp_ns=view.now_ns,
            severity=severity,
            code=code,
            sentence=sentence,
            order_id=order_id,
            order_outcome=outcome,
        )
        self.commands.append(Publish(Topic.EVENT, event))

    def take_commands(self) -> list[Command]:
        """Return the commands since the last call, in order."""
        commands = self.commands
        self.commands = []
        return commands
