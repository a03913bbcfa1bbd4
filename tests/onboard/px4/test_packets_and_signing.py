"""Packets and signatures, against pymavlink's own."""

from __future__ import annotations

import os
import random
import re

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from onboard.px4 import packets
from onboard.px4.packets import READ, SENT, Packet, Remainder, cut, cut_stream, fields_of, packed
from onboard.px4.signing import SignatureVerdict, Signer
from onboard.security.mavlink_key import signing_time

KEY = bytes(range(1, 33))
OTHER_KEY = bytes(range(2, 34))
NOW = signing_time(1_790_000_000 * 10**9)
MINUTE = 60 * 100_000


def theirs(key: bytes | None = KEY, stamp: int = NOW, link_id: int = 1) -> mavlink.MAVLink:
    """pymavlink's end, as PX4."""
    end = mavlink.MAVLink(None, 3, 1)
    if key is not None:
        end.signing.secret_key = key
        end.signing.sign_outgoing = True
        end.signing.timestamp = stamp
        end.signing.link_id = link_id
    return end


def heartbeat(end: mavlink.MAVLink) -> Packet:
    (packet,) = cut(bytes(mavlink.MAVLink_heartbeat_message(2, 12, 81, 50593792, 3, 3).pack(end)))
    assert isinstance(packet, Packet)
    return packet


def ours(signer: Signer, clock: int = NOW) -> bytes:
    payload = SENT["COMMAND_LONG"].layout.pack(*(1.0,) * 7, 400, 3, 1, 0)
    return signer.sign(packed(76, payload, 5, 3, 191, is_signed=True), clock)


def codes(layout: str) -> str:
    """A struct's format with each number for itself; text is as many bytes."""
    return re.sub(r"(\d+)([a-zA-Z])", lambda m: m[2].replace("s", "B") * int(m[1]), layout)


def test_layouts_and_checksums_are_those_of_mavlink() -> None:
    for name, message in (READ | SENT).items():
        known = mavlink.mavlink_map[message.number]
        assert (known.msgname, known.crc_extra) == (name, message.checksum_seed)
        assert codes(known.unpacker.format).startswith(codes(message.layout.format)), name
        counts = zip(known.ordered_fieldnames, known.array_lengths, strict=True)
        places = [
            field
            for field, count in counts
            for _ in range(max(1, count if known.unpacker.format.find("s") < 0 else 1))
        ]
        for field, place, _ in message.fields:
            assert places[place] == field, name
    for number, seed in (packets.MAVSDK_READS | packets.MAVSDK_SENDS).items():
        assert mavlink.mavlink_map[number].crc_extra == seed


def test_pymavlink_reads_what_is_written_and_what_it_writes_is_read() -> None:
    values = SENT["SET_ATTITUDE_TARGET"].layout.pack(
        7, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 3, 1, 7
    )
    (read,) = mavlink.MAVLink(None).parse_buffer(bytearray(packed(82, values, 255, 3, 191)))
    assert (read.time_boot_ms, read.q, read.thrust, read.target_system, read.type_mask) == (
        7,
        [1, 0, 0, 0],
        0.5,
        3,
        7,
    )
    battery = mavlink.MAVLink_battery_status_message(
        1, 0, 0, 25, [16000] + [65535] * 9, -1, 3, -1, 77
    )
    (packet,) = cut(bytes(battery.pack(mavlink.MAVLink(None, 3, 1))))
    assert isinstance(packet, Packet)
    assert packet.has_right_checksum
    fields = fields_of("BATTERY_STATUS", packet.payload)
    assert (fields["voltages"][:2], fields["battery_remaining"]) == ((16000, 65535), 77)
    old = mavlink.MAVLink_attitude_quaternion_message(9, 1.0, 0.0, 0.0, 0.0, 0, 0, 0)
    (packet,) = cut(bytes(old.pack(mavlink.MAVLink(None, 3, 1), force_mavlink1=True)))
    assert isinstance(packet, Packet)
    assert (
        packet.has_right_checksum,
        packet.system_id,
        fields_of("ATTITUDE_QUATERNION", packet.payload)["time_boot_ms"],
    ) == (
        True,
        3,
        9,
    )


def test_no_bytes_stop_the_cutting_and_no_flipped_bit_passes() -> None:
    draw = random.Random(1)
    good = ours(Signer(KEY, 10))
    for _ in range(3000):
        data = (
            bytearray(good)
            if draw.random() < 0.7
            else bytearray(draw.randbytes(draw.randrange(1, 300)))
        )
        for _ in range(draw.randrange(3)):
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        for packet in cut(bytes(data)):
            if isinstance(packet, Packet) and packet.data != good:
                verdict = Signer(KEY, 10).check(packet, NOW)
                assert verdict is not SignatureVerdict.FRESH
            elif isinstance(packet, Remainder):
                assert packet.data


