"""The simulated battery and what PX4 does as it empties, down to taking the vehicle out of
OFFBOARD.
"""

from __future__ import annotations

import math

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import Hover, airborne
from sitl.conformance.vehicle_client import VehicleClient

_HEIGHT_M = 2.5
# The band from critical to emergency is 2 % wide, and has to last for a heartbeat.
_LAG_S = 1.5  # the percentage follows the voltage
_FAST_DRAIN_S, _SLOW_DRAIN_S, _SLOW_FROM_PCT = 12.0, 60.0, 19
DRAIN = facts("battery", "drain")
EMPTY = facts("battery", "empty")


def run(client: VehicleClient, report: FactReport) -> None:
    """Fly until the battery is empty, faster than usual, then let it fill up."""
    client.greet(as_ground_station=True)
    # What was flown before this shows the default floor.
    before = [packet.message.battery_remaining for packet in client.received.of("BATTERY_STATUS")]
    if report.wants("battery.floor"):
        if before.count(min(before, default=100)) >= 3 and min(before, default=100) < 90:
            report.add("battery.floor", float(min(before)))
        else:
            report.skip(
                [fact for fact in DRAIN if fact.name == "battery.floor"],
                "nothing flew long enough before",
            )
    hover = airborne(client, _HEIGHT_M)
    client.interval("BATTERY_STATUS", 10.0)
    if report.wants("battery.drain"):
        _drain(client, report)
    client.params.set("SIM_BAT_MIN_PCT", 0.0)
    client.params.set("SIM_BAT_DRAIN", _FAST_DRAIN_S)
    _empty(client, report, hover)
    client.params.restore()
    disarmed_s = client.now_s
    filled = client.spend(10.0, lambda: client.newest("BATTERY_STATUS").battery_remaining >= 99)
    report.add("battery.refill", client.now_s - disarmed_s if filled else math.inf)
    client.interval("BATTERY_STATUS", 0.0)


def _drain(client: VehicleClient, report: FactReport) -> None:
    packets = client.received.of("BATTERY_STATUS", client.now_s - 0.5)
    begin = client.newest("BATTERY_STATUS").voltages[0]
    begin_s = packets[-1].at_s if packets else client.now_s
    client.spend(5.0)
    packet = client.received.of("BATTERY_STATUS", begin_s)[-1]
    # Voltage has more digits than the percentage.
    drained_pct = (begin - packet.message.voltages[0]) / 18.0
    report.add("battery.drain", drained_pct / (packet.at_s - begin_s))


def _empty(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    since_s = client.now_s
    client.spend(
        1.2 * _FAST_DRAIN_S,
        lambda: client.newest("BATTERY_STATUS").battery_remaining <= _SLOW_FROM_PCT,
    )
    client.params.set("SIM_BAT_DRAIN", _SLOW_DRAIN_S)
    slow_s = client.now_s + _LAG_S
    client.text("Low battery", since_s, wait_s=0.1 * _SLOW_DRAIN_S)
    low_s = _say(client, report, "low", "Low battery", since_s)
    client.text("Critical battery", since_s, wait_s=0.12 * _SLOW_DRAIN_S)
    # The last heartbeat before that text.
    report.add("battery.low-mode", client.mode if math.isfinite(low_s) else "not seen")
    critical_s = _say(client, report, "critical", "Critical battery", since_s)
    client.next_heartbeat()
    report.add("battery.hold-mode", client.mode)
    report.add("battery.hold-status", client.status)
    text = client.text("Failsafe activated: entering", since_s)
    report.add("battery.hold-text", text[2].rstrip("\t") if text else "none")
    landing = client.spend(8.0, lambda: client.mode == "AUTO.LAND")
    if landing:
        # The heartbeat tells it up to a second later.
        report.add("battery.land-after", client.now_s - critical_s)
    text = client.text("Emergency battery", since_s)
    report.add("battery.emergency-text", text[2].rstrip("\t") if text else "none")
    full = [packet.message for packet in client.received.of("BATTERY_STATUS", slow_s)]
    errors = [
        abs(m.voltages[0] - 14400 - 18 * m.battery_remaining)
        for m in full
        if m.battery_remaining > 0
    ]
    report.add("battery.voltage", float(max(errors)))
    states = sorted(
        {packet.message.charge_state for packet in client.received.of("BATTERY_STATUS")}
    )
    report.add("battery.charge-states", " ".join(map(str, states)))
    down = client.spend(25.0, lambda: not client.is_armed)
    report.add("battery.disarms", "yes" if down else "no")
    client.stream(None)


def _say(
    client: VehicleClient, report: FactReport, charge_state: str, start: str, since_s: float
) -> float:
    text = client.text(start, since_s)
    if text is None:
        report.add(f"battery.{charge_state}-text", "none")
        return math.nan
    at_s, severity, words, _ = text
    report.add(f"battery.{charge_state}-text", words.rstrip("\t"))
    report.add(f"battery.{charge_state}-severity", str(severity))
    near = min(
        client.received.of("BATTERY_STATUS", since_s), key=lambda packet: abs(packet.at_s - at_s)
    )
    report.add(f"battery.{charge_state}-at", float(near.message.battery_remaining))
    return at_s


FACT_GROUP = FactGroup("battery", (*DRAIN, *EMPTY), run)
