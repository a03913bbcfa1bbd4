"""The ground station's link, on a socket of its own: streams unasked, and has texts of its own."""

from __future__ import annotations

import math

from sitl.conformance.facts import FactReport, facts
from sitl.conformance.phase import Phase
from sitl.conformance.vehicle_client import ARM, VehicleClient

FACTS = facts("ground_link", "facts")


def run(client: VehicleClient, report: FactReport) -> None:
    """Listen, then be a ground station."""
    wanted = client.system_id
    if not client.listen(3.0, lambda: client.received.newest("HEARTBEAT") is not None):
        client.send_heartbeat()
        if not client.listen(5.0, lambda: client.received.newest("HEARTBEAT") is not None):
            report.fail(FACTS, "nobody is heard there")
            return
    client.spend(4.2)
    everybody = client.received.of("HEARTBEAT")
    others = sorted({packet.system_id for packet in everybody if packet.component_id == 1} - {wanted})
    if others and any(packet.system_id == wanted for packet in everybody):
        report.skip(
            FACTS, f"other autopilots send to this port as well (system {', '.join(map(str, others))}): stop them"
        )
        return
    beats = [packet for packet in everybody if packet.system_id == wanted]
    report.add("gcs.system", "yes" if beats else "no")
    span_s = beats[-1].at_s - beats[0].at_s if len(beats) > 1 else math.nan
    report.add("gcs.heartbeat", (len(beats) - 1) / span_s)
    report.add("gcs.version", "MAVLink 2" if not client.received.v1_frames else "MAVLink 1 among them")
    client.greet(as_ground_station=True)
    client.spend(1.2)
    report.add("gcs.answers", client.set_mode("OFFBOARD").partition(",")[0])
    since_s = client.now_s
    client.command(ARM, 1.0)  # in OFFBOARD without setpoints: refused, with a text
    client.spend(0.5)
    report.add("gcs.text", "sent" if client.texts(since_s) else "not sent")
    client.set_mode("AUTO.LOITER")
    client.next_heartbeat()


PHASE = Phase("the ground station's link", FACTS, run, turns_motors=False)
