"""PX4's flight modes and what the commander does about them, as tables."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum


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


class Landed(IntEnum):
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


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


@dataclass(frozen=True, slots=True)
class ModeRow:
    """How a mode looks on the wire, and whether it can be entered without a position.

    base_mode is without the armed bit; needs_position says whether arming in it needs a position estimate.
    """

    main: int
    sub: int
    base_mode: int
    needs_position: bool

    @property
    def custom_mode(self) -> int:
        """HEARTBEAT.custom_mode."""
        return self.main << 16 | self.sub << 24


MODES: dict[Mode, ModeRow] = {
    Mode.MANUAL: ModeRow(1, 0, 65, False),
    Mode.ALTCTL: ModeRow(2, 0, 81, True),
    Mode.POSCTL: ModeRow(3, 0, 81, True),
    Mode.STABILIZED: ModeRow(7, 0, 81, False),
    Mode.OFFBOARD: ModeRow(6, 0, 17, False),
    Mode.TAKEOFF: ModeRow(4, 2, 29, True),
    Mode.LOITER: ModeRow(4, 3, 29, True),
    Mode.MISSION: ModeRow(4, 4, 29, True),
    Mode.RTL: ModeRow(4, 5, 29, True),
    Mode.LAND: ModeRow(4, 6, 29, True),
}
ARMED_BIT = 128
OFFBOARD_WITHOUT_SETPOINTS_BASE_MODE = 1
OFFBOARD_RATES_BASE_MODE = 1

BY_NUMBERS: dict[tuple[int, int], Mode] = {(row.main, row.sub): mode for mode, row in MODES.items()}

# COM_OBL_RC_ACT: what a vehicle does when setpoints stop. Without a radio control POSCTL and ALTCTL are a level,
# blind descent. The values 6 (terminate) and 7 (disarm) stop the motors.
OFFBOARD_LOSS_MODE: dict[int, Mode | None] = {
    0: Mode.POSCTL,
    1: Mode.ALTCTL,
    2: Mode.STABILIZED,
    3: Mode.RTL,
    4: Mode.LAND,
    5: Mode.LOITER,
    6: None,
    7: None,
}

BLIND_DESCENT = frozenset({Mode.MANUAL, Mode.ALTCTL, Mode.POSCTL, Mode.STABILIZED})

# Modes that a person or a program chose for good; the others lead to another mode by themselves.
INTENT_AFTER_DISARM: dict[Mode, Mode] = dict.fromkeys((Mode.LAND, Mode.RTL, Mode.TAKEOFF), Mode.LOITER)
