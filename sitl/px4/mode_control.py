"""Control of a PX4 in each of its own modes and in OFFBOARD: from its inputs to an actuation.

Each of PX4's modes has a goal (a position, a velocity, a heading), to which `position_control.py`
flies. A position setpoint in OFFBOARD is such a goal as well. A setpoint of an attitude or of body
rates is commanded directly.
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
_SPOOL_S = 1.0  # time from arming until a take-off begins
_FIRST_SHARE = 0.25  # share of the climb speed with which the ramp of a take-off begins
_MIN_RAMP_S = 0.1  # lower limit of the duration of that ramp

# A take-off ends within the first distance of its height. After this time since arming it ends
# within the larger second distance.
_TAKEOFF_REACHED_M = 0.1
_TAKEOFF_NEAR_M = 0.4
_TAKEOFF_LATE_S = 6.5
_TAKEOFF_BESIDE_M = 2.0  # horizontal distance from its goal at which it ends
MAX_TAKEOFF_M = 1e4  # horizontal distance from which on the goal of a take-off is not flown to

_MAX_TILT_DEG = 89.0  # upper limit of the tilt, whatever MPC_TILTMAX_AIR allows
_RTL_NEAR_M = 0.5  # horizontal distance from home at which a return becomes a landing

# The hover thrust is estimated below this vertical speed, with this time constant, within limits.
_HOVER_TIME_S = 2.0
_HOVER_SPEED_M_S = 0.5
_MIN_HOVER_THRUST = 0.1
_MAX_HOVER_THRUST = 0.9

# Share of full deflection below which a stick counts as centred (MPC_HOLD_DZ).
_STICK_REST = 0.1
_TAKEOFF_THROTTLE = 0.65  # throttle above which a vehicle on the ground takes off by hand

_NO_POSITION = np.full(3, math.nan)
_ZERO = np.zeros(3)


def level(yaw_rad: float) -> Array:
    """Return the attitude (4,) without tilt at a heading."""
    return np.array([math.cos(0.5 * yaw_rad), 0.0, 0.0, math.sin(0.5 * yaw_rad)])


def _turned(yaw_rad: float, yaw_rate_rad_s: float) -> float:
    """Return a heading after one tick, at a rate of at most half a turn a second."""
    limited_rad_s = max(-math.pi, min(math.pi, yaw_rate_rad_s))
    return math.remainder(yaw_rad + TICK_S * limited_rad_s, 2.0 * math.pi)


def _motors_off(attitude: Array) -> Actuation:
    return Actuation(
        attitude=attitude,
        rate_rad_s=_ZERO,
        is_rate=False,
        thrust_frac=0.0,
        motors_on=False,
    )


@dataclass(slots=True)
class ModeControl:
    """State of the control of one vehicle."""

    # Newest output.
    actuation: Actuation = field(
        default_factory=lambda: _motors_off(np.array([1.0, 0.0, 0.0, 0.0]))
    )
    goal: PositionGoal | None = None  # goal of the position control; None while it is not used
    home_ned_m: Array = field(default_factory=lambda: np.zeros(3))  # (3,) set at arming
    # Whether a command has set home to a position. Arming then leaves it there.
    is_home_commanded: bool = False
    # Goal of a commanded take-off. NaN horizontally: above its start. NaN vertically:
    # MIS_TAKEOFF_ALT above its start.
    takeoff_ned_m: Array = field(default_factory=_NO_POSITION.copy)
    # Commanded horizontal speed of an automatic mode, until the mode ends; None: MPC_XY_CRUISE.
    cruise_m_s: float | None = None
    has_lost_attitude: bool = False  # whether the attitude control has failed until a restart
    _control: PositionControl = field(default_factory=PositionControl)
    _armed_time_s: float = 0.0
    _entry: AutopilotInputs | None = None  # inputs at the begin of the mode
    # Position that Hold or POSCTL holds. None in Hold: the position at the start of the mode is
    # held. None in POSCTL: no position is held, and the sticks command a velocity.
    _hold_ned_m: Array | None = None
    _hold_yaw_rad: float = math.nan  # heading that Hold turns to; NaN: that at its start
    _yaw_setpoint_rad: float | None = None  # None before the first heading of the mode
    _hover_thrust_frac: float = 0.5  # estimated in flight
    _sticks: Axes | None = None  # sticks of a pilot at this tick; None while none are received

    def armed(self, now_s: float, inputs: AutopilotInputs | None, params: Parameters) -> None:
        """Reset the control at arming, and set home here unless a command has set it elsewhere."""
        self._armed_time_s = now_s
        self._control.reset()
        self._hover_thrust_frac = params["MPC_THR_HOVER"]
        if inputs is not None and not self.is_home_commanded:
            self.home_ned_m = inputs.position_ned_m.copy()
        self.entered(inputs)

    def disarmed(self) -> None:
        """Stop the motors."""
        self.goal = None
        self.terminate()

    def entered(self, inputs: AutopilotInputs | None) -> None:
        """Begin a mode with the present inputs."""
        self.cruise_m_s = None
        self._entry = inputs
        self._hold_ned_m = None
        self._hold_yaw_rad = math.nan
        self._yaw_setpoint_rad = None
        self._control.forget_horizontal()

    def hold_at(self, position_ned_m: Array, yaw_rad: float = math.nan) -> None:
        """Let Hold fly to another position and heading (DO_REPOSITION); NaN keeps a value."""
        if self._hold_ned_m is not None:
            is_given = np.isfinite(position_ned_m)
            position_ned_m = np.where(is_given, position_ned_m, self._hold_ned_m)
        self._hold_ned_m = position_ned_m
        if math.isfinite(yaw_rad):
            self._hold_yaw_rad = yaw_rad

    def frame_jumped(self, shift_ned_m: Array) -> None:
        """Shift all stored positions by a jump of the local frame.

        The vehicle therefore does not move with the jump.
        """
        self.home_ned_m = self.home_ned_m + shift_ned_m
        self.takeoff_ned_m = self.takeoff_ned_m + shift_ned_m
        if self._entry is not None:
            moved = self._entry.position_ned_m + shift_ned_m
            self._entry = replace(self._entry, position_ned_m=moved)
        if self._hold_ned_m is not None:
            self._hold_ned_m = self._hold_ned_m + shift_ned_m

    def takeoff_goal_ned_m(self, inputs: AutopilotInputs, params: Parameters) -> Array:
        """Return the position (3,) at which a take-off ends, which is never below its start."""
        start = self._start(inputs).position_ned_m
        default = start - np.array([0.0, 0.0, params["MIS_TAKEOFF_ALT"]])
        goal = np.where(np.isfinite(self.takeoff_ned_m), self.takeoff_ned_m, default)
        goal[2] = min(goal[2], start[2])
        return goal

    def terminate(self) -> None:
        """Stop the motors, even if the vehicle is armed."""
        self.actuation = _motors_off(self.actuation.attitude)

    def take_setpoint(self, setpoint: Setpoint) -> None:
        """Command an attitude or rate setpoint at once; a position waits for the next tick."""
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
        """Advance an armed vehicle by one tick; return whether a take-off has ended."""
        self._sticks = sticks
        self._estimate_hover_thrust(inputs)

        if mode is Mode.OFFBOARD:
            if setpoint is not None and setpoint.goal is not None:
                most_m_s = params["MPC_XY_VEL_MAX"]
                self._fly(inputs, setpoint.goal, params, speed_m_s=most_m_s)
            return False

        if mode is Mode.TERMINATION:
            self.terminate()
            return False

        # On the ground the motors idle unless the vehicle takes off. Modes that hold the height
        # continue until the landing is detected, so that a vehicle that hovers low and touches the
        # ground does not drop.
        has_landed = landed is LandedState.ON_GROUND
        holds_height = mode is Mode.LOITER or (mode in modes.BLIND_DESCENT and sticks is not None)
        has_touched = inputs.on_ground and not holds_height
        takes_off = mode is Mode.TAKEOFF or self._takes_off_by_hand(inputs, mode)
        if not takes_off and (has_landed or has_touched):
            self._idle(self._start(inputs).yaw_rad)
            return False

        _MODE_STEPS[mode](self, inputs, params)

        if mode is not Mode.TAKEOFF or has_landed:
            return False
        return self._has_reached_takeoff_height(inputs, params)

    # -- modes -------------------------------------------------------------------------------------

    def _take_off(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        position = self.takeoff_goal_ned_m(inputs, params)
        if not params.version.takes_off_sideways:
            position[:2] = start.position_ned_m[:2]

        climbing_s = inputs.time_s - self._armed_time_s - _SPOOL_S
        is_above = position[2] < start.position_ned_m[2]
        # PX4 climbs along a straight line, which does not leave the ground to a goal far away.
        away_m = math.dist(position[:2], start.position_ned_m[:2])
        leaves_ground = is_above and away_m < MAX_TAKEOFF_M
        if climbing_s < 0.0 or (inputs.on_ground and not leaves_ground):
            self._idle(start.yaw_rad)
            return

        # The speed grows from a share of the climb speed, so that the vehicle leaves the ground at
        # once.
        ramp_s = max(params["MPC_TKO_RAMP_T"], _MIN_RAMP_S)
        speed_share = min(1.0, _FIRST_SHARE + climbing_s / ramp_s)
        up_m_s = speed_share * params["MPC_TKO_SPEED"]
        self._fly(inputs, PositionGoal(position, _ZERO, start.yaw_rad), params, up_m_s=up_m_s)

    def _has_reached_takeoff_height(self, inputs: AutopilotInputs, params: Parameters) -> bool:
        goal = self.takeoff_goal_ned_m(inputs, params)
        away_m = math.dist(goal[:2], inputs.position_ned_m[:2])
        if params.version.takes_off_sideways and away_m > _TAKEOFF_BESIDE_M:
            return False

        left_m = abs(float(inputs.position_ned_m[2]) - float(goal[2]))
        # Slow estimate errors can hold off the last centimetres for seconds.
        is_late = inputs.time_s - self._armed_time_s >= _TAKEOFF_LATE_S
        if is_late:
            return left_m < _TAKEOFF_NEAR_M
        return left_m < _TAKEOFF_REACHED_M

    def _hold(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        position = start.position_ned_m
        if self._hold_ned_m is not None:
            position = np.where(np.isfinite(self._hold_ned_m), self._hold_ned_m, position)
        yaw_rad = start.yaw_rad
        if math.isfinite(self._hold_yaw_rad):
            yaw_rad = self._hold_yaw_rad
        self._fly(inputs, PositionGoal(position, _ZERO, yaw_rad), params)

    def _land(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        self._descend(inputs, start.position_ned_m, start.yaw_rad, params)

    def _return(self, inputs: AutopilotInputs, params: Parameters) -> None:
        start = self._start(inputs)
        north_m, east_m, _ = self.home_ned_m
        _, _, down_m = start.position_ned_m
        home = np.array([north_m, east_m, down_m])  # home, at the height at the start of the mode
        if math.dist(home[:2], inputs.position_ned_m[:2]) < _RTL_NEAR_M:
            self._descend(inputs, home, start.yaw_rad, params)
        else:
            self._fly(inputs, PositionGoal(home, _ZERO, start.yaw_rad), params)

    def _descend_without_position(self, inputs: AutopilotInputs, params: Parameters) -> None:
        # The descent is level and holds no position, because sticks or a position are missing.
        velocity = np.array([0.0, 0.0, params["MPC_LAND_SPEED"]])
        goal = PositionGoal(_NO_POSITION, velocity, self._heading_by_stick(inputs, params))
        self._fly(inputs, goal, params, is_level=True)

    # -- manual modes ------------------------------------------------------------------------------

    def _takes_off_by_hand(self, inputs: AutopilotInputs, mode: Mode) -> bool:
        """Return whether a pilot's throttle lifts a vehicle off the ground.

        PX4 lets STABILIZED and MANUAL lift off at any thrust. Here they need as much throttle as
        the other modes.
        """
        if self._sticks is None or mode not in modes.BY_HAND:
            return False

        _, _, throttle, _ = self._sticks
        has_spooled = inputs.time_s - self._armed_time_s >= _SPOOL_S
        return has_spooled and throttle > _TAKEOFF_THROTTLE

    def _fly_position_by_hand(self, inputs: AutopilotInputs, params: Parameters) -> None:
        """Fly POSCTL: centred sticks hold the position, others command a velocity."""
        if self._sticks is None:
            self._descend_without_position(inputs, params)
            return

        yaw_rad = self._heading_by_stick(inputs, params)
        pitch, roll, throttle, _ = self._sticks
        climb = 2.0 * throttle - 1.0
        if max(abs(pitch), abs(roll), abs(climb)) < _STICK_REST:
            if self._hold_ned_m is None:
                self._hold_ned_m = inputs.position_ned_m.copy()
            self._fly(inputs, PositionGoal(self._hold_ned_m, _ZERO, yaw_rad), params)
            return

        self._hold_ned_m = None
        north = math.cos(inputs.yaw_rad) * pitch - math.sin(inputs.yaw_rad) * roll
        east = math.sin(inputs.yaw_rad) * pitch + math.cos(inputs.yaw_rad) * roll
        speed_m_s = params["MPC_VEL_MANUAL"]
        down_m_s = -climb * params["MPC_Z_VEL_MAX_UP"]
        velocity = np.array([speed_m_s * north, speed_m_s * east, down_m_s])
        goal = PositionGoal(_NO_POSITION, velocity, yaw_rad)
        self._fly(inputs, goal, params, speed_m_s=speed_m_s)

    def _fly_height_by_hand(self, inputs: AutopilotInputs, params: Parameters) -> None:
        """Fly ALTCTL: the throttle commands a climb, roll and pitch a tilt.

        No position is held.
        """
        if self._sticks is None:
            self._descend_without_position(inputs, params)
            return

        _, _, throttle, _ = self._sticks
        climb = 2.0 * throttle - 1.0
        velocity = np.array([0.0, 0.0, -climb * params["MPC_Z_VEL_MAX_UP"]])
        goal = PositionGoal(_NO_POSITION, velocity, self._heading_by_stick(inputs, params))
        self._fly(inputs, goal, params, is_level=True)

    def _fly_attitude_by_hand(self, inputs: AutopilotInputs, params: Parameters) -> None:
        """Fly STABILIZED or MANUAL: roll and pitch command a tilt, the throttle a thrust.

        The vehicle hovers with the throttle in its middle.
        """
        if self._sticks is None:
            self._descend_without_position(inputs, params)
            return

        _, _, throttle, _ = self._sticks
        hover_frac = self._hover_thrust_frac
        thrust_frac = 2.0 * throttle * hover_frac
        if throttle > 0.5:
            thrust_frac = hover_frac + (2.0 * throttle - 1.0) * (1.0 - hover_frac)
        self.goal = None
        attitude = self._attitude_by_sticks(self._heading_by_stick(inputs, params), params)
        self._command(attitude, thrust_frac)

    def _heading_by_stick(self, inputs: AutopilotInputs, params: Parameters) -> float:
        """Turn the heading of the mode at the rate of the yaw stick; return it."""
        if self._yaw_setpoint_rad is None:
            self._yaw_setpoint_rad = self._start(inputs).yaw_rad

        if self._sticks is not None:
            _, _, _, yaw = self._sticks
            if abs(yaw) >= _STICK_REST:
                yaw_rate_rad_s = yaw * math.radians(params["MPC_MAN_Y_MAX"])
                self._yaw_setpoint_rad = _turned(self._yaw_setpoint_rad, yaw_rate_rad_s)
        return self._yaw_setpoint_rad

    def _attitude_by_sticks(self, yaw_rad: float, params: Parameters) -> Array:
        """Return the attitude (4,) that the sticks command; without sticks it is level."""
        if self._sticks is None:
            return level(yaw_rad)

        pitch, roll, _, _ = self._sticks
        most_rad = math.radians(params["MPC_MAN_TILT_MAX"])
        half_pitch_rad = -0.5 * most_rad * pitch  # a stick forward turns the nose down
        half_roll_rad = 0.5 * most_rad * roll
        tilt = np.array([1.0, half_roll_rad, half_pitch_rad, 0.0])
        return frames.multiply(level(yaw_rad), tilt / np.linalg.norm(tilt))

    # -- parts -------------------------------------------------------------------------------------

    def _start(self, inputs: AutopilotInputs) -> AutopilotInputs:
        """Return the inputs at the start of the mode."""
        if self._entry is None:
            return inputs
        return self._entry

    def _descend(
        self, inputs: AutopilotInputs, at_ned_m: Array, yaw_rad: float, params: Parameters
    ) -> None:
        """Descend at landing speed above a position; level if there is no local position."""
        north_m, east_m, _ = at_ned_m
        position = np.array([north_m, east_m, math.nan])
        velocity = np.array([0.0, 0.0, params["MPC_LAND_SPEED"]])
        goal = PositionGoal(position, velocity, yaw_rad)
        self._fly(inputs, goal, params, is_level=not inputs.has_local_position)

    def _fly(
        self,
        inputs: AutopilotInputs,
        goal: PositionGoal,
        params: Parameters,
        *,
        speed_m_s: float | None = None,
        up_m_s: float | None = None,
        is_level: bool = False,
    ) -> None:
        """Command the attitude and the thrust that lead to a goal.

        Args:
            inputs: inputs at this tick.
            goal: the goal.
            params: PX4's parameters.
            speed_m_s: limit of the horizontal speed; None: that of PX4's automatic modes.
            up_m_s: limit of the climb; None: MPC_Z_VEL_MAX_UP.
            is_level: whether the attitude is that of the sticks, level without them.
        """
        self.goal = goal
        yaw_rad = self._heading(goal, inputs)

        if up_m_s is None:
            up_m_s = params["MPC_Z_VEL_MAX_UP"]
        if speed_m_s is None:
            speed_m_s = params["MPC_XY_CRUISE"]
            if self.cruise_m_s is not None:
                speed_m_s = self.cruise_m_s
        limits = PositionLimits(
            speed_m_s=max(0.0, min(speed_m_s, params["MPC_XY_VEL_MAX"])),
            up_m_s=up_m_s,
            down_m_s=params["MPC_Z_VEL_MAX_DN"],
            tilt_rad=math.radians(min(_MAX_TILT_DEG, max(0.0, params["MPC_TILTMAX_AIR"]))),
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
            attitude = self._attitude_by_sticks(yaw_rad, params)
        self._command(attitude, thrust_frac)

    def _heading(self, goal: PositionGoal, inputs: AutopilotInputs) -> float:
        """Return the heading to fly.

        A goal without a heading keeps the last one. The first is the heading at the start of the
        mode.
        """
        if math.isfinite(goal.yaw_rad):
            self._yaw_setpoint_rad = goal.yaw_rad
            return self._yaw_setpoint_rad

        if self._yaw_setpoint_rad is None:
            self._yaw_setpoint_rad = inputs.yaw_rad
        if math.isfinite(goal.yaw_rate_rad_s):
            self._yaw_setpoint_rad = _turned(self._yaw_setpoint_rad, goal.yaw_rate_rad_s)
        return self._yaw_setpoint_rad

    def _idle(self, yaw_rad: float) -> None:
        """Turn the motors without lift."""
        self._control.reset()
        self.goal = None
        self._command(level(yaw_rad), 0.0)

    def _command(
        self, attitude: Array, thrust_frac: float, rate_rad_s: Array | None = None
    ) -> None:
        """Command an attitude, or body rates in place of it, and a thrust within [0, 1]."""
        if self.has_lost_attitude:
            rate_rad_s = DRIFT_RAD_S
        is_rate = rate_rad_s is not None
        if rate_rad_s is None:
            rate_rad_s = _ZERO

        self.actuation = Actuation(
            attitude=attitude,
            rate_rad_s=rate_rad_s,
            is_rate=is_rate,
            thrust_frac=min(1.0, max(0.0, thrust_frac)),
            motors_on=True,
        )

    def _estimate_hover_thrust(self, inputs: AutopilotInputs) -> None:
        # PX4 estimates its hover thrust in flight. Without an estimate a heavy vehicle would sink
        # when a failsafe starts.
        is_level_flight = abs(inputs.velocity_ned_m_s[2]) <= _HOVER_SPEED_M_S
        if inputs.on_ground or not is_level_flight:
            return

        lift_frac = self.actuation.thrust_frac * frames.uprightness(inputs.attitude)
        error_frac = lift_frac - self._hover_thrust_frac
        estimate_frac = self._hover_thrust_frac + TICK_S / _HOVER_TIME_S * error_frac
        self._hover_thrust_frac = min(_MAX_HOVER_THRUST, max(_MIN_HOVER_THRUST, estimate_frac))


_MODE_STEPS: dict[Mode, Callable[[ModeControl, AutopilotInputs, Parameters], None]] = {
    Mode.TAKEOFF: ModeControl._take_off,
    Mode.LOITER: ModeControl._hold,
    Mode.MISSION: ModeControl._hold,
    Mode.RTL: ModeControl._return,
    Mode.LAND: ModeControl._land,
    Mode.POSCTL: ModeControl._fly_position_by_hand,
    Mode.ALTCTL: ModeControl._fly_height_by_hand,
    Mode.STABILIZED: ModeControl._fly_attitude_by_hand,
    Mode.MANUAL: ModeControl._fly_attitude_by_hand,
    Mode.DESCEND: ModeControl._descend_without_position,
}
