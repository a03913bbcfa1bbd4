"""PX4's failsafes as a table of triggers, with the parameter that selects the action of each.

PX4 evaluates all triggers at each tick. Each active trigger selects an action, in most cases
through a user parameter. PX4 carries out the most severe of these actions.

There are four exceptions:

* An action that is not urgent (for a critical battery or a lost ground station) follows after
  COM_FAIL_ACT_T seconds of Hold, so that a pilot has time to take over.
* Some actions are latched and outlast their trigger. `Clears` names the end of each action.
* A failsafe that would return home only warns a vehicle that lands or returns home already.
* A user who requests a mode while an action between Hold and a level descent is carried out takes
  over: the requested mode is flown, and the triggers only warn, until all of them are over or a
  further one appears.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import NamedTuple

from msgspec import Struct

from sitl.px4.battery import ChargeState
from sitl.px4.modes import Mode
from sitl.px4.parameters import Parameters

FLIGHT_TERMINATION_OFF = 121212.0  # value of CBRK_FLIGHTTERM that forbids the termination
GEOFENCE = "geofence"  # name of the trigger
# Bit of a requested mode in COM_DLL_EXCEPT.
_GROUND_LOSS_EXCEPTIONS: dict[Mode, int] = {
    Mode.MISSION: 1,
    Mode.LOITER: 2,
    Mode.TAKEOFF: 2,
    Mode.OFFBOARD: 4,
}
_MIN_SPEED_M_S = 1e-3  # lower limit of the speeds of a return


class FailsafeAction(IntEnum):
    """Actions of a failsafe in PX4's order of severity and with its numbers."""

    NONE = 0
    WARN = 1
    POSCTL = 2
    ALTCTL = 3
    STABILIZED = 4
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


_MANUAL = (FailsafeAction.POSCTL, FailsafeAction.ALTCTL, FailsafeAction.STABILIZED)

# Mode of an action. Actions without an entry keep the mode, or end the flight at once.
ACTION_MODE: dict[FailsafeAction, Mode] = {
    FailsafeAction.POSCTL: Mode.POSCTL,
    FailsafeAction.ALTCTL: Mode.ALTCTL,
    FailsafeAction.STABILIZED: Mode.STABILIZED,
    FailsafeAction.HOLD: Mode.LOITER,
    FailsafeAction.RETURN: Mode.RTL,
    FailsafeAction.LAND: Mode.LAND,
    FailsafeAction.DESCEND: Mode.DESCEND,
    FailsafeAction.TERMINATE: Mode.TERMINATION,
}


class FailsafeInputs(Struct, frozen=True):
    """Inputs of the failsafes at one tick."""

    has_offboard_signal: bool  # False when OFFBOARD is requested without fresh setpoints
    battery: ChargeState  # charge of the battery
    attitude_failed: bool  # whether the tilt was beyond FD_FAIL_R or FD_FAIL_P
    from_home_m: tuple[float, float]  # horizontal and vertical distance from home
    ground_silent_s: float  # time since the last heartbeat of a ground station
    requested_mode: Mode = Mode.LOITER
    has_sticks: bool = False  # whether the sticks of a pilot are received
    flown_s: float = 0.0  # time since the take-off
    battery_left_s: float = math.inf  # time that the charge lasts
    wind_m_s: float = 0.0  # wind that PX4 estimates


class Clears(Enum):
    """The end of an action."""

    WITH_CONDITION = "when the condition is gone"
    BY_MODE_CHANGE = "when somebody asks for a mode, or on disarming"
    NEVER = "on disarming only"


@dataclass(frozen=True, slots=True)
class FailsafeTrigger:
    """One row of the table."""

    name: str
    holds: Callable[[FailsafeInputs, Parameters], bool]  # whether the trigger holds now
    parameter: str | None  # parameter of the action; None when the action is always `otherwise`
    actions: Mapping[int, FailsafeAction]  # action by value of the parameter
    otherwise: FailsafeAction  # action for every other value
    is_delayed: bool = False  # whether COM_FAIL_ACT_T seconds of Hold precede the action
    clears: Clears = Clears.WITH_CONDITION  # end of the action
    allows_takeover: bool = True  # whether a requested mode is flown in spite of the trigger

    def action(self, inputs: FailsafeInputs, params: Parameters) -> FailsafeAction:
        """Return the action that the parameters select."""
        if self.parameter is None:
            return self.otherwise

        action = self.actions.get(params.integer(self.parameter), self.otherwise)

        # Newer versions return home where a manual mode is selected and no sticks are received.
        has_manual_control = inputs.has_sticks or params.version.flies_manual_modes_without_sticks
        if action in _MANUAL and not has_manual_control:
            return FailsafeAction.RETURN
        return action


