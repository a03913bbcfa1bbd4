"""Facts of a resting vehicle that receives nothing: its start, its streams, details of fields."""

from __future__ import annotations

import itertools
import math
import statistics
from typing import Any

from pymavlink.dialects.v20 import common

from sitl.conformance.endpoint import NAMES
from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import Fact, FactReport, facts, number
from sitl.conformance.measurements import NOT_MEASURED, count_or_none, first_s, mean
from sitl.conformance.vehicle_client import MODES, STATUS, VehicleClient

_WATCH_S = 10.0
_READY_S = 6.0  # longest wait until the vehicle is ready; its streams are watched from then on
_FIRST_LOOK_S = 1.0  # time from the first ATTITUDE to the first check whether the vehicle is ready
_READY_BEFORE_S = 1.3  # a vehicle ready before this may have been ready before the first check
_FRESH_S = 1.8  # a vehicle whose first ATTITUDE is stamped no later than this has just started
_RATE_SLACK_SHARE = 0.06
_CLOCK_STEP_MS = 4
_MIN_PACE = 0.9  # limits of the pace of a vehicle in real time
_MAX_PACE = 1.1
# Positions of the diagonal in the upper triangle of a 6 x 6 matrix, row by row.
_DIAGONAL = (0, 6, 11, 15, 18, 20)
_RATES_HZ = {
    "ATTITUDE": 100.0,
    "HIGHRES_IMU": 50.0,
    "ATTITUDE_QUATERNION": 50.0,
    "GLOBAL_POSITION_INT": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "ODOMETRY": 30.0,
    "TIMESYNC": 10.0,
    "ALTITUDE": 10.0,
    "DISTANCE_SENSOR": 10.0,
    "ATTITUDE_TARGET": 10.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "VFR_HUD": 10.0,
    "GPS_RAW_INT": 8.0,
    "EXTENDED_SYS_STATE": 5.0,
    "SYS_STATUS": 5.0,
    "HEARTBEAT": 1.0,
    "ESTIMATOR_STATUS": 1.0,
    "OPEN_DRONE_ID_LOCATION": 1.0,
    "OPEN_DRONE_ID_SYSTEM": 1.0,
    "PING": 1.0,
    "SCALED_PRESSURE": 1.0,
    "SYSTEM_TIME": 1.0,
    "LINK_NODE_STATUS": 1.0,
    "MISSION_CURRENT": 1.0,
    "BATTERY_STATUS": 0.5,
    "CURRENT_MODE": 0.5,
    "HOME_POSITION": 0.5,
    "VIBRATION": 0.5,
    "TIME_ESTIMATE_TO_TARGET": 0.5,
    "CURRENT_EVENT_SEQUENCE": 0.3,
}
_EVENTS_ONLY = (
    "EVENT",
    "COMMAND_ACK",
    "PARAM_VALUE",
    "STATUSTEXT",
    "POSITION_TARGET_GLOBAL_INT",
    "GPS_GLOBAL_ORIGIN",
)


def _stream_name(message: str) -> str:
    return f"stream.{message.lower().replace('_', '-')}"


def _rate_fact(message: str, hz: float) -> Fact:
    # The tolerance is the larger of one message in the watched time and a share of the rate.
    slack = max(1.01 / _WATCH_S, _RATE_SLACK_SHARE * hz)
    return number(
        _stream_name(message), "4", f"{message} at {hz:g} Hz unasked", hz - slack, hz + slack, "Hz"
    )


BOOT = facts("streams", "boot")
STREAMS = tuple(_rate_fact(message, hz) for message, hz in _RATES_HZ.items())
MESSAGE_LAYOUT = facts("streams", "message_layout")
QUIRKS = facts("streams", "quirks")


def run(client: VehicleClient, report: FactReport) -> None:
    """Watch the vehicle without sending."""
    _boot(client, report)
    if not report.wants(
        "stream.*", "wire.*", "clock.*", "heartbeat.*", "pad.*", "quirk.*", "text.silent-alone"
    ):
        return

    if client.now_s < _READY_S:
        client.wait(_READY_S - client.now_s)
    since_s = client.now_s
    datagrams_before = client.received.datagrams
    octets_before = client.received.octets

    client.wait(_WATCH_S)
    until_s = client.now_s
    elapsed_s = until_s - since_s
    datagrams = client.received.datagrams - datagrams_before
    octets = client.received.octets - octets_before

    _streams(client, report, since_s, until_s)
    report.add("wire.datagrams", datagrams / elapsed_s)
    report.add("wire.bytes", octets / elapsed_s / 1e3)
    _message_layout(client, report, since_s)
    _quirks(client, report)
    _noise(client, report, since_s)


