"""Facts of PX4's own take-off and landing, requested as any ground station would."""

from __future__ import annotations

import math

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import grounded
from sitl.conformance.measurements import descent_speed_m_s, mean
from sitl.conformance.vehicle_client import ARM, LAND, LANDED, TAKEOFF, Stuck, VehicleClient

_HIGHEST_M = 1.3  # greatest height at which the speed of the landing is measured
_SAME_TIME_S = 0.3  # a text and a state within this time belong together
UP = facts("automatic", "up")
DOWN = facts("automatic", "down")


def run(client: VehicleClient, report: FactReport) -> None:
    """Take off, wait and land."""
    client.greet(as_ground_station=True)
    grounded(client)
    client.wait(1.2)
    client.interval("EXTENDED_SYS_STATE", 20.0)
    ground_z = client.newest("LOCAL_POSITION_NED").z

    default = math.nan  # PX4 chooses the value
    answer = client.command(TAKEOFF, default, 0.0, 0.0, default, default, default, default)
    report.add("takeoff.accepted", answer)

    client.next_heartbeat(2)
    report.add("takeoff.waits", f"{client.mode} {client.arming_state}")

    armed_s = client.now_s
    if client.command(ARM, 1.0) != "ACCEPTED":
        raise Stuck("it did not arm in AUTO.TAKEOFF")
    client.wait(12.0, lambda: math.isfinite(_state_after_s(client, "IN_AIR", armed_s)))
    report.add("takeoff.text", client.quote("Using default", armed_s))
    report.add("takeoff.detected", client.delay_s("Takeoff detected", armed_s))
    report.add("takeoff.state", _state_after_s(client, "TAKEOFF", armed_s))
    report.add("takeoff.in-air", _state_after_s(client, "IN_AIR", armed_s))

    # the mode after the take-off, and the messages of that mode
    since_s = client.now_s
    client.next_heartbeat(2)
    report.add("takeoff.then", client.mode)
    client.wait(1.0)
    count = len(client.received.of("POSITION_TARGET_GLOBAL_INT", since_s))
    report.add("stream.position-target-global-int", count / (client.now_s - since_s))

    positions = client.received.of("LOCAL_POSITION_NED", client.now_s - 1.0)
    heights_m = [ground_z - packet.message.z for packet in positions]
    report.add("takeoff.height", mean(heights_m))

    if report.wants("land.*"):
        _land(client, report, ground_z)
    client.interval("EXTENDED_SYS_STATE", 0.0)


def _state_after_s(client: VehicleClient, state: str, since_s: float) -> float:
    """Return the time from `since_s` to the first EXTENDED_SYS_STATE with a state, or infinity."""
    for packet in client.received.of("EXTENDED_SYS_STATE", since_s):
        if LANDED.get(packet.message.landed_state) == state:
            return packet.at_s - since_s
    return math.inf


def _land(client: VehicleClient, report: FactReport, ground_z: float) -> None:
    """Land by a command, and report mode, speed, texts and times."""
    since_s = client.now_s
    report.add("land.accepted", client.command(LAND))
    client.next_heartbeat(2)
    report.add("land.mode", client.mode)
    report.add("land.state", client.landed)

    disarmed = client.text("Disarmed by", since_s, wait_s=25.0)
    report.add("land.text", client.quote("Landing at", since_s))

    positions = client.received.of("LOCAL_POSITION_NED", since_s)
    report.add("land.speed", descent_speed_m_s(positions, ground_z, top_m=_HIGHEST_M))

    detected = client.text("Landing detected", since_s)
    on_ground_s = _state_after_s(client, "ON_GROUND", since_s) + since_s
    if detected is None or disarmed is None:
        return

    apart_s = on_ground_s - detected.at_s
    if abs(apart_s) < _SAME_TIME_S:
        report.add("land.detected", "yes")
    else:
        report.add("land.detected", f"{apart_s:+.1f} s apart")

    report.add("land.disarm", disarmed.at_s - detected.at_s)
    report.add("land.disarm-text", repr(disarmed.words))
    report.add("land.duration", disarmed.at_s - since_s)
    client.next_heartbeat(2)
    report.add("land.mode-after", client.mode)


FACT_GROUP = FactGroup("take-off and landing by commands", (*UP, *DOWN), run)
