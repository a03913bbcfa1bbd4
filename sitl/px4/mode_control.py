"""Control of a PX4 in each of its own modes and in OFFBOARD: from its inputs to an actuation.

Each of PX4's modes states a goal (a position, a speed, a heading), and `position_control.py` flies
to it. An OFFBOARD setpoint of a position is such a goal, too; one of an attitude or of rates is
flown as it is.
"""

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
from sitl.px4.sticks import Axes

TICK_S = 0.02
_SPOOL_S = 1.0  # from arming until a take-off begins
_FIRST_SHARE = 0.25  # of the climb speed, with which the ramp of a take-off begins

# A take-off ends close to its height; after a while it ends also when it has come near.
_TAKEOFF_REACHED_M = 0.1
_TAKEOFF_NEAR_M = 0.4
_TAKEOFF_PATIENCE_S = 6.5

_RTL_NEAR_M = 0.5  # from home, horizontally: there the return becomes a landing

_HOVER_LEARN_S = 2.0  # time constant
_HOVER_LEARN_BELOW_M_S = 0.5  # vertical speed

_STICK_REST = 0.1  # of full deflection, within which a stick stands in its middle (MPC_HOLD_DZ)

_NOWHERE = np.full(3, math.nan)
_STILL = np.zeros(3)


def level(yaw_rad: float) -> Array:
    """Return the attitude (4,) without tilt at a heading."""
    return np.array([math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)])


def _motors_off(attitude: Array) -> Actuation:
    return Actuation(
        attitude=attitude,
        rate_rad_s=_STILL,
        is_rate=False,
        thrust_frac=0.0,
        motors_on=False,
    )


