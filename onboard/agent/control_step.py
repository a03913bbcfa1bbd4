"""Runs the control pipeline of one vehicle, and keeps its parameters, memory and newest result.

The core calls :meth:`ControlStep.run` at every tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from onboard.avoidance.own_law_runner import OwnLawRunner
from onboard.avoidance.params import still
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline, router
from onboard.control.control_mode import ControlMode
from onboard.control.pipeline import PipelineMemory
from onboard.estimation.disturbance_observer import ObserverMemory
from onboard.frames import turned_about_up
from onboard.safety.setpoint_check import is_sendable
from onboard.types import AttitudeSetpoint, Goal, Neighbour, State, Tick
from onboard.vectors import ZERO_3, Vec3

_LEVEL = (1.0, 0.0, 0.0, 0.0)  # wxyz

# type of :func:`onboard.control.pipeline.step`
PipelineStep = Callable[..., tuple[PipelineMemory, Tick]]


class ControlStep:
    """Runs the pipeline once a tick.

    Args:
        fleet: the fleet file.
        vehicle_name: one of its vehicles.
        clock: returns the time [s]; it measures how long a user's own law takes. None in simulated
            time.
        pipeline_step: ``pipeline.step``, or the same function compiled.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle_name: str,
        *,
        clock: Callable[[], float] | None = None,
        pipeline_step: PipelineStep = pipeline.step,
    ) -> None:
        vehicle = fleet.vehicles[vehicle_name]
        self.params = pipeline.pipeline_params(fleet, vehicle_name)
        self.obstacles = still(fleet)
        self.surroundings = router.surroundings(self.obstacles, self.params.law)

        self.tick: Tick | None = None  # newest result
        self.waits_for = router.NOBODY  # index of the neighbour to which it has given way
        self.is_finite = True  # whether the newest result can be flown
        self.hover_frac = vehicle.hover_thrust_frac  # learned in this flight
        self.flown_hover_frac = math.nan  # learned in the newest flight; NaN before the first one
        # why Covey's law flies instead of the user's law; empty if it does not
        self.law_refusal = ""

        self._configured_hover_frac = vehicle.hover_thrust_frac
        self._max_tilt_deg = vehicle.max_tilt_deg
        self._start_enu_m = Vec3(*vehicle.start_enu_m)
        self._pipeline_step = pipeline_step
        self._route = router.RouteMemory()
        self._memory = pipeline.initial(self.params, self._start_enu_m)
        self._own_law: OwnLawRunner | None = None
        if fleet.own_law is not None:
            self._own_law = OwnLawRunner(fleet.own_law, clock)

    @property
    def observer(self) -> ObserverMemory:
        """Memory of the disturbance observer after the newest pass."""
        return self._memory.observer

    def run(
        self,
        state: State | None,
        goal: Goal,
        mode: ControlMode,
        neighbours: Sequence[Neighbour],
        dt_s: float,
    ) -> Tick:
        """Return the result of one pass of the pipeline.

        Args:
            state: our own estimate. If it is None, the vehicle is assumed to be at its start.
            goal: goal of the order that is flown.
            mode: control mode of the flight's step.
            neighbours: neighbours as of this tick.
            dt_s: time since the last pass.
        """
        if state is None:
            state = State(
                position_enu_m=self._start_enu_m,
                velocity_enu_m_s=ZERO_3,
                acceleration_enu_m_s2=ZERO_3,
                yaw_rad=0.0,
                age_s=0.0,
                position_std_m=0.0,
                velocity_std_m_s=0.0,
            )
            mode = ControlMode.GROUND

        self.waits_for = router.NOBODY
        if mode in (ControlMode.FLYING, ControlMode.LANDING):
            # A landing vehicle waits for nobody, because it would sink on the way to a refuge.
            met = neighbours
            if mode is ControlMode.LANDING:
                met = ()
            self._route, goal = router.step(self._route, state, goal, met, self.surroundings, dt_s)
            self.waits_for = self._route.waits_for
        memory, tick = self._pass(state, goal, mode, neighbours, dt_s)

        self._memory = memory
        self.tick = tick
        self.hover_frac = tick.hover_thrust_frac
        if mode is ControlMode.FLYING:
            self.flown_hover_frac = tick.hover_thrust_frac
        self.is_finite = tick.is_finite and is_sendable(tick.attitude, self._max_tilt_deg)
        return tick

    def expect_push(self, push_enu_m_s2: Vec3) -> None:
        """Expect a push of the wind at the lift-off that begins with the next pass.

        Args:
            push_enu_m_s2: expected push [m/s^2], ENU, finite.
        """
        self._memory = pipeline.expecting_push(self._memory, push_enu_m_s2, self.params)

    def _pass(
        self,
        state: State,
        goal: Goal,
        mode: ControlMode,
        neighbours: Sequence[Neighbour],
        dt_s: float,
    ) -> tuple[PipelineMemory, Tick]:
        """Return the pipeline's memory and result after one pass, by Covey's or the user's law."""
        if self._own_law is None:
            return self._pipeline_step(
                self._memory, state, goal, neighbours, self.obstacles, mode, self.params, dt_s
            )

        if mode is ControlMode.GROUND:
            self._own_law.begin_anew()
        memory_and_tick = pipeline.step(
            self._memory,
            state,
            goal,
            neighbours,
            self.obstacles,
            mode,
            self.params,
            dt_s,
            law_step=self._own_law.step,
        )
        self.law_refusal = self._own_law.refusal
        return memory_and_tick

    @property
    def flies_own_law(self) -> bool:
        """Whether the user's law flies."""
        return self._own_law is not None and not self._own_law.refusal

    def replace_own_law(self, reason: str) -> None:
        """Let Covey's law fly the rest of this flight; see :meth:`OwnLawRunner.replace`."""
        assert self._own_law is not None
        self._own_law.replace(reason)

    def level(self) -> AttitudeSetpoint:
        """Return a level attitude at hover thrust, with the heading that was last commanded."""
        hover_frac = self.hover_frac
        if not math.isfinite(hover_frac):
            hover_frac = self._configured_hover_frac
        return AttitudeSetpoint(turned_about_up(_LEVEL, self._memory.yaw_rad), hover_frac)
