"""Facts of links on other ports: those of the ground station and of the simulator's viewers."""

from __future__ import annotations

from sitl.conformance.endpoint import NAMES
from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.measurements import NOT_MEASURED, sent_or_not, yes_or_no
from sitl.conformance.vehicle_client import ARM, VehicleClient

FACTS = facts("ground_link", "facts")
SIMULATOR_FACTS = facts("simulator_link", "facts")
_WATCH_S = 6.0
_OCCASIONAL = ("EVENT", "PARAM_VALUE")  # messages that are sent only after events


def run_ground_link(client: VehicleClient, report: FactReport) -> None:
    """Listen, then act as a ground station."""
    system_id = client.system_id
    if not client.listen(3.0, lambda: client.received.newest("HEARTBEAT") is not None):
        client.send_heartbeat()
        if not client.listen(5.0, lambda: client.received.newest("HEARTBEAT") is not None):
            report.fail(FACTS, "nobody is heard there")
            return
    client.wait(4.2)

    all_beats = client.received.of("HEARTBEAT")
    beats = [packet for packet in all_beats if packet.system_id == system_id]
    autopilots = {packet.system_id for packet in all_beats if packet.component_id == 1}
    other_autopilots = sorted(autopilots - {system_id})
    if other_autopilots and beats:
        systems = ", ".join(map(str, other_autopilots))
        report.skip(
            FACTS,
            f"other autopilots send to this port as well (system {systems}): stop them",
        )
        return

    report.add("gcs.system", yes_or_no(bool(beats)))
    rate_hz = NOT_MEASURED
    if len(beats) > 1:
        rate_hz = (len(beats) - 1) / (beats[-1].at_s - beats[0].at_s)
    report.add("gcs.heartbeat", rate_hz)

    version = "MAVLink 2"
    if client.received.v1_frames:
        version = "MAVLink 1 among them"
    report.add("gcs.version", version)

    client.greet(as_ground_station=True)
    client.wait(1.2)
    first_ack, _, _ = client.set_mode("OFFBOARD").partition(",")
    report.add("gcs.answers", first_ack)
    since_s = client.now_s
    client.command(ARM, 1.0)  # PX4 refuses it in OFFBOARD without setpoints, with a text
    client.wait(0.5)
    report.add("gcs.text", sent_or_not(client.texts(since_s)))
    client.set_mode("AUTO.LOITER")
    client.next_heartbeat()


def run_simulator_link(client: VehicleClient, report: FactReport) -> None:
    """Listen without sending, as a viewer does."""
    if not client.listen(3.0, lambda: client.received.newest("HIL_STATE_QUATERNION") is not None):
        report.fail(SIMULATOR_FACTS, "no HIL_STATE_QUATERNION comes there")
        return

    counts_before = _counts(client)
    # Use this computer's time, because no message of this link carries the vehicle's time.
    client.listen(_WATCH_S, lambda: False)
    counts = {name: count - counts_before.get(name, 0) for name, count in _counts(client).items()}

    report.add("sih.state", counts["HIL_STATE_QUATERNION"] / _WATCH_S)
    report.add("sih.actuators", counts.get("HIL_ACTUATOR_CONTROLS", 0) / _WATCH_S)
    report.add("sih.heartbeat", counts.get("HEARTBEAT", 0) / _WATCH_S)

    expected = {"HIL_STATE_QUATERNION", "HIL_ACTUATOR_CONTROLS", "HEARTBEAT", *_OCCASIONAL}
    other_messages = sorted(set(counts) - expected)
    report.add("sih.others", ", ".join(other_messages) or "nothing")

    state = client.newest("HIL_STATE_QUATERNION")
    senders = {packet.system_id for packet in client.received.of("HIL_STATE_QUATERNION")}
    report.add("sih.system", yes_or_no(senders == {client.system_id}))
    report.add("sih.time", str(state.time_usec))
    report.add("sih.latitude", 1e-7 * state.lat)
    report.add("sih.longitude", 1e-7 * state.lon)


def _counts(client: VehicleClient) -> dict[str, int]:
    return {
        NAMES.get(number, str(number)): len(packets)
        for number, packets in client.received.packets.items()
        if packets
    }


GROUND_LINK = FactGroup("the ground station's link", FACTS, run_ground_link, turns_motors=False)
SIMULATOR_LINK = FactGroup(
    "the simulator's link", SIMULATOR_FACTS, run_simulator_link, turns_motors=False
)
