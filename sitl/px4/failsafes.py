"""PX4's failsafes as a table: which condition leads to which action, by which parameter.

Of all conditions that hold, the most severe action is taken. An action that is not urgent waits in
Hold first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum

from msgspec import Struct

from sitl.px4.battery import ChargeState
from sitl.px4.modes import Mode
from sitl.px4.parameters import Parameters

FLIGHT_TERMINATION_OFF = 121212.0


class Action(IntEnum):
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


_MANUAL = (Action.POSCTL, Action.ALTCTL, Action.STABILIZED)

# The mode that an action flies; the others keep the mode, or end the flight at once.
ACTION_MODE: dict[Action, Mode] = {
    Action.POSCTL: Mode.POSCTL,
    Action.ALTCTL: Mode.ALTCTL,
    Action.STABILIZED: Mode.STABILIZED,
    Action.HOLD: Mode.LOITER,
    Action.RETURN: Mode.RTL,
    Action.LAND: Mode.LAND,
    Action.DESCEND: Mode.DESCEND,
    Action.TERMINATE: Mode.TERMINATION,
}


class Facts(Struct, frozen=True):
    """Inputs of the failsafes."""

    has_offboard_signal: bool  # False when OFFBOARD is wanted and its setpoints do not come
    battery: ChargeState  # how empty it is
    attitude_failed: bool  # tilted beyond FD_FAIL_R or FD_FAIL_P
    from_home_m: tuple[float, float]  # horizontal and vertical distance from the place of arming
    ground_silent_s: float  # time since the last heartbeat of a ground station
    has_sticks: bool = False  # somebody's sticks are heard


class Clears(Enum):
    """Conditions under which an action ends."""

    WITH_CONDITION = "when the condition is gone"
    BY_MODE_CHANGE = "when somebody asks for a mode, or on disarming"
    NEVER = "on disarming only"


@dataclass(frozen=True, slots=True)
class Condition:
    """One row of the table."""

    name: str
    holds: Callable[[Facts, Parameters], bool]  # whether the condition is there
    parameter: str | None  # what decides; None when the action is always `otherwise`
    actions: Mapping[int, Action]  # parameter value -> action; other values give `otherwise`
    otherwise: Action
    waits: bool = False  # whether the action is preceded by COM_FAIL_ACT_T seconds of Hold
    clears: Clears = Clears.WITH_CONDITION  # when it ends

    def action(self, facts: Facts, params: Parameters) -> Action:
        """Return the action that the parameters select."""
        if self.parameter is None:
            return self.otherwise
        action = self.actions.get(params.integer(self.parameter), self.otherwise)
        is_flyable = (
            action not in _MANUAL
            or facts.has_sticks
            or params.version.flies_manual_modes_without_sticks
        )
        return action if is_flyable else Action.RETURN


def _beyond_fence(facts: Facts, params: Parameters) -> bool:
    (away_m, height_m), farthest_m, highest_m = (
        facts.from_home_m,
        params["GF_MAX_HOR_DIST"],
        params["GF_MAX_VER_DIST"],
    )
    return 0.0 < farthest_m < away_m or 0.0 < highest_m < height_m


CONDITIONS: tuple[Condition, ...] = (
    Condition(
        "offboard setpoints lost",
        lambda facts, _: not facts.has_offboard_signal,
        "COM_OBL_RC_ACT",
        {
            0: Action.POSCTL,
            1: Action.ALTCTL,
            2: Action.STABILIZED,
            3: Action.RETURN,
            4: Action.LAND,
            5: Action.HOLD,
            6: Action.TERMINATE,
            7: Action.DISARM,
        },
        Action.POSCTL,
    ),
    Condition(
        "battery low", lambda facts, _: facts.battery is ChargeState.LOW, None, {}, Action.WARN
    ),
    Condition(
        "battery critical",
        lambda facts, _: facts.battery is ChargeState.CRITICAL,
        "COM_LOW_BAT_ACT",
        {0: Action.WARN, 1: Action.RETURN, 2: Action.LAND, 3: Action.RETURN},
        Action.WARN,
        waits=True,
    ),
    Condition(
        "battery at emergency level",
        lambda facts, _: facts.battery is ChargeState.EMERGENCY,
        "COM_LOW_BAT_ACT",
        {0: Action.WARN, 1: Action.RETURN, 2: Action.LAND, 3: Action.LAND},
        Action.WARN,
        waits=True,
    ),
    Condition(
        "attitude failure",
        lambda facts, params: (
            facts.attitude_failed
            and (
                params["CBRK_FLIGHTTERM"] != FLIGHT_TERMINATION_OFF
                or params.version.warns_of_attitude_failure
            )
        ),
        "CBRK_FLIGHTTERM",
        {int(FLIGHT_TERMINATION_OFF): Action.WARN},
        Action.TERMINATE,
        clears=Clears.NEVER,
    ),
    Condition(
        "geofence",
        _beyond_fence,
        "GF_ACTION",
        {
            0: Action.NONE,
            1: Action.WARN,
            2: Action.HOLD,
            3: Action.RETURN,
            4: Action.TERMINATE,
            5: Action.LAND,
        },
        Action.WARN,
        clears=Clears.BY_MODE_CHANGE,
    ),
    Condition(
        "ground station lost",
        lambda facts, params: (
            params["NAV_DLL_ACT"] > 0 and facts.ground_silent_s > params["COM_DL_LOSS_T"]
        ),
        "NAV_DLL_ACT",
        {1: Action.HOLD, 2: Action.RETURN, 3: Action.LAND, 5: Action.TERMINATE, 6: Action.DISARM},
        Action.NONE,
        waits=True,
        clears=Clears.BY_MODE_CHANGE,
    ),
)


@dataclass(slots=True)
class Failsafe:
    """The failsafes of one armed vehicle."""

    action: Action = Action.NONE  # what is done now
    delayed: Action = Action.NONE  # what follows when the Hold before it is over
    present: frozenset[str] = frozenset()  # names of the conditions that act
    _latched: dict[str, Action] = field(default_factory=dict)
    _waiting_since_s: float = math.inf

    @property
    def is_active(self) -> bool:
        """Whether the mode is no longer the one that was asked for."""
        return self.action > Action.WARN

    def reset(self) -> None:
        """Arming and disarming end everything."""
        self.action = self.delayed = Action.NONE
        self.present = frozenset()
        self._latched.clear()
        self._waiting_since_s = math.inf

    def commanded_mode(self) -> None:
        """Somebody has asked for a mode."""
        for condition in CONDITIONS:
            if condition.clears is Clears.BY_MODE_CHANGE:
                self._latched.pop(condition.name, None)

    def step(self, now_s: float, facts: Facts, params: Parameters) -> bool:
        """Decide anew; True when something new has to be told."""
        before, present_before = self.action, self.present
        if not self._latched and not any(
            condition.holds(facts, params) for condition in CONDITIONS
        ):
            self.action = self.delayed = Action.NONE
            self.present, self._waiting_since_s = frozenset(), math.inf
            return False
        urgent, patient = Action.NONE, Action.NONE
        present: list[str] = []
        for condition in CONDITIONS:
            latched = self._latched.get(condition.name, Action.NONE)
            action = (
                condition.action(facts, params) if condition.holds(facts, params) else Action.NONE
            )
            if action > latched and condition.clears is not Clears.WITH_CONDITION:
                self._latched[condition.name] = action
            action = max(action, latched)
            if action is Action.NONE:
                continue
            present.append(condition.name)
            if condition.waits and action > Action.WARN:
                patient = max(patient, action)
            else:
                urgent = max(urgent, action)
        self.present = frozenset(present)
        self.delayed = Action.NONE
        if patient is Action.NONE:
            self._waiting_since_s = math.inf
        else:
            self._waiting_since_s = min(self._waiting_since_s, now_s)
            if now_s - self._waiting_since_s < params["COM_FAIL_ACT_T"]:
                self.delayed, patient = patient, Action.HOLD
        self.action = max(urgent, patient)
        is_new_warning = self.action is Action.WARN and not self.present <= present_before
        return self.action is not Action.NONE and (self.action > before or is_new_warning)
