"""Judges flights by their true positions, every tick: separation, arrival, and why a flight failed.

Arrays hold all flights that are under way: F flights of N vehicles, P pairs of vehicles. When a
flight ends, its row is removed from all arrays, and its outcome is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.arrays import Array, BoolArray, IntArray
from onboard.config.fleet import FleetConfig
from onboard.constants import GRAVITY_M_S2
from onboard.flight.arrival import moved_by_gusts
from onboard.rollout.rows import Rows
from onboard.types import LawStatus
from sitl.monte_carlo.campaign_settings import ErrorClass
from sitl.monte_carlo.clutter import Outlines
from sitl.monte_carlo.scenarios import FlightPlan, person_radii_m
from sitl.monte_carlo.vehicles import TICK_S, TrueMotions
from sitl.physics.contacts import HEIGHT_OF_DIAMETER

HOLD_S = 0.5  # time for which all vehicles must be near their goals and slow to have arrived
_RECENT_S = 3.0  # time constant that smooths the progress towards a goal
_STUCK_M_S = 0.10  # a slower vehicle stands still
_APPROACHING_M_S = 0.02  # a vehicle that approaches its goal faster than this makes progress
_FIRST_SAMPLES = 512  # initial capacity of a trace


@dataclass(frozen=True, slots=True)
class Trace:
    """A flight in T samples."""

    t_s: Array  # (T,)
    position_enu_m: Array  # (T, N, 3) true position
    status: NDArray[np.int8]  # (T, N) LawStatus
    # (T, N) index of the vehicle that the law avoids most; -1 for none
    active_neighbour: NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """Result of one flight.

    Separations are between centres, over all pairs. They are horizontal. If the fleet has a
    vertical separation, a separation is the larger one of the horizontal distance and the scaled
    difference of heights (docs/law.md).
    """

    min_separation_m: float
    violation_s: float
    violation_depth_m: float
    is_collision: bool
    # Closing speed of two bodies, or of a body and a person's circle, when they first touched; NaN:
    # none touched. Contact with an obstacle does not count.
    contact_m_s: float
    makespan_s: float  # time at which all had arrived; inf if they did not arrive in time
    duration_s: float
    # Why not all arrived in time: "blocked" (a lost vehicle is so close to the goals of the missing
    # vehicles that they must not fly there), "deadlock" (the missing vehicles stand still),
    # "livelock" (they move, but do not approach their goals) or "time" (they were still approaching
    # them).
    reason: str | None
    # Share of the vehicles' ticks in which the law was relaxed. An intruder or a person counts
    # neither here nor in the other numbers of law, paths and energy.
    relaxed_share: float
    slew_rms_m_s3: float  # change of the horizontal command
    max_speed_m_s: float
    intervention_m_s2: float  # mean |u - u0|
    path_ratio: float  # length of all flown paths over that of all straight ones
    # smallest gap between a body and a static obstacle; inf without obstacles, below 0: a collision
    min_clearance_m: float
    energy_hover_s: float  # energy of the motors per vehicle, in seconds of hovering
    trace: Trace | None

    @property
    def is_success(self) -> bool:
        """Whether all arrived in time."""
        return math.isfinite(self.makespan_s)


@dataclass(slots=True)
class _Roles:
    """Properties of flights, vehicles and pairs, by the plans."""

    flight: IntArray  # (F,) index of the plan
    earliest_s: Array  # (F,) the flight does not end before
    longest_s: Array  # (F,) time after which the flight has failed
    straight_m: Array  # (F,) length of all straight lines from goal to goal

    is_counted: BoolArray  # (F, N) whether a vehicle's arrival counts
    is_lost: BoolArray  # (F, N)
    # (F, N) whether a vehicle flies by its commands; an intruder or a person does not
    is_controlled: BoolArray

    is_judged: BoolArray  # (F, P) whether the distance is judged; that from a liar is not
    radius_m: Array  # (F, P) radius of the circle around a person; 0 for a pair of vehicles
    touching_m: Array  # (F, P) distance below which the two touch


@dataclass(slots=True)
class _Course:
    """Positions of the vehicles on the ways to their goals, at the last tick."""

    goal_enu_m: Array  # (F, N, 3)
    is_last_goal: BoolArray  # (F, N)
    is_at_goal: BoolArray  # (F, N) whether a vehicle is near its goal, and slow
    ticks_there: Array  # (F,) ticks since all reached their last goals

    position_enu_m: Array  # (F, N, 3)
    command_m_s2: Array  # (F, N, 2)
    distance_m: Array  # (F, P), from a person's circle or between centres
    away_m: Array  # (F, N) distance from the goal
    recent_speed_m_s: Array  # (F, N) smoothed
    recent_gain_m_s: Array  # (F, N) smoothed speed towards the goal


@dataclass(slots=True)
class _Totals:
    """Sums over the ticks of each flight, and extremes, (F,)."""

    violation_s: Array
    path_m: Array  # of all vehicles

    # means over the vehicles, summed over the ticks
    relaxed: Array
    squared_slew: Array  # (m/s^3)^2
    intervention_m_s2: Array
    energy_hover_s: Array

    largest_speed_m_s: Array
    least_separation_m: Array
    least_clearance_m: Array
    has_touched: BoolArray
    contact_m_s: Array  # closing speed at the first touch; NaN: none


_Rows = TypeVar("_Rows", _Roles, _Course, _Totals)


def _only(arrays: _Rows, rows: IntArray) -> _Rows:
    """Return the arrays with only these rows."""
    kept = {field.name: getattr(arrays, field.name)[rows] for field in fields(arrays)}
    return replace(arrays, **kept)


class FlightMetrics:
    """Measures of the flights under way, and the outcomes of those that have ended."""

    def __init__(
        self,
        plans: Sequence[FlightPlan],
        longest_s: Sequence[float],
        fleet: FleetConfig,
        errors: ErrorClass,
        gusts_m_s2: Sequence[float],
        start_enu_m: Array,
        *,
        has_trace: bool,
    ) -> None:
        """Begin with all vehicles at their starts.

        Args:
            plans: plans of the F flights.
            longest_s: times (F,) after which a flight has failed.
            fleet: the fleet of all flights.
            errors: error class, which says how near to its goal and how slow a vehicle must be.
            gusts_m_s2: standard deviation (N,) per axis of the acceleration that gusts cause on
                each vehicle. They widen both limits, as in the agent.
            start_enu_m: starts (F, N, 3).
            has_trace: whether the outcomes hold samples.
        """
        count = start_enu_m.shape[1]
        moved = [moved_by_gusts(gust_m_s2) for gust_m_s2 in gusts_m_s2]
        self._near_m = errors.arrival_m + np.array([moved_m for moved_m, _ in moved])
        self._slow_m_s = errors.slow_m_s + np.array([moved_m_s for _, moved_m_s in moved])
        self._outlines = Outlines(plans[0].obstacles)

        self._limit_m = fleet.fleet.safety_distance_m
        self._body_m = fleet.fleet.body_diameter_m
        # a difference of heights times this is compared with the safety distance; 0: heights do
        # not count
        self._height_share = 0.0
        vertical_m = fleet.fleet.vertical_separation_m
        if vertical_m is not None:
            self._height_share = self._limit_m / vertical_m

        # least distance that vehicles keep from a vehicle that does not avoid
        least_lag_s = min(vehicle.lag_s for vehicle in fleet.vehicles.values())
        margin_m = fleet.law.margin_m(least_lag_s) + fleet.law.uncooperative_margin_m
        self._kept_from_lost_m = self._limit_m + margin_m

        self.ticks = 0
        self._done: dict[int, FlightOutcome] = {}  # by index of the plan
        self._pairs = np.triu_indices(count, 1)

        # rows of the flights under way; keep() drops those that have ended
        self._roles = self._roles_of(plans, longest_s)
        self._course = _course_at_start(plans, start_enu_m)
        self._totals = _totals_at_start(len(plans))

        self._measure_separation(start_enu_m)
        self._trace: _TraceBuffer | None = None
        if has_trace:
            self._trace = _TraceBuffer(start_enu_m)

    def _roles_of(self, plans: Sequence[FlightPlan], longest_s: Sequence[float]) -> _Roles:
        """Return what the plans say; ``longest_s`` as at the start."""
        flights = len(plans)
        count = plans[0].count
        first, second = self._pairs

        is_counted = np.ones((flights, count), bool)
        is_lost = np.zeros((flights, count), bool)
        is_controlled = np.ones((flights, count), bool)
        is_judged = np.ones((flights, len(first)), bool)
        for f, plan in enumerate(plans):
            if plan.intruder_m_s is not None:
                is_counted[f, -1] = False
                is_controlled[f, -1] = False
            if plan.lost is not None:
                lost_index, _, _ = plan.lost
                is_counted[f, lost_index] = False
                is_lost[f, lost_index] = True
            if plan.lie is not None:
                is_counted[f, plan.lie.member] = False
                is_judged[f] = (first != plan.lie.member) & (second != plan.lie.member)

        straight_m = np.zeros(flights)
        for f, plan in enumerate(plans):
            straight_m[f] = plan.legs_m[:, is_counted[f]].sum()

        of_vehicle_m = person_radii_m(plans)
        radius_m = np.maximum(of_vehicle_m[:, first], of_vehicle_m[:, second])
        # in a pair of a person and a vehicle, only the vehicle has half a body around its point
        bodies = np.where(radius_m > 0.0, 0.5, 1.0)

        return _Roles(
            flight=np.arange(flights),
            earliest_s=np.array([plan.earliest_s for plan in plans]),
            longest_s=np.array(longest_s, dtype=np.float64),
            straight_m=straight_m,
            is_counted=is_counted,
            is_lost=is_lost,
            is_controlled=is_controlled,
            is_judged=is_judged,
            radius_m=radius_m,
            touching_m=bodies * self._body_m,
        )

    @property
    def is_at_goal(self) -> BoolArray:
        """Whether each vehicle (F, N) is at the goal that it flies to."""
        return self._course.is_at_goal

    @property
    def time_s(self) -> float:
        """Time since the start."""
        return self.ticks * TICK_S

    @property
    def outcomes(self) -> list[FlightOutcome]:
        """Outcomes of the flights that have ended, in the order of the plans."""
        return [self._done[f] for f in sorted(self._done)]

    def update(self, truth: TrueMotions, ticks: Rows, active: IntArray) -> IntArray:
        """Add one tick; return the row indexes of the flights that go on.

        Args:
            truth: true motion after the tick.
            ticks: results (F, N) of the pipelines.
            active: index (F, N) of the vehicle that the law avoids most, -1 for none.
        """
        self.ticks += 1
        position = truth.position_enu_m
        velocity = truth.velocity_enu_m_s
        law = ticks["law"]
        speed = np.sqrt(np.einsum("fnc,fnc->fn", velocity, velocity))

        self._measure_separation(position)
        self._measure_law(law)
        self._measure_motion(position, speed)
        if self._trace is not None:
            self._trace.add(self._roles.flight, self.ticks, position, law["status"], active)

        course = self._course
        is_near = course.away_m < self._near_m
        is_slow = speed < self._slow_m_s
        course.is_at_goal = is_near & is_slow
        is_there = (course.is_at_goal & course.is_last_goal) | ~self._roles.is_counted
        return self._end_flights(is_there)

    def change_goals(self, goal_enu_m: Array, is_last: BoolArray) -> None:
        """Judge arrival and progress by these goals from now on.

        Args:
            goal_enu_m: (F, N, 3) where each vehicle flies to.
            is_last: (F, N) whether that is the last of its goals.
        """
        course = self._course
        course.goal_enu_m = goal_enu_m
        course.is_last_goal = is_last
        offset = course.position_enu_m - goal_enu_m
        course.away_m = np.sqrt(np.einsum("fnc,fnc->fn", offset, offset))

    def _measure_separation(self, position_enu_m: Array) -> None:
        """Note the distances of vehicles from each other and from obstacles."""
        roles = self._roles
        course = self._course
        totals = self._totals
        first, second = self._pairs
        offset = position_enu_m[:, first] - position_enu_m[:, second]  # (F, P, 3)
        horizontal = offset[..., :2]
        distance = np.sqrt(np.einsum("fpc,fpc->fp", horizontal, horizontal)) - roles.radius_m

        # the distance from a liar is not promised, so only the others are judged
        distance = np.where(roles.is_judged, distance, np.inf)
        touches = distance < roles.touching_m
        before_m = course.distance_m
        course.distance_m = distance
        if self._height_share > 0.0:
            height = np.abs(offset[..., 2])
            distance = np.maximum(distance, self._height_share * height)
            touches &= height < HEIGHT_OF_DIAMETER * self._body_m

        has_touched_now = touches.any(-1) & np.isnan(totals.contact_m_s)
        if has_touched_now.any():
            closing_m_s = np.full_like(before_m, -np.inf)
            np.subtract(before_m, course.distance_m, out=closing_m_s, where=touches)
            closing_m_s /= TICK_S
            totals.contact_m_s[has_touched_now] = closing_m_s.max(-1)[has_touched_now]

        nearest_gap_m = self._outlines.gaps_m(position_enu_m[..., :2]).min(-1)
        clearance_m = nearest_gap_m - 0.5 * self._body_m
        totals.least_clearance_m = np.minimum(totals.least_clearance_m, clearance_m)
        totals.has_touched |= np.asarray(touches.any(-1)) | (totals.least_clearance_m < 0.0)

        nearest_m = distance.min(-1, initial=np.inf)
        totals.least_separation_m = np.minimum(totals.least_separation_m, nearest_m)
        totals.violation_s += np.where(nearest_m < self._limit_m, TICK_S, 0.0)

    def _measure_law(self, law: Rows) -> None:
        """Note how the law changed the vehicles' commands."""
        command = law["commanded_acceleration_enu_m_s2"][..., :2]
        if self.ticks > 1:
            slew = (command - self._course.command_m_s2) / TICK_S
            self._totals.squared_slew += self._mean(np.einsum("fnc,fnc->fn", slew, slew))
        self._course.command_m_s2 = command

        is_relaxed = law["status"] == int(LawStatus.RELAXED)
        self._totals.relaxed += self._mean(is_relaxed)
        self._totals.intervention_m_s2 += self._mean(law["intervention_m_s2"])
        self._measure_energy(law["commanded_acceleration_enu_m_s2"])

    def _measure_energy(self, command_m_s2: Array) -> None:
        """Note what the motors spend; the power of a rotor grows with its thrust to the 3/2.

        That is the ideal rotor of momentum theory; Leishman, Principles of Helicopter
        Aerodynamics, section 2.3.
        """
        thrust_g = command_m_s2 / GRAVITY_M_S2
        thrust_g[..., 2] += 1.0  # the weight
        thrust_squared = np.einsum("fnc,fnc->fn", thrust_g, thrust_g)
        power = thrust_squared**0.75  # relative to hovering
        self._totals.energy_hover_s += TICK_S * self._mean(power)

    def _mean(self, values: Array | BoolArray) -> Array:
        """Return the means (F,) of values (F, N) over the vehicles that fly by their commands."""
        is_controlled = self._roles.is_controlled
        total = np.where(is_controlled, values, 0.0).sum(-1)
        return np.asarray(total / is_controlled.sum(-1))

    def _measure_motion(self, position: Array, speed: Array) -> None:
        """Note the lengths of the paths, the speeds, and the progress towards the goals."""
        course = self._course
        totals = self._totals
        is_counted = self._roles.is_counted

        fastest = np.where(is_counted, speed, 0.0).max(-1)
        totals.largest_speed_m_s = np.maximum(totals.largest_speed_m_s, fastest)

        step = position - course.position_enu_m
        step_length = np.sqrt(np.einsum("fnc,fnc->fn", step, step))
        totals.path_m += np.where(is_counted, step_length, 0.0).sum(-1)
        course.position_enu_m = position

        offset = position - course.goal_enu_m
        away = np.sqrt(np.einsum("fnc,fnc->fn", offset, offset))
        gain = (course.away_m - away) / TICK_S
        course.away_m = away

        blend = TICK_S / _RECENT_S
        course.recent_speed_m_s += blend * (speed - course.recent_speed_m_s)
        course.recent_gain_m_s += blend * (gain - course.recent_gain_m_s)

    def _end_flights(self, is_there: BoolArray) -> IntArray:
        """Keep the outcomes of the flights that are over; return the rows of the others.

        Args:
            is_there: (F, N) whether a vehicle is at its goal, or its arrival does not count.
        """
        roles = self._roles
        course = self._course
        is_all_there = np.asarray(is_there.all(-1)) & (self.time_s >= roles.earliest_s)
        course.ticks_there = np.where(is_all_there, course.ticks_there + 1.0, 0.0)

        has_arrived = course.ticks_there * TICK_S > HOLD_S
        is_late = self.time_s >= roles.longest_s + HOLD_S
        is_over = has_arrived | is_late

        for row in np.flatnonzero(is_over):
            flight = int(roles.flight[row])
            self._done[flight] = self._outcome(int(row), bool(has_arrived[row]), is_there[row])
        return np.flatnonzero(~is_over)

    def _outcome(self, row: int, has_arrived: bool, is_there: BoolArray) -> FlightOutcome:
        """Return the outcome of the flight in a row."""
        roles = self._roles
        totals = self._totals
        nearest_m = float(totals.least_separation_m[row])

        makespan_s = math.inf
        reason = None
        if has_arrived:
            # the time of the first tick in which all were there
            makespan_s = self.time_s - (self._course.ticks_there[row] - 1.0) * TICK_S
        else:
            reason = self._reason(row, missing=~is_there)

        # there is no ratio if the goals are at the starts
        path_ratio = math.nan
        if roles.straight_m[row] > 0.1:
            path_ratio = float(totals.path_m[row]) / float(roles.straight_m[row])

        trace = None
        if self._trace is not None:
            trace = self._trace.of(int(roles.flight[row]), self.ticks)

        return FlightOutcome(
            min_separation_m=nearest_m,
            violation_s=float(totals.violation_s[row]),
            violation_depth_m=max(0.0, self._limit_m - nearest_m),
            is_collision=bool(totals.has_touched[row]),
            contact_m_s=float(totals.contact_m_s[row]),
            makespan_s=makespan_s,
            duration_s=self.time_s,
            reason=reason,
            relaxed_share=float(totals.relaxed[row]) / self.ticks,
            slew_rms_m_s3=math.sqrt(float(totals.squared_slew[row]) / self.ticks),
            max_speed_m_s=float(totals.largest_speed_m_s[row]),
            intervention_m_s2=float(totals.intervention_m_s2[row]) / self.ticks,
            path_ratio=path_ratio,
            min_clearance_m=float(totals.least_clearance_m[row]),
            energy_hover_s=float(totals.energy_hover_s[row]),
            trace=trace,
        )

    def _reason(self, row: int, missing: BoolArray) -> str:
        """Return why a flight is late.

        Args:
            row: row of the flight.
            missing: (N,) whether a vehicle is not at its goal.
        """
        if not missing.any():
            return "time"
        if self._is_blocked(row, missing):
            return "blocked"
        if (self._course.recent_gain_m_s[row, missing] > _APPROACHING_M_S).any():
            return "time"
        if (self._course.recent_speed_m_s[row, missing] < _STUCK_M_S).all():
            return "deadlock"
        return "livelock"

    def _is_blocked(self, row: int, missing: BoolArray) -> bool:
        """Return whether the goal of every missing vehicle is too near to a lost vehicle.

        Args:
            row: row of the flight.
            missing: (N,) whether a vehicle is not at its goal.
        """
        lost = self._course.position_enu_m[row, self._roles.is_lost[row], :2]  # (L, 2)
        goals = self._course.goal_enu_m[row, missing, :2]  # (M, 2)
        gaps_m = np.hypot(*(goals[:, None] - lost[None, :]).transpose(2, 0, 1))  # (M, L)
        is_goal_blocked = (gaps_m < self._kept_from_lost_m).any(axis=1)
        return bool(is_goal_blocked.all())

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._roles = _only(self._roles, flights)
        self._course = _only(self._course, flights)
        self._totals = _only(self._totals, flights)


