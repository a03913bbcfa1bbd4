"""One PX4 commander and its modes: arming, mode requests, failsafes, landing. Pure: time comes in, texts go out.

The mode that was asked for (`intent`) and the mode that is flown (`mode`) are two things, as in PX4: a failsafe changes
only the second, and when its cause is gone the first is flown again without being asked for.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from sitl import modes, rotation
from sitl.battery import Battery
from sitl.modes import MODES, Landed, Mode, Result, SystemStatus
from sitl.parameters import Parameters
from sitl.position_control import Goal, PositionControl
from sitl.rotation import Array
from sitl.signals import Actuation, Setpoint, SetpointKind, Situation, Text

TICK_S = 0.02
BOOT_S = 4.3
_SPOOL_S = 1.0
_TAKEOFF_REACHED_M = 0.25
_LAND_DETECT_AUTO_S = 4.3
_LAND_DETECT_OFFBOARD_S = 2.2
_FORCE_MAGIC = 21196.0
_RTL_NEAR_M = 0.5
_BATTERY_HOLD_S = 5.0
_HOVER_LEARN_S = 2.0


class BatteryStage(Enum):
    """How empty the battery is, by PX4's parameters; what follows is in `_BATTERY_STAGES`."""

    OK = 1
    LOW = 2
    CRITICAL = 3
    EMERGENCY = 4


# From the emptiest: parameter of the threshold, stage, text.
_BATTERY_STAGES = (
    ("BAT_EMERGEN_THR", BatteryStage.EMERGENCY, "Emergency battery level"),
    ("BAT_CRIT_THR", BatteryStage.CRITICAL, "Critical battery"),
    ("BAT_LOW_THR", BatteryStage.LOW, "Low battery"),
)


