"""Parameters: defaults, reading and setting over MAVLink."""

from __future__ import annotations

import math

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts, number
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
# A drone in use has its own values; only a freshly installed one has these.
DEFAULTS = tuple(
    number(
        f"param.{name}",
        "9" if name.startswith("SIM_BAT") else "13",
        f"{name} by default",
        value,
        value,
    )
    for name, value in _DEFAULTS.items()
)
ACCESS = facts("parameters", "access")


def run(client: VehicleClient, report: FactReport) -> None:
    """Read the defaults, then set one of each kind and put it back."""
    for name, value in _DEFAULTS.items():
        if report.wants(f"param.{name}"):
            read = client.params.read(name)
            # Floats travel with 24 bits.
            close = read is not None and math.isclose(read, value, rel_tol=1e-6, abs_tol=1e-9)
            report.add(f"param.{name}", value if close else math.nan if read is None else read)
    if not report.wants(*(fact.name for fact in ACCESS)):
        return
    for fact, name, value in (
        ("param.set-float", "COM_DISARM_LAND", 0.75),
        ("param.set-integer", "COM_OBL_RC_ACT", 4.0),
    ):
        answer = client.params.set(name, value)
        read = client.params.read(name)
        report.add(fact, " and ".join("nothing" if v is None else f"{v:g}" for v in (answer, read)))
        kinds = [
            p.message.param_type
            for p in client.received.of("PARAM_VALUE")
            if p.message.param_id == name
        ]
        kind_fact = "param.float-type" if value == 0.75 else "param.integer-type"
        report.add(kind_fact, str(kinds[-1]) if kinds else "nothing")
    client.params.restore()


FACT_GROUP = FactGroup("parameters", (*DEFAULTS, *ACCESS), run, turns_motors=False)
