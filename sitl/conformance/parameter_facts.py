"""Facts of parameters: defaults, reading and setting over MAVLink."""

from __future__ import annotations

import math

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import Fact, FactReport, facts, number
from sitl.conformance.measurements import NOT_MEASURED
from sitl.conformance.vehicle_client import VehicleClient

_DEFAULTS = {
    "COM_OF_LOSS_T": 1.0,
    "COM_OBL_RC_ACT": 0,
    "MPC_THR_HOVER": 0.5,
    "MC_ROLL_P": 6.5,
    "MC_ROLLRATE_P": 0.15,
    "MC_ROLLRATE_MAX": 220.0,
    "MC_YAW_P": 2.8,
    "MC_YAWRATE_MAX": 200.0,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "NAV_DLL_ACT": 0,
    "NAV_RCL_ACT": 2,
    "MIS_TAKEOFF_ALT": 2.5,
    "BAT_LOW_THR": 0.15,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "COM_LOW_BAT_ACT": 3,
    "COM_RC_IN_MODE": 1,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TKO_SPEED": 1.5,
    "COM_FAIL_ACT_T": 5.0,
    "FD_FAIL_R": 60,
    "IMU_GYRO_RATEMAX": 800,
    "THR_MDL_FAC": 0.0,
    "MC_AIRMODE": 0,
    "SIM_BAT_DRAIN": 60.0,
    "SIM_BAT_MIN_PCT": 50.0,
}


def _default_fact(name: str, value: float) -> Fact:
    section = "13"
    if name.startswith("SIM_BAT"):
        section = "9"
    return number(f"param.{name}", section, f"{name} by default", value, value)


# A newly installed PX4 has these values. A drone in use usually has different ones.
DEFAULTS = tuple(_default_fact(name, value) for name, value in _DEFAULTS.items())
ACCESS = facts("parameters", "access")


def run(client: VehicleClient, report: FactReport) -> None:
    """Read the defaults, then set and restore one parameter of each type."""
    for name, value in _DEFAULTS.items():
        if report.wants(f"param.{name}"):
            report.add(f"param.{name}", _default(client, name, value))
    if not report.wants(*(fact.name for fact in ACCESS)):
        return

    report.add("param.set-float", _set(client, "COM_DISARM_LAND", 0.75))
    report.add("param.float-type", _type(client, "COM_DISARM_LAND"))
    report.add("param.set-integer", _set(client, "COM_OBL_RC_ACT", 4.0))
    report.add("param.integer-type", _type(client, "COM_OBL_RC_ACT"))
    client.params.restore()


def _default(client: VehicleClient, name: str, expected: float) -> float:
    """Return the value of a parameter; NOT_MEASURED without an answer."""
    read = client.params.read(name)
    if read is None:
        return NOT_MEASURED

    # The value in a message has a precision of 24 bits.
    if math.isclose(read, expected, rel_tol=1e-6, abs_tol=1e-9):
        return expected
    return read


def _set(client: VehicleClient, name: str, value: float) -> str:
    """Set a parameter; return the value in the answer and the value that is read afterwards."""
    answer = client.params.set(name, value)
    read = client.params.read(name)
    return f"{_shown(answer)} and {_shown(read)}"


def _shown(value: float | None) -> str:
    if value is None:
        return "nothing"
    return f"{value:g}"


def _type(client: VehicleClient, name: str) -> str:
    """Return the newest MAV_PARAM_TYPE of a parameter."""
    newest = "nothing"
    for packet in client.received.of("PARAM_VALUE"):
        if packet.message.param_id == name:
            newest = str(packet.message.param_type)
    return newest


FACT_GROUP = FactGroup("parameters", (*DEFAULTS, *ACCESS), run, turns_motors=False)
