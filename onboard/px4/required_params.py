"""PX4 parameters that close flight demands, why, and how far a vehicle is from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from onboard.config.fleet import Vehicle

Value = float | int
FUSES_POSITION, FUSES_HEADING = 1, 8  # bits of EKF2_EV_CTRL


@dataclass(frozen=True, slots=True)
class Demand:
    """One parameter: what it must be and why.

    needs_restart: PX4 reads it only when it starts. is_advice: another value costs quality, not safety; it refuses
    nothing, and only ``covey px4 params --apply`` sets it. tolerance: so far from the value is as good.
    """

    name: str
    value: Value
    why: str
    needs_restart: bool = False
    is_advice: bool = False
    tolerance: float = 0.0

    def is_met(self, value: Value | None) -> bool:
        """Whether PX4's value will do."""
        if value is None:
            return False
        return math.isclose(float(value), float(self.value), rel_tol=1e-5, abs_tol=max(1e-6, self.tolerance))


_FAILSAFE = (
    Demand("COM_OF_LOSS_T", 0.3, "PX4 acts when setpoints have been silent for so long [s]: a hung agent is silence"),
    Demand("COM_OBL_RC_ACT", 4, "it acts on that silence by landing (4), not by a blind descent or a return"),
    Demand("COM_LOW_BAT_ACT", 2, "at its critical battery level PX4 lands (2) and does not climb to return"),
    Demand("NAV_RCL_ACT", 3, "a lost radio control lands it (3) and does not climb to return"),
    Demand("NAV_DLL_ACT", 0, "a lost ground link is for the agent to decide (0: PX4 does nothing)"),
)
_MOCAP = (
    Demand("EKF2_EV_CTRL", 15, "PX4 fuses position, height, velocity and heading of the mocap (bits 1 2 4 8)"),
    Demand("EKF2_HGT_REF", 3, "its height comes from the mocap (3)", needs_restart=True),
    Demand("EKF2_GPS_CTRL", 0, "and not from satellites (0), which are wrong indoors"),
    Demand(
        "EKF2_MAG_TYPE",
        5,
        "its heading comes from the mocap, not from a compass beside motors and steel (5: none)",
        needs_restart=True,
    ),
)
_MOCAP_ADVICE = (
    Demand(
        "EKF2_EVP_NOISE",
        0.01,
        "a mocap is good to a centimetre [m]: PX4's own hold and land stay in place",
        False,
        True,
    ),
    Demand("EKF2_TAU_VEL", 0.02, "PX4's output follows its filter at once [s]", False, True),
    Demand("EKF2_TAU_POS", 0.1, "PX4's output follows its filter at once [s]", False, True),
    Demand("EKF2_DELAY_MAX", 20.0, "PX4's filter lags no further than the mocap does [ms]", True, True, 30.0),
)


def demands(vehicle: Vehicle) -> tuple[Demand, ...]:
    """All that this vehicle's PX4 should be set to; the fleet file's own ``px4_params`` replace what is built in."""
    hover = min(max(vehicle.hover_thrust_frac, 0.1), 0.8)
    built_in = (
        *_FAILSAFE,
        *((*_MOCAP, *_MOCAP_ADVICE) if vehicle.mocap_required else ()),
        Demand("MPC_THR_HOVER", hover, "PX4's own hold and land begin with this throttle", False, True, 0.1),
    )
    own = vehicle.px4_params
    asked = tuple(Demand(name, value, "the fleet file's px4_params ask for it") for name, value in own.items())
    return (*(demand for demand in built_in if demand.name not in own), *asked)


def page() -> str:
    """The built-in demands as a table for docs/deployment.md."""
    lines = ["| parameter | value | take-off without it | why |", "|---|---|---|---|"]
    for demand in (*_FAILSAFE, *_MOCAP, *_MOCAP_ADVICE):
        without = "allowed" if demand.is_advice else "**refused**"
        restart = " Restart PX4 after it." if demand.needs_restart else ""
        lines.append(f"| `{demand.name}` | {demand.value:g} | {without} | {demand.why}.{restart} |")
    lines.append(
        "| `MPC_THR_HOVER` | `hover_thrust_frac` | allowed | PX4's own hold and land begin with this throttle. |"
    )
    return "\n".join(lines)


def required_params(vehicle: Vehicle) -> dict[str, Value]:
    """What take-off is refused without: the built-in demands and the fleet file's own."""
    return {demand.name: demand.value for demand in demands(vehicle) if not demand.is_advice}


def differences(required: Mapping[str, Value], actual: Mapping[str, Value | None]) -> tuple[str, ...]:
    """A sentence for each parameter that is not as required; None means that PX4 did not tell."""
    found = []
    for name, wanted in required.items():
        value = actual.get(name)
        if value is None:
            found.append(f"PX4 did not tell its parameter {name}: check the link and PX4's version.")
        elif not Demand(name, wanted, "").is_met(value):
            found.append(f"PX4 parameter {name} is {value:g}, this fleet needs {wanted:g}.")
    return tuple(found)
