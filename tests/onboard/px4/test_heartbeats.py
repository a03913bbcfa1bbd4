"""What the agent reads from PX4's heartbeats."""

from __future__ import annotations

import pytest

from onboard.px4.message_parsers import PARSERS

# values of MAV_STATE
STANDBY = 3
ACTIVE = 4
CRITICAL = 5
FLIGHT_TERMINATION = 8


@pytest.mark.parametrize(
    ("system_status", "is_failsafe"),
    [(STANDBY, False), (ACTIVE, False), (CRITICAL, True), (FLIGHT_TERMINATION, True)],
)
def test_a_critical_or_terminated_px4_is_in_a_failsafe(
    system_status: int, is_failsafe: bool
) -> None:
    fields = {"base_mode": 193, "custom_mode": 1 << 16, "system_status": system_status}
    assert PARSERS["HEARTBEAT"](fields, 1)["is_failsafe"] is is_failsafe
