"""Take-off and landing by PX4 itself, as any ground station would ask for them."""

from __future__ import annotations

import math
import statistics

from sitl.conformance.facts import FactReport, number, word
from sitl.conformance.hover import grounded
from sitl.conformance.phase import Phase
from sitl.conformance.pilot import ARM, LAND, LANDED, TAKEOFF, Pilot, Stuck

UP = (
    word("takeoff.accepted", "5", "take-off asked for while disarmed", "ACCEPTED"),
    word("takeoff.waits", "5", "it waits in AUTO.TAKEOFF, disarmed", "AUTO.TAKEOFF disarmed"),
    word("takeoff.text", "5", "text at arming", repr("Using default takeoff altitude: 2.5 m\t")),
    number("takeoff.detected", "5", "text 'Takeoff detected' after arming", 1.0, 2.6, "s"),
    number("takeoff.state", "5", "landed state TAKEOFF after arming", 1.0, 2.8, "s"),
    number("takeoff.in-air", "5", "landed state IN_AIR after arming", 4.5, 8.5, "s"),
    word("takeoff.then", "5", "then holds by itself", "AUTO.LOITER"),
    number("takeoff.height", "5", "height reached", 2.1, 2.9, "m"),
    number("stream.position-target-global-int", "4", "POSITION_TARGET_GLOBAL_INT in AUTO modes", 9.0, 11.0, "Hz"),
)
DOWN = (
    word("land.accepted", "5", "landing asked for", "ACCEPTED"),
    word("land.text", "5", "text", repr("Landing at current position\t")),
    word("land.mode", "5", "mode", "AUTO.LAND"),
    word("land.state", "5", "landed state on the way", "LANDING"),
    number("land.speed", "5", "speed near the ground", 0.5, 0.95, "m/s"),
    word("land.detected", "5", "'Landing detected' comes with landed state ON_GROUND", "yes"),
    number("land.disarm", "5", "disarmed after that", 1.8, 2.4, "s"),
    word("land.disarm-text", "5", "text", repr("Disarmed by landing\t")),
    number("land.duration", "5", "from about 2.5 m to disarmed", 6.0, 16.0, "s"),
    word("land.mode-after", "5", "mode after it was armed from AUTO.TAKEOFF", "AUTO.LOITER"),
)


def run(pilot: Pilot, report: FactReport) -> None:
    """Up, wait, down."""
    pilot.greet(as_ground_station=True)
    grounded(pilot)
    pilot.spend(1.2)
    pilot.interval("EXTENDED_SYS_STATE", 20.0)
    ground_z = pilot.newest("LOCAL_POSITION_NED").z
    report.add("takeoff.accepted", pilot.command(TAKEOFF, math.nan, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan))
    pilot.next_heartbeat(2)
    report.add("takeoff.waits", f"{pilot.mode} {'armed' if pilot.is_armed else 'disarmed'}")
    armed_s = pilot.now_s
    if pilot.command(ARM, 1.0) != "ACCEPTED":
        raise Stuck("it did not arm in AUTO.TAKEOFF")
    pilot.spend(12.0, lambda: _since(pilot, "IN_AIR", armed_s) < math.inf)
    text = pilot.text("Using default", armed_s)
    report.add("takeoff.text", repr(text[2]) if text else "none")
    text = pilot.text("Takeoff detected", armed_s)
    report.add("takeoff.detected", text[0] - armed_s if text else math.nan)
    report.add("takeoff.state", _since(pilot, "TAKEOFF", armed_s))
    report.add("takeoff.in-air", _since(pilot, "IN_AIR", armed_s))
    since_s = pilot.now_s
    pilot.next_heartbeat(2)
    report.add("takeoff.then", pilot.mode)
    pilot.spend(1.0)
    count = len(pilot.seen.of("POSITION_TARGET_GLOBAL_INT", since_s))
    report.add("stream.position-target-global-int", count / (pilot.now_s - since_s))
    place = pilot.seen.of("LOCAL_POSITION_NED", pilot.now_s - 1.0)
    report.add("takeoff.height", statistics.fmean(ground_z - packet.message.z for packet in place))
    if report.wants("land.*"):
        _land(pilot, report, ground_z)
    pilot.interval("EXTENDED_SYS_STATE", 0.0)


def _since(pilot: Pilot, state: str, armed_s: float) -> float:
    for packet in pilot.seen.of("EXTENDED_SYS_STATE", armed_s):
        if LANDED.get(packet.message.landed_state) == state:
            return packet.at_s - armed_s
    return math.inf


def _land(pilot: Pilot, report: FactReport, ground_z: float) -> None:
    since_s = pilot.now_s
    report.add("land.accepted", pilot.command(LAND))
    pilot.next_heartbeat(2)
    report.add("land.mode", pilot.mode)
    report.add("land.state", pilot.landed)
    pilot.spend(25.0, lambda: pilot.text("Disarmed by", since_s) is not None)
    text = pilot.text("Landing at", since_s)
    report.add("land.text", repr(text[2]) if text else "none")
    low = [
        packet.message.vz
        for packet in pilot.seen.of("LOCAL_POSITION_NED", since_s)
        if 0.5 < ground_z - packet.message.z < 1.3
    ]
    report.add("land.speed", statistics.fmean(low) if low else math.nan)
    detected, disarmed = pilot.text("Landing detected", since_s), pilot.text("Disarmed by", since_s)
    down_s = _since(pilot, "ON_GROUND", since_s) + since_s
    if detected is None or disarmed is None:
        return
    report.add("land.detected", "yes" if abs(down_s - detected[0]) < 0.3 else f"{down_s - detected[0]:+.1f} s apart")
    report.add("land.disarm", disarmed[0] - detected[0])
    report.add("land.disarm-text", repr(disarmed[2]))
    report.add("land.duration", disarmed[0] - since_s)
    pilot.next_heartbeat(2)
    report.add("land.mode-after", pilot.mode)


PHASE = Phase("take-off and landing by commands", (*UP, *DOWN), run)