def _is_offboard_lost(inputs: FailsafeInputs, _: Parameters) -> bool:
    return not inputs.has_offboard_signal


def _is_battery_low(inputs: FailsafeInputs, _: Parameters) -> bool:
    return inputs.battery is ChargeState.LOW


def _is_battery_critical(inputs: FailsafeInputs, _: Parameters) -> bool:
    return inputs.battery is ChargeState.CRITICAL


def _is_battery_at_emergency_level(inputs: FailsafeInputs, _: Parameters) -> bool:
    return inputs.battery is ChargeState.EMERGENCY


def _has_attitude_failed(inputs: FailsafeInputs, params: Parameters) -> bool:
    may_terminate = params["CBRK_FLIGHTTERM"] != FLIGHT_TERMINATION_OFF
    is_shown = may_terminate or params.version.warns_of_attitude_failure
    return inputs.attitude_failed and is_shown


def is_beyond_fence(from_home_m: tuple[float, float], params: Parameters) -> bool:
    """Return whether a position at a horizontal and vertical distance from home is outside."""
    distance_m, height_m = from_home_m
    max_distance_m = params["GF_MAX_HOR_DIST"]
    max_height_m = params["GF_MAX_VER_DIST"]

    # A limit of 0 stands for no limit.
    is_too_far = 0.0 < max_distance_m < distance_m
    is_too_high = 0.0 < max_height_m < height_m
    return is_too_far or is_too_high


def _has_left_fence(inputs: FailsafeInputs, params: Parameters) -> bool:
    return is_beyond_fence(inputs.from_home_m, params)


def _is_ground_lost(inputs: FailsafeInputs, params: Parameters) -> bool:
    # A landing goes on without a ground station, and so do the modes of COM_DLL_EXCEPT.
    if inputs.requested_mode is Mode.LAND:
        return False
    if params.integer("COM_DLL_EXCEPT") & _GROUND_LOSS_EXCEPTIONS.get(inputs.requested_mode, 0):
        return False
    return params["NAV_DLL_ACT"] > 0 and inputs.ground_silent_s > params["COM_DL_LOSS_T"]


def _is_flight_too_long(inputs: FailsafeInputs, params: Parameters) -> bool:
    return 0.0 < params["COM_FLT_TIME_MAX"] < inputs.flown_s


def _is_battery_short_of_home(inputs: FailsafeInputs, params: Parameters) -> bool:
    return inputs.battery_left_s <= _return_s(inputs, params)


def _return_s(inputs: FailsafeInputs, params: Parameters) -> float:
    """Return the time that PX4 expects to climb, fly home and land, with its margins [s]."""
    distance_m, height_m = inputs.from_home_m
    top_m = height_m
    if distance_m > params["RTL_MIN_DIST"]:
        top_m = max(height_m, params["RTL_RETURN_ALT"])

    climb_s = (top_m - height_m) / max(params["MPC_Z_V_AUTO_UP"], _MIN_SPEED_M_S)
    cruise_s = distance_m / max(params["MPC_XY_CRUISE"], _MIN_SPEED_M_S)
    descent_s = max(0.0, top_m) / max(params["MPC_LAND_SPEED"], _MIN_SPEED_M_S)
    flight_s = climb_s + cruise_s + descent_s
    return params["RTL_TIME_FACTOR"] * flight_s + params["RTL_TIME_MARGIN"]


def _is_wind_too_strong(inputs: FailsafeInputs, params: Parameters) -> bool:
    return 0.0 < params["COM_WIND_MAX"] < inputs.wind_m_s


