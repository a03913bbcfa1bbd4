"""One PX4 commander: arming, mode requests, failsafes, landing.

PX4 distinguishes the requested mode and the active mode, `mode`. A failsafe changes only the
active one. When its cause is over, PX4 returns to the requested mode without a new request.

The commander makes the decisions, and uses these modules:

* `modes.py`: the conditions of each mode,
* `arming_checks.py`: the reasons against arming,
* `failsafes.py`: the actions that replace the requested mode,
* `mode_control.py`: the control in each mode,
* `land_detector.py`, `battery.py`, `sticks.py`: the state of the vehicle and the pilot's input,
* `journal.py`: texts and events of PX4.

The commander is pure: each call passes the time, and texts and events go to the journal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sitl.physics.frames import Array, euler, uprightness
from sitl.px4 import arming_checks, modes
from sitl.px4.arming_checks import Readiness
from sitl.px4.battery import Battery, ChargeState, charge_state_of
from sitl.px4.failsafes import (
    ACTION_MODE,
    GEOFENCE,
    Failsafe,
    FailsafeAction,
    FailsafeInputs,
    is_beyond_fence,
)
from sitl.px4.journal import REASONS, Journal
from sitl.px4.land_detector import LandDetector
from sitl.px4.mode_control import MAX_TAKEOFF_M, TICK_S, ModeControl
from sitl.px4.modes import MODES, CommandResult, LandedState, Mode, ModeCondition, SystemStatus
from sitl.px4.parameters import Parameters
from sitl.px4.signals import Actuation, AutopilotInputs, Setpoint, SetpointKind
from sitl.px4.sticks import Axes, Sticks
from sitl.px4.versions import Version

_FORCE_MAGIC = 21196.0  # parameter 2 of a command that forces disarming
# Throttles with which a vehicle is armed: in the modes whose throttle is a thrust, below the first
# one; in those whose throttle commands a climb, up to the second one.
_MAX_ARMING_THRUST = 0.1
_MAX_ARMING_CLIMB = 0.6
# Values of GF_ACTION. With a larger one than the first, goals of Hold beyond the fence are refused.
_GF_ACTION_WARN = 1
_GF_ACTION_HOLD = 2
_REFUSAL_INTERVAL_S = 1.0  # time between two texts about refused modes
# Keys of the journal.
_BATTERY_TEXTS: dict[ChargeState, str] = {
    ChargeState.LOW: "battery low",
    ChargeState.CRITICAL: "battery critical",
    ChargeState.EMERGENCY: "battery emergency",
}


@dataclass(slots=True)
class EmulatedPx4:
    """State of one PX4."""

    params: Parameters = field(default_factory=Parameters)  # kept by a restart
    boot_time_s: float = 0.0  # time of the last start
    battery: Battery = field(default_factory=Battery)
    requested_mode: Mode = Mode.LOITER  # the mode that was requested
    mode: Mode = Mode.LOITER  # the mode that is flown
    is_armed: bool = False
    setpoint: Setpoint | None = None  # newest setpoint for OFFBOARD
    charge_state: ChargeState = ChargeState.OK
    # Further reasons against arming, as sentences. Faults of the emulator add them.
    faults: list[str] = field(default_factory=list)
    ground_time_s: float = -math.inf  # time of the last heartbeat of a ground station on any link
    tunes: int = 0  # number of requested tunes
    journal: Journal = field(default_factory=Journal)
    failsafe: Failsafe = field(default_factory=Failsafe)
    land_detector: LandDetector = field(default_factory=LandDetector)
    mode_control: ModeControl = field(default_factory=ModeControl)
    sticks: Sticks = field(default_factory=Sticks)
    # Positions of the sticks of an emulated pilot, which every tick uses; None without a pilot.
    held_sticks: Axes | None = None
    _mode_after_disarming: Mode = Mode.LOITER  # requested mode that disarming restores
    _armed_time_s: float = 0.0  # time of the last arming
    _refused_time_s: float = -math.inf  # time of the last text about a refused mode
    _tilted_since_s: float = math.inf  # start of a tilt beyond the limits
    _has_attitude_failed: bool = False  # whether the attitude has failed since arming
    _inputs: AutopilotInputs | None = None  # newest inputs; None before the first tick

    def __post_init__(self) -> None:
        self.journal.severities = self.version.severities

    @property
    def version(self) -> Version:
        """Version of this PX4."""
        return self.params.version

    # -- values of messages ------------------------------------------------------------------------

    @property
    def shown_mode(self) -> Mode:
        """The mode that HEARTBEAT shows."""
        if self.mode is Mode.TERMINATION and not self.version.shows_termination:
            return self.requested_mode
        return self.mode

    @property
    def landed(self) -> LandedState:
        """EXTENDED_SYS_STATE.landed_state."""
        return self.land_detector.state

    @property
    def actuation(self) -> Actuation:
        """Actuation of the vehicle at this tick."""
        return self.mode_control.actuation

    @property
    def is_failsafe(self) -> bool:
        """Whether a failsafe has taken the vehicle out of its mode."""
        return self.is_armed and (self.failsafe.is_active or self.mode is not self.requested_mode)

    def has_fresh_setpoint(self, now_s: float) -> bool:
        """Return whether the newest setpoint for OFFBOARD is recent, and the estimate allows it."""
        if self.setpoint is None:
            return False
        if now_s - self.setpoint.time_s > self.params["COM_OF_LOSS_T"]:
            return False
        if self.setpoint.needs_position:
            return self._has_local_position
        return True

    def arming_obstacles(self, now_s: float) -> list[str]:
        """Return the reasons against arming now; empty when there are none."""
        since_boot_s = 0.0
        if self._inputs is not None:
            since_boot_s = now_s - self.boot_time_s

        needs = MODES[self.requested_mode].needs
        if self.failsafe.is_terminated:
            needs = MODES[Mode.TERMINATION].needs
        readiness = Readiness(
            since_boot_s=since_boot_s,
            needs=needs,
            missing=needs & ~self._available(now_s),
            battery=charge_state_of(self.battery.remaining_frac, self.params),
            needs_ground=self.params.integer("NAV_DLL_ACT") > 0,
            has_ground=now_s - self.ground_time_s <= self.params["COM_DL_LOSS_T"],
            has_attitude=not self.mode_control.has_lost_attitude,
            faults=tuple(self.faults),
        )
        return arming_checks.obstacles(readiness)

    def system_status(self, now_s: float) -> SystemStatus:
        """Return HEARTBEAT.system_status."""
        if self.mode is Mode.TERMINATION:
            return SystemStatus.FLIGHT_TERMINATION
        if self.is_failsafe:
            return SystemStatus.CRITICAL
        if self.is_armed:
            return SystemStatus.ACTIVE
        if self.arming_obstacles(now_s):
            return SystemStatus.UNINIT
        return SystemStatus.STANDBY

    def base_mode(self, now_s: float) -> int:
        """Return HEARTBEAT.base_mode."""
        base_mode = MODES[self.shown_mode].base_mode

        if self.shown_mode is Mode.OFFBOARD:
            if not self.has_fresh_setpoint(now_s):
                base_mode = modes.OFFBOARD_WITHOUT_SETPOINTS_BASE_MODE
            elif self.setpoint and self.setpoint.kind is SetpointKind.RATE:
                base_mode = modes.OFFBOARD_RATES_BASE_MODE

        if self.is_armed:
            base_mode |= modes.ARMED_BIT
        return base_mode

    # -- requests ----------------------------------------------------------------------------------

    def request_arm(self, now_s: float, arm: bool, magic: float) -> CommandResult:
        """Arm or disarm as requested by MAV_CMD_COMPONENT_ARM_DISARM.

        The magic number forces disarming. PX4 ignores the number in a request to arm.
        """
        if arm == self.is_armed:
            return CommandResult.ACCEPTED

        if arm:
            reason = self._reason_against_arming(now_s)
            if reason is not None:
                self.journal.say(now_s, reason)
                return CommandResult.TEMPORARILY_REJECTED
            self._arm(now_s)
            return CommandResult.ACCEPTED

        if self.landed is not LandedState.ON_GROUND and magic != _FORCE_MAGIC:
            self.journal.say(now_s, "disarm denied")
            return CommandResult.TEMPORARILY_REJECTED
        self._disarm(now_s, "command")
        return CommandResult.ACCEPTED

    def _reason_against_arming(self, now_s: float) -> str | None:
        """Return the key of the text that says why the vehicle cannot be armed; None if it can."""
        if self.mode in modes.BY_HAND and self.has_sticks(now_s):
            _, _, throttle, _ = self.sticks.positions
            if self.mode in modes.BY_THRUST:
                is_safe = throttle < _MAX_ARMING_THRUST
                reason = "arm denied, high throttle"
            else:
                is_safe = throttle <= _MAX_ARMING_CLIMB
                reason = "arm denied, throttle above center"

            if not is_safe and self.version.has_one_throttle_text:
                return "arm denied, unsafe throttle"
            if not is_safe:
                return reason

        if self.arming_obstacles(now_s):
            return "arm denied"
        return None

    def request_mode(self, now_s: float, main: int, sub: int, base_mode: int = 1) -> CommandResult:
        """Change the mode as requested by DO_SET_MODE or SET_MODE; return the commander's answer.

        A client sees the answer of PX4's MAVLink receiver instead, which comes before it.
        """
        mode = modes.mode_of(base_mode, main, sub)
        if mode is not None:
            return self.request(now_s, mode)

        # PX4 refuses an unknown automatic mode. It accepts all other unknown numbers and ignores
        # them.
        if main != modes.AUTO_MAIN:
            return CommandResult.ACCEPTED
        self.journal.say(now_s, "no such mode")
        return CommandResult.TEMPORARILY_REJECTED

    def request(self, now_s: float, mode: Mode, text: str | None = None) -> CommandResult:
        """Enter a mode.

        A disarmed PX4 accepts every mode. An armed one accepts only a mode that it can fly now. It
        accepts no mode after the termination of its flight.

        Args:
            now_s: present time.
            mode: the requested mode.
            text: key of the text that PX4 sends when it accepts; None: the text of a landing for
                LAND, no text for other modes.
        """
        needs = MODES[mode].needs & ~ModeCondition.ARMING
        if mode is Mode.LAND:
            # A landing always begins. Without a position it becomes a level descent.
            needs = ModeCondition.NOTHING

        is_terminated = self.mode is Mode.TERMINATION
        is_flyable = not needs & ~self._available(now_s)
        if self.is_armed and (is_terminated or not is_flyable):
            self._say_mode_refused(now_s, mode)
            return CommandResult.TEMPORARILY_REJECTED

        if text is None and mode is Mode.LAND:
            text = "landing"
        if text is not None:
            self.journal.say(now_s, text)

        self._request_mode(mode)
        self.failsafe.mode_requested()
        self._select_mode(now_s)
        return CommandResult.ACCEPTED

    def request_takeoff(self, now_s: float, goal_ned_m: Array) -> CommandResult:
        """Take off as requested by MAV_CMD_NAV_TAKEOFF, on the ground or in the air.

        Args:
            now_s: present time.
            goal_ned_m: local position (3,) to fly to. NaN horizontally: above the start; NaN
                vertically: MIS_TAKEOFF_ALT above the start. A vehicle that is higher stays at its
                height.
        """
        result = self.request(now_s, Mode.TAKEOFF)
        if result is not CommandResult.ACCEPTED:
            return result

        self.mode_control.takeoff_ned_m = goal_ned_m
        if self.mode is Mode.TAKEOFF:
            self.mode_control.entered(self._inputs)  # a second take-off starts here
        if self.is_armed:
            self._say_takeoff_height(now_s)
        return result

    def fence_allows(self, goal_ned_m: Array) -> bool:
        """Return whether the geofence allows a goal (3,) of Hold; NaN: as at present."""
        if self._inputs is None or self.params.integer("GF_ACTION") <= _GF_ACTION_WARN:
            return True
        goal_ned_m = np.where(np.isfinite(goal_ned_m), goal_ned_m, self._inputs.position_ned_m)
        return not is_beyond_fence(self._from_home_m(goal_ned_m), self.params)

    def play_tune(self) -> None:
        """Count a request to play a tune."""
        self.tunes += 1

    def request_termination(self, now_s: float) -> CommandResult:
        """Stop the motors as requested by MAV_CMD_DO_FLIGHTTERMINATION.

        The vehicle stays armed until a command disarms it or it lies on the ground.
        """
        if not self.is_armed:
            return CommandResult.DENIED

        self.requested_mode = Mode.TERMINATION
        self._select_mode(now_s)
        self.mode_control.terminate()
        return CommandResult.ACCEPTED

    def accept_setpoint(self, setpoint: Setpoint) -> None:
        """Store the newest setpoint for OFFBOARD; attitude and rates take effect at once."""
        self.setpoint = setpoint
        if self.is_armed and self.mode is Mode.OFFBOARD:
            self._follow(setpoint)

    def take_sticks(self, now_s: float, positions: Axes) -> None:
        """Use the sticks of MANUAL_CONTROL.

        A pilot who moves a stick takes over from a program, unless the parameters forbid it or a
        failsafe is active.
        """
        self.sticks.take(now_s, positions)

        is_flown_by_program = self.mode is Mode.OFFBOARD or MODES[self.mode].main == modes.AUTO_MAIN
        if not self.is_armed or not is_flown_by_program or self.failsafe.is_active:
            return

        override_speed_1_s = self.params.values.get("MAN_OVERRIDE_SPD", -1.0)
        if not self.sticks.is_moving(override_speed_1_s):
            return
        if self._has_local_position:
            self.request(now_s, Mode.POSCTL)
        else:
            self.request(now_s, Mode.ALTCTL)

    def has_sticks(self, now_s: float) -> bool:
        """Return whether the sticks of a pilot are received."""
        return now_s - self.sticks.time_s <= self.params["COM_RC_LOSS_T"]

    @property
    def _has_local_position(self) -> bool:
        return self._inputs is not None and self._inputs.has_local_position

    def _follow(self, setpoint: Setpoint) -> None:
        """Command the actuation of a setpoint."""
        if not setpoint.is_rotation and not self.version.survives_no_rotation:
            self.mode_control.has_lost_attitude = True
        self.mode_control.take_setpoint(setpoint)

    def _say_mode_refused(self, now_s: float, mode: Mode) -> None:
        if now_s - self._refused_time_s <= _REFUSAL_INTERVAL_S:
            return
        self._refused_time_s = now_s

        name, number = modes.NAMES[mode]
        self.journal.say(now_s, "mode refused", MODES[mode].custom_mode, number, mode=name)

    # -- time --------------------------------------------------------------------------------------

    def tick(self, inputs: AutopilotInputs) -> None:
        """Run one tick of the autopilot, which happens at 50 Hz."""
        now_s = inputs.time_s
        self._inputs = inputs
        if self.held_sticks is not None:
            self.take_sticks(now_s, self.held_sticks)

        self.battery.step(
            TICK_S,
            is_armed=self.is_armed,
            drain_s=self.params["SIM_BAT_DRAIN"],
            floor_pct=self.params["SIM_BAT_MIN_PCT"],
        )

        if not self.is_armed:
            self._select_mode(now_s)
            return

        self._watch_battery(now_s)
        self._watch_attitude(inputs)
        self._select_mode(now_s)
        if not self.is_armed:  # a failsafe has just disarmed it
            return

        text = self.land_detector.step(inputs, self.mode, self.actuation.thrust_frac, self.params)
        if text is not None:
            self.journal.say(now_s, text)
        self._auto_disarm(now_s)
        if not self.is_armed:
            return

        sticks = None
        if self.has_sticks(now_s):
            sticks = self.sticks.positions
        has_taken_off = self.mode_control.step(
            inputs, self.mode, self.landed, self.params, self.setpoint, sticks
        )
        if has_taken_off:
            goal_ned_m = self.mode_control.takeoff_goal_ned_m(inputs, self.params)
            if math.dist(goal_ned_m[:2], inputs.position_ned_m[:2]) > MAX_TAKEOFF_M:
                goal_ned_m[:2] = math.nan
            self.mode_control.takeoff_ned_m = np.full(3, math.nan)
            self._request_mode(Mode.LOITER)
            self._select_mode(now_s)
            if self.mode is Mode.LOITER:
                self.mode_control.hold_at(goal_ned_m)

    def _available(self, now_s: float) -> ModeCondition:
        """Return the conditions of modes that are met now."""
        available = ModeCondition.NOTHING
        if self._has_local_position:
            available |= ModeCondition.LOCAL_POSITION
        if self._inputs is not None and self._inputs.has_global_position:
            available |= ModeCondition.GLOBAL_POSITION
        if self.has_fresh_setpoint(now_s):
            available |= ModeCondition.SETPOINTS
        if self.has_sticks(now_s):
            available |= ModeCondition.STICKS
        return available

    def _request_mode(self, mode: Mode) -> None:
        self.requested_mode = mode
        # Disarming does not restore a mode in which the vehicle cannot be armed.
        if ModeCondition.ARMING not in MODES[mode].needs:
            self._mode_after_disarming = mode

    def _arm(self, now_s: float) -> None:
        self.is_armed = True
        self._armed_time_s = now_s
        self._has_attitude_failed = False
        self._tilted_since_s = math.inf
        self.charge_state = ChargeState.OK
        self.failsafe.reset()
        self.land_detector.disarmed()
        self.mode_control.armed(now_s, self._inputs, self.params)

        reason_text, number = REASONS["command"]
        self.journal.say(now_s, "armed", number, why=reason_text)
        if self.requested_mode is Mode.TAKEOFF:
            self._say_takeoff_height(now_s)

        self._select_mode(now_s)
        if self.mode is Mode.OFFBOARD and self.setpoint is not None:
            self._follow(self.setpoint)

    def _say_takeoff_height(self, now_s: float) -> None:
        down_m = self.mode_control.takeoff_ned_m[2]
        if math.isnan(down_m):
            height_m = self.params["MIS_TAKEOFF_ALT"]
            self.journal.say(now_s, "takeoff height", height=height_m)
        elif self._inputs is not None and down_m > self._inputs.position_ned_m[2]:
            self.journal.say(now_s, "takeoff height passed")

    def _disarm(self, now_s: float, reason: str) -> None:
        self.is_armed = False
        self.land_detector.disarmed()
        self.failsafe.reset()
        self.requested_mode = self._mode_after_disarming

        reason_text, number = REASONS[reason]
        self.journal.say(now_s, "disarmed", number, why=reason_text)

        self.mode_control.takeoff_ned_m = np.full(3, math.nan)
        self._select_mode(now_s)
        self.mode_control.disarmed()

    # -- the mode that is flown --------------------------------------------------------------------

    def _select_mode(self, now_s: float) -> None:
        """Enter the active mode: the requested one, a failsafe's, or a fallback of either."""
        mode = self.requested_mode

        if self.is_armed:
            self._step_failsafe(now_s)
            if self.failsafe.action is FailsafeAction.DISARM:
                self._disarm(now_s, "failsafe")
                return

            mode = ACTION_MODE.get(self.failsafe.action, mode)
            if self.requested_mode is Mode.TERMINATION:
                mode = Mode.TERMINATION

            # a fallback mode is announced when it begins
            flyable = self._flyable(mode)
            if flyable is not mode and flyable is not self.mode:
                shown = MODES[flyable].custom_mode
                self.journal.say(now_s, "failsafe", shown, FailsafeAction.LAND)
            mode = flyable
        elif self.failsafe.is_terminated:
            mode = Mode.TERMINATION

        if mode is self.mode:
            return
        self.mode = mode
        self.mode_control.entered(self._inputs)
        if mode is Mode.OFFBOARD and self.is_armed and self.setpoint is not None:
            self._follow(self.setpoint)

    def _flyable(self, mode: Mode) -> Mode:
        """Return a mode, or its fallback mode when there is no position."""
        if self._has_local_position:
            return mode
        # POSCTL stays, because PX4 shows it. Without sticks it is always a level descent.
        while mode in modes.FALLBACK and mode is not Mode.POSCTL:
            mode = modes.FALLBACK[mode]
        return mode

    def _step_failsafe(self, now_s: float) -> None:
        """Advance the failsafes with the present inputs, and announce a new action."""
        has_offboard_signal = True  # other modes do not need one
        if self.requested_mode is Mode.OFFBOARD:
            has_offboard_signal = self.has_fresh_setpoint(now_s)
        from_home_m = (0.0, 0.0)
        if self._inputs is not None:
            from_home_m = self._from_home_m(self._inputs.position_ned_m)
        inputs = FailsafeInputs(
            has_offboard_signal=has_offboard_signal,
            battery=self.charge_state,
            attitude_failed=self._has_attitude_failed,
            from_home_m=from_home_m,
            ground_silent_s=now_s - self.ground_time_s,
            requested_mode=self.requested_mode,
            has_sticks=self.has_sticks(now_s),
            flown_s=now_s - self.land_detector.takeoff_time_s,
            battery_left_s=self.battery.left_s(self.params),
            wind_m_s=self._estimated_wind_m_s(),
        )
        was_beyond_fence = GEOFENCE in self.failsafe.present
        is_announced = self.failsafe.step(now_s, inputs, self.params)

        has_just_left = GEOFENCE in self.failsafe.present and not was_beyond_fence
        holds_there = self.params.integer("GF_ACTION") == _GF_ACTION_HOLD
        if has_just_left and holds_there and self.mode is Mode.LOITER:
            self.mode_control.entered(self._inputs)  # Hold drops its goal beyond the fence

        if not is_announced:
            return

        shown = MODES[ACTION_MODE.get(self.failsafe.action, self.requested_mode)].custom_mode
        if self.failsafe.delayed is FailsafeAction.NONE:
            self.journal.say(now_s, "failsafe", shown, self.failsafe.action)
            return

        hold_s = self.params["COM_FAIL_ACT_T"]
        shown_s = int(min(65535.0, max(0.0, hold_s)))
        self.journal.say(
            now_s, "failsafe hold", shown, self.failsafe.delayed, shown_s, seconds=hold_s
        )

    def _estimated_wind_m_s(self) -> float:
        """Return the estimated wind, which PX4 has for a multirotor only if it fuses the drag."""
        if self._inputs is None or not self.params.integer("EKF2_DRAG_CTRL"):
            return 0.0
        return self._inputs.wind_m_s

    def _from_home_m(self, position_ned_m: Array) -> tuple[float, float]:
        """Return the horizontal distance of a position (3,) from home, and its height above it."""
        north, east, down = (position_ned_m - self.mode_control.home_ned_m).tolist()
        return math.hypot(north, east), -down

    # -- monitoring while armed --------------------------------------------------------------------

    def _watch_battery(self, now_s: float) -> None:
        charge_state = charge_state_of(self.battery.remaining_frac, self.params)
        # The charge state of an armed vehicle does not improve.
        if charge_state.value <= self.charge_state.value:
            return

        self.charge_state = charge_state
        self.journal.say(now_s, _BATTERY_TEXTS[charge_state])
        if charge_state is ChargeState.EMERGENCY:
            self.journal.say(now_s, "no shutdown")

    def _watch_attitude(self, inputs: AutopilotInputs) -> None:
        """Note an attitude failure when roll or pitch stays beyond its limit for too long."""
        if self._has_attitude_failed or inputs.on_ground:
            return

        roll_limit_deg = self.params["FD_FAIL_R"]
        pitch_limit_deg = self.params["FD_FAIL_P"]

        # Most ticks need no angles: roll and pitch are within limits if the tilt is below both.
        least_limit_rad = math.radians(min(roll_limit_deg, pitch_limit_deg))
        if uprightness(inputs.attitude) > math.cos(least_limit_rad):
            self._tilted_since_s = math.inf
            return

        w, x, y, z = inputs.attitude.tolist()
        roll_rad, pitch_rad, _ = euler((w, x, y, z))
        is_roll = abs(roll_rad) > math.radians(roll_limit_deg)
        is_pitch = abs(pitch_rad) > math.radians(pitch_limit_deg)
        if not is_roll and not is_pitch:
            self._tilted_since_s = math.inf
            return

        self._tilted_since_s = min(self._tilted_since_s, inputs.time_s)
        if inputs.time_s - self._tilted_since_s >= self.params["FD_FAIL_R_TTRI"]:
            self._has_attitude_failed = True
            if is_roll:
                self.journal.say(inputs.time_s, "roll failure")
            else:
                self.journal.say(inputs.time_s, "pitch failure")

    def _auto_disarm(self, now_s: float) -> None:
        if self.landed is not LandedState.ON_GROUND:
            return

        if self.land_detector.has_flown:
            after_landing_s = self.params["COM_DISARM_LAND"]
            landed_for_s = now_s - self.land_detector.landed_time_s
            if after_landing_s > 0.0 and landed_for_s >= after_landing_s:
                self._disarm(now_s, "landing")
        else:
            before_flight_s = self.params["COM_DISARM_PRFLT"]
            armed_for_s = now_s - self._armed_time_s
            if before_flight_s > 0.0 and armed_for_s >= before_flight_s:
                self._disarm(now_s, "preflight")
