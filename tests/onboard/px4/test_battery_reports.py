"""Two battery monitors are told as one battery, and one that is gone is not forgotten."""

from __future__ import annotations

import math
from typing import Any

from onboard.autopilot import BATTERY_KNOWN_NS
from onboard.px4.battery_reports import BatteryReports

S = 1_000_000_000


def report(at_s: float, frac: float, voltage_v: float = 15.0) -> dict[str, Any]:
    return {
        "battery_frac": frac,
        "battery_voltage_v": voltage_v,
        "battery_ns": round(at_s * S),
    }


def gone(at_s: float) -> dict[str, Any]:
    """What PX4 says of a monitor without a battery."""
    return report(at_s, math.nan, 0.0)


def test_the_charge_is_that_of_the_weaker_battery_and_a_monitor_without_one_is_none() -> None:
    reports = BatteryReports()
    reports.changes(0, report(1.0, 0.6), is_armed=False)
    assert reports.changes(1, report(1.1, 0.24, 14.0), is_armed=False)["battery_frac"] == 0.24
    assert reports.changes(2, gone(1.2), is_armed=False) == {}


def test_a_battery_that_comes_loose_in_flight_makes_the_charge_unknown() -> None:
    reports = BatteryReports()
    reports.changes(0, report(1.0, 0.6), is_armed=False)
    reports.changes(1, report(1.0, 0.24), is_armed=False)

    known_s = BATTERY_KNOWN_NS / S
    charges = []
    for at_s in range(2, 12):
        reports.changes(1, gone(at_s), is_armed=True)
        charges.append(reports.changes(0, report(at_s, 0.6), is_armed=True)["battery_frac"])
    for at_s, charge_frac in zip(range(2, 12), charges, strict=True):
        assert math.isnan(charge_frac) == (at_s - 1.0 > known_s), at_s

    # the operator lands, and takes the second battery out
    assert reports.changes(0, report(12.0, 0.6), is_armed=False)["battery_frac"] == 0.6
    assert reports.changes(0, report(13.0, 0.6), is_armed=True)["battery_frac"] == 0.6