def _boot(client: VehicleClient, report: FactReport) -> None:
    """Report the times of PX4's first messages, if PX4 has just started."""
    received = client.received
    report.add("boot.unasked", "yes")  # the check has sent nothing so far

    other_facts = [fact for fact in BOOT if fact.name != "boot.unasked"]
    client.listen(1.5, lambda: received.newest("ATTITUDE") is not None)
    attitudes = received.of("ATTITUDE")
    if not attitudes:
        report.skip(other_facts, "no ATTITUDE tells its time")
        return

    clock_s = attitudes[0].message.time_boot_ms * 1e-3
    if clock_s > _FRESH_S:
        reason = f"it started {clock_s:.0f} s before: start it while the check already waits"
        report.skip(other_facts, reason)
        return
    report.add("boot.clock", clock_s)
    if not report.wants("boot.*"):
        return

    client.wait(_FIRST_LOOK_S)
    armable_s = NOT_MEASURED
    if client.wait(_READY_S, client.shows_ready):
        armable_s = client.now_s
        if armable_s < _READY_BEFORE_S:
            # The vehicle was ready before the first check. The time of its first SYS_STATUS is the
            # best estimate.
            armable_s = received.of("SYS_STATUS")[0].at_s
    client.wait(1.0)

    heartbeats = received.of("HEARTBEAT")
    first_status = "none"
    if heartbeats:
        first_status = STATUS.get(heartbeats[0].message.system_status, "?")
    fixes = [packet for packet in received.of("GPS_RAW_INT") if packet.message.fix_type >= 3]

    report.add("boot.heartbeat", first_s(heartbeats))
    report.add("boot.heartbeat-status", first_status)
    report.add("boot.gps", first_s(fixes))
    report.add("boot.home", first_s(received.of("HOME_POSITION")))
    report.add("boot.armable", armable_s)


def _streams(client: VehicleClient, report: FactReport, since_s: float, until_s: float) -> None:
    for message in _RATES_HZ:
        count = len(client.received.of(message, since_s, until_s))
        report.add(_stream_name(message), count / (until_s - since_s))

    other_messages: list[str] = []
    for message_id, packets in client.received.packets.items():
        is_recent = bool(packets) and packets[-1].at_s >= since_s
        is_known = NAMES.get(message_id) in (*_RATES_HZ, *_EVENTS_ONLY)
        if is_recent and not is_known:
            other_messages.append(NAMES.get(message_id, str(message_id)))
    report.add("wire.unasked-others", ", ".join(sorted(other_messages)) or "nothing")


def _message_layout(client: VehicleClient, report: FactReport, since_s: float) -> None:
    """Report the form of the messages of a PX4 that receives nothing, and their regularity.

    One of these facts is ``text.silent-alone``: such a PX4 sends no texts.

    Args:
        client: the client that has listened.
        report: the report to add the facts to.
        since_s: time from which messages count.
    """
    received = client.received
    version = "MAVLink 2"
    if received.v1_frames:
        version = f"{received.v1_frames} frames of MAVLink 1"
    report.add("wire.version", version)
    report.add("wire.messages-per-datagram", received.frames / max(1, received.datagrams))
    report.add("wire.checksums", _checksums(client))
    report.add("wire.component", str(received.of("HEARTBEAT")[-1].component_id))
    rc_packets = [*received.of("RC_CHANNELS"), *received.of("RC_CHANNELS_RAW")]
    if rc_packets:
        report.add("wire.no-rc", "streamed")
    else:
        report.add("wire.no-rc", "none")
    texts = len(received.of("STATUSTEXT"))
    report.add("text.silent-alone", count_or_none(texts, "texts"))

    _clock(client, report, since_s)
    _heartbeats(client, report, since_s)


def _clock(client: VehicleClient, report: FactReport, since_s: float) -> None:
    if _MIN_PACE < client.clock.pace < _MAX_PACE:
        report.add("clock.pace", client.clock.pace)
    else:
        pace = f"it runs at {client.clock.pace:.1f} times real time"
        report.skip([fact for fact in MESSAGE_LAYOUT if fact.name == "clock.pace"], pace)

    stamps_ms = [packet.message.time_boot_ms for packet in client.received.of("ATTITUDE", since_s)]
    gaps_ms = [after - before for before, after in itertools.pairwise(stamps_ms)]
    report.add("clock.gap-mean", mean(gaps_ms))

    whole_fraction = NOT_MEASURED
    if gaps_ms:
        whole_fraction = sum(map(_is_whole, gaps_ms)) / len(gaps_ms)
    report.add("clock.gap-steps", whole_fraction)


def _is_whole(gap_ms: int) -> bool:
    """Return whether a gap between stamps, rounded to a millisecond, is a whole number of steps."""
    remainder_ms = gap_ms % _CLOCK_STEP_MS
    off_ms = min(remainder_ms, _CLOCK_STEP_MS - remainder_ms)
    return off_ms <= 1 and gap_ms >= _CLOCK_STEP_MS - 1


def _heartbeats(client: VehicleClient, report: FactReport, since_s: float) -> None:
    beats_s = [packet.at_s for packet in client.received.of("HEARTBEAT", since_s)]
    intervals_s = [after_s - before_s for before_s, after_s in itertools.pairwise(beats_s)]
    if not intervals_s:
        report.add("heartbeat.interval-min", NOT_MEASURED)
        report.add("heartbeat.interval-max", NOT_MEASURED)
        return

    # The arrival is measured by the clock of this computer, so its error grows with the pace. The
    # slack moves an interval towards 1 s, which is right, but not beyond it.
    slack_s = 0.02 * max(0.0, client.clock.pace - 1.0)
    report.add("heartbeat.interval-min", min(1.0, min(intervals_s) + slack_s))
    report.add("heartbeat.interval-max", max(1.0, max(intervals_s) - slack_s))