@dataclass(slots=True)
class ModeControl:
    """Memory of what is flown."""

    # the newest output
    actuation: Actuation = field(
        default_factory=lambda: _motors_off(np.array([1.0, 0.0, 0.0, 0.0]))
    )
    goal: PositionGoal | None = None  # where PX4's own control flies to; None while it does not
    home_ned_m: Array = field(default_factory=lambda: np.zeros(3))  # (3,) where it was armed
    takeoff_height_m: float | None = None  # requested by a command; None for MIS_TAKEOFF_ALT
    has_lost_attitude: bool = False  # the attitude control is broken until PX4 restarts
    _control: PositionControl = field(default_factory=PositionControl)
    _armed_time_s: float = 0.0
    _entry: AutopilotInputs | None = None  # what was known when the mode began
    _hold_ned_m: Array | None = None  # where Hold was sent to; None for where it began
    _yaw_setpoint_rad: float | None = None  # None before the mode's first heading
    _hover_thrust_frac: float = 0.5  # learnt in flight
    _sticks: Axes | None = None  # of a pilot, at this tick; None while none are heard

    def armed(self, now_s: float, inputs: AutopilotInputs | None, params: Parameters) -> None:
        """Start afresh, with home here."""
        self._armed_time_s = now_s
        self._control.reset()
        self._hover_thrust_frac = params["MPC_THR_HOVER"]
        if inputs is not None:
            self.home_ned_m = inputs.position_ned_m.copy()
        self.entered(inputs)

    def disarmed(self) -> None:
        """Stop the motors."""
        self.goal = None
        self.terminate()

    def entered(self, inputs: AutopilotInputs | None) -> None:
        """Begin a mode here."""
        self._entry = inputs
        self._hold_ned_m = None
        self._yaw_setpoint_rad = None
        self._control.forget_horizontal()

    def hold_at(self, position_ned_m: Array) -> None:
        """Let Hold fly to another position (DO_REPOSITION); NaN keeps a coordinate."""
        self._hold_ned_m = position_ned_m

    def frame_jumped(self, shift_ned_m: Array) -> None:
        """Move all remembered positions along with a jump of the local frame.

        The vehicle stays where it is.
        """
        self.home_ned_m = self.home_ned_m + shift_ned_m
        if self._entry is not None:
            moved = self._entry.position_ned_m + shift_ned_m
            self._entry = replace(self._entry, position_ned_m=moved)
        if self._hold_ned_m is not None:
            self._hold_ned_m = self._hold_ned_m + shift_ned_m

    def terminate(self) -> None:
        """Stop the motors for good, though the vehicle is still armed."""
        self.actuation = _motors_off(self.actuation.attitude)

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """Act on an attitude or rate setpoint at once; positions wait for the next tick."""
        if setpoint.kind is SetpointKind.POSITION:
            return

        attitude = setpoint.attitude
        if attitude is None:
            attitude = self.actuation.attitude
        rate_rad_s = None
        if setpoint.kind is SetpointKind.RATE:
            rate_rad_s = setpoint.rate_rad_s

        self.goal = None
        self._command(attitude, setpoint.thrust_frac, rate_rad_s)

    def step(
        self,
        inputs: AutopilotInputs,
        mode: Mode,
        landed: LandedState,
        params: Parameters,
        setpoint: Setpoint | None,
        sticks: Axes | None = None,
    ) -> bool:
        """Advance an armed vehicle by one tick; True when a take-off has reached its height."""
        self._sticks = sticks
        self._learn_hover_thrust(inputs)

        if mode is Mode.OFFBOARD:
            if setpoint is not None and setpoint.goal is not None:
                self._fly(inputs, setpoint.goal, params)
            return False

        if mode is Mode.TERMINATION:
            self.terminate()
            return False

        # On the ground only a take-off turns the motors; Hold goes on until the landing is
        # detected, so that a touch of the ground does not drop a vehicle that hovers low.
        has_landed = landed is LandedState.ON_GROUND
        holds_height = mode is Mode.LOITER or (mode in modes.BLIND_DESCENT and sticks is not None)
        has_touched = inputs.on_ground and not holds_height
        if mode is not Mode.TAKEOFF and (has_landed or has_touched):
            self._idle(self._start(inputs).yaw_rad)
            return False

        _FLOWN[mode](self, inputs, params)

        if mode is not Mode.TAKEOFF or has_landed:
            return False
        return self._has_reached_takeoff_height(inputs, params)

    # -- modes -------------------------------------------------------------------------------------

    def _take_off(self, inputs: AutopilotInputs, params: Parameters) -> None:
        yaw_rad = self._start(inputs).yaw_rad
        since_s = inputs.time_s - self._armed_time_s - _SPOOL_S
        if since_s < 0.0:
            self._idle(yaw_rad)
            return

        position = np.array([self.home_ned_m[0], self.home_ned_m[1], self._takeoff_down_m(params)])
        # The climb begins gently, and from the ground at once.
        share = min(1.0, _FIRST_SHARE + since_s / max(params["MPC_TKO_RAMP_T"], 0.1))
        up_m_s = share * params["MPC_TKO_SPEED"]
        self._fly(inputs, PositionGoal(position, _STILL, yaw_rad), params, up_m_s=up_m_s)

    def _has_reached_takeoff_height(self, inputs: AutopilotInputs, params: Parameters) -> bool:
        left_m = abs(float(inputs.position_ned_m[2]) - self._takeoff_down_m(params))
        # The slow errors of the estimate keep the last centimetres away for seconds.
        is_patient = inputs.time_s - self._armed_time_s < _TAKEOFF_PATIENCE_S
        if is_patient:
            return left_m < _TAKEOFF_REACHED_M
        return left_m < _TAKEOFF_NEAR_M

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
        velocity = np.array([0.0, 0.0, params["MPC_LAND_SPEED"]])
        goal = PositionGoal(_NOWHERE, velocity, self._start(inputs).yaw_rad)
        self._fly(inputs, goal, params, is_level=True)

    # -- by hand -----------------------------------------------------------------------------------

    def _fly_position_by_hand(self, inputs: AutopilotInputs, params: Parameters) -> None:
        """POSCTL: sticks in their middle hold the position, moved ones give a velocity."""
        if self._sticks is None:
            self._sink(inputs, params)
            return

        pitch, roll, throttle, _ = self._sticks
        climb = 2.0 * throttle - 1.0
        if max(abs(pitch), abs(roll), abs(climb)) < _STICK_REST:
            if self._hold_ned_m is None:
                self._hold_ned_m = inputs.position_ned_m.copy()
            goal = PositionGoal(self._hold_ned_m, _STILL, self._start(inputs).yaw_rad)
            self._fly(inputs, goal, params)
            return

        self._hold_ned_m = None
        north = math.cos(inputs.yaw_rad) * pitch - math.sin(inputs.yaw_rad) * roll
        east = math.sin(inputs.yaw_rad) * pitch + math.cos(inputs.yaw_rad) * roll
        speed_m_s = params["MPC_VEL_MANUAL"]
        down_m_s = -climb * params["MPC_Z_VEL_MAX_UP"]
        velocity = np.array([speed_m_s * north, speed_m_s * east, down_m_s])
        self._fly(inputs, PositionGoal(_NOWHERE, velocity, self._start(inputs).yaw_rad), params)

    def _fly_height_by_hand(self, inputs: AutopilotInputs, params: Parameters) -> None:
        """ALTCTL: the throttle gives a climb, roll and pitch a tilt; nothing holds the place."""
        if self._sticks is None:
            self._sink(inputs, params)
            return

        climb = 2.0 * self._sticks[2] - 1.0
        velocity = np.array([0.0, 0.0, -climb * params["MPC_Z_VEL_MAX_UP"]])
        goal = PositionGoal(_NOWHERE, velocity, self._start(inputs).yaw_rad)
        self._fly(inputs, goal, params, is_level=True)

    def _fly_attitude_by_hand(self, inputs: AutopilotInputs, params: Parameters) -> None:
        """STABILIZED and MANUAL: roll and pitch give a tilt, the throttle's middle hovers."""
        if self._sticks is None:
            self._sink(inputs, params)
            return

        throttle = self._sticks[2]
        hover_frac = self._hover_thrust_frac
        thrust_frac = 2.0 * throttle * hover_frac
        if throttle > 0.5:
            thrust_frac = hover_frac + (2.0 * throttle - 1.0) * (1.0 - hover_frac)
        self.goal = None
        self._command(self._held_level(self._start(inputs).yaw_rad, params), thrust_frac)

    def _held_level(self, yaw_rad: float, params: Parameters) -> Array:
        """Return the level attitude (4,), tilted as the sticks say."""
        if self._sticks is None:
            return level(yaw_rad)

        most_rad = math.radians(params["MPC_MAN_TILT_MAX"])
        half_pitch_rad = -0.5 * most_rad * self._sticks[0]  # forward is nose down
        half_roll_rad = 0.5 * most_rad * self._sticks[1]
        tilt = np.array([1.0, half_roll_rad, half_pitch_rad, 0.0])
        return frames.multiply(level(yaw_rad), tilt / np.linalg.norm(tilt))

    # -- parts -------------------------------------------------------------------------------------

    def _start(self, inputs: AutopilotInputs) -> AutopilotInputs:
        """Return the inputs at the begin of the mode."""
        return self._entry or inputs

    def _takeoff_down_m(self, params: Parameters) -> float:
        height_m = self.takeoff_height_m
        if height_m is None:
            height_m = params["MIS_TAKEOFF_ALT"]
        return float(self.home_ned_m[2]) - height_m

    def _descend(
        self, inputs: AutopilotInputs, at_ned_m: Array, yaw_rad: float, params: Parameters
    ) -> None:
        position = np.array([at_ned_m[0], at_ned_m[1], math.nan])
        velocity = np.array([0.0, 0.0, params["MPC_LAND_SPEED"]])
        goal = PositionGoal(position, velocity, yaw_rad)
        self._fly(inputs, goal, params, is_level=not inputs.has_local_position)

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
        yaw_rad = self._heading(goal, inputs)

        if up_m_s is None:
            up_m_s = params["MPC_Z_VEL_MAX_UP"]
        limits = PositionLimits(
            speed_m_s=params["MPC_XY_CRUISE"],
            up_m_s=up_m_s,
            down_m_s=params["MPC_Z_VEL_MAX_DN"],
            tilt_rad=math.radians(params["MPC_TILTMAX_AIR"]),
        )

        attitude, thrust_frac = self._control.step(
            goal,
            inputs.position_ned_m,
            inputs.velocity_ned_m_s,
            TICK_S,
            hover_thrust_frac=self._hover_thrust_frac,
            limits=limits,
            yaw_rad=yaw_rad,
        )
        if is_level:
            attitude = self._held_level(yaw_rad, params)
        self._command(attitude, thrust_frac)

    def _heading(self, goal: PositionGoal, inputs: AutopilotInputs) -> float:
        """Return the heading to fly.

        Without one in the goal the last one stays; a mode begins with the heading that it finds.
        """
        if math.isfinite(goal.yaw_rad):
            self._yaw_setpoint_rad = goal.yaw_rad
            return self._yaw_setpoint_rad

        if self._yaw_setpoint_rad is None:
            self._yaw_setpoint_rad = inputs.yaw_rad
        if math.isfinite(goal.yaw_rate_rad_s):
            yaw_rate_rad_s = max(-math.pi, min(math.pi, goal.yaw_rate_rad_s))
            turned_rad = self._yaw_setpoint_rad + TICK_S * yaw_rate_rad_s
            self._yaw_setpoint_rad = math.remainder(turned_rad, 2.0 * math.pi)
        return self._yaw_setpoint_rad

    def _idle(self, yaw_rad: float) -> None:
        """Turn the motors without lift."""
        self._control.reset()
        self.goal = None
        self._command(level(yaw_rad), 0.0)

    def _command(
        self, attitude: Array, thrust_frac: float, rate_rad_s: Array | None = None
    ) -> None:
        if self.has_lost_attitude:
            rate_rad_s = DRIFT_RAD_S

        self.actuation = Actuation(
            attitude=attitude,
            rate_rad_s=_STILL if rate_rad_s is None else rate_rad_s,
            is_rate=rate_rad_s is not None,
            thrust_frac=thrust_frac,
            motors_on=True,
        )

    def _learn_hover_thrust(self, inputs: AutopilotInputs) -> None:
        # PX4 estimates its hover thrust in flight; without that a heavy vehicle sinks when a
        # failsafe takes over.
        is_level_flight = abs(inputs.velocity_ned_m_s[2]) <= _HOVER_LEARN_BELOW_M_S
        if inputs.on_ground or not is_level_flight:
            return

        lift_frac = self.actuation.thrust_frac * frames.uprightness(inputs.attitude)
        error_frac = lift_frac - self._hover_thrust_frac
        learnt_frac = self._hover_thrust_frac + TICK_S / _HOVER_LEARN_S * error_frac
        self._hover_thrust_frac = min(0.9, max(0.1, learnt_frac))


_FLOWN: dict[Mode, Callable[[ModeControl, AutopilotInputs, Parameters], None]] = {
    Mode.TAKEOFF: ModeControl._take_off,
    Mode.LOITER: ModeControl._hold,
    Mode.MISSION: ModeControl._hold,
    Mode.RTL: ModeControl._return,
    Mode.LAND: ModeControl._land,
    Mode.POSCTL: ModeControl._fly_position_by_hand,
    Mode.ALTCTL: ModeControl._fly_height_by_hand,
    Mode.STABILIZED: ModeControl._fly_attitude_by_hand,
    Mode.MANUAL: ModeControl._fly_attitude_by_hand,
    Mode.DESCEND: ModeControl._sink,
}
