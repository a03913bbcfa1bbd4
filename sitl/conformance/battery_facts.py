"""Facts of the simulated battery, and of PX4's actions while it empties in OFFBOARD."""

from __future__ import annotations

import math
from typing import Any

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import Hover, airborne
from sitl.conformance.measurements import NOT_MEASURED, yes_or_no
from sitl.conformance.vehicle_client import VehicleClient

_HEIGHT_M = 2.5
# The battery empties fast down to a charge and slowly below it. The band between critical and
# emergency is only 2 % wide and has to last for one heartbeat.
_FAST_DRAIN_S = 12.0
_SLOW_DRAIN_S = 60.0
_SLOW_FROM_PCT = 19
_LAG_S = 1.5  # time by which the percentage lags behind the voltage
# Voltage of the simulated battery by its charge.
_EMPTY_MV = 14400
_MV_PER_PCT = 18
DRAIN = facts("battery", "drain")
EMPTY = facts("battery", "empty")


def run(client: VehicleClient, report: FactReport) -> None:
    """Fly until the fast-draining battery is empty, then let it fill up."""
    client.greet(as_ground_station=True)
    if report.wants("battery.floor"):
        _floor(client, report)

    hover = airborne(client, _HEIGHT_M)
    client.interval("BATTERY_STATUS", 10.0)
    if report.wants("battery.drain"):
        _drain(client, report)
    client.params.set("SIM_BAT_MIN_PCT", 0.0)
    client.params.set("SIM_BAT_DRAIN", _FAST_DRAIN_S)
    _empty(client, report, hover)
    client.params.restore()

    disarmed_s = client.now_s
    is_full = client.wait(10.0, lambda: client.newest("BATTERY_STATUS").battery_remaining >= 99)
    refill_s = math.inf
    if is_full:
        refill_s = client.now_s - disarmed_s
    report.add("battery.refill", refill_s)
    client.interval("BATTERY_STATUS", 0.0)


def _floor(client: VehicleClient, report: FactReport) -> None:
    """Report the charge at which the simulated battery stops by default (SIM_BAT_MIN_PCT).

    It is the lowest charge received earlier in this run. A battery that stopped there sent it
    several times.
    """
    charges = [packet.message.battery_remaining for packet in client.received.of("BATTERY_STATUS")]
    least = min(charges, default=100)
    if least < 90 and charges.count(least) >= 3:
        report.add("battery.floor", float(least))
    else:
        floor_facts = [fact for fact in DRAIN if fact.name == "battery.floor"]
        report.skip(floor_facts, "nothing flew long enough before")


def _drain(client: VehicleClient, report: FactReport) -> None:
    """Report how fast the battery empties by default, measured by its voltage."""
    begin_mv = _voltage_mv(client.newest("BATTERY_STATUS"))
    begin_s = client.now_s
    packets = client.received.of("BATTERY_STATUS", begin_s - 0.5)
    if packets:
        begin_s = packets[-1].at_s

    client.wait(5.0)
    end = client.received.of("BATTERY_STATUS", begin_s)[-1]
    # The voltage has a finer resolution than the percentage.
    drained_pct = (begin_mv - _voltage_mv(end.message)) / _MV_PER_PCT
    report.add("battery.drain", drained_pct / (end.at_s - begin_s))


def _voltage_mv(status: Any) -> int:
    """Return the voltage in a BATTERY_STATUS, which has the simulated battery as one cell."""
    return int(status.voltages[0])


def _empty(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    """Empty the battery, and report PX4's texts and actions at each charge state."""
    since_s = client.now_s
    client.wait(
        1.2 * _FAST_DRAIN_S,
        lambda: client.newest("BATTERY_STATUS").battery_remaining <= _SLOW_FROM_PCT,
    )
    client.params.set("SIM_BAT_DRAIN", _SLOW_DRAIN_S)
    settled_s = client.now_s + _LAG_S

    # Wait until the charge is low, for the time in which the slow drain takes 10 % of it.
    client.text("Low battery", since_s, wait_s=0.1 * _SLOW_DRAIN_S)
    low_s = _report_text(client, report, "low", "Low battery", since_s)

    # Wait until the charge is critical. The last heartbeat came before that text, so it still has
    # the mode of a low battery.
    client.text("Critical battery", since_s, wait_s=0.12 * _SLOW_DRAIN_S)
    low_mode = "not seen"
    if math.isfinite(low_s):
        low_mode = client.mode
    report.add("battery.low-mode", low_mode)

    # Critical battery: Hold, then a landing.
    critical_s = _report_text(client, report, "critical", "Critical battery", since_s)
    client.next_heartbeat()
    report.add("battery.hold-mode", client.mode)
    report.add("battery.hold-status", client.status)
    report.add("battery.hold-text", _words(client, "Failsafe activated: entering", since_s))
    is_landing = client.wait(8.0, lambda: client.mode == "AUTO.LAND")
    if is_landing:
        # The heartbeat shows the landing up to a second later.
        report.add("battery.land-after", client.now_s - critical_s)

    # Battery at emergency level.
    report.add("battery.emergency-text", _words(client, "Emergency battery", since_s))

    errors_mv: list[int] = []
    for packet in client.received.of("BATTERY_STATUS", settled_s):
        remaining_pct = packet.message.battery_remaining
        if remaining_pct > 0:
            expected_mv = _EMPTY_MV + _MV_PER_PCT * remaining_pct
            errors_mv.append(abs(_voltage_mv(packet.message) - expected_mv))
    report.add("battery.voltage", float(max(errors_mv)))

    statuses = client.received.of("BATTERY_STATUS")
    states = sorted({packet.message.charge_state for packet in statuses})
    report.add("battery.charge-states", " ".join(map(str, states)))

    is_disarmed = client.wait(25.0, lambda: not client.is_armed)
    report.add("battery.disarms", yes_or_no(is_disarmed))
    client.stream(None)


def _words(client: VehicleClient, start: str, since_s: float) -> str:
    """Return the text with a beginning, without the tab at its end; "none" when it is missing."""
    text = client.text(start, since_s)
    if text is None:
        return "none"
    return text.words.rstrip("\t")


def _report_text(
    client: VehicleClient, report: FactReport, charge_state: str, start: str, since_s: float
) -> float:
    """Report the text about a charge state; return its time, or NOT_MEASURED."""
    text = client.text(start, since_s)
    if text is None:
        report.add(f"battery.{charge_state}-text", "none")
        return NOT_MEASURED
    report.add(f"battery.{charge_state}-text", text.words.rstrip("\t"))
    report.add(f"battery.{charge_state}-severity", str(text.severity))

    statuses = client.received.of("BATTERY_STATUS", since_s)
    nearest = min(statuses, key=lambda packet: abs(packet.at_s - text.at_s))
    report.add(f"battery.{charge_state}-at", float(nearest.message.battery_remaining))
    return text.at_s


FACT_GROUP = FactGroup("battery", (*DRAIN, *EMPTY), run)