FAILSAFE_TRIGGERS: tuple[FailsafeTrigger, ...] = (
    FailsafeTrigger(
        name="offboard setpoints lost",
        holds=_is_offboard_lost,
        parameter="COM_OBL_RC_ACT",
        actions={
            0: FailsafeAction.POSCTL,
            1: FailsafeAction.ALTCTL,
            2: FailsafeAction.STABILIZED,
            3: FailsafeAction.RETURN,
            4: FailsafeAction.LAND,
            5: FailsafeAction.HOLD,
            6: FailsafeAction.TERMINATE,
            7: FailsafeAction.DISARM,
        },
        otherwise=FailsafeAction.POSCTL,
        allows_takeover=False,  # it ends with any other mode
    ),
    FailsafeTrigger(
        name="battery low",
        holds=_is_battery_low,
        parameter=None,
        actions={},
        otherwise=FailsafeAction.WARN,
    ),
    FailsafeTrigger(
        name="battery critical",
        holds=_is_battery_critical,
        parameter="COM_LOW_BAT_ACT",
        actions={
            0: FailsafeAction.WARN,
            1: FailsafeAction.RETURN,
            2: FailsafeAction.LAND,
            3: FailsafeAction.RETURN,
        },
        otherwise=FailsafeAction.WARN,
        is_delayed=True,
    ),
    FailsafeTrigger(
        name="battery at emergency level",
        holds=_is_battery_at_emergency_level,
        parameter="COM_LOW_BAT_ACT",
        actions={
            0: FailsafeAction.WARN,
            1: FailsafeAction.RETURN,
            2: FailsafeAction.LAND,
            3: FailsafeAction.LAND,
        },
        otherwise=FailsafeAction.WARN,
        is_delayed=True,
    ),
    FailsafeTrigger(
        name="attitude failure",
        holds=_has_attitude_failed,
        parameter="CBRK_FLIGHTTERM",
        actions={int(FLIGHT_TERMINATION_OFF): FailsafeAction.WARN},
        otherwise=FailsafeAction.TERMINATE,
        clears=Clears.NEVER,
    ),
    FailsafeTrigger(
        name=GEOFENCE,
        holds=_has_left_fence,
        parameter="GF_ACTION",
        actions={
            0: FailsafeAction.NONE,
            1: FailsafeAction.WARN,
            2: FailsafeAction.HOLD,
            3: FailsafeAction.RETURN,
            4: FailsafeAction.TERMINATE,
            5: FailsafeAction.LAND,
        },
        otherwise=FailsafeAction.WARN,
        is_delayed=True,
        clears=Clears.BY_MODE_CHANGE,
    ),
    FailsafeTrigger(
        name="flight too long",
        holds=_is_flight_too_long,
        parameter=None,
        actions={},
        otherwise=FailsafeAction.RETURN,
        is_delayed=True,
    ),
    FailsafeTrigger(
        name="battery short of home",
        holds=_is_battery_short_of_home,
        parameter="COM_FLTT_LOW_ACT",
        actions={1: FailsafeAction.WARN, 3: FailsafeAction.RETURN},
        otherwise=FailsafeAction.NONE,
        is_delayed=True,
        clears=Clears.BY_MODE_CHANGE,
    ),
    FailsafeTrigger(
        name="wind",
        holds=_is_wind_too_strong,
        parameter="COM_WIND_MAX_ACT",
        actions={
            0: FailsafeAction.NONE,
            1: FailsafeAction.WARN,
            2: FailsafeAction.HOLD,
            3: FailsafeAction.RETURN,
            4: FailsafeAction.TERMINATE,
            5: FailsafeAction.LAND,
        },
        otherwise=FailsafeAction.WARN,
        is_delayed=True,
        clears=Clears.BY_MODE_CHANGE,
    ),
    FailsafeTrigger(
        name="ground station lost",
        holds=_is_ground_lost,
        parameter="NAV_DLL_ACT",
        actions={
            1: FailsafeAction.HOLD,
            2: FailsafeAction.RETURN,
            3: FailsafeAction.LAND,
            5: FailsafeAction.TERMINATE,
            6: FailsafeAction.DISARM,
        },
        otherwise=FailsafeAction.NONE,
        is_delayed=True,
        clears=Clears.BY_MODE_CHANGE,
    ),
)


class _Selection(NamedTuple):
    """The most severe actions of all triggers at one time, and which triggers have one."""

    immediate: FailsafeAction
    delayed: FailsafeAction  # follows after a Hold
    without_takeover: FailsafeAction  # that a user cannot take over
    present: frozenset[str]
    has_new_hold: bool  # whether a trigger that had no action before asks for Hold or more


