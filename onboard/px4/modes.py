"""PX4's modes as HEARTBEAT carries them, and the numbers of the commands that the link uses."""

from __future__ import annotations

CMD_SET_MODE = 176
CMD_ARM = 400
CMD_LAND = 21
CMD_SET_MESSAGE_INTERVAL = 511
CMD_REQUEST_MESSAGE = 512
FORCE_DISARM_MAGIC = 21196.0
BASE_MODE_ARMED = 0x80
BASE_MODE_CUSTOM_ENABLED = 1
MAIN_MODE_OFFBOARD = 6
STATUS_CRITICAL = 5

_MAIN = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
}
_AUTO = {
    1: "READY",
    2: "TAKEOFF",
    3: "HOLD",
    4: "MISSION",
    5: "RTL",
    6: "LAND",
    8: "FOLLOW",
    9: "PRECLAND",
}
_AUTO_MAIN = 4


def mode_name(custom_mode: int) -> str:
    """Return PX4's custom mode in words: main mode in bits 16-23, AUTO's submode in bits 24-31."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    if main == _AUTO_MAIN:
        return _AUTO.get(sub, f"AUTO {sub}")
    return _MAIN.get(main, f"MODE {main}")