def _course_at_start(plans: Sequence[FlightPlan], start_enu_m: Array) -> _Course:
    flights, count = start_enu_m.shape[:2]
    goal_enu_m = np.stack([plan.goal_enu_m for plan in plans])
    has_one_goal = np.array([plan.later_goals_enu_m is None for plan in plans])

    return _Course(
        goal_enu_m=goal_enu_m,
        is_last_goal=np.repeat(has_one_goal[:, None], count, axis=1),
        is_at_goal=np.zeros((flights, count), bool),
        ticks_there=np.zeros(flights),
        position_enu_m=start_enu_m,
        command_m_s2=np.zeros((flights, count, 2)),
        distance_m=np.full((flights, count * (count - 1) // 2), np.inf),
        away_m=np.sqrt(((start_enu_m - goal_enu_m) ** 2).sum(-1)),
        recent_speed_m_s=np.zeros((flights, count)),
        recent_gain_m_s=np.zeros((flights, count)),
    )


def _totals_at_start(flights: int) -> _Totals:
    return _Totals(
        violation_s=np.zeros(flights),
        path_m=np.zeros(flights),
        relaxed=np.zeros(flights),
        squared_slew=np.zeros(flights),
        intervention_m_s2=np.zeros(flights),
        energy_hover_s=np.zeros(flights),
        largest_speed_m_s=np.zeros(flights),
        least_separation_m=np.full(flights, np.inf),
        least_clearance_m=np.full(flights, np.inf),
        has_touched=np.zeros(flights, bool),
        contact_m_s=np.full(flights, np.nan),
    )


class _TraceBuffer:
    """Samples of all flights from the start on; the arrays are doubled when they are full."""

    def __init__(self, start_enu_m: Array) -> None:
        flights, count = start_enu_m.shape[:2]
        self._position = np.zeros((_FIRST_SAMPLES, flights, count, 3))
        self._status = np.zeros((_FIRST_SAMPLES, flights, count), np.int8)
        self._active = np.full((_FIRST_SAMPLES, flights, count), -1, np.int16)
        self._position[0] = start_enu_m

    def add(
        self, flights: IntArray, tick: int, position_enu_m: Array, status: Array, active: IntArray
    ) -> None:
        if tick == len(self._position):
            self._position = np.concatenate([self._position, np.zeros_like(self._position)])
            self._status = np.concatenate([self._status, np.zeros_like(self._status)])
            self._active = np.concatenate([self._active, np.zeros_like(self._active)])

        self._position[tick, flights] = position_enu_m
        self._status[tick, flights] = status
        self._active[tick, flights] = active

    def of(self, flight: int, ticks: int) -> Trace:
        samples = ticks + 1
        return Trace(
            t_s=TICK_S * np.arange(samples, dtype=np.float64),
            position_enu_m=self._position[:samples, flight].copy(),
            status=self._status[:samples, flight].copy(),
            active_neighbour=self._active[:samples, flight].copy(),
        )
