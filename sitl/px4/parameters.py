"""PX4's parameters that the emulator honours or that clients ask for, with PX4's names and defaults."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass, field

MAV_PARAM_TYPE_UINT32 = 5
MAV_PARAM_TYPE_INT32 = 6
MAV_PARAM_TYPE_REAL32 = 9
HASH_CHECK = "_HASH_CHECK"

# An int default makes an INT32 parameter, a float default a FLOAT, as in PX4's metadata.
_COMMANDER: dict[str, int | float] = {
    "CBRK_FLIGHTTERM": 121212,
    "CBRK_SUPPLY_CHK": 894281,
    "COM_ARM_WO_GPS": 1,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_HOME_EN": 1,
    "COM_LOW_BAT_ACT": 3,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "COM_RC_IN_MODE": 1,
    "COM_RC_LOSS_T": 0.5,
    "FD_FAIL_P": 60,
    "FD_FAIL_P_TTRI": 0.3,
    "FD_FAIL_R": 60,
    "FD_FAIL_R_TTRI": 0.3,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MIS_TAKEOFF_ALT": 2.5,
    "NAV_ACC_RAD": 10.0,
    "NAV_DLL_ACT": 0,
    "NAV_LOITER_RAD": 80.0,
    "NAV_RCL_ACT": 2,
    "RTL_DESCEND_ALT": 30.0,
    "RTL_LAND_DELAY": 0.0,
    "RTL_MIN_DIST": 10.0,
    "RTL_RETURN_ALT": 60.0,
    "RTL_TYPE": 0,
}
_BATTERY: dict[str, int | float] = {
    "BAT1_CAPACITY": -1.0,
    "BAT1_N_CELLS": 4,
    "BAT1_SOURCE": 0,
    "BAT1_V_CHARGED": 4.05,
    "BAT1_V_EMPTY": 3.6,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "SIM_BAT_DRAIN": 60.0,
    "SIM_BAT_ENABLE": 1,
    "SIM_BAT_MIN_PCT": 50.0,
}
_ESTIMATOR: dict[str, int | float] = {
    "EKF2_ACC_NOISE": 0.35,
    "EKF2_BARO_CTRL": 1,
    "EKF2_DELAY_MAX": 200.0,
    "EKF2_EN": 1,
    "EKF2_EVA_NOISE": 0.1,
    "EKF2_EVP_GATE": 5.0,
    "EKF2_EVP_NOISE": 0.1,
    "EKF2_EVV_GATE": 3.0,
    "EKF2_EVV_NOISE": 0.1,
    "EKF2_EV_CTRL": 15,
    "EKF2_EV_DELAY": 0.0,
    "EKF2_EV_NOISE_MD": 0,
    "EKF2_EV_POS_X": 0.0,
    "EKF2_EV_POS_Y": 0.0,
    "EKF2_EV_POS_Z": 0.0,
    "EKF2_EV_QMIN": 0,
    "EKF2_GPS_CHECK": 245,
    "EKF2_GPS_CTRL": 7,
    "EKF2_GPS_DELAY": 110.0,
    "EKF2_GPS_P_NOISE": 0.5,
    "EKF2_GPS_V_NOISE": 0.3,
    "EKF2_GYR_NOISE": 0.015,
    "EKF2_HGT_REF": 1,
    "EKF2_MAG_TYPE": 0,
    "EKF2_NOAID_TOUT": 5_000_000,
    "EKF2_OF_CTRL": 1,
    "EKF2_REQ_EPH": 3.0,
    "EKF2_REQ_EPV": 5.0,
    "EKF2_RNG_CTRL": 1,
    "EKF2_TAU_POS": 0.25,
    "EKF2_TAU_VEL": 0.25,
    "IMU_GYRO_RATEMAX": 800,
    "SYS_HAS_BARO": 1,
    "SYS_HAS_GPS": 1,
    "SYS_HAS_MAG": 1,
}
_CONTROL: dict[str, int | float] = {
    "MC_AIRMODE": 0,
    "MC_PITCHRATE_D": 0.003,
    "MC_PITCHRATE_I": 0.2,
    "MC_PITCHRATE_MAX": 220.0,
    "MC_PITCHRATE_P": 0.15,
    "MC_PITCH_P": 6.5,
    "MC_ROLLRATE_D": 0.003,
    "MC_ROLLRATE_I": 0.2,
    "MC_ROLLRATE_MAX": 220.0,
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLL_P": 6.5,
    "MC_YAWRATE_I": 0.1,
    "MC_YAWRATE_MAX": 200.0,
    "MC_YAWRATE_P": 0.2,
    "MC_YAW_P": 2.8,
    "MC_YAW_WEIGHT": 0.4,
    "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_ACC_HOR": 3.0,
    "MPC_ACC_HOR_MAX": 5.0,
    "MPC_ACC_UP_MAX": 4.0,
    "MPC_JERK_AUTO": 4.0,
    "MPC_LAND_ALT1": 10.0,
    "MPC_LAND_ALT2": 5.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_MAN_TILT_MAX": 35.0,
    "MPC_THR_HOVER": 0.5,
    "MPC_THR_MAX": 1.0,
    "MPC_THR_MIN": 0.12,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TILTMAX_LND": 12.0,
    "MPC_TKO_RAMP_T": 3.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_USE_HTE": 1,
    "MPC_VEL_MANUAL": 10.0,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_P": 0.95,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_YAWRAUTO_MAX": 60.0,
    "MPC_Z_P": 1.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "MPC_Z_VEL_P_ACC": 4.0,
    "MPC_Z_V_AUTO_DN": 1.5,
    "MPC_Z_V_AUTO_UP": 3.0,
    "THR_MDL_FAC": 0.0,
}
_SYSTEM: dict[str, int | float] = {
    "CAL_ACC0_ID": 1310988,
    "CAL_BARO0_ID": 6620172,
    "CAL_GYRO0_ID": 1310988,
    "CAL_MAG0_ID": 197388,
    "CA_ROTOR_COUNT": 4,
    "MAV_COMP_ID": 1,
    "MAV_PROTO_VER": 0,
    "MAV_SYS_ID": 1,
    "MAV_TYPE": 2,
    "SDLOG_MODE": 0,
    "SIH_IXX": 0.025,
    "SIH_IYY": 0.025,
    "SIH_IZZ": 0.03,
    "SIH_KDV": 1.0,
    "SIH_LOC_H0": 489.4,
    "SIH_LOC_LAT0": 47.397742,
    "SIH_LOC_LON0": 8.545594,
    "SIH_MASS": 1.0,
    "SIH_T_MAX": 5.0,
    "SIH_T_TAU": 0.05,
    "SIH_VEHICLE_TYPE": 0,
    "SYS_AUTOCONFIG": 0,
    "SYS_AUTOSTART": 10040,
    "SYS_FAILURE_EN": 0,
    "SYS_HITL": 2,
}
# PX4 raises it to the largest delay of any sensor, used or not: that of satellites.
_LEAST = {"EKF2_DELAY_MAX": 110.0}
DEFAULTS: dict[str, int | float] = dict(sorted((_COMMANDER | _BATTERY | _ESTIMATOR | _CONTROL | _SYSTEM).items()))
_NAMES: tuple[str, ...] = tuple(DEFAULTS)
_INDICES: dict[str, int] = {name: index for index, name in enumerate(_NAMES)}


@dataclass(slots=True)
class Parameters:
    """Values of one vehicle for this run."""

    values: dict[str, int | float] = field(default_factory=lambda: dict(DEFAULTS))

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def integer(self, name: str) -> int:
        """A parameter that is a choice or a set of bits."""
        return int(self.values[name])

    def names(self) -> list[str]:
        """All names in PX4's order (alphabetical)."""
        return list(_NAMES)

    def index(self, name: str) -> int:
        """Index of a known parameter in that order."""
        return _INDICES[name]

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a known parameter."""
        return MAV_PARAM_TYPE_INT32 if isinstance(DEFAULTS[name], int) else MAV_PARAM_TYPE_REAL32

    def encoded_value(self, name: str) -> float:
        """The value as MAVLink's float field carries it: integers bytewise, not converted."""
        value = self.values[name]
        if isinstance(DEFAULTS[name], int):
            return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
        return value

    def hash_value(self) -> float:
        """Checksum of all names and values, as :data:`HASH_CHECK` carries it: an unsigned integer, bytewise."""
        checksum = 0
        for name in _NAMES:
            packed = struct.pack("<i" if isinstance(DEFAULTS[name], int) else "<f", self.values[name])
            checksum = zlib.crc32(name.encode("ascii") + packed, checksum)
        # One bit is given away so that the four bytes are never a NaN, which does not survive being a float.
        return float(struct.unpack("<f", struct.pack("<I", checksum & 0xBFFFFFFF))[0])

    def set_encoded(self, name: str, encoded: float, kind: int) -> bool:
        """Take a PARAM_SET; False when name or type is not one that PX4 would accept. NaN leaves the value."""
        if name not in self.values or kind != self.kind(name):
            return False
        if kind == MAV_PARAM_TYPE_INT32:
            self.values[name] = int(struct.unpack("<i", struct.pack("<f", encoded))[0])
        elif math.isfinite(encoded):
            self.values[name] = max(float(encoded), _LEAST.get(name, -math.inf))
        return True
