"""The ground station's link, on a socket of its own: streams unasked, and has texts of its own."""

from __future__ import annotations

import math

from sitl.conformance.facts import FactReport, number, word
from sitl.conformance.phase import Phase
from sitl.conformance.pilot import ARM, Pilot

FACTS = (
    number("gcs.heartbeat", "1", "heartbeats on the ground station's link", 0.9, 1.1, "Hz"),
    word("gcs.system", "1", "they come from the same vehicle", "yes"),
    word("gcs.version", "4", "MAVLink 2 there too", "MAVLink 2"),
    word("gcs.text", "2", "a ground station's heartbeat on this link brings STATUSTEXT here", "sent"),
    word("gcs.answers", "4", "commands are answered here", "ACCEPTED"),
)


def run(pilot: Pilot, report: FactReport) -> None:
    """Listen, then be a ground station."""
    wanted = pilot.system_id
    if not pilot.listen(3.0, lambda: pilot.seen.newest("HEARTBEAT") is not None):
        pilot.send_heartbeat()
        if not pilot.listen(5.0, lambda: pilot.seen.newest("HEARTBEAT") is not None):
            report.fail(FACTS, "nobody is heard there")
            return
    pilot.spend(4.2)
    beats = [packet for packet in pilot.seen.of("HEARTBEAT") if packet.system_id == wanted]
    report.add("gcs.system", "yes" if beats else "no")
    span_s = beats[-1].at_s - beats[0].at_s if len(beats) > 1 else math.nan
    report.add("gcs.heartbeat", (len(beats) - 1) / span_s)
    report.add("gcs.version", "MAVLink 2" if not pilot.seen.v1_frames else "MAVLink 1 among them")
    pilot.greet(as_ground_station=True)
    pilot.spend(1.2)
    report.add("gcs.answers", pilot.set_mode("OFFBOARD").partition(",")[0])
    since_s = pilot.now_s
    pilot.command(ARM, 1.0)  # in OFFBOARD without setpoints: refused, with a text
    pilot.spend(0.5)
    report.add("gcs.text", "sent" if pilot.texts(since_s) else "not sent")
    pilot.set_mode("AUTO.LOITER")
    pilot.next_heartbeat()


PHASE = Phase("the ground station's link", FACTS, run, turns_motors=False)
