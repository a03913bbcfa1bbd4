"""Computes a fleet's share of a radio channel's time, and the finding about it. Pure.

For small packets, the number of packets fills a channel, not the number of bits, because waiting,
preamble and acknowledgement take most of an 802.11 frame's time. Therefore stations of 802.11n and
later send all packets that wait for one receiver in one aggregate.

The time of a frame follows the distributed coordination function without collisions: DIFS, half of
the first contention window, the frame, SIFS and the acknowledgement. For 802.11b, this gives the
throughputs that Cisco publishes for its wireless phones ("Maximum Throughput Calculations for
802.11b WLAN", table I-2). The values for OFDM are those of IEEE 802.11: slot 9 us, SIFS 16 us,
symbols of 4 us, preamble and header 36 us in 802.11n, and 20 us in an acknowledgement.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from onboard.bus.topics import TOPICS, Topic
from onboard.config.fleet import FleetConfig
from onboard.config.radio import RadioConfig
from onboard.feasibility.finding import Finding, at_most

# sizes of encoded messages of the bus
STATE_BYTES = 270
POSE_BYTES = 110
TELEMETRY_BYTES = 450
CLOCK_BYTES = 60

# a batch of ten ticks is sent in this number of packets of this size
TICK_PACKETS = 5
TICK_BYTES = 1200

OVERHEAD_BYTES = 130  # of IP, UDP, QUIC and Zenoh, and of the frame beyond its first 28 bytes
MAX_IN_TURN = 32  # largest number of packets in one aggregate

# sizes of IEEE 802.11
_MAC_BYTES = 28
_ACK_BYTES = 14
_DELIMITER_BYTES = 6  # between two packets of an aggregate

_MAX_BYTES = 1400  # largest size of one packet


class Phy(NamedTuple):
    """Times of a physical layer [us]."""

    slot_us: float
    sifs_us: float
    header_us: float  # preamble and header, before the first bit of data
    ack_header_us: float  # preamble and header of an acknowledgement
    symbol_us: float  # duration of a symbol, as data take whole symbols; 0: they take single bits
    extra_bits: float  # service and tail bits of a frame
    backoff_slots: float  # mean backoff: half of the first contention window
    ack_rates_mbit_s: tuple[float, ...]  # possible rates of acknowledgements; empty: the frame's


# 802.11n
OFDM = Phy(
    slot_us=9.0,
    sifs_us=16.0,
    header_us=36.0,
    ack_header_us=20.0,
    symbol_us=4.0,
    extra_bits=22.0,
    backoff_slots=7.5,
    ack_rates_mbit_s=(6.0, 12.0, 24.0),
)

# 802.11b with short preambles
DSSS_SHORT = Phy(
    slot_us=20.0,
    sifs_us=10.0,
    header_us=96.0,
    ack_header_us=96.0,
    symbol_us=0.0,
    extra_bits=0.0,
    backoff_slots=16.0,
    ack_rates_mbit_s=(),
)


def frame_s(packet_bytes: float, rate_mbit_s: float, phy: Phy = OFDM) -> float:
    """Return how long [s] one packet and its acknowledgement keep a channel busy.

    Args:
        packet_bytes: size of the packet, with the headers of all layers above 802.11.
        rate_mbit_s: rate of the data.
        phy: times of the physical layer.
    """
    # a receiver acknowledges at the fastest basic rate that is not faster than the frame's
    possible_rates = [rate for rate in phy.ack_rates_mbit_s if rate <= rate_mbit_s]
    ack_mbit_s = max(possible_rates, default=rate_mbit_s)

    # DIFS, which is SIFS and two slots, then the backoff
    waiting_us = phy.sifs_us + 2.0 * phy.slot_us + phy.backoff_slots * phy.slot_us
    frame_us = phy.header_us + _data_us(packet_bytes + _MAC_BYTES, rate_mbit_s, phy)
    ack_us = phy.ack_header_us + _data_us(_ACK_BYTES, ack_mbit_s, phy)

    return 1e-6 * (waiting_us + frame_us + phy.sifs_us + ack_us)


def _data_us(frame_bytes: float, rate_mbit_s: float, phy: Phy) -> float:
    """Return the time [us] of the data of one frame."""
    data_us = (phy.extra_bits + 8.0 * frame_bytes) / rate_mbit_s
    if phy.symbol_us > 0.0:
        data_us = phy.symbol_us * math.ceil(data_us / phy.symbol_us - 1e-9)
    return data_us


def turn_s(packets: int, size_bytes: float, rate_mbit_s: float, phy: Phy = OFDM) -> float:
    """Return the time [s] of one aggregate for one receiver, and its acknowledgement.

    Args:
        packets: number of packets in the aggregate.
        size_bytes: size of all of them, with the headers of all layers above 802.11.
        rate_mbit_s: rate of the data.
        phy: times of the physical layer.
    """
    # frame_s adds the header of the first packet
    further_headers_bytes = (packets - 1) * (_MAC_BYTES + _DELIMITER_BYTES)
    return frame_s(size_bytes + further_headers_bytes, rate_mbit_s, phy)


def message_packets(message_bytes: int) -> int:
    """Return the number of packets of a message of the bus.

    Args:
        message_bytes: size of the encoded message.
    """
    return max(1, math.ceil(message_bytes / _MAX_BYTES))


class Flow(NamedTuple):
    """Packets of one kind, from or to one vehicle."""

    what: str  # the kind in words
    packets_1_s: float
    message_bytes: int  # size of the message in each packet
    # True: to other vehicles; False: between a vehicle and the wired side of an access point
    is_to_vehicles: bool


def flows(count: int, near: int, states_hz: float, has_mocap: bool) -> list[Flow]:
    """Return the packets of one vehicle's radio: those it sends, and the poses that it receives.

    Args:
        count: number of vehicles of the fleet.
        near: number of neighbours that receive its states at full rate.
        states_hz: the full rate.
        has_mocap: whether poses come over the radio.
    """
    rate_hz = {topic: spec.rate_hz for topic, spec in TOPICS.items()}
    others = count - 1
    far = others - near

    own_poses_1_s = 0.0
    all_poses_1_s = 0.0
    if has_mocap:
        own_poses_1_s = rate_hz[Topic.MOCAP]
        all_poses_1_s = rate_hz[Topic.ALL_POSES]

    to_vehicles = [
        Flow("states to near vehicles", near * states_hz, STATE_BYTES, is_to_vehicles=True),
        Flow("states to far vehicles", far * rate_hz[Topic.FAR], STATE_BYTES, is_to_vehicles=True),
        Flow(
            "telemetry to vehicles",
            others * rate_hz[Topic.SLOW_TELEMETRY],
            TELEMETRY_BYTES,
            is_to_vehicles=True,
        ),
        Flow("clock to vehicles", others * rate_hz[Topic.CLOCK], CLOCK_BYTES, is_to_vehicles=True),
    ]
    with_the_ground = [
        Flow("states to the record", states_hz, STATE_BYTES, is_to_vehicles=False),
        Flow(
            "ticks to the record",
            TICK_PACKETS * rate_hz[Topic.TICK],
            TICK_BYTES,
            is_to_vehicles=False,
        ),
        Flow(
            "telemetry to the ground",
            rate_hz[Topic.TELEMETRY],
            TELEMETRY_BYTES,
            is_to_vehicles=False,
        ),
        Flow("own poses", own_poses_1_s, POSE_BYTES, is_to_vehicles=False),
        Flow("poses of all", all_poses_1_s, count * POSE_BYTES, is_to_vehicles=False),
    ]
    return to_vehicles + with_the_ground


def airtime_finding(fleet: FleetConfig, radio: RadioConfig, near: int) -> Finding:
    """Check whether one channel can carry the whole fleet.

    Each state that a vehicle publishes takes aggregates ("turns"). With an access point it takes
    two: one to the access point, and one from it. With direct links it takes one for each receiver.
    Each pose takes a turn, too. All other messages travel in the same aggregates.

    Args:
        fleet: the fleet file; at least two vehicles.
        radio: the channel.
        near: number of neighbours that each vehicle follows at full rate.
    Returns:
        The finding: a warning beyond ``usable_frac`` of the channel's time, and a refusal beyond
        all of it.
    """
    names = fleet.enabled_names
    count = len(names)

    if radio.link == "access point":
        hops_between_vehicles = 2
        turns_for_a_state = 2
        link_words = "an access point"
        twice_words = ", which sends what goes between vehicles twice,"
    else:
        hops_between_vehicles = 1
        turns_for_a_state = near
        link_words = "direct links"
        twice_words = ""

    packets_1_s = 0.0
    bits_1_s = 0.0
    turns_1_s = 0.0
    for name in names:
        has_mocap = fleet.vehicles[name].mocap_required and not fleet.mocap.direct

        for flow in flows(count, near, radio.states_hz, has_mocap):
            hops = 1
            if flow.is_to_vehicles:
                hops = hops_between_vehicles
            frames_1_s = flow.packets_1_s * hops

            packets_1_s += flow.packets_1_s
            bits_1_s += frames_1_s * 8.0 * (flow.message_bytes + OVERHEAD_BYTES)

        poses_1_s = 0.0
        if has_mocap:
            poses_1_s = TOPICS[Topic.MOCAP].rate_hz
        turns_1_s += turns_for_a_state * radio.states_hz + poses_1_s

    # a turn takes the time of an empty frame plus the time of its bits
    busy_frac = turns_1_s * frame_s(0.0, radio.rate_mbit_s) + bits_1_s * 1e-6 / radio.rate_mbit_s

    return at_most(
        name="airtime",
        value=100.0 * busy_frac,
        bound=100.0 * radio.usable_frac,
        unit="%",
        sentence=(
            f"The radio carries up to {packets_1_s / count:.0f} packets/s for each vehicle (states "
            f"at {radio.states_hz} Hz to {near} near ones, the record included), "
            f"{packets_1_s:.0f} in all. Over {link_words} at {radio.rate_mbit_s:g} Mbit/s"
            f"{twice_words} they "
            "take <value> of one channel's time, of which the fleet may take <bound>"
        ),
        remedy=(
            "Lower [radio] states_hz or law.max_neighbours, stand farther apart, use a faster "
            "radio ([radio] rate_mbit_s), or spread the fleet over several channels. States are up "
            "to 0.1 s old on a channel so full: declare it ([radio] expected_delay_s = 0.1). See "
            "docs/network.md."
        ),
        refuse_above=100.0,
    )