@dataclass(slots=True)
class Failsafe:
    """The failsafes of one vehicle."""

    action: FailsafeAction = FailsafeAction.NONE  # present action
    delayed: FailsafeAction = FailsafeAction.NONE  # action that follows the present Hold
    present: frozenset[str] = frozenset()  # names of the triggers with an action
    _latched: dict[str, FailsafeAction] = field(default_factory=dict)  # by name of the trigger
    _delayed_since_s: float = math.inf  # start of the Hold before a delayed action
    # Whether somebody has requested a mode during the present action, which then only warns.
    _is_taken_over: bool = False

    @property
    def is_active(self) -> bool:
        """Whether a failsafe has taken the vehicle out of the mode that was requested."""
        return self.action > FailsafeAction.WARN

    @property
    def is_terminated(self) -> bool:
        """Whether a failsafe has ended the flight; only a restart of PX4 clears this."""
        return self.action is FailsafeAction.TERMINATE

    def reset(self) -> None:
        """End every action but a termination, on arming and on disarming."""
        if not self.is_terminated:
            self.action = FailsafeAction.NONE
        self.delayed = FailsafeAction.NONE
        self.present = frozenset()
        self._latched.clear()
        self._delayed_since_s = math.inf
        self._is_taken_over = False

    def mode_requested(self) -> None:
        """End the actions that last until a mode is requested, and let others be taken over."""
        self._unlatch()
        if FailsafeAction.HOLD <= self.action <= FailsafeAction.DESCEND:
            self._is_taken_over = True

    def _unlatch(self) -> None:
        for trigger in FAILSAFE_TRIGGERS:
            if trigger.clears is Clears.BY_MODE_CHANGE:
                self._latched.pop(trigger.name, None)

    def step(self, now_s: float, inputs: FailsafeInputs, params: Parameters) -> bool:
        """Determine the present action; return whether PX4 announces it."""
        if self.is_terminated:
            return False

        action_before = self.action
        present_before = self.present

        if self._is_taken_over:
            self._unlatch()

        # In most ticks no trigger holds, and no action is latched.
        has_trigger = any(trigger.holds(inputs, params) for trigger in FAILSAFE_TRIGGERS)
        if not self._latched and not has_trigger:
            self.action = FailsafeAction.NONE
            self.delayed = FailsafeAction.NONE
            self.present = frozenset()
            self._delayed_since_s = math.inf
            self._is_taken_over = False
            return False

        selection = self._select(inputs, params)
        self.present = selection.present
        if selection.has_new_hold and self._is_taken_over:
            self._is_taken_over = False
            self._delayed_since_s = math.inf
        if max(selection.immediate, selection.delayed) < FailsafeAction.HOLD:
            self._is_taken_over = False

        if self._is_taken_over:
            self.delayed = FailsafeAction.NONE
            self.action = max(FailsafeAction.WARN, selection.without_takeover)
        else:
            after_hold = self._hold_first(now_s, selection.delayed, params)
            self.action = max(selection.immediate, after_hold)

        is_return = FailsafeAction.RETURN in (self.action, self.delayed)
        is_milder = self.action <= FailsafeAction.RETURN
        if is_return and is_milder and inputs.requested_mode in (Mode.LAND, Mode.RTL):
            self.action = FailsafeAction.WARN
            self.delayed = FailsafeAction.NONE

        if self.action is FailsafeAction.NONE:
            return False
        has_new_trigger = bool(self.present - present_before)
        is_new_warning = self.action is FailsafeAction.WARN and has_new_trigger
        return self.action > action_before or is_new_warning

    def _select(self, inputs: FailsafeInputs, params: Parameters) -> _Selection:
        """Return the most severe actions of all triggers."""
        immediate = FailsafeAction.NONE
        delayed = FailsafeAction.NONE
        without_takeover = FailsafeAction.NONE
        present: list[str] = []
        has_new_hold = False

        for trigger in FAILSAFE_TRIGGERS:
            action = self._latching_action(trigger, inputs, params)
            if action is FailsafeAction.NONE:
                continue

            present.append(trigger.name)
            if trigger.name not in self.present and action >= FailsafeAction.HOLD:
                has_new_hold = True

            if not trigger.allows_takeover or action > FailsafeAction.DESCEND:
                without_takeover = max(without_takeover, action)
            if trigger.is_delayed and FailsafeAction.HOLD < action < FailsafeAction.DISARM:
                delayed = max(delayed, action)
            else:
                immediate = max(immediate, action)

        return _Selection(
            immediate=immediate,
            delayed=delayed,
            without_takeover=without_takeover,
            present=frozenset(present),
            has_new_hold=has_new_hold,
        )

    def _latching_action(
        self, trigger: FailsafeTrigger, inputs: FailsafeInputs, params: Parameters
    ) -> FailsafeAction:
        """Return the present or latched action of a trigger; latch it if it is to outlast it."""
        latched = self._latched.get(trigger.name, FailsafeAction.NONE)

        action = FailsafeAction.NONE
        if trigger.holds(inputs, params):
            action = trigger.action(inputs, params)

        if action > latched and trigger.clears is not Clears.WITH_CONDITION:
            self._latched[trigger.name] = action
        return max(action, latched)

    def _hold_first(
        self, now_s: float, delayed: FailsafeAction, params: Parameters
    ) -> FailsafeAction:
        """Return Hold until COM_FAIL_ACT_T has passed, then the delayed action."""
        self.delayed = FailsafeAction.NONE
        if delayed is FailsafeAction.NONE:
            self._delayed_since_s = math.inf
            return FailsafeAction.NONE

        self._delayed_since_s = min(self._delayed_since_s, now_s)
        if now_s - self._delayed_since_s < params["COM_FAIL_ACT_T"]:
            self.delayed = delayed
            return FailsafeAction.HOLD
        return delayed
