"""Fragments of corrections on the wire: packed by the agent, read by pymavlink and the emulator."""

from __future__ import annotations

import os

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.corrections.fragments import FRAGMENT_BYTES, fragments_of
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.packets import SENT, packed
from tests.onboard.corrections.rtcm_frames import base_frame, observations
from tests.sitl.sitl_flying import Client, emulator


def on_the_wire(flags: int, data: bytes) -> bytes:
    """The packet that the agent's link sends."""
    link = Px4Link("udpin://127.0.0.1:0", 1)
    sent: list[bytes] = []
    link._relay.send = lambda number, payload: sent.append(packed(number, payload, 3, 1, 191))  # type: ignore[method-assign]
    link.send_corrections(flags, data)
    assert len(sent) == 1
    return sent[0]


@pytest.mark.parametrize("size", [19, 174, 354, 500, 714])
def test_pymavlink_reads_what_the_agent_writes(size: int):
    frame = observations(size=size)
    parser = mavlink.MAVLink(None)
    given = b""
    for fragment in fragments_of(frame, 11):
        message = parser.parse_buffer(bytearray(on_the_wire(fragment.flags, fragment.data)))[0]
        assert message.get_type() == "GPS_RTCM_DATA"
        assert message.flags == fragment.flags
        assert message.len == len(fragment.data)
        given += bytes(message.data[: message.len])
    assert given == frame
    assert SENT["GPS_RTCM_DATA"].layout.size == 2 + FRAGMENT_BYTES


def test_the_emulated_px4_hands_them_to_its_receiver_whatever_else_comes():
    emu = emulator()
    client = Client(emu)
    receiver = emu.receivers[0]
    for sequence, frame in enumerate((base_frame(), observations(size=500))):
        for fragment in fragments_of(frame, sequence):
            client.link.receive(on_the_wire(fragment.flags, fragment.data))
    assert (receiver.frames, receiver.bad_frames) == (2, 0)

    # a length beyond what a message can hold, and fragments of nothing
    for flags, length in ((0, 255), (7, 0), (255, 180), (1, 0)):
        message = mavlink.MAVLink(None, 255, 190).gps_rtcm_data_encode(flags, length, [0xD3] * 180)
        client.link.receive(message.pack(mavlink.MAVLink(None, 255, 190)))
    assert receiver.frames == 2
