"""Judges flights on true positions, sampled every tick: separation, arrival, and why a flight
failed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.arrays import Array, IntArray
from onboard.config.fleet import FleetConfig
from onboard.rollout.rows import Rows
from onboard.types import LawStatus
from sitl.monte_carlo.clutter import clearances_m
from sitl.monte_carlo.scenarios import Plan
from sitl.monte_carlo.settings import ErrorClass
from sitl.monte_carlo.vehicles import TICK_S, Truth
from sitl.physics.contacts import HEIGHT_OF_DIAMETER

HOLD_S = 0.5  # everybody has arrived when all have been near their goals and slow for this long
_RECENT_S = 3.0
_STUCK_M_S = 0.10


@dataclass(frozen=True, slots=True)
class Trace:
    """A flight in samples: t_s (T,), position_enu_m (T, N, 3) true; status, active_neighbour (T, N)
    of the law.
    """

    t_s: Array
    position_enu_m: Array
    status: NDArray[np.int8]
    active_neighbour: NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one flight. Separations are between centres, over all pairs: horizontal ones, and
    with a vertical separation the larger of that and of the height difference in the same measure
    (docs/law.md).

    makespan_s: when all had arrived; inf if that did not happen in time, and then ``reason`` says
    why: "deadlock" (those missing stand still), "livelock" (they move and get no nearer) or "time"
    (they were still getting nearer). relaxed_share: of the vehicles' ticks. slew_rms_m_s3: of the
    horizontal command. intervention_m_s2: mean |u - u0|. path_ratio: flown paths over straight
    ones, of all together. min_clearance_m: of a body's outline from a static obstacle's; inf
    without obstacles, below 0 a collision.
    """

    min_separation_m: float
    violation_s: float
    violation_depth_m: float
    is_collision: bool
    makespan_s: float
    duration_s: float
    reason: str | None
    relaxed_share: float
    slew_rms_m_s3: float
    max_speed_m_s: float
    intervention_m_s2: float
    path_ratio: float
    min_clearance_m: float
    trace: Trace | None

    @property
    def is_success(self) -> bool:
        """Whether all arrived in time."""
        return math.isfinite(self.makespan_s)


