"""Which unhealthy sensors of PX4 keep a vehicle on the ground."""

from __future__ import annotations

import pytest

from onboard.autopilot import Snapshot
from onboard.px4.sensor_status import unhealthy

_GYROSCOPE = 0x1
_MAGNETOMETER = 0x4
_SATELLITES = 0x20


@pytest.mark.parametrize(
    ("by_satellites", "reported"),
    [
        (True, (("gyroscope", True), ("magnetometer", True), ("satellites", True))),
        (False, (("gyroscope", True), ("magnetometer", False))),  # by a mocap or by a camera
    ],
)
def test_only_a_flight_by_satellites_requires_them(
    by_satellites: bool, reported: tuple[tuple[str, bool], ...]
) -> None:
    bits = _GYROSCOPE | _MAGNETOMETER | _SATELLITES
    seen = Snapshot(sensors_enabled=bits, sensors_healthy=0, sensors_ns=1)
    assert unhealthy(seen, by_satellites) == reported
