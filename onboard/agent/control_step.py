"""The pipeline of one vehicle: its parameters, its memory, the inputs of a pass and the newest
result.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from msgspec import Struct

from onboard.avoidance.params import obstacles
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline
from onboard.control.own_law_pipeline import OwnLawPipeline
from onboard.control.pipeline import Phase, PipelineMemory
from onboard.neighbours.table import NeighbourTable
from onboard.safety.setpoint_check import is_sendable
from onboard.types import AttitudeSetpoint, Goal, Neighbour, State, Tick
from onboard.vectors import ZERO_3, Vec3


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
    def neighbours(self) -> list[Neighbour]:
        """Frozen snapshot of the others."""
        return self.table.snapshot(self.now_ns)


class ControlStep:
    """Runs the pipeline once a tick.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        clock: seconds, by which a law of somebody's own is found slow; None in simulated time.
    """

    def __init__(
        self, fleet: FleetConfig, vehicle_name: str, clock: Callable[[], float] | None = None
    ) -> None:
        vehicle = fleet.vehicles[vehicle_name]
        self.params, self.obstacles = (
            pipeline.pipeline_params(fleet, vehicle_name),
            obstacles(fleet),
        )
        self.tick: Tick | None = None  # newest result
        self.is_finite = True  # whether the newest result can be flown
        self.hover_frac = vehicle.hover_thrust_frac  # learned in flight
        self._configured_hover_frac = vehicle.hover_thrust_frac
        self._max_tilt_deg = vehicle.max_tilt_deg
        self._start_enu_m = Vec3(*vehicle.start_enu_m)
        self._memory = pipeline.initial(self.params, self._start_enu_m)
        self._own_law = None if fleet.own_law is None else OwnLawPipeline(fleet.own_law, clock)

    @property
    def law_refusal(self) -> str:
        """Why Covey's law flies in the place of the one that the fleet file names; empty while it
        does not.
        """
        return "" if self._own_law is None else self._own_law.refusal

    def inputs(
        self,
        state: State | None,
        goal: Goal,
        phase: Phase,
        table: NeighbourTable,
        now_ns: int,
        dt_s: float,
    ) -> PipelineInputs:
        """Return the inputs of the pass that is due; without an estimate it stays on the ground at
        the start.
        """
        if state is None:
            state, phase = (
                State(self._start_enu_m, ZERO_3, ZERO_3, 0.0, 0.0, 0.0, 0.0),
                Phase.GROUND,
            )
        return PipelineInputs(self._memory, state, goal, table, now_ns, dt_s, phase)

    def run(self, due: PipelineInputs) -> tuple[PipelineMemory, Tick]:
        """Compute one pass."""
        step = pipeline.step if self._own_law is None else self._own_law.step
        return step(
            due.memory,
            due.state,
            due.goal,
            due.neighbours,
            self.obstacles,
            due.phase,
            self.params,
            due.dt_s,
        )

    def accept(self, memory: PipelineMemory, tick: Tick) -> None:
        """Take the result of the pass."""
        self._memory, self.tick = memory, tick
        self.hover_frac = tick.hover_thrust_frac
        self.is_finite = tick.is_finite and is_sendable(tick.attitude, self._max_tilt_deg)

    def level(self) -> AttitudeSetpoint:
        """Return a level attitude at hover thrust."""
        hover_frac = (
            self.hover_frac if math.isfinite(self.hover_frac) else self._configured_hover_frac
        )
        return AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), hover_frac)
