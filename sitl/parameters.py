"""PX4's parameters that the emulator honours or that clients ask for, with PX4's names and defaults."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

MAV_PARAM_TYPE_INT32 = 6
MAV_PARAM_TYPE_REAL32 = 9

# An int default makes an INT32 parameter, a float default a FLOAT, as in PX4's metadata.
DEFAULTS: dict[str, int | float] = {
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "CBRK_SUPPLY_CHK": 894281,
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_FAIL_ACT_T": 5.0,
    "COM_LOW_BAT_ACT": 3,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RC_IN_MODE": 1,
    "EKF2_DELAY_MAX": 200.0,
    "EKF2_EVP_NOISE": 0.1,
    "EKF2_EV_CTRL": 15,
    "EKF2_EV_DELAY": 0.0,
    "EKF2_GPS_CTRL": 7,
    "EKF2_HGT_REF": 1,
    "EKF2_MAG_TYPE": 0,
    "EKF2_TAU_POS": 0.25,
    "EKF2_TAU_VEL": 0.25,
    "FD_FAIL_P": 60,
    "FD_FAIL_R": 60,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "IMU_GYRO_RATEMAX": 800,
    "MAV_COMP_ID": 1,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "MC_AIRMODE": 0,
    "MC_ROLLRATE_MAX": 220.0,
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLL_P": 6.5,
    "MC_YAWRATE_MAX": 200.0,
    "MC_YAW_P": 2.8,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_LAND_SPEED": 0.7,
    "MPC_THR_HOVER": 0.5,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "RTL_RETURN_ALT": 60.0,
    "SIM_BAT_DRAIN": 60.0,
    "SIM_BAT_MIN_PCT": 50.0,
    "SYS_AUTOSTART": 10040,
    "SYS_FAILURE_EN": 0,
    "SYS_HAS_GPS": 1,
    "SYS_HAS_MAG": 1,
    "THR_MDL_FAC": 0.0,
}


@dataclass(slots=True)
class Parameters:
    """Values of one vehicle for this run."""

    values: dict[str, int | float] = field(default_factory=lambda: dict(sorted(DEFAULTS.items())))

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def names(self) -> list[str]:
        """All names in PX4's order (alphabetical)."""
        return list(self.values)

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a known parameter."""
        return MAV_PARAM_TYPE_INT32 if isinstance(DEFAULTS[name], int) else MAV_PARAM_TYPE_REAL32

    def wire_value(self, name: str) -> float:
        """The value as MAVLink's float field carries it: integers bytewise, not converted."""
        value = self.values[name]
        if isinstance(value, int):
            return float(struct.unpack("<f", struct.pack("<i", value))[0])
        return value

    def set_from_wire(self, name: str, wire: float, kind: int) -> bool:
        """Take a PARAM_SET; False when name or type is not one that PX4 would accept."""
        if name not in self.values or kind != self.kind(name):
            return False
        if kind == MAV_PARAM_TYPE_INT32:
            self.values[name] = int(struct.unpack("<i", struct.pack("<f", wire))[0])
        elif math.isfinite(wire):
            self.values[name] = float(wire)
        else:
            return False
        return True