@dataclass(slots=True)
class Autopilot:
    """State of one PX4."""

    params: Parameters = field(default_factory=Parameters)
    battery: Battery = field(default_factory=Battery)
    intent: Mode = Mode.LOITER
    mode: Mode = Mode.LOITER
    is_armed: bool = False
    is_failsafe: bool = False
    landed: Landed = Landed.ON_GROUND
    setpoint: Setpoint | None = None
    battery_stage: BatteryStage = BatteryStage.OK
    actuation: Actuation = field(
        default_factory=lambda: Actuation(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), False, 0.0, False)
    )
    texts: list[Text] = field(default_factory=list)
    _control: PositionControl = field(default_factory=PositionControl)
    _intent_before: Mode = Mode.LOITER
    _armed_time_s: float = 0.0
    _has_flown: bool = False
    _contact_time_s: float = 0.0
    _landed_time_s: float = 0.0
    _mode_entry: Situation | None = None
    _home_ned_m: Array = field(default_factory=lambda: np.zeros(3))
    _critical_time_s: float | None = None
    _told_failure: bool = False
    _last: Situation | None = None
    _hover_thrust_frac: float = 0.0

    # -- what a heartbeat shows ---------------------------------------------------------------------------------

    def has_fresh_setpoint(self, now_s: float) -> bool:
        """Whether OFFBOARD may be flown: the newest setpoint is younger than COM_OF_LOSS_T."""
        return self.setpoint is not None and now_s - self.setpoint.time_s <= self.params["COM_OF_LOSS_T"]

    def arming_obstacles(self, now_s: float) -> list[str]:
        """Why this vehicle cannot be armed now; empty when it can."""
        found: list[str] = []
        situation = self._last
        if now_s < BOOT_S or situation is None:
            found.append("system is still starting")
        if self.intent is Mode.OFFBOARD:
            if not self.has_fresh_setpoint(now_s):
                found.append("no offboard setpoints")
            elif (
                self.setpoint is not None
                and self.setpoint.kind is SetpointKind.POSITION
                and not (situation is not None and situation.has_local_position)
            ):
                found.append("no local position")
        elif MODES[self.intent].needs_position and not (situation is not None and situation.has_global_position):
            found.append("no position for this mode")
        return found

    def system_status(self, now_s: float) -> SystemStatus:
        """HEARTBEAT.system_status."""
        if self.is_armed:
            return SystemStatus.CRITICAL if self.is_failsafe else SystemStatus.ACTIVE
        return SystemStatus.UNINIT if self.arming_obstacles(now_s) else SystemStatus.STANDBY

    def base_mode(self, now_s: float) -> int:
        """HEARTBEAT.base_mode."""
        base = MODES[self.mode].base_mode
        if self.mode is Mode.OFFBOARD:
            if not self.has_fresh_setpoint(now_s):
                base = modes.OFFBOARD_WITHOUT_SETPOINTS_BASE_MODE
            elif self.setpoint and self.setpoint.kind is SetpointKind.RATE:
                base = modes.OFFBOARD_RATES_BASE_MODE
        return base | (modes.ARMED_BIT if self.is_armed else 0)

    # -- requests -----------------------------------------------------------------------------------------------

    def say(self, now_s: float, severity: int, text: str) -> None:
        """Put a text in the outbox."""
        self.texts.append(Text(now_s, severity, text))

    def request_arm(self, now_s: float, arm: bool, magic: float) -> Result:
        """MAV_CMD_COMPONENT_ARM_DISARM."""
        is_forced = magic == _FORCE_MAGIC
        if arm == self.is_armed:
            return Result.ACCEPTED
        if arm:
            if self.arming_obstacles(now_s) and not is_forced:
                self.say(now_s, 2, "Arming denied: Resolve system health failures first\t")
                return Result.TEMPORARILY_REJECTED
            self._arm(now_s)
            return Result.ACCEPTED
        if self.landed is not Landed.ON_GROUND and not is_forced:
            self.say(now_s, 2, "Disarming denied: not landed\t")
            return Result.TEMPORARILY_REJECTED
        self._disarm(now_s, "Disarmed by external command\t")
        return Result.ACCEPTED

    def request_mode(self, now_s: float, main: int, sub: int) -> Result:
        """DO_SET_MODE or SET_MODE: the commander's own answer (the receiver's early one is the server's)."""
        mode = modes.BY_NUMBERS.get((main, sub if main == 4 else 0))
        if mode is None:
            return Result.TEMPORARILY_REJECTED
        return self.request(now_s, mode)

    def request(self, now_s: float, mode: Mode) -> Result:
        """Ask for a mode. Disarmed, everything is taken; armed, only what can be flown now."""
        if self.is_armed:
            if mode is Mode.OFFBOARD and not self.has_fresh_setpoint(now_s):
                return Result.TEMPORARILY_REJECTED
            position = self._last is not None and self._last.has_local_position
            if mode is not Mode.LAND and MODES[mode].needs_position and not position:
                return Result.TEMPORARILY_REJECTED
        if mode is Mode.LAND:
            self.say(now_s, 6, "Landing at current position\t")
        if mode is not self.intent:
            self._intent_before = self.intent
        self.intent = mode
        self._choose_mode(now_s)
        return Result.ACCEPTED

    def accept_setpoint(self, setpoint: Setpoint) -> None:
        """Take the newest OFFBOARD setpoint; attitude and rates act at once."""
        self.setpoint = setpoint
        if self.is_armed and self.mode is Mode.OFFBOARD:
            self._offboard_actuation()

    # -- time ---------------------------------------------------------------------------------------------------

    def tick(self, situation: Situation) -> None:
        """Everything that happens at 50 Hz."""
        now = situation.time_s
        self._last = situation
        self.battery.step(
            TICK_S,
            is_armed=self.is_armed,
            drain_s=self.params["SIM_BAT_DRAIN"],
            floor_pct=self.params["SIM_BAT_MIN_PCT"],
        )
        self._watch_battery(now)
        self._watch_attitude(situation)
        self._choose_mode(now)
        if self.is_armed:
            self._detect_landing(situation)
            self._auto_disarm(now)
            self._learn_hover_thrust(situation)
        self._actuate(situation)

    def _arm(self, now_s: float) -> None:
        self.is_armed = True
        self._armed_time_s = now_s
        self._has_flown = False
        self._told_failure = False
        self._critical_time_s = None
        self.battery_stage = BatteryStage.OK
        self._control.reset()
        self._hover_thrust_frac = self.params["MPC_THR_HOVER"]
        if self._last is not None:
            self._home_ned_m = self._last.position_ned_m.copy()
        self._mode_entry = self._last
        self.say(now_s, 6, "Armed by external command\t")
        if self.intent is Mode.TAKEOFF:
            self.say(now_s, 6, f"Using default takeoff altitude: {self.params['MIS_TAKEOFF_ALT']:.1f} m\t")
        self._choose_mode(now_s)
        if self.mode is Mode.OFFBOARD:
            self._offboard_actuation()

    def _disarm(self, now_s: float, why: str) -> None:
        self.is_armed = False
        self.landed = Landed.ON_GROUND  # PX4's land detector takes whatever is not armed for landed
        self._critical_time_s = None
        if self.intent in modes.INTENT_AFTER_DISARM:
            was_offboard = self._intent_before is Mode.OFFBOARD
            self.intent = Mode.OFFBOARD if was_offboard else modes.INTENT_AFTER_DISARM[self.intent]
        self.say(now_s, 6, why)
        self._choose_mode(now_s)
        self.actuation = Actuation(self.actuation.attitude, np.zeros(3), False, 0.0, False)

    def _choose_mode(self, now_s: float) -> None:
        mode, failsafe = self.intent, False
        if self.is_armed:
            if self._critical_time_s is not None:
                failsafe = True
                mode = Mode.LOITER if now_s - self._critical_time_s < _BATTERY_HOLD_S else Mode.LAND
            elif self.intent is Mode.OFFBOARD and not self.has_fresh_setpoint(now_s):
                action = modes.OFFBOARD_LOSS_MODE.get(int(self.params["COM_OBL_RC_ACT"]), Mode.POSCTL)
                failsafe = True
                if action is None:
                    self._disarm(now_s, "Disarmed by failsafe\t")
                    return
                mode = action
        if failsafe and not self.is_failsafe:
            self.say(now_s, 2, "Failsafe activated\t")
        self.is_failsafe = failsafe
        if mode is not self.mode:
            self.mode = mode
            self._mode_entry = self._last
            self._control.integral_m_s2[:2] = 0.0

    def _watch_battery(self, now_s: float) -> None:
        if not self.is_armed:
            return
        charge = self.battery.remaining_frac
        for parameter, stage, text in _BATTERY_STAGES:
            if charge <= self.params[parameter] and stage.value > self.battery_stage.value:
                self.battery_stage = stage
                self.say(now_s, 0, text + "\t")
                if stage is not BatteryStage.LOW and self._critical_time_s is None:
                    self._critical_time_s = now_s
                return

    def _watch_attitude(self, situation: Situation) -> None:
        if not self.is_armed or self._told_failure or situation.on_ground:
            return
        down = rotation.body_down(situation.attitude)
        if down[2] < math.cos(math.radians(self.params["FD_FAIL_R"])):
            self._told_failure = True
            self.say(situation.time_s, 2, "Preflight Fail: Attitude failure (roll)\t")
            self.say(situation.time_s, 2, "Failsafe activated\t")

    def _detect_landing(self, situation: Situation) -> None:
        now = situation.time_s
        low_thrust = 0.12 + 0.3 * (self.params["MPC_THR_HOVER"] - 0.12)
        if not situation.on_ground:
            if self.landed is Landed.ON_GROUND:
                self._has_flown = True
                self.say(now, 6, "Takeoff detected\t")
            self._contact_time_s = now
            climbs = self.mode is Mode.TAKEOFF
            descends = self.mode is Mode.LAND
            self.landed = Landed.TAKEOFF if climbs else Landed.LANDING if descends else Landed.IN_AIR
            return
        if self.actuation.thrust_frac > low_thrust:
            self._contact_time_s = now
            return
        patience = _LAND_DETECT_OFFBOARD_S if self.mode is Mode.OFFBOARD else _LAND_DETECT_AUTO_S
        if self.landed is not Landed.ON_GROUND and now - self._contact_time_s >= patience:
            self.landed = Landed.ON_GROUND
            self._landed_time_s = now
            self.say(now, 6, "Landing detected\t")

    def _learn_hover_thrust(self, situation: Situation) -> None:
        # PX4 estimates its hover thrust in flight; without that a heavy vehicle sinks when a failsafe takes over.
        if situation.on_ground or abs(situation.velocity_ned_m_s[2]) > 0.5:
            return
        lift = self.actuation.thrust_frac * rotation.body_down(situation.attitude)[2]
        learned = self._hover_thrust_frac + TICK_S / _HOVER_LEARN_S * (lift - self._hover_thrust_frac)
        self._hover_thrust_frac = float(min(0.9, max(0.1, learned)))

    def _auto_disarm(self, now_s: float) -> None:
        if self.landed is not Landed.ON_GROUND:
            return
        after_landing, before_flight = self.params["COM_DISARM_LAND"], self.params["COM_DISARM_PRFLT"]
        if self._has_flown:
            if after_landing > 0.0 and now_s - self._landed_time_s >= after_landing:
                self._disarm(now_s, "Disarmed by landing\t")
        elif before_flight > 0.0 and now_s - self._armed_time_s >= before_flight:
            self._disarm(now_s, "Disarmed by auto preflight disarming\t")

    # -- flying -------------------------------------------------------------------------------------------------

    def _actuate(self, situation: Situation) -> None:
        if not self.is_armed:
            return
        if self.mode is Mode.OFFBOARD:
            if self.setpoint is not None and self.setpoint.kind is SetpointKind.POSITION and self.setpoint.goal:
                self._fly(situation, self.setpoint.goal)
            return
        entry = self._mode_entry or situation
        yaw = entry.yaw_rad
        hold = entry.position_ned_m
        still = np.zeros(3)
        nowhere = np.full(3, math.nan)
        rests = self.landed is Landed.ON_GROUND
        if self.mode is Mode.TAKEOFF:
            if situation.time_s - self._armed_time_s < _SPOOL_S:
                self._idle(yaw)
                return
            goal_ned_m = self._home_ned_m.copy()
            goal_ned_m[2] -= self.params["MIS_TAKEOFF_ALT"]
            self._fly(situation, Goal(goal_ned_m, still, yaw), max_up_m_s=self.params["MPC_TKO_SPEED"])
            if not rests and abs(situation.position_ned_m[2] - goal_ned_m[2]) < _TAKEOFF_REACHED_M:
                self.intent = Mode.LOITER
        elif rests or (situation.on_ground and self.mode is not Mode.LOITER):
            self._idle(yaw)
        elif self.mode in modes.BLIND_DESCENT:
            # Level, whatever the position does: there is nobody at the sticks.
            down = np.array([0.0, 0.0, self.params["MPC_LAND_SPEED"]])
            self._fly(situation, Goal(nowhere, down, yaw), is_level=True)
        elif self.mode is Mode.LAND:
            self._descend(situation, hold, yaw)
        elif self.mode is Mode.RTL:
            home = np.array([self._home_ned_m[0], self._home_ned_m[1], hold[2]])
            if math.dist(home[:2], situation.position_ned_m[:2]) < _RTL_NEAR_M:
                self._descend(situation, home, yaw)
            else:
                self._fly(situation, Goal(home, still, yaw))
        else:
            self._fly(situation, Goal(hold, still, yaw))

    def _descend(self, situation: Situation, at_ned_m: Array, yaw_rad: float) -> None:
        goal = np.array([at_ned_m[0], at_ned_m[1], math.nan])
        speed = np.array([0.0, 0.0, self.params["MPC_LAND_SPEED"]])
        self._fly(situation, Goal(goal, speed, yaw_rad), is_level=not situation.has_local_position)

    def _fly(
        self, situation: Situation, goal: Goal, *, max_up_m_s: float | None = None, is_level: bool = False
    ) -> None:
        attitude, thrust = self._control.step(
            goal,
            situation.position_ned_m,
            situation.velocity_ned_m_s,
            TICK_S,
            hover_thrust_frac=self._hover_thrust_frac,
            max_speed_m_s=self.params["MPC_XY_CRUISE"],
            max_up_m_s=self.params["MPC_Z_VEL_MAX_UP"] if max_up_m_s is None else max_up_m_s,
            max_down_m_s=self.params["MPC_Z_VEL_MAX_DN"],
            max_tilt_rad=math.radians(self.params["MPC_TILTMAX_AIR"]),
        )
        if is_level:
            attitude = rotation.yaw_quaternion(np.float64(goal.yaw_rad))  # type: ignore[arg-type]
        self.actuation = Actuation(attitude, np.zeros(3), False, thrust, True)

    def _idle(self, yaw_rad: float) -> None:
        self._control.reset()
        level = rotation.yaw_quaternion(np.float64(yaw_rad))  # type: ignore[arg-type]
        self.actuation = Actuation(level, np.zeros(3), False, 0.0, True)

    def _offboard_actuation(self) -> None:
        setpoint = self.setpoint
        if setpoint is None or setpoint.kind is SetpointKind.POSITION:
            return
        attitude = self.actuation.attitude if setpoint.attitude is None else setpoint.attitude
        rate = np.zeros(3) if setpoint.rate_rad_s is None else setpoint.rate_rad_s
        self.actuation = Actuation(attitude, rate, setpoint.kind is SetpointKind.RATE, setpoint.thrust_frac, True)
