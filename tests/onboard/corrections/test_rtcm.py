from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyrtcm import RTCMReader

from onboard.corrections import rtcm
from onboard.corrections.fragments import MAX_BYTES, fragments_of
from onboard.corrections.relay.framing import FrameCutter
from tests.onboard.corrections.rtcm_frames import (
    STATION,
    ZURICH_DEG,
    ZURICH_HEIGHT_M,
    base_frame,
    ecef_frame,
    ecef_m,
    epoch,
    framed,
    observations,
    recording,
)


@pytest.mark.parametrize("number", [1005, 1006])
@pytest.mark.parametrize(
    ("latitude_deg", "longitude_deg", "height_m"),
    [(47.4, 8.5, 500.0), (-33.9, -70.6, 2800.0), (0.0, 180.0, -30.0), (89.9, 0.0, 0.0)],
)
def test_a_base_is_read_where_pyrtcm_reads_it(number, latitude_deg, longitude_deg, height_m):
    frame = base_frame((latitude_deg, longitude_deg), height_m, number=number)
    told = RTCMReader.parse(frame)

    base = rtcm.base_of(frame)

    assert base is not None
    assert base.station == told.DF003 == STATION
    assert base.ecef_m == pytest.approx((told.DF025, told.DF026, told.DF027), abs=1e-6)
    assert base.ecef_m == pytest.approx(ecef_m(latitude_deg, longitude_deg, height_m), abs=1e-3)
    latitude, longitude, height = base.latitude_longitude_height
    assert latitude == pytest.approx(latitude_deg, abs=1e-8)
    assert math.remainder(longitude - longitude_deg, 360.0) == pytest.approx(0.0, abs=1e-8)
    assert height == pytest.approx(height_m, abs=1e-3)


def test_observations_have_a_number_a_station_and_an_end_of_their_moment():
    first, second, last = epoch(3)

    assert [rtcm.number_of(frame) for frame in (first, second, last)] == [1077, 1087, 1097]
    assert rtcm.station_of(last) == STATION
    assert rtcm.is_observation(1077)
    assert not rtcm.is_observation(1005)
    assert [rtcm.ends_epoch(frame) for frame in (first, second, last)] == [False, False, True]


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xd3\x00\x00",
        b"\xd3\x00\x01\x3e\x00\x00\x00",  # shorter than a number
        b"\xd2" + base_frame()[1:],
        b"\xd3\xfc" + base_frame()[2:],  # reserved bits
        base_frame()[:-1],
        base_frame() + b"\0",
    ],
)
def test_what_is_no_whole_frame_is_none(data):
    assert not rtcm.is_frame(data)


@given(message=st.binary(min_size=2, max_size=60), number=st.integers(0, 4095))
@settings(max_examples=15, deadline=None)
def test_no_message_of_a_right_frame_makes_the_readers_fail(message, number):
    head = (number << 4 | message[1] & 0xF).to_bytes(2, "big")
    frame = framed(head + message[2:])

    assert rtcm.is_frame(frame)
    assert rtcm.number_of(frame) == number
    rtcm.station_of(frame)
    rtcm.ends_epoch(frame)
    base = rtcm.base_of(frame)
    assert base is None or math.isfinite(sum(base.latitude_longitude_height))


def test_a_base_that_does_not_know_its_place_is_not_on_earth():
    nowhere = rtcm.base_of(ecef_frame((0.0, 0.0, 0.0)))
    somewhere = rtcm.base_of(base_frame())

    assert nowhere is not None
    assert not nowhere.is_on_earth
    assert somewhere is not None
    assert somewhere.is_on_earth
    assert somewhere.latitude_longitude_height[:2] == pytest.approx(ZURICH_DEG, abs=1e-8)
    assert somewhere.latitude_longitude_height[2] == pytest.approx(ZURICH_HEIGHT_M, abs=1e-3)


@pytest.mark.parametrize("piece_bytes", [1, 7, 64, 5000])
def test_frames_come_out_of_a_stream_however_it_is_cut(piece_bytes):
    frames = [base_frame(), *epoch(0), *epoch(1)]
    stream = b"".join(frames)
    cutter = FrameCutter()

    found = []
    for begin in range(0, len(stream), piece_bytes):
        found += cutter.feed(stream[begin : begin + piece_bytes])

    assert found == frames
    assert (cutter.bad_checksums, cutter.skipped_bytes) == (0, 0)


def test_frames_behind_noise_lost_bytes_and_false_preambles_are_found():
    good = [base_frame(), observations(size=200), observations(1087, size=90)]
    damaged = bytearray(observations(size=150))
    damaged[40] ^= 0x10
    # a preamble whose length reaches over everything that follows
    false_start = b"\xd3\x03\xff"
    stream = b"$GPGGA,noise\r\n" + false_start + good[0] + bytes(damaged) + good[1] + good[1][:50]
    cutter = FrameCutter()

    # so much behind it that the false frame is complete
    found = cutter.feed(stream + good[2] + 1100 * b"\0")

    assert found == good
    assert cutter.bad_checksums >= 2


def test_each_flipped_bit_of_a_frame_is_found_out():
    frame = base_frame()
    for bit in range(8 * len(frame)):
        flipped = bytearray(frame)
        flipped[bit // 8] ^= 1 << bit % 8
        assert FrameCutter().feed(bytes(flipped) + 1100 * b"\0") == []


@pytest.mark.parametrize("kind", ["noise", "preambles"])
def test_ten_kilobytes_of_garbage_lead_to_few_checks_of_checksums(kind):
    noise = random.Random(1).randbytes(10_000)
    garbage = {"noise": noise, "preambles": b"\xd3\x03\xff" * 3333}[kind]
    cutter = FrameCutter()

    found = []
    for begin in range(0, 10_000, 100):
        found += cutter.feed(garbage[begin : begin + 100])

    assert found == []
    # a check of a kilobyte takes a millisecond, and without a limit there would be 3000 of them
    assert cutter.bad_checksums < 100
    assert cutter.feed(2000 * b"\0" + base_frame()) == [base_frame()]


@pytest.mark.parametrize(
    ("size", "lengths"),
    [
        (25, [25]),
        (180, [180]),
        (181, [180, 1]),
        (360, [180, 180, 0]),
        (540, [180, 180, 180, 0]),
        (700, [180, 180, 180, 160]),
        (720, [180, 180, 180, 180]),
    ],
)
def test_a_frame_is_cut_so_that_its_end_is_known(size, lengths):
    frame = observations(size=size - 6)
    assert len(frame) == size <= MAX_BYTES

    fragments = fragments_of(frame, sequence=37)

    assert [len(fragment.data) for fragment in fragments] == lengths
    assert b"".join(fragment.data for fragment in fragments) == frame
    for number, fragment in enumerate(fragments):
        is_cut = len(fragments) > 1
        assert fragment.flags & 1 == is_cut
        assert fragment.flags >> 1 & 3 == number
        assert fragment.flags >> 3 == 37 % 32


def test_a_recording_has_the_base_every_five_seconds():
    frames = FrameCutter().feed(recording(10))
    assert [rtcm.number_of(frame) for frame in frames].count(1005) == 2
