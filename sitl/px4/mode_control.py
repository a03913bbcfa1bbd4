"""Control of a PX4 in each of its own modes and in OFFBOARD: from a situation to an actuation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from sitl.physics import frames
from sitl.physics.frames import Array
from sitl.px4 import modes
from sitl.px4.modes import LandedState, Mode
from sitl.px4.parameters import Parameters
from sitl.px4.position_control import PositionControl, PositionGoal, PositionLimits
from sitl.px4.signals import DRIFT_RAD_S, Actuation, AutopilotInputs, Setpoint, SetpointKind

TICK_S = 0.02
_SPOOL_S = 1.0
_FIRST_SHARE = 0.25
_TAKEOFF_REACHED_M, _TAKEOFF_NEAR_M = 0.1, 0.4
_TAKEOFF_PATIENCE_S = 6.5
_RTL_NEAR_M = 0.5
_HOVER_LEARN_S = 2.0
_NOWHERE = np.full(3, math.nan)
_STILL = np.zeros(3)


def level(yaw_rad: float) -> Array:
    """Attitude without tilt at a heading."""
    return np.array([math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)])


@dataclass(slots=True)
class ModeControl:
    """Memory of what is flown."""

    # the newest output
    actuation: Actuation = field(
        default_factory=lambda: Actuation(
            np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), False, 0.0, False
        )
    )
    goal: PositionGoal | None = (
        None  # where PX4's own control flies to; None while there is no such place
    )
    home_ned_m: Array = field(default_factory=lambda: np.zeros(3))  # (3,) where it was armed
    takeoff_height_m: float | None = None  # asked for by a command; None for MIS_TAKEOFF_ALT
    has_lost_attitude: bool = False  # the attitude control is broken until PX4 restarts
    _control: PositionControl = field(default_factory=PositionControl)
    _armed_time_s: float = 0.0
    _entry: AutopilotInputs | None = None
    _hold_ned_m: Array | None = None
    _yaw_setpoint_rad: float | None = None
    _hover_thrust_frac: float = 0.5

    def armed(self, now_s: float, inputs: AutopilotInputs | None, params: Parameters) -> None:
        """Start afresh, with home here."""
        self._armed_time_s = now_s
        self._control.reset()
        self._hover_thrust_frac = params["MPC_THR_HOVER"]
        if inputs is not None:
            self.home_ned_m = inputs.position_ned_m.copy()
        self.entered(inputs)

    def disarmed(self) -> None:
        """Motors off."""
        self.goal = None
        self.terminate()

    def entered(self, inputs: AutopilotInputs | None) -> None:
        """A mode begins here."""
        self._entry = inputs
        self._hold_ned_m = None
        self._yaw_setpoint_rad = None
        self._control.forget_horizontal()

    def hold_at(self, position_ned_m: Array) -> None:
        """Let Hold fly to another place (DO_REPOSITION); NaN keeps a coordinate."""
        self._hold_ned_m = position_ned_m

    def frame_jumped(self, shift_ned_m: Array) -> None:
        """Move what is remembered along with a jump of the local frame, so that the vehicle stays
        where it is.
        """
        self.home_ned_m = self.home_ned_m + shift_ned_m
        if self._entry is not None:
            self._entry = replace(
                self._entry, position_ned_m=self._entry.position_ned_m + shift_ned_m
            )
        if self._hold_ned_m is not None:
            self._hold_ned_m = self._hold_ned_m + shift_ned_m

    def terminate(self) -> None:
        """Motors off for good, though still armed."""
        self.actuation = Actuation(self.actuation.attitude, _STILL, False, 0.0, False)

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """Attitude and rate setpoints act at once; positions wait for the next tick."""
        if setpoint.kind is SetpointKind.POSITION:
            return
        attitude = self.actuation.attitude if setpoint.attitude is None else setpoint.attitude
        self.goal = None
        self._command(
            attitude,
            setpoint.thrust_frac,
            setpoint.rate_rad_s if setpoint.kind is SetpointKind.RATE else None,
        )

    def step(
        self,
        inputs: AutopilotInputs,
        mode: Mode,
        landed: LandedState,
        params: Parameters,
        setpoint: Setpoint | None,
    ) -> bool:
        """One tick of an armed vehicle; True when a take-off has reached its height."""
        self._learn_hover_thrust(inputs)
        if mode is Mode.OFFBOARD:
            if setpoint is not None and setpoint.goal is not None:
                self._fly(inputs, setpoint.goal, params)
            return False
        if mode is Mode.TERMINATION:
            self.terminate()
            return False
        rests = landed is LandedState.ON_GROUND
        if mode is not Mode.TAKEOFF and (rests or (inputs.on_ground and mode is not Mode.LOITER)):
            self._idle(self._start(inputs).yaw_rad)
            return False
        _FLOWN[mode](self, inputs, params)
        if mode is not Mode.TAKEOFF or rests:
            return False
        # The slow errors of the estimate keep the last centimetres away for seconds.
        is_patient = inputs.time_s - self._armed_time_s < _TAKEOFF_PATIENCE_S
        left_m = abs(float(inputs.position_ned_m[2]) - self._takeoff_down_m(params))
        return left_m < (_TAKEOFF_REACHED_M if is_patient else _TAKEOFF_NEAR_M)

    # -- modes -------------------------------------------------------------------------------------

    def _take_off(self, inputs: AutopilotInputs, params: Parameters) -> None:
        yaw = self._start(inputs).yaw_rad
        since_s = inputs.time_s - self._armed_time_s - _SPOOL_S
        if since_s < 0.0:
            self._idle(yaw)
            return
        position = np.array([self.home_ned_m[0], self.home_ned_m[1], self._takeoff_down_m(params)])
        # The climb begins gently, and from the ground at once.
        share = min(1.0, _FIRST_SHARE + since_s / max(params["MPC_TKO_RAMP_T"], 0.1))
        self._fly(
            inputs,
            PositionGoal(position, _STILL, yaw),
            params,
            up_m_s=share * params["MPC_TKO_SPEED"],
        )

    def _hold(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        position = start.position_ned_m
        if self._hold_ned_m is not None:
            position = np.where(np.isfinite(self._hold_ned_m), self._hold_ned_m, position)
        self._fly(inputs, PositionGoal(position, _STILL, start.yaw_rad), params)

    def _land(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        self._descend(inputs, start.position_ned_m, start.yaw_rad, params)

    def _return(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        home = np.array([self.home_ned_m[0], self.home_ned_m[1], start.position_ned_m[2]])
        if math.dist(home[:2], inputs.position_ned_m[:2]) < _RTL_NEAR_M:
            self._descend(inputs, home, start.yaw_rad, params)
        else:
            self._fly(inputs, PositionGoal(home, _STILL, start.yaw_rad), params)

    def _sink(self, inputs: AutopilotInputs, params: Parameters) -> None:
        # Level, whatever the position does: there is nobody at the sticks, or no position.
        down = np.array([0.0, 0.0, params["MPC_LAND_SPEED"]])
        self._fly(
            inputs, PositionGoal(_NOWHERE, down, self._start(inputs).yaw_rad), params, is_level=True
        )

    # -- parts -------------------------------------------------------------------------------------

    def _start(self, inputs: AutopilotInputs) -> AutopilotInputs:
        return self._entry or inputs

    def _takeoff_down_m(self, params: Parameters) -> float:
        height_m = (
            params["MIS_TAKEOFF_ALT"] if self.takeoff_height_m is None else self.takeoff_height_m
        )
        return float(self.home_ned_m[2]) - height_m

    def _descend(
        self, inputs: AutopilotInputs, at_ned_m: Array, yaw_rad: float, params: Parameters
    ) -> None:
        position = np.array([at_ned_m[0], at_ned_m[1], math.nan])
        speed = np.array([0.0, 0.0, params["MPC_LAND_SPEED"]])
        self._fly(
            inputs,
            PositionGoal(position, speed, yaw_rad),
            params,
            is_level=not inputs.has_local_position,
        )

    def _fly(
        self,
        inputs: AutopilotInputs,
        goal: PositionGoal,
        params: Parameters,
        *,
        up_m_s: float | None = None,
        is_level: bool = False,
    ) -> None:
        self.goal = goal
        yaw = self._heading(goal, inputs)
        attitude, thrust = self._control.step(
            goal,
            inputs.position_ned_m,
            inputs.velocity_ned_m_s,
            TICK_S,
            hover_thrust_frac=self._hover_thrust_frac,
            limits=PositionLimits(
                params["MPC_XY_CRUISE"],
                params["MPC_Z_VEL_MAX_UP"] if up_m_s is None else up_m_s,
                params["MPC_Z_VEL_MAX_DN"],
                math.radians(params["MPC_TILTMAX_AIR"]),
            ),
            yaw_rad=yaw,
        )
        self._command(level(yaw) if is_level else attitude, thrust)

    def _heading(self, goal: PositionGoal, inputs: AutopilotInputs) -> float:
        # A heading that is not asked for stays where it was when it was last asked for, or at the
        # mode's start.
        if math.isfinite(goal.yaw_rad):
            self._yaw_setpoint_rad = goal.yaw_rad
        elif self._yaw_setpoint_rad is None:
            self._yaw_setpoint_rad = inputs.yaw_rad
        if not math.isfinite(goal.yaw_rad) and math.isfinite(goal.yaw_rate_rad_s):
            turned = self._yaw_setpoint_rad + TICK_S * max(
                -math.pi, min(math.pi, goal.yaw_rate_rad_s)
            )
            self._yaw_setpoint_rad = math.remainder(turned, 2.0 * math.pi)
        return self._yaw_setpoint_rad

    def _idle(self, yaw_rad: float) -> None:
        self._control.reset()
        self.goal = None
        self._command(level(yaw_rad), 0.0)

    def _command(
        self, attitude: Array, thrust_frac: float, rate_rad_s: Array | None = None
    ) -> None:
        if self.has_lost_attitude:
            rate_rad_s = DRIFT_RAD_S
        is_rate = rate_rad_s is not None
        self.actuation = Actuation(
            attitude, _STILL if rate_rad_s is None else rate_rad_s, is_rate, thrust_frac, True
        )

    def _learn_hover_thrust(self, inputs: AutopilotInputs) -> None:
        # PX4 estimates its hover thrust in flight; without that a heavy vehicle sinks when a
        # failsafe takes over.
        if inputs.on_ground or abs(inputs.velocity_ned_m_s[2]) > 0.5:
            return
        lift = self.actuation.thrust_frac * frames.uprightness(inputs.attitude)
        learned = self._hover_thrust_frac + TICK_S / _HOVER_LEARN_S * (
            lift - self._hover_thrust_frac
        )
        self._hover_thrust_frac = min(0.9, max(0.1, learned))


_FLOWN: dict[Mode, Callable[[ModeControl, AutopilotInputs, Parameters], None]] = {
    Mode.TAKEOFF: ModeControl._take_off,
    Mode.LOITER: ModeControl._hold,
    Mode.MISSION: ModeControl._hold,
    Mode.RTL: ModeControl._return,
    Mode.LAND: ModeControl._land,
    **dict.fromkeys(modes.BLIND_DESCENT, ModeControl._sink),
}
