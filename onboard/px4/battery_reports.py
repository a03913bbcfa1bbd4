"""Combines the reports of all battery monitors of a PX4 into those of one battery.

Autopilots with two power ports have two monitors. A monitor without a battery is also reported as
often as the other, but without charge and voltage.
"""

from __future__ import annotations

import math
from typing import Any

from onboard.autopilot import BATTERY_KNOWN_NS


class BatteryReports:
    """The newest report of each battery monitor."""

    def __init__(self) -> None:
        # by the monitor's id: snapshot fields of one battery, as the parser returns them
        self._newest: dict[int, dict[str, Any]] = {}

    def changes(self, monitor: int, report: dict[str, Any]) -> dict[str, Any]:
        """Take a report, and return the fields of a snapshot that it changes.

        The charge is that of the weakest battery. The voltage is always that of the first battery,
        because switching between batteries would look like a voltage drop.

        Args:
            monitor: id of the monitor.
            report: snapshot fields of this monitor's battery.
        """
        self._newest[monitor] = report
        now_ns = report["battery_ns"]
        connected = []  # recent reports of monitors with a battery, in the order of their ids
        for _, newest in sorted(self._newest.items()):
            is_recent = now_ns - newest["battery_ns"] <= BATTERY_KNOWN_NS
            if is_recent and _is_connected(newest):
                connected.append(newest)
        if not connected:
            return report
        if not _is_connected(report):
            return {}

        first, *_ = connected
        charges_frac = [newest["battery_frac"] for newest in connected]
        known_frac = [charge_frac for charge_frac in charges_frac if not math.isnan(charge_frac)]
        return {
            "battery_frac": min(known_frac, default=math.nan),
            "battery_voltage_v": first["battery_voltage_v"],
            "battery_ns": now_ns,
        }


def _is_connected(report: dict[str, Any]) -> bool:
    """Return whether the monitor of a report has a battery."""
    return report["battery_voltage_v"] > 0.0 or not math.isnan(report["battery_frac"])
