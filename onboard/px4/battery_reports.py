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
        self._connected_ns: dict[int, int] = {}  # monitor -> when it last had a battery
        self._in_use: set[int] = set()  # monitors with a battery when the vehicle was last disarmed

    def changes(self, monitor: int, report: dict[str, Any], *, is_armed: bool) -> dict[str, Any]:
        """Take a report, and return the fields of a snapshot that it changes.

        The charge is that of the weakest battery. The voltage is always that of the first battery,
        because switching between batteries would look like a voltage drop. If a battery with which
        the vehicle was armed is gone, the charge is not known.

        Args:
            monitor: id of the monitor.
            report: snapshot fields of this monitor's battery.
            is_armed: whether the vehicle is armed.
        """
        self._newest[monitor] = report
        now_ns = report["battery_ns"]
        if _is_connected(report):
            self._connected_ns[monitor] = now_ns
        present = {
            other
            for other, connected_ns in self._connected_ns.items()
            if now_ns - connected_ns <= BATTERY_KNOWN_NS
        }
        if not is_armed:
            self._in_use = present
        is_one_gone = not self._in_use <= present

        connected = []  # recent reports of monitors with a battery, in the order of their ids
        for _, newest in sorted(self._newest.items()):
            is_recent = now_ns - newest["battery_ns"] <= BATTERY_KNOWN_NS
            if is_recent and _is_connected(newest):
                connected.append(newest)
        if not connected:
            return report
        if not _is_connected(report) and not is_one_gone:
            return {}

        first, *_ = connected
        charges_frac = [newest["battery_frac"] for newest in connected]
        known_frac = [charge_frac for charge_frac in charges_frac if not math.isnan(charge_frac)]
        charge_frac = min(known_frac, default=math.nan)
        if is_one_gone:
            charge_frac = math.nan
        return {
            "battery_frac": charge_frac,
            "battery_voltage_v": first["battery_voltage_v"],
            "battery_ns": now_ns,
        }


def _is_connected(report: dict[str, Any]) -> bool:
    """Return whether the monitor of a report has a battery."""
    return report["battery_voltage_v"] > 0.0 or not math.isnan(report["battery_frac"])