@pytest.mark.parametrize("magic", [0xFD, 0xFE])
@pytest.mark.parametrize("index", range(6))
@pytest.mark.parametrize(
    "junk",
    [b"", b"\xfd", b"\xfd\x09noise\xfe\x03", bytes(range(256))],
    ids=["none", "magic", "noise", "all"],
)
def test_no_packet_of_a_stream_is_lost_to_bytes_that_look_like_the_start_of_one(
    junk: bytes, index: int, magic: int
) -> None:
    """A byte of the timestamp looks so in every packet, the fourth one for 168 s every 12 hours."""
    stamp = bytearray(NOW.to_bytes(6, "little"))
    stamp[index] = magic
    end = theirs(stamp=int.from_bytes(stamp, "little"))
    beats = [
        bytes(mavlink.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3).pack(end)) for _ in range(20)
    ]
    unread = bytes(mavlink.MAVLink_altitude_message(1, *(0.5,) * 6).pack(end))
    data = junk + unread.join(beats)

    for piece_bytes in (1, 7, len(data)):
        begun = b""
        found = []
        for start in range(0, len(data), piece_bytes):
            pieces = list(cut_stream(begun + data[start : start + piece_bytes]))
            begun = b""
            if pieces and isinstance(pieces[-1], Remainder) and not pieces[-1].is_junk:
                begun = pieces.pop().data
            found += [piece.data for piece in pieces if isinstance(piece, Packet)]
        assert [packet for packet in found if packet in beats] == beats


@pytest.mark.parametrize("piece_bytes", [1, 16, 1000])
def test_a_lost_byte_of_a_stream_costs_a_packet_or_two(piece_bytes: int) -> None:
    """Of a kind that is not known, only the next packet shows whether it was one."""
    stamp = bytearray(NOW.to_bytes(6, "little"))
    stamp[3] = 0xFE
    end = theirs(stamp=int.from_bytes(stamp, "little"))
    draw = random.Random(5)
    intact = []
    stream = bytearray()
    lost_count = 0
    for n in range(1500):
        unread = mavlink.MAVLink_altitude_message(n, *(0.5,) * 6)
        beat = mavlink.MAVLink_heartbeat_message(2, 12, 81, n, 3, 3)
        packet = bytearray((beat if draw.random() < 0.5 else unread).pack(end))
        if draw.random() < 0.02:
            del packet[draw.randrange(len(packet))]
            lost_count += 1
        elif packet[7] == 0:  # a heartbeat
            intact.append(bytes(packet))
        stream += packet

    begun = b""
    found = set()
    for start in range(0, len(stream), piece_bytes):
        pieces = list(cut_stream(begun + bytes(stream[start : start + piece_bytes])))
        begun = b""
        if pieces and isinstance(pieces[-1], Remainder) and not pieces[-1].is_junk:
            begun = pieces.pop().data
        found |= {piece.data for piece in pieces if isinstance(piece, Packet)}
    assert len(set(intact) - found) <= lost_count


def test_signatures_are_those_of_mavlink_in_both_directions() -> None:
    end = theirs()
    signer = Signer(KEY, 10)
    assert signer.check(heartbeat(end), NOW) is SignatureVerdict.FRESH
    (read,) = end.parse_buffer(bytearray(ours(signer)))
    assert (read.get_signed(), read.command) == (True, 400)
    with pytest.raises(mavlink.MAVError, match="Invalid signature"):
        theirs(OTHER_KEY).parse_buffer(bytearray(ours(signer)))


def test_what_is_unsigned_forged_replayed_or_from_an_old_clock_is_refused() -> None:
    signer = Signer(KEY, 10)
    assert signer.check(heartbeat(theirs(None)), NOW) is SignatureVerdict.UNSIGNED
    assert signer.check(heartbeat(theirs(OTHER_KEY)), NOW) is SignatureVerdict.FORGED
    assert signer.check(heartbeat(theirs(stamp=NOW - MINUTE - 1)), NOW) is SignatureVerdict.OLD
    first = heartbeat(theirs(stamp=NOW - MINUTE + 1))
    assert [signer.check(first, NOW) for _ in range(2)] == [
        SignatureVerdict.FRESH,
        SignatureVerdict.OLD,
    ]
    assert signer.check(heartbeat(theirs(stamp=NOW - MINUTE)), NOW) is SignatureVerdict.OLD
    assert signer.check(heartbeat(theirs(stamp=NOW - MINUTE + 2)), NOW) is SignatureVerdict.FRESH
    assert signer.check(heartbeat(theirs(stamp=NOW, link_id=2)), NOW) is SignatureVerdict.FRESH
    assert not signer.has_wrong_clock


def stamp_of(data: bytes) -> int:
    return int.from_bytes(data[-12:-6], "little")


def test_timestamps_never_go_back_and_a_clock_that_is_years_behind_goes_on_from_px4s() -> None:
    signer = Signer(KEY, 10)
    stamps = [stamp_of(ours(signer, clock)) for clock in (NOW, NOW, NOW - MINUTE, NOW + 7)]
    assert stamps == [NOW, NOW + 1, NOW + 2, NOW + 7]
    restarted = Signer(KEY, 10)  # on a computer that thinks that it is years ago
    assert restarted.check(heartbeat(theirs(stamp=NOW + 9)), 1000) is SignatureVerdict.FRESH
    assert restarted.has_wrong_clock
    assert stamp_of(ours(restarted, 2000)) > NOW + 9
