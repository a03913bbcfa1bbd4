"""Judges flights by their true positions, every tick: separation, arrival, and why a flight failed.

Arrays hold all flights that are under way: F flights of N vehicles, P pairs of vehicles. When a
flight ends, its row is removed from all arrays, and its outcome is kept.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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


class FlightMetrics:
    """Sums of the flights under way (F rows), and the outcomes of those that have ended."""

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
        flights, count = start_enu_m.shape[:2]
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

        self.ticks = 0
        self._done: dict[int, FlightOutcome] = {}  # by index of the plan
        self._pairs = np.triu_indices(count, 1)
        pair_count = count * (count - 1) // 2

        # least distance that vehicles keep from a vehicle that does not avoid
        least_lag_s = min(vehicle.lag_s for vehicle in fleet.vehicles.values())
        margin_m = fleet.law.margin_m(least_lag_s) + fleet.law.uncooperative_margin_m
        self._kept_from_lost_m = self._limit_m + margin_m

        # From here on: rows (F, ...) of the flights under way; keep() drops those that have ended.
        self._flights = np.arange(flights)
        self._goal = np.stack([plan.goal_enu_m for plan in plans])
        self._earliest = np.array([plan.earliest_s for plan in plans])
        self._longest = np.array(longest_s, dtype=np.float64)

        self._counts = np.ones((flights, count), bool)  # whether a vehicle's arrival counts
        self._is_lost = np.zeros((flights, count), bool)
        # whether a vehicle flies by its commands; an intruder or a person does not
        self._is_controlled = np.ones((flights, count), bool)
        for f, plan in enumerate(plans):
            if plan.intruder_m_s is not None:
                self._counts[f, -1] = False
                self._is_controlled[f, -1] = False
            if plan.lost is not None:
                lost_index, _, _ = plan.lost
                self._counts[f, lost_index] = False
                self._is_lost[f, lost_index] = True
            if plan.lie is not None:
                self._counts[f, plan.lie.member] = False
        self._is_judged = self._judged_pairs(plans)
        self._radius_m = self._pair_radii_m(plans)
        # in a pair of a person and a vehicle, only the vehicle has half a body around its point
        bodies = np.where(self._radius_m > 0.0, 0.5, 1.0)
        self._touching_m = bodies * self._body_m

        self._position = start_enu_m
        self._command = np.zeros((flights, count, 2))
        self._away = np.sqrt(((start_enu_m - self._goal) ** 2).sum(-1))  # (F, N) distance from goal
        self._straight = np.where(self._counts, self._away, 0.0).sum(-1)
        for f, plan in enumerate(plans):
            if plan.later_goals_enu_m is not None:
                self._straight[f] = plan.legs_m.sum(axis=0)[self._counts[f]].sum()
        # (F, N): whether a vehicle is at the goal that it flies to, and whether that is its last
        self.is_at_goal = np.zeros((flights, count), bool)
        has_one_goal = np.array([plan.later_goals_enu_m is None for plan in plans])
        self._is_last = np.repeat(has_one_goal[:, None], count, axis=1)
        self._ticks_there = np.zeros(flights)  # ticks since all reached their goals
        self._recent_speed = np.zeros((flights, count))
        self._recent_gain = np.zeros((flights, count))  # smoothed speed towards the goal

        self._sums = {
            "violation": np.zeros(flights),
            "relaxed": np.zeros(flights),
            "slew": np.zeros(flights),
            "speed": np.zeros(flights),  # the greatest speed, which is not a sum
            "intervention": np.zeros(flights),
            "path": np.zeros(flights),
            "energy": np.zeros(flights),
        }
        self._nearest = np.full(flights, np.inf)
        self._has_touched = np.zeros(flights, bool)
        self._contact_m_s = np.full(flights, np.nan)  # closing speed at the first touch
        self._apart_m = np.full((flights, pair_count), np.inf)  # at the last tick
        self._clearance = np.full(flights, np.inf)

        self._measure_separation(start_enu_m)
        self._trace: _TraceBuffer | None = None
        if has_trace:
            self._trace = _TraceBuffer(start_enu_m)

    def _judged_pairs(self, plans: Sequence[FlightPlan]) -> BoolArray:
        """Return the pairs (F, P) whose distance is judged: all but those of a liar."""
        first, second = self._pairs
        is_judged = np.ones((len(plans), len(first)), bool)
        for f, plan in enumerate(plans):
            if plan.lie is not None:
                is_judged[f] = (first != plan.lie.member) & (second != plan.lie.member)
        return is_judged

    def _pair_radii_m(self, plans: Sequence[FlightPlan]) -> Array:
        """Return the radii (F, P) of the circles around persons, to which distances are measured.

        They are 0 for pairs of vehicles.
        """
        radii_m = person_radii_m(plans)
        first, second = self._pairs
        return np.asarray(np.maximum(radii_m[:, first], radii_m[:, second]))

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
            self._trace.add(self._flights, self.ticks, position, law["status"], active)

        is_near = self._away < self._near_m
        is_slow = speed < self._slow_m_s
        self.is_at_goal = is_near & is_slow
        is_there = (self.is_at_goal & self._is_last) | ~self._counts
        return self._end_flights(is_there)

    def change_goals(self, goal_enu_m: Array, is_last: BoolArray) -> None:
        """Judge arrival and progress by these goals from now on.

        Args:
            goal_enu_m: (F, N, 3) where each vehicle flies to.
            is_last: (F, N) whether that is the last of its goals.
        """
        self._goal = goal_enu_m
        self._is_last = is_last
        offset = self._position - goal_enu_m
        self._away = np.sqrt(np.einsum("fnc,fnc->fn", offset, offset))

    def _measure_separation(self, position_enu_m: Array) -> None:
        """Note the distances of vehicles from each other and from obstacles."""
        first, second = self._pairs
        offset = position_enu_m[:, first] - position_enu_m[:, second]  # (F, P, 3)
        horizontal = offset[..., :2]
        distance = np.sqrt(np.einsum("fpc,fpc->fp", horizontal, horizontal)) - self._radius_m

        # the distance from a liar is not promised, so only the others are judged
        distance = np.where(self._is_judged, distance, np.inf)
        touches = distance < self._touching_m
        before_m = self._apart_m
        self._apart_m = distance
        if self._height_share > 0.0:
            height = np.abs(offset[..., 2])
            distance = np.maximum(distance, self._height_share * height)
            touches &= height < HEIGHT_OF_DIAMETER * self._body_m

        has_touched_now = touches.any(-1) & np.isnan(self._contact_m_s)
        if has_touched_now.any():
            closing_m_s = np.full_like(before_m, -np.inf)
            np.subtract(before_m, self._apart_m, out=closing_m_s, where=touches)
            closing_m_s /= TICK_S
            self._contact_m_s[has_touched_now] = closing_m_s.max(-1)[has_touched_now]

        nearest_gap_m = self._outlines.gaps_m(position_enu_m[..., :2]).min(-1)
        self._clearance = np.minimum(self._clearance, nearest_gap_m - 0.5 * self._body_m)
        self._has_touched |= np.asarray(touches.any(-1)) | (self._clearance < 0.0)

        nearest = distance.min(-1, initial=np.inf)
        self._nearest = np.minimum(self._nearest, nearest)
        self._sums["violation"] += np.where(nearest < self._limit_m, TICK_S, 0.0)

    def _measure_law(self, law: Rows) -> None:
        """Note how the law changed the vehicles' commands."""
        command = law["commanded_acceleration_enu_m_s2"][..., :2]
        if self.ticks > 1:
            slew = (command - self._command) / TICK_S
            self._sums["slew"] += self._mean(np.einsum("fnc,fnc->fn", slew, slew))
        self._command = command

        is_relaxed = law["status"] == int(LawStatus.RELAXED)
        self._sums["relaxed"] += self._mean(is_relaxed)
        self._sums["intervention"] += self._mean(law["intervention_m_s2"])
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
        self._sums["energy"] += TICK_S * self._mean(power)

    def _mean(self, values: Array | BoolArray) -> Array:
        """Return the means (F,) of values (F, N) over the vehicles that fly by their commands."""
        total = np.where(self._is_controlled, values, 0.0).sum(-1)
        return np.asarray(total / self._is_controlled.sum(-1))

    def _measure_motion(self, position: Array, speed: Array) -> None:
        """Note the lengths of the paths, the speeds, and the progress towards the goals."""
        fastest = np.where(self._counts, speed, 0.0).max(-1)
        self._sums["speed"] = np.maximum(self._sums["speed"], fastest)

        step = position - self._position
        step_length = np.sqrt(np.einsum("fnc,fnc->fn", step, step))
        self._sums["path"] += np.where(self._counts, step_length, 0.0).sum(-1)
        self._position = position

        offset = position - self._goal
        away = np.sqrt(np.einsum("fnc,fnc->fn", offset, offset))
        gain = (self._away - away) / TICK_S
        self._away = away

        blend = TICK_S / _RECENT_S
        self._recent_speed += blend * (speed - self._recent_speed)
        self._recent_gain += blend * (gain - self._recent_gain)

    def _end_flights(self, is_there: BoolArray) -> IntArray:
        """Keep the outcomes of the flights that are over; return the rows of the others.

        Args:
            is_there: (F, N) whether a vehicle is at its goal, or its arrival does not count.
        """
        is_all_there = np.asarray(is_there.all(-1)) & (self.time_s >= self._earliest)
        self._ticks_there = np.where(is_all_there, self._ticks_there + 1.0, 0.0)

        has_arrived = self._ticks_there * TICK_S > HOLD_S
        is_late = self.time_s >= self._longest + HOLD_S
        is_over = has_arrived | is_late

        for row in np.flatnonzero(is_over):
            flight = int(self._flights[row])
            self._done[flight] = self._outcome(int(row), bool(has_arrived[row]), is_there[row])
        return np.flatnonzero(~is_over)

    def _outcome(self, row: int, has_arrived: bool, is_there: BoolArray) -> FlightOutcome:
        """Return the outcome of the flight in a row."""
        flight = int(self._flights[row])
        sums = {name: float(values[row]) for name, values in self._sums.items()}
        nearest_m = float(self._nearest[row])

        makespan_s = math.inf
        reason = None
        if has_arrived:
            # the time of the first tick in which all were there
            makespan_s = self.time_s - (self._ticks_there[row] - 1.0) * TICK_S
        else:
            reason = self._reason(row, missing=~is_there)

        # there is no ratio if the goals are at the starts
        path_ratio = math.nan
        if self._straight[row] > 0.1:
            path_ratio = sums["path"] / float(self._straight[row])

        trace = None
        if self._trace is not None:
            trace = self._trace.of(flight, self.ticks)

        return FlightOutcome(
            min_separation_m=nearest_m,
            violation_s=sums["violation"],
            violation_depth_m=max(0.0, self._limit_m - nearest_m),
            is_collision=bool(self._has_touched[row]),
            contact_m_s=float(self._contact_m_s[row]),
            makespan_s=makespan_s,
            duration_s=self.time_s,
            reason=reason,
            relaxed_share=sums["relaxed"] / self.ticks,
            slew_rms_m_s3=math.sqrt(sums["slew"] / self.ticks),
            max_speed_m_s=sums["speed"],
            intervention_m_s2=sums["intervention"] / self.ticks,
            path_ratio=path_ratio,
            min_clearance_m=float(self._clearance[row]),
            energy_hover_s=sums["energy"],
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
        if (self._recent_gain[row, missing] > _APPROACHING_M_S).any():
            return "time"
        if (self._recent_speed[row, missing] < _STUCK_M_S).all():
            return "deadlock"
        return "livelock"

    def _is_blocked(self, row: int, missing: BoolArray) -> bool:
        """Return whether the goal of every missing vehicle is too near to a lost vehicle.

        Args:
            row: row of the flight.
            missing: (N,) whether a vehicle is not at its goal.
        """
        lost = self._position[row, self._is_lost[row], :2]  # (L, 2)
        goals = self._goal[row, missing, :2]  # (M, 2)
        gaps_m = np.hypot(*(goals[:, None] - lost[None, :]).transpose(2, 0, 1))  # (M, L)
        is_goal_blocked = (gaps_m < self._kept_from_lost_m).any(axis=1)
        return bool(is_goal_blocked.all())

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._flights = self._flights[flights]
        self._goal = self._goal[flights]
        self._is_last = self._is_last[flights]
        self.is_at_goal = self.is_at_goal[flights]
        self._earliest = self._earliest[flights]
        self._longest = self._longest[flights]
        self._counts = self._counts[flights]
        self._is_lost = self._is_lost[flights]
        self._is_controlled = self._is_controlled[flights]
        self._is_judged = self._is_judged[flights]
        self._radius_m = self._radius_m[flights]
        self._touching_m = self._touching_m[flights]

        self._position = self._position[flights]
        self._command = self._command[flights]
        self._away = self._away[flights]
        self._straight = self._straight[flights]
        self._ticks_there = self._ticks_there[flights]
        self._recent_speed = self._recent_speed[flights]
        self._recent_gain = self._recent_gain[flights]

        self._sums = {name: values[flights] for name, values in self._sums.items()}
        self._nearest = self._nearest[flights]
        self._has_touched = self._has_touched[flights]
        self._contact_m_s = self._contact_m_s[flights]
        self._apart_m = self._apart_m[flights]
        self._clearance = self._clearance[flights]


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