def _checksums(client: VehicleClient) -> str:
    wrong = 0
    for message_id, packets in client.received.packets.items():
        if message_id not in common.mavlink_map:
            continue
        for packet in packets[:20]:
            try:
                _ = packet.message  # decodes the frame and checks its checksum
            except common.MAVError:
                wrong += 1

    if wrong:
        return f"{wrong} wrong"
    return "all right"


def _quirks(client: VehicleClient, report: FactReport) -> None:
    """Report details of the fields of messages."""

    def add_field(name: str, message: str, field: str) -> None:
        packet = client.received.newest(message)
        if packet is None:
            report.add(name, f"no {message}")
        else:
            report.add(name, str(getattr(packet.message, field)))

    beat = client.newest("HEARTBEAT")
    report.add("quirk.heartbeat", f"type {beat.type} autopilot {beat.autopilot}")
    report.add("pad.mode", MODES.get(beat.custom_mode, str(beat.custom_mode)))
    report.add("pad.base-mode", str(beat.base_mode))
    report.add("pad.status", client.status)
    report.add("pad.prearm-bit", client.prearm_bit)
    add_field("pad.landed", "EXTENDED_SYS_STATE", "landed_state")
    add_field("quirk.vtol-state", "EXTENDED_SYS_STATE", "vtol_state")
    add_field("quirk.odometry-estimator", "ODOMETRY", "estimator_type")
    add_field("quirk.odometry-quality", "ODOMETRY", "quality")
    add_field("quirk.battery-current", "BATTERY_STATUS", "current_battery")
    add_field("quirk.battery-temperature", "BATTERY_STATUS", "temperature")
    add_field("quirk.battery-consumed", "BATTERY_STATUS", "current_consumed")
    add_field("quirk.battery-charge-state", "BATTERY_STATUS", "charge_state")
    add_field("quirk.servo-disarmed", "SERVO_OUTPUT_RAW", "servo1_raw")
    add_field("quirk.attitude-target-mask", "ATTITUDE_TARGET", "type_mask")

    odometry = client.newest("ODOMETRY")
    battery = client.newest("BATTERY_STATUS")
    report.add("quirk.odometry-frames", f"{odometry.frame_id} and {odometry.child_frame_id}")
    off_diagonal = [
        value
        for position, value in enumerate(odometry.pose_covariance)
        if position not in _DIAGONAL
    ]
    covariance = "numbers"
    if all(map(math.isnan, off_diagonal)):
        covariance = "NaN"
    report.add("quirk.odometry-covariance", covariance)
    report.add("quirk.odometry-resets", float(odometry.reset_counter))

    report.add("quirk.battery-voltage", float(battery.voltages[0]))
    other_cells = sorted({str(value) for value in battery.voltages[1:]})
    report.add("quirk.battery-cells", ", ".join(other_cells))

    position = client.newest("GLOBAL_POSITION_INT")
    report.add("pad.latitude", position.lat * 1e-7)
    report.add("pad.longitude", position.lon * 1e-7)


def _noise(client: VehicleClient, report: FactReport, since_s: float) -> None:
    positions = [packet.message for packet in client.received.of("LOCAL_POSITION_NED", since_s)]
    attitudes = [packet.message for packet in client.received.of("ATTITUDE", since_s)]
    if len(positions) < 10 or len(attitudes) < 10:
        return

    report.add("pad.height", abs(mean(position.z for position in positions)))
    report.add("pad.position-noise", max(_spreads(positions, "x", "y", "z")))
    report.add("pad.velocity-noise", max(_spreads(positions, "vx", "vy", "vz")))

    tilt_spreads_deg = [math.degrees(rad) for rad in _spreads(attitudes, "roll", "pitch")]
    report.add("pad.attitude-noise", mean(tilt_spreads_deg))

    first_yaw = attitudes[0].yaw
    turned = [math.remainder(attitude.yaw - first_yaw, math.tau) for attitude in attitudes]
    report.add("pad.yaw-noise", math.degrees(statistics.pstdev(turned)))

    rate_spreads = _spreads(attitudes, "rollspeed", "pitchspeed")
    rate_spreads_deg_s = [math.degrees(rad_s) for rad_s in rate_spreads]
    report.add("pad.gyro-noise", mean(rate_spreads_deg_s))


def _spreads(messages: list[Any], *fields: str) -> list[float]:
    """Return the standard deviation of each field over the messages."""
    spreads: list[float] = []
    for field in fields:
        values = [getattr(message, field) for message in messages]
        spreads.append(statistics.pstdev(values))
    return spreads


FACT_GROUP = FactGroup(
    "streams on the pad", (*BOOT, *STREAMS, *MESSAGE_LAYOUT, *QUIRKS), run, turns_motors=False
)
