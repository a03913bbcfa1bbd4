"""PX4's flight modes as tables: MAVLink numbers, conditions, names and fallback modes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, Flag, IntEnum, auto


class Mode(Enum):
    """Navigation states that the emulator knows."""

    MANUAL = "MANUAL"
    ALTCTL = "ALTCTL"
    POSCTL = "POSCTL"
    STABILIZED = "STABILIZED"
    OFFBOARD = "OFFBOARD"
    TAKEOFF = "AUTO.TAKEOFF"
    LOITER = "AUTO.LOITER"
    MISSION = "AUTO.MISSION"
    RTL = "AUTO.RTL"
    LAND = "AUTO.LAND"
    DESCEND = "DESCEND"
    TERMINATION = "TERMINATION"


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class SystemStatus(IntEnum):
    """The values of MAV_STATE that the emulated PX4 shows."""

    UNINIT = 0
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5
    FLIGHT_TERMINATION = 8


class CommandResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class ModeCondition(Flag):
    """Conditions of a mode.

    Arming in the mode requires all of them. Changing to it in the air requires all but ARMING.
    """

    NOTHING = 0
    LOCAL_POSITION = auto()
    GLOBAL_POSITION = auto()
    SETPOINTS = auto()
    MISSION = auto()
    STICKS = auto()  # sticks of a pilot
    ARMING = auto()  # never met: a vehicle cannot be armed in this mode


@dataclass(frozen=True, slots=True)
class ModeRow:
    """MAVLink numbers of a mode, and its conditions."""

    main: int  # main mode in HEARTBEAT.custom_mode
    sub: int  # sub mode in HEARTBEAT.custom_mode
    base_mode: int  # HEARTBEAT.base_mode without the armed bit
    standard_mode: int  # CURRENT_MODE.standard_mode (MAV_STANDARD_MODE)
    needs: ModeCondition  # conditions for arming in the mode and for changing to it
    is_selectable: bool = True  # whether the mode can be requested

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode."""
        return self.main << 16 | self.sub << 24


_GLOBAL = ModeCondition.LOCAL_POSITION | ModeCondition.GLOBAL_POSITION

MODES: dict[Mode, ModeRow] = {
    Mode.MANUAL: ModeRow(
        main=1,
        sub=0,
        base_mode=65,
        standard_mode=0,
        needs=ModeCondition.STICKS,
    ),
    Mode.ALTCTL: ModeRow(
        main=2,
        sub=0,
        base_mode=81,
        standard_mode=4,
        needs=ModeCondition.STICKS,
    ),
    Mode.POSCTL: ModeRow(
        main=3,
        sub=0,
        base_mode=81,
        standard_mode=1,
        needs=ModeCondition.LOCAL_POSITION | ModeCondition.STICKS,
    ),
    Mode.STABILIZED: ModeRow(
        main=7,
        sub=0,
        base_mode=81,
        standard_mode=0,
        needs=ModeCondition.STICKS,
    ),
    Mode.OFFBOARD: ModeRow(
        main=6,
        sub=0,
        base_mode=17,
        standard_mode=0,
        needs=ModeCondition.SETPOINTS,
    ),
    Mode.TAKEOFF: ModeRow(
        main=4,
        sub=2,
        base_mode=29,
        standard_mode=8,
        needs=_GLOBAL,
    ),
    Mode.LOITER: ModeRow(
        main=4,
        sub=3,
        base_mode=29,
        standard_mode=0,
        needs=_GLOBAL,
    ),
    Mode.MISSION: ModeRow(
        main=4,
        sub=4,
        base_mode=29,
        standard_mode=6,
        needs=_GLOBAL | ModeCondition.MISSION,
    ),
    Mode.RTL: ModeRow(
        main=4,
        sub=5,
        base_mode=29,
        standard_mode=5,
        needs=_GLOBAL | ModeCondition.ARMING,
    ),
    Mode.LAND: ModeRow(
        main=4,
        sub=6,
        base_mode=29,
        standard_mode=7,
        needs=ModeCondition.LOCAL_POSITION | ModeCondition.ARMING,
    ),
    # PX4 shows a descent without position as AUTO.LAND, and a terminated flight as MANUAL.
    Mode.DESCEND: ModeRow(
        main=4,
        sub=6,
        base_mode=29,
        standard_mode=7,
        needs=ModeCondition.ARMING,
        is_selectable=False,
    ),
    Mode.TERMINATION: ModeRow(
        main=1,
        sub=0,
        base_mode=65,
        standard_mode=0,
        needs=ModeCondition.ARMING,
        is_selectable=False,
    ),
}

