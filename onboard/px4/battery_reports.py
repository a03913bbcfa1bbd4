"""Makes one battery of the reports of several: PX4 reports each of its battery monitors.

Autopilots with two power ports have two monitors. A monitor without a battery is reported as often
as the other one, with neither charge nor voltage.
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
        since a change from one to another would look like a fall.

        Args:
            monitor: id of the monitor.
            report: snapshot fields of this monitor's battery.
        """
        self._newest[monitor] = report
        now_ns = report["battery_ns"]
        batteries = [
            known
            for _, known in sorted(self._newest.items())
            if _is_connected(known) and now_ns - known["battery_ns"] <= BATTERY_KNOWN_NS
        ]
        if not batteries:
            return report
        if not _is_connected(report):
            return {}

        charges_frac = [known["battery_frac"] for known in batteries]
        known_frac = [charge_frac for charge_frac in charges_frac if not math.isnan(charge_frac)]
        return {
            "battery_frac": min(known_frac, default=math.nan),
            "battery_voltage_v": batteries[0]["battery_voltage_v"],
            "battery_ns": now_ns,
        }


def _is_connected(report: dict[str, Any]) -> bool:
    return report["battery_voltage_v"] > 0.0 or not math.isnan(report["battery_frac"])
