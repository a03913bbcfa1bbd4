"""PX4 parameters that close flight demands, and how far a vehicle is from them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from onboard.config import Vehicle

# A hung agent is silence on the wire: PX4 must act on it within 0.3 s, and by landing.
_FAILSAFE: dict[str, float | int] = {"COM_OF_LOSS_T": 0.3, "COM_OBL_RC_ACT": 4}
# PX4 fuses the forwarded mocap pose and nothing else, so that its own land works indoors.
_MOCAP: dict[str, float | int] = {"EKF2_EV_CTRL": 15, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0, "EKF2_MAG_TYPE": 5}


def required_params(vehicle: Vehicle) -> dict[str, float | int]:
    """What this vehicle's PX4 must be set to: the built-in demands and the fleet file's own."""
    return {**_FAILSAFE, **(_MOCAP if vehicle.mocap_required else {}), **vehicle.px4_params}


def differences(required: Mapping[str, float | int], actual: Mapping[str, float | int | None]) -> tuple[str, ...]:
    """A sentence for each parameter that is not as required; None means that PX4 did not tell."""
    found = []
    for name, wanted in required.items():
        value = actual.get(name)
        if value is None:
            found.append(f"PX4 did not tell its parameter {name}: check the link and PX4's version.")
        elif not math.isclose(float(value), float(wanted), rel_tol=1e-5, abs_tol=1e-6):
            found.append(
                f"PX4 parameter {name} is {value:g}, this fleet needs {wanted:g}: "
                "set it, or start the agent with --apply-params."
            )
    return tuple(found)
