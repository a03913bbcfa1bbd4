"""PX4 parameters that close flight requires, the reason for each, and a vehicle's differences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from onboard.autopilot import Version, plausible_version
from onboard.config.fleet import Vehicle

Value = float | int

# Bits of EKF2_EV_CTRL.
FUSES_POSITION = 1
FUSES_HEADING = 8

# Charge at which PX4's simulated battery stops emptying [%]; required of nobody.
BATTERY_FLOOR = "SIM_BAT_MIN_PCT"


@dataclass(frozen=True, slots=True)
class RequiredParam:
    """One required parameter."""

    name: str  # as PX4 has it
    value: Value  # that PX4 must have
    reason: str  # what follows from the value
    needs_restart: bool = False  # PX4 reads it only when it starts
    # another value costs quality, not safety: it refuses nothing, and only covey px4 params --apply
    # sets it
    is_advice: bool = False
    tolerance: float = 0.0  # a value within it is as good
    since: Version = (0, 0)  # PX4 knows it from this version on,
    before: Version = (99, 0)  # and only before this one

    def is_for(self, version: Version | None) -> bool:
        """Whether PX4 of this version knows it; of an unknown version, whether all do."""
        if version is None:
            return self.since == (0, 0) and self.before == (99, 0)
        return self.since <= version < self.before

    def is_met(self, value: Value | None) -> bool:
        """Whether PX4's value is good enough; None is not."""
        if value is None:
            return False
        return math.isclose(
            float(value), float(self.value), rel_tol=1e-5, abs_tol=max(1e-6, self.tolerance)
        )


_FAILSAFE = (
    RequiredParam(
        "COM_OF_LOSS_T",
        0.3,
        "PX4 acts after so long without setpoints [s], for instance of a hung agent",
    ),
    RequiredParam(
        "COM_OBL_RC_ACT",
        4,
        "then PX4 lands (4); it neither descends without position control nor returns",
    ),
    RequiredParam(
        "COM_LOW_BAT_ACT",
        2,
        "at its critical battery level PX4 lands (2) and does not climb to return",
    ),
    RequiredParam(
        "NAV_RCL_ACT", 3, "without radio control PX4 lands (3) and does not climb to return"
    ),
    RequiredParam(
        "NAV_DLL_ACT", 0, "without a ground link PX4 does nothing (0): the agent decides"
    ),
    RequiredParam(
        "MAN_OVERRIDE_SPD",
        -1.0,
        "a bumped stick takes no vehicle out of OFFBOARD (-1); the pilot takes it with the mode "
        "switch",
        since=(1, 18),
    ),
    # 0 or 1: never in OFFBOARD (2), whatever PX4's own modes do
    RequiredParam(
        "COM_RC_OVERRIDE",
        0,
        "a bumped stick takes no vehicle out of OFFBOARD (0 or 1); the pilot takes it with the "
        "mode switch",
        tolerance=1.0,
        before=(1, 18),
    ),
)

_MOCAP = (
    RequiredParam(
        "EKF2_EV_CTRL",
        15,
        "PX4 fuses position, height, velocity and heading of the mocap (bits 1 2 4 8)",
    ),
    RequiredParam("EKF2_HGT_REF", 3, "PX4's height comes from the mocap (3)", needs_restart=True),
    RequiredParam("EKF2_GPS_CTRL", 0, "PX4 does not use satellites (0), which are wrong indoors"),
    RequiredParam(
        "EKF2_MAG_TYPE",
        5,
        "PX4's heading comes from the mocap, not from a compass near motors and steel (5: no "
        "compass)",
        needs_restart=True,
    ),
)

_MOCAP_ADVICE = (
    RequiredParam(
        "EKF2_EVP_NOISE",
        0.01,
        "a mocap is accurate to a centimetre [m]: PX4's own hold and land stay in position",
        is_advice=True,
    ),
    RequiredParam(
        "EKF2_TAU_VEL", 0.02, "PX4's output follows its filter at once [s]", is_advice=True
    ),
    RequiredParam(
        "EKF2_TAU_POS", 0.1, "PX4's output follows its filter at once [s]", is_advice=True
    ),
    # PX4 raises it to the largest delay of any sensor, used or not: 110 ms for satellites in v1.16,
    # 100 ms for airspeed
    RequiredParam(
        "EKF2_DELAY_MAX",
        100.0,
        "PX4's filter lags no further than it must [ms]",
        needs_restart=True,
        is_advice=True,
        tolerance=80.0,
    ),
)

# Of a vehicle with a mocap; docs/deployment.md lists them.
BUILT_IN = (*_FAILSAFE, *_MOCAP, *_MOCAP_ADVICE)
_TOLERANCES = {param.name: param.tolerance for param in BUILT_IN}


def all_params(vehicle: Vehicle, version: Version | None = None) -> tuple[RequiredParam, ...]:
    """Return all values that this vehicle's PX4 should have.

    The fleet file's ``px4_params`` replace built-in ones.

    Args:
        vehicle: of the fleet file.
        version: of its PX4, as reported; None when it is not known.
    """
    version = plausible_version(version)
    hover_throttle = RequiredParam(
        "MPC_THR_HOVER",
        min(max(vehicle.hover_thrust_frac, 0.1), 0.8),
        "PX4's own hold and land begin with this throttle",
        is_advice=True,
        tolerance=0.1,
    )
    built_in = BUILT_IN if vehicle.mocap_required else _FAILSAFE
    own = vehicle.px4_params

    params = [
        param
        for param in (*built_in, hover_throttle)
        if param.name not in own and param.is_for(version)
    ]
    for name, value in own.items():
        params.append(RequiredParam(name, value, "the fleet file's px4_params require it"))
    return tuple(params)


def required_params(vehicle: Vehicle, version: Version | None = None) -> dict[str, Value]:
    """Return the parameters without which take-off is refused.

    They are the built-in ones and the fleet file's own.
    """
    return {
        param.name: param.value for param in all_params(vehicle, version) if not param.is_advice
    }


def differences(
    required: Mapping[str, Value], actual: Mapping[str, Value | None]
) -> tuple[str, ...]:
    """Return a sentence for each parameter that is not as required.

    Args:
        required: name -> value.
        actual: name -> PX4's value; None where PX4 did not send it.
    """
    sentences: list[str] = []
    for name, value_required in required.items():
        value = actual.get(name)
        if value is None:
            sentences.append(
                f"PX4 did not send its parameter {name}: check the link and PX4's version."
            )
            continue

        param = RequiredParam(name, value_required, "", tolerance=_TOLERANCES.get(name, 0.0))
        if not param.is_met(value):
            sentences.append(
                f"PX4 parameter {name} is {value:g}, this fleet requires {value_required:g}."
            )
    return tuple(sentences)
