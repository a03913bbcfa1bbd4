"""A state message of a neighbour that hovers, as the tests of several rooms need it."""

from __future__ import annotations

from typing import Any

from onboard.bus.schema import StateMessage

_ZERO = (0.0, 0.0, 0.0)


def state_message(**changes: Any) -> StateMessage:
    """Return a valid state of mav1 in hover 1 m above the origin; changes name what differs."""
    place = changes.get("position_enu_m", (0.0, 0.0, 1.0))
    values: dict[str, Any] = {
        "vehicle": "mav1",
        "boot_id": 1,
        "sequence": 1,
        "stamp_ns": 1_000_000_000,
        "is_valid": True,
        "is_airborne": True,
        "is_cooperative": True,
        "position_enu_m": place,
        "velocity_enu_m_s": _ZERO,
        "acceleration_enu_m_s2": _ZERO,
        "predicted_position_enu_m": place,
        "predicted_velocity_enu_m_s": _ZERO,
        "commanded_acceleration_enu_m_s2": _ZERO,
        "lead_time_s": 0.15,
        "position_std_m": 0.01,
        "velocity_std_m_s": 0.02,
        "crowd_count": 0.0,
    }
    return StateMessage(**{**values, **changes})