# Name of a mode in PX4's texts, and its number in events.
NAMES: dict[Mode, tuple[str, int]] = {
    Mode.MANUAL: ("Manual", 0),
    Mode.ALTCTL: ("Altitude", 1),
    Mode.POSCTL: ("Position", 2),
    Mode.MISSION: ("Mission", 3),
    Mode.LOITER: ("Hold", 4),
    Mode.RTL: ("Return", 5),
    Mode.OFFBOARD: ("Offboard", 7),
    Mode.STABILIZED: ("Stabilized", 8),
    Mode.TAKEOFF: ("Takeoff", 10),
    Mode.LAND: ("Land", 11),
}
ARMED_BIT = 128
# base_mode in OFFBOARD without setpoints, and with body rate setpoints
OFFBOARD_WITHOUT_SETPOINTS_BASE_MODE = 1
OFFBOARD_RATES_BASE_MODE = 1

BY_NUMBERS: dict[tuple[int, int], Mode] = {
    (row.main, row.sub): mode for mode, row in MODES.items() if row.is_selectable
}
AUTO_MAIN = 4

# Bits of MAVLink's base_mode.
_IS_CUSTOM = 1
_IS_AUTO = 4
_IS_GUIDED = 8
_IS_STABILIZED = 16
_IS_MANUAL = 64
# Modes that a client requests by MAVLink's base_mode alone. The first row whose bits are all set in
# the request applies.
_BY_BASE_MODE: tuple[tuple[int, Mode], ...] = (
    (_IS_AUTO, Mode.MISSION),
    (_IS_MANUAL | _IS_GUIDED, Mode.POSCTL),
    (_IS_MANUAL | _IS_STABILIZED, Mode.STABILIZED),
    (_IS_MANUAL, Mode.MANUAL),
)

# Mode that replaces a mode when there is no position. LAND becomes a level descent.
FALLBACK: dict[Mode, Mode] = {
    Mode.TAKEOFF: Mode.LAND,
    Mode.LOITER: Mode.LAND,
    Mode.MISSION: Mode.LAND,
    Mode.RTL: Mode.LAND,
    Mode.LAND: Mode.DESCEND,
    Mode.POSCTL: Mode.ALTCTL,
}

# Modes that a pilot flies by hand, and those of them in which the throttle is a thrust.
BY_HAND = frozenset({Mode.POSCTL, Mode.ALTCTL, Mode.STABILIZED, Mode.MANUAL})
BY_THRUST = frozenset({Mode.STABILIZED, Mode.MANUAL})

# Modes that become a level descent when there is neither a position nor sticks.
BLIND_DESCENT = BY_HAND | {Mode.DESCEND}


def mode_of(base_mode: int, main: int, sub: int) -> Mode | None:
    """Return the mode that a DO_SET_MODE requests; None for a mode that is not emulated.

    Args:
        base_mode: base_mode of the request; without its bit 0 its other bits select the mode.
        main: main mode, as in custom_mode.
        sub: sub mode; 0 in AUTO selects MISSION.
    """
    if not base_mode & _IS_CUSTOM:
        for bits, mode in _BY_BASE_MODE:
            if base_mode & bits == bits:
                return mode
        return None

    if main != AUTO_MAIN:
        sub = 0
    elif sub == 0:
        sub = MODES[Mode.MISSION].sub
    return BY_NUMBERS.get((main, sub))
