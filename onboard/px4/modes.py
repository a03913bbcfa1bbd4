"""PX4's modes as in HEARTBEAT, and the numbers of the commands that the link uses.

The numbers are those of MAVLink's common.xml and of PX4's ``px4_custom_mode.h``.
"""

from __future__ import annotations

# MAV_CMD
CMD_LAND = 21
CMD_SET_MODE = 176
CMD_REBOOT = 246
CMD_ARM = 400
CMD_SET_MESSAGE_INTERVAL = 511
CMD_REQUEST_MESSAGE = 512

FORCE_DISARM_MAGIC = 21196.0  # second parameter of CMD_ARM; it disarms even in the air

# bits of base_mode
BASE_MODE_CUSTOM_ENABLED = 1
BASE_MODE_ARMED = 0x80

MAIN_MODE_OFFBOARD = 6
# values of MAV_STATE in a failsafe: CRITICAL, and FLIGHT_TERMINATION
FAILSAFE_STATUSES = (5, 8)

_MAIN = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
    11: "ALTITUDE_CRUISE",
}
_AUTO_MAIN = 4  # main mode with the following submodes
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


def mode_name(custom_mode: int) -> str:
    """Return PX4's custom mode in words.

    The main mode is in bits 16 to 23, the submode of AUTO in bits 24 to 31.
    """
    main_mode = custom_mode >> 16 & 0xFF
    sub_mode = custom_mode >> 24 & 0xFF
    if main_mode == _AUTO_MAIN:
        return _AUTO.get(sub_mode, f"AUTO {sub_mode}")
    return _MAIN.get(main_mode, f"MODE {main_mode}")
