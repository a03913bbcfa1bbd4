"""Take-off and landing by PX4 itself, as any ground station would request them."""

from __future__ import annotations

import math
import statistics

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import grounded
from sitl.conformance.vehicle_client import ARM, LAND, LANDED, TAKEOFF, Stuck, VehicleClient

UP = facts("automatic", "up")
DOWN = facts("automatic", "down")


def run(client: VehicleClient, report: FactReport) -> None:
    """Take off, wait, land."""
    client.greet(as_ground_station=True)
    grounded(client)
    client.spend(1.2)
    client.interval("EXTENDED_SYS_STATE", 20.0)
    ground_z = client.newest("LOCAL_POSITION_NED").z

    default = math.nan
    answer = client.command(TAKEOFF, default, 0.0, 0.0, default, default, default, default)
    report.add("takeoff.accepted", answer)
    client.next_heartbeat(2)
    report.add("takeoff.waits", f"{client.mode} {'armed' if client.is_armed else 'disarmed'}")
    armed_s = client.now_s
    if client.command(ARM, 1.0) != "ACCEPTED":
        raise Stuck("it did not arm in AUTO.TAKEOFF")
    client.spend(12.0, lambda: _since(client, "IN_AIR", armed_s) < math.inf)
    report.add("takeoff.text", client.quote("Using default", armed_s))
    report.add("takeoff.detected", client.delay_s("Takeoff detected", armed_s))
    report.add("takeoff.state", _since(client, "TAKEOFF", armed_s))
    report.add("takeoff.in-air", _since(client, "IN_AIR", armed_s))

    since_s = client.now_s
    client.next_heartbeat(2)
    report.add("takeoff.then", client.mode)
    client.spend(1.0)
    count = len(client.received.of("POSITION_TARGET_GLOBAL_INT", since_s))
    report.add("stream.position-target-global-int", count / (client.now_s - since_s))
    position = client.received.of("LOCAL_POSITION_NED", client.now_s - 1.0)
    report.add(
        "takeoff.height", statistics.fmean(ground_z - packet.message.z for packet in position)
    )
    if report.wants("land.*"):
        _land(client, report, ground_z)
    client.interval("EXTENDED_SYS_STATE", 0.0)


def _since(client: VehicleClient, state: str, armed_s: float) -> float:
    for packet in client.received.of("EXTENDED_SYS_STATE", armed_s):
        if LANDED.get(packet.message.landed_state) == state:
            return packet.at_s - armed_s
    return math.inf


def _land(client: VehicleClient, report: FactReport, ground_z: float) -> None:
    since_s = client.now_s
    report.add("land.accepted", client.command(LAND))
    client.next_heartbeat(2)
    report.add("land.mode", client.mode)
    report.add("land.state", client.landed)
    disarmed = client.text("Disarmed by", since_s, wait_s=25.0)
    report.add("land.text", client.quote("Landing at", since_s))
    low = [
        packet.message.vz
        for packet in client.received.of("LOCAL_POSITION_NED", since_s)
        if 0.5 < ground_z - packet.message.z < 1.3
    ]
    report.add("land.speed", statistics.fmean(low) if low else math.nan)

    detected = client.text("Landing detected", since_s)
    on_ground_s = _since(client, "ON_GROUND", since_s) + since_s
    if detected is None or disarmed is None:
        return
    detected_s, _, _, _ = detected
    disarmed_s, _, words, _ = disarmed
    apart_s = on_ground_s - detected_s
    report.add("land.detected", "yes" if abs(apart_s) < 0.3 else f"{apart_s:+.1f} s apart")
    report.add("land.disarm", disarmed_s - detected_s)
    report.add("land.disarm-text", repr(words))
    report.add("land.duration", disarmed_s - since_s)
    client.next_heartbeat(2)
    report.add("land.mode-after", client.mode)


FACT_GROUP = FactGroup("take-off and landing by commands", (*UP, *DOWN), run)
