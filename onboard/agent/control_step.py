"""The pipeline of one vehicle: its parameters, its memory, the inputs of a pass and the newest result.

The only module of the agent that knows in which form the pipeline takes and gives its values.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from onboard.autopilot import Vec3, Vec4
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline
from onboard.control.pipeline import Phase, PipelineMemory
from onboard.flight.types import FlightGoal
from onboard.neighbours.table import NeighbourTable
from onboard.safety.setpoint_check import is_sendable
from onboard.types import Array, AttitudeSetpoint, Goal, LawStatus, Neighbours, State, Tick


class PipelineInputs(Struct, frozen=True):
    """Arguments of one pass that is due; the neighbours as of ``now_ns``."""

    memory: PipelineMemory
    state: State
    goal: Goal
    table: NeighbourTable
    now_ns: int
    dt_s: float
    phase: Phase

    @property
    def neighbours(self) -> Neighbours:
        """Frozen snapshot of the others."""
        return self.table.snapshot(self.now_ns)


class ControlStep:
    """Runs the pipeline once a tick.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        law: overrides the fleet file's law.
    """

    def __init__(self, fleet: FleetConfig, vehicle_name: str, law: str | None) -> None:
        vehicle = fleet.vehicles[vehicle_name]
        self.params = pipeline.pipeline_params(fleet, vehicle_name, law=law)
        self.law = self.params.law.name
        self.tick: Tick | None = None  # newest result
        self.is_finite = True  # whether the newest result can be flown
        self.hover_frac = vehicle.hover_thrust_frac  # learned in flight
        self._configured_hover_frac = vehicle.hover_thrust_frac
        self._max_tilt_deg = vehicle.max_tilt_deg
        self._start = np.asarray(vehicle.start_enu_m, dtype=np.float64)
        self._memory = pipeline.initial(self.params, self._start)
        self._flight_goal: FlightGoal | None = None
        self._goal: Goal

    def inputs(
        self, state: State | None, goal: FlightGoal, phase: Phase, table: NeighbourTable, now_ns: int, dt_s: float
    ) -> PipelineInputs:
        """Return the inputs of the pass that is due; without an estimate it stays on the ground at the start."""
        if state is None:
            zero = np.zeros(())
            state, phase = State(self._start, np.zeros(3), np.zeros(3), zero, zero, zero, zero), Phase.GROUND
        if goal is not self._flight_goal:
            self._flight_goal, self._goal = goal, _goal(goal)
        return PipelineInputs(self._memory, state, self._goal, table, now_ns, dt_s, phase)

    def run(self, due: PipelineInputs) -> tuple[PipelineMemory, Tick]:
        """Compute one pass."""
        return pipeline.step(
            due.memory, due.state, due.goal, due.neighbours, params=self.params, dt_s=due.dt_s, phase=due.phase
        )

    def accept(self, memory: PipelineMemory, tick: Tick) -> None:
        """Take the result of the pass."""
        self._memory, self.tick = memory, tick
        self.hover_frac = float(tick.hover_thrust_frac)
        self.is_finite = bool(tick.is_finite) and is_sendable(tick.attitude, self._max_tilt_deg)

    def law_result(self) -> tuple[int, int]:
        """Return status and active neighbour of the newest result; inactive and -1 before the first."""
        return (0, -1) if self.tick is None else (int(self.tick.law.status), int(self.tick.law.active_neighbour))

    def setpoint_height_m(self) -> float:
        """Return the height [m] of the newest trajectory setpoint."""
        return math.nan if self.tick is None else float(self.tick.setpoint.position_enu_m[2])

    def level(self) -> AttitudeSetpoint:
        """Return a level attitude at hover thrust."""
        hover_frac = self.hover_frac if math.isfinite(self.hover_frac) else self._configured_hover_frac
        return AttitudeSetpoint(np.array([1.0, 0.0, 0.0, 0.0]), np.asarray(hover_frac))


def _goal(goal: FlightGoal) -> Goal:
    return Goal(
        np.asarray(goal.position_enu_m, dtype=np.float64),
        np.asarray(goal.duration_s),
        np.asarray(goal.sequence, dtype=np.int64),
    )


def law_status(tick: Tick) -> str:
    """Return the law's status in a word."""
    return LawStatus(int(tick.law.status)).name.lower()


def vec3(array: Array) -> Vec3:
    """Return three floats."""
    x, y, z = array.tolist()
    return x, y, z


def vec4(array: Array) -> Vec4:
    """Return four floats."""
    w, x, y, z = array.tolist()
    return w, x, y, z
