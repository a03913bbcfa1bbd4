"""PX4's flight modes and what the commander does about them, as tables."""

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
    """MAV_STATE as far as PX4 shows it here."""

    UNINIT = 0
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5


class CommandResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class ModeCondition(Flag):
    """Conditions of a mode: all to be armed in it, all but ARMING to be changed to it in the air."""

    NOTHING = 0
    LOCAL_POSITION = auto()
    GLOBAL_POSITION = auto()
    SETPOINTS = auto()
    MISSION = auto()
    ARMING = auto()  # never there: nobody arms in this mode


@dataclass(frozen=True, slots=True)
class ModeRow:
    """MAVLink numbers of a mode, and its conditions."""

    # main, sub: of HEARTBEAT.custom_mode
    main: int
    sub: int
    base_mode: int  # without the armed bit
    standard_mode: int  # CURRENT_MODE.standard_mode (MAV_STANDARD_MODE)
    needs: ModeCondition  # to be armed in it, and to be changed to it
    is_selectable: bool = True  # whether somebody may ask for it

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode."""
        return self.main << 16 | self.sub << 24


_GLOBAL = ModeCondition.LOCAL_POSITION | ModeCondition.GLOBAL_POSITION

MODES: dict[Mode, ModeRow] = {
    Mode.MANUAL: ModeRow(1, 0, 65, 0, ModeCondition.NOTHING),
    Mode.ALTCTL: ModeRow(2, 0, 81, 4, ModeCondition.NOTHING),
    Mode.POSCTL: ModeRow(3, 0, 81, 1, ModeCondition.LOCAL_POSITION),
    Mode.STABILIZED: ModeRow(7, 0, 81, 0, ModeCondition.NOTHING),
    Mode.OFFBOARD: ModeRow(6, 0, 17, 0, ModeCondition.SETPOINTS),
    Mode.TAKEOFF: ModeRow(4, 2, 29, 8, _GLOBAL),
    Mode.LOITER: ModeRow(4, 3, 29, 0, _GLOBAL),
    Mode.MISSION: ModeRow(4, 4, 29, 6, _GLOBAL | ModeCondition.MISSION),
    Mode.RTL: ModeRow(4, 5, 29, 5, _GLOBAL | ModeCondition.ARMING),
    Mode.LAND: ModeRow(4, 6, 29, 7, ModeCondition.LOCAL_POSITION | ModeCondition.ARMING),
    # PX4 shows a descent without position as AUTO.LAND, and a terminated flight as MANUAL.
    Mode.DESCEND: ModeRow(4, 6, 29, 7, ModeCondition.ARMING, is_selectable=False),
    Mode.TERMINATION: ModeRow(1, 0, 65, 0, ModeCondition.ARMING, is_selectable=False),
}
# What PX4 calls a mode in a text, and its number in an event.
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
OFFBOARD_WITHOUT_SETPOINTS_BASE_MODE = 1
OFFBOARD_RATES_BASE_MODE = 1

BY_NUMBERS: dict[tuple[int, int], Mode] = {
    (row.main, row.sub): mode for mode, row in MODES.items() if row.is_selectable
}
AUTO_MAIN = 4

_IS_CUSTOM, _IS_AUTO, _IS_GUIDED, _IS_STABILIZED, _IS_MANUAL = 1, 4, 8, 16, 64
# What an old client means that knows only MAVLink's modes: the first row whose bits are all set.
_BY_BASE_MODE: tuple[tuple[int, Mode], ...] = (
    (_IS_AUTO, Mode.MISSION),
    (_IS_MANUAL | _IS_GUIDED, Mode.POSCTL),
    (_IS_MANUAL | _IS_STABILIZED, Mode.STABILIZED),
    (_IS_MANUAL, Mode.MANUAL),
)

# What a mode leads to when it cannot be flown (no position): LAND too becomes a level, blind
# descent.
FALLBACK: dict[Mode, Mode] = {
    Mode.TAKEOFF: Mode.LAND,
    Mode.LOITER: Mode.LAND,
    Mode.MISSION: Mode.LAND,
    Mode.RTL: Mode.LAND,
    Mode.LAND: Mode.DESCEND,
    Mode.POSCTL: Mode.ALTCTL,
}

# Flown without sticks (there is no radio control) these are a level, blind descent.
BLIND_DESCENT = frozenset({Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.STABILIZED, Mode.DESCEND})


def mode_of(base_mode: int, main: int, sub: int) -> Mode | None:
    """The mode that a DO_SET_MODE asks for; None for what PX4 does not know or the emulator does
    not have.

    Args:
        base_mode: bit 0 says that the other two count; without it MAVLink's own bits decide.
        main, sub: as in custom_mode; AUTO without a sub mode is a mission.
    """
    if not base_mode & _IS_CUSTOM:
        return next((mode for bits, mode in _BY_BASE_MODE if base_mode & bits == bits), None)
    if main == AUTO_MAIN:
        return BY_NUMBERS.get((main, sub or 4))
    return BY_NUMBERS.get((main, 0))