class FlightMetrics:
    """Sums of the flights in the air (F rows), and the outcomes of those that have ended."""

    def __init__(
        self,
        plans: Sequence[Plan],
        longest_s: Sequence[float],
        fleet: FleetConfig,
        errors: ErrorClass,
        start_enu_m: Array,
        *,
        has_trace: bool,
    ) -> None:
        flights, count = start_enu_m.shape[:2]
        self._limit_m, self._body_m = fleet.fleet.safety_distance_m, fleet.fleet.body_diameter_m
        vertical_m = fleet.fleet.vertical_separation_m
        self._height_share = 0.0 if vertical_m is None else self._limit_m / vertical_m
        self._errors, self._obstacles = errors, plans[0].obstacles
        self.ticks = 0
        self._flights = np.arange(flights)
        self._done: dict[int, Outcome] = {}
        self._goal = np.stack([plan.goal_enu_m for plan in plans])
        self._earliest = np.array([plan.earliest_s for plan in plans])
        self._longest = np.array(longest_s, dtype=np.float64)
        self._counts = np.ones((flights, count), bool)  # whose arrival counts
        for f, plan in enumerate(plans):
            if plan.intruder_m_s is not None:
                self._counts[f, -1] = False
            if plan.lost is not None:
                self._counts[f, plan.lost[0]] = False
        self._pairs = np.triu_indices(count, 1)
        self._position = start_enu_m
        self._command = np.zeros((flights, count, 2))
        self._away = np.sqrt(((start_enu_m - self._goal) ** 2).sum(-1))
        self._straight = np.where(self._counts, self._away, 0.0).sum(-1)
        self._stay = np.zeros(flights)
        self._recent_speed = np.zeros((flights, count))
        self._recent_gain = np.zeros((flights, count))
        self._sums = {
            name: np.zeros(flights)
            for name in ("violation", "relaxed", "slew", "speed", "intervention", "path")
        }
        self._nearest, self._has_touched = np.full(flights, np.inf), np.zeros(flights, bool)
        self._clearance = np.full(flights, np.inf)
        self._see(start_enu_m)
        self._trace = _TraceBuffer(start_enu_m) if has_trace else None

    @property
    def time_s(self) -> float:
        """Since the start."""
        return self.ticks * TICK_S

    @property
    def outcomes(self) -> list[Outcome]:
        """Of all flights, in the order of the plans, when all have ended."""
        return [self._done[f] for f in sorted(self._done)]

    def _see(self, position_enu_m: Array) -> None:
        offset = position_enu_m[:, self._pairs[0]] - position_enu_m[:, self._pairs[1]]
        gap = offset[..., :2]
        distance = np.sqrt(np.einsum("fpc,fpc->fp", gap, gap))
        touches = distance < self._body_m
        if self._height_share > 0.0:
            height = np.abs(offset[..., 2])
            distance = np.maximum(distance, self._height_share * height)
            touches &= height < HEIGHT_OF_DIAMETER * self._body_m
        if self._obstacles:
            self._clearance = np.minimum(
                self._clearance, clearances_m(position_enu_m, self._obstacles, self._body_m)
            )
        self._has_touched |= np.asarray(touches.any(-1)) | (self._clearance < 0.0)
        nearest = distance.min(-1, initial=np.inf)
        self._nearest = np.minimum(self._nearest, nearest)
        self._sums["violation"] += TICK_S * (nearest < self._limit_m)

    def update(self, truth: Truth, ticks: Rows, active: IntArray) -> IntArray:
        """FlightMetrics one tick more; return the indexes of the flights that go on.

        Args:
            truth: after the tick.
            ticks: (F, N) of the pipelines.
            active: (F, N) the vehicle that each one avoids most, -1 for none.
        """
        self.ticks += 1
        position, sums, law = truth.position_enu_m, self._sums, ticks["law"]
        self._see(position)
        command = law["commanded_acceleration_enu_m_s2"][..., :2]
        if self.ticks > 1:
            change = (command - self._command) / TICK_S
            sums["slew"] += np.einsum("fnc,fnc->fn", change, change).mean(-1)
        self._command = command
        speed = np.sqrt(np.einsum("fnc,fnc->fn", truth.velocity_enu_m_s, truth.velocity_enu_m_s))
        sums["speed"] = np.maximum(sums["speed"], np.where(self._counts, speed, 0.0).max(-1))
        sums["relaxed"] += (law["status"] == int(LawStatus.RELAXED)).mean(-1)
        sums["intervention"] += law["intervention_m_s2"].mean(-1)
        step = position - self._position
        sums["path"] += np.where(
            self._counts, np.sqrt(np.einsum("fnc,fnc->fn", step, step)), 0.0
        ).sum(-1)
        self._position = position
        offset = position - self._goal
        away = np.sqrt(np.einsum("fnc,fnc->fn", offset, offset))
        blend = TICK_S / _RECENT_S
        self._recent_speed += blend * (speed - self._recent_speed)
        self._recent_gain += blend * ((self._away - away) / TICK_S - self._recent_gain)
        self._away = away
        if self._trace is not None:
            self._trace.add(self._flights, self.ticks, position, law["status"], active)
        is_there = (
            (away < self._errors.arrival_m) & (speed < self._errors.slow_m_s)
        ) | ~self._counts
        all_there = np.asarray(is_there.all(-1)) & (self.time_s >= self._earliest)
        self._stay = np.where(all_there, self._stay + 1.0, 0.0)
        has_arrived = self._stay * TICK_S > HOLD_S
        is_over = has_arrived | (self.time_s >= self._longest + HOLD_S)
        for row in np.flatnonzero(is_over):
            self._done[int(self._flights[row])] = self._outcome(
                int(row), bool(has_arrived[row]), is_there[row]
            )
        return np.flatnonzero(~is_over)

    def _outcome(self, row: int, has_arrived: bool, is_there: NDArray[np.bool_]) -> Outcome:
        sums = {name: float(values[row]) for name, values in self._sums.items()}
        nearest = float(self._nearest[row])
        reason = None
        if not has_arrived:
            missing = ~is_there
            if not missing.any() or (self._recent_gain[row, missing] > 0.02).any():
                reason = "time"
            else:
                reason = (
                    "deadlock"
                    if (self._recent_speed[row, missing] < _STUCK_M_S).all()
                    else "livelock"
                )
        flight = int(self._flights[row])
        return Outcome(
            min_separation_m=nearest,
            violation_s=sums["violation"],
            violation_depth_m=max(0.0, self._limit_m - nearest),
            is_collision=bool(self._has_touched[row]),
            makespan_s=self.time_s - (self._stay[row] - 1.0) * TICK_S if has_arrived else math.inf,
            duration_s=self.time_s,
            reason=reason,
            relaxed_share=sums["relaxed"] / self.ticks,
            slew_rms_m_s3=math.sqrt(sums["slew"] / self.ticks),
            max_speed_m_s=sums["speed"],
            intervention_m_s2=sums["intervention"] / self.ticks,
            path_ratio=sums["path"] / float(self._straight[row])
            if self._straight[row] > 0.1
            else math.nan,
            min_clearance_m=float(self._clearance[row]),
            trace=None if self._trace is None else self._trace.of(flight, self.ticks),
        )

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        for name in (
            *(
                "_flights",
                "_goal",
                "_earliest",
                "_longest",
                "_counts",
                "_position",
                "_command",
                "_away",
                "_straight",
            ),
            *("_stay", "_recent_speed", "_recent_gain", "_nearest", "_has_touched", "_clearance"),
        ):
            setattr(self, name, getattr(self, name)[flights])
        self._sums = {name: values[flights] for name, values in self._sums.items()}


class _TraceBuffer:
    """Samples of all flights from the start on, growing."""

    def __init__(self, start_enu_m: Array) -> None:
        flights, count = start_enu_m.shape[:2]
        self._position = np.zeros((512, flights, count, 3))
        self._status = np.zeros((512, flights, count), np.int8)
        self._active = np.full((512, flights, count), -1, np.int16)
        self._position[0] = start_enu_m

    def add(
        self, flights: IntArray, tick: int, position_enu_m: Array, status: Array, active: IntArray
    ) -> None:
        if tick == len(self._position):
            self._position, self._status, self._active = (
                np.concatenate([values, np.zeros_like(values)])
                for values in (self._position, self._status, self._active)
            )
        self._position[tick, flights] = position_enu_m
        self._status[tick, flights] = status
        self._active[tick, flights] = active

    def of(self, flight: int, ticks: int) -> Trace:
        last = ticks + 1
        return Trace(
            TICK_S * np.arange(last, dtype=np.float64),
            self._position[:last, flight].copy(),
            self._status[:last, flight].copy(),
            self._active[:last, flight].copy(),
        )
