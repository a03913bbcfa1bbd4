"""The emulator's MAVLink: bytes, acknowledgements, parameters, rates, texts, and nonsense."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import common

from onboard.px4.message_parsers import PARSERS
from sitl.mavlink.codec import LAYOUTS, Decoder, Encoder
from sitl.mavlink.streams import BUILDERS, ONBOARD_RATES_HZ
from sitl.mavlink.view import View
from sitl.px4.modes import Mode
from sitl.px4.parameters import HASH_CHECK
from tests.sitl.sitl_flying import Client, emulator, run_for

ACCEPTED = 0
REJECTED = 1
UNSUPPORTED = 3
FAILED = 4
# Every message that the emulator does something with.
HANDLED = (
    *(
        0,
        4,
        11,
        20,
        21,
        23,
        40,
        43,
        44,
        45,
        48,
        51,
        69,
        75,
        76,
        82,
        84,
        86,
        102,
        110,
        111,
        117,
        233,
        331,
        412,
    ),
    *(75, 76, 82, 84, 86),  # most of all these
)


def packed_by_pymavlink(ours: bytes) -> bytes | None:
    """The same message, decoded and packed anew by pymavlink."""
    theirs = common.MAVLink(None, srcSystem=1, srcComponent=1).parse_buffer(bytearray(ours))
    if theirs is None:
        return None
    again = common.MAVLink(None, srcSystem=1, srcComponent=1)
    again.seq = ours[4]
    return bytes(theirs[0].pack(again))


def test_streamed_messages_are_byte_for_byte_those_of_pymavlink() -> None:
    emu = emulator()
    run_for(emu, 3.0)
    encoder = Encoder(1, sequence=7)
    view = View(emu, 0)
    emu.autopilots[0].request(emu.time_s, Mode.TAKEOFF)
    for message_id in sorted(set(BUILDERS) & set(common.mavlink_map)):
        values = BUILDERS[message_id](view)
        if values is not None:
            ours = encoder.encode(message_id, *values)
            assert packed_by_pymavlink(ours) == ours, LAYOUTS[message_id].name


def test_messages_of_any_numbers_are_byte_for_byte_those_of_pymavlink() -> None:
    encoder = Encoder(1, sequence=7)
    for message_id in sorted(set(BUILDERS) & set(common.mavlink_map)):
        layout = LAYOUTS[message_id]
        rng = random.Random(message_id)
        size = layout.packer.size
        for _ in range(50):
            # Zeros at the end now and then. A float that is not a number has no one byte pattern.
            raw = rng.randbytes(size)[: rng.randrange(size + 1)].ljust(size, b"\0")
            drawn = [
                0.5 if isinstance(value, float) and math.isnan(value) else value
                for value in layout.packer.unpack(raw)
            ]
            ours = encoder.encode(message_id, *drawn)
            assert packed_by_pymavlink(ours) == ours, layout.name


def test_messages_that_pymavlink_lacks_have_the_checksum_seeds_that_mavlink_publishes() -> None:
    published = {8: 117, 300: 217, 380: 232, 410: 160, 411: 106, 412: 33, 413: 77, 436: 193}
    assert {number: LAYOUTS[number].crc_extra for number in published} == published
    assert not set(published) & set(common.mavlink_map)


def test_decoding_gives_what_pymavlink_encoded_in_both_versions() -> None:
    reference = common.MAVLink(None, srcSystem=9, srcComponent=8)
    message = common.MAVLink_set_attitude_target_message(
        5, 1, 1, 7, [1.0, 0.5, 0.0, 0.0], 0.0, 0.0, 0.0, 0.25
    )
    for force_v1 in (False, True):
        (decoded,) = Decoder().decode(bytes(message.pack(reference, force_mavlink1=force_v1)))
        assert (decoded.name, decoded.system_id, decoded.component_id) == (
            "SET_ATTITUDE_TARGET",
            9,
            8,
        )
        assert decoded.fields["q"] == [1.0, 0.5, 0.0, 0.0]
        assert decoded.fields["thrust"] == 0.25


def test_default_rates_are_those_of_the_companion_link() -> None:
    emu = emulator(px4="1.18")
    client = Client(emu)
    client.collect(5.0)
    seen = [message.message_id for message in client.collect(10.0)]
    # on change, and while PX4 flies by itself
    unsaid = {"GPS_GLOBAL_ORIGIN", "POSITION_TARGET_GLOBAL_INT"}
    for message_id, rate_hz in ONBOARD_RATES_HZ.items():
        if LAYOUTS[message_id].name in unsaid:
            continue
        assert seen.count(message_id) == pytest.approx(
            10.0 * rate_hz, abs=1.0 + 0.02 * 10.0 * rate_hz
        )


def test_a_mode_command_gets_two_answers_and_the_second_is_the_truth() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    assert client.command(176, 1, 6) == [ACCEPTED, ACCEPTED]
    assert client.command(176, 1, 4, 3) == [ACCEPTED, ACCEPTED]
    assert client.command(400, 1) == [ACCEPTED]
    assert client.command(176, 1, 6) == [ACCEPTED, REJECTED]
    assert emu.autopilots[0].mode is Mode.LOITER


def test_answers_go_to_the_sender_and_unknown_commands_are_unsupported() -> None:
    client = Client(emulator())
    (ack,) = client.send(
        "COMMAND_LONG", command=31000, target_system=1, param1=math.nan, param2=math.nan
    )
    assert ack.fields["result"] == UNSUPPORTED
    assert (ack.fields["target_system"], ack.fields["target_component"]) == (245, 190)


def test_messages_for_another_system_are_met_with_silence() -> None:
    emu = emulator()
    client = Client(emu)
    assert client.send("COMMAND_LONG", command=400, target_system=7, param1=1.0) == []
    client.send("SET_ATTITUDE_TARGET", q=[1.0, 0.0, 0.0, 0.0], target_system=7, type_mask=7)
    assert emu.autopilots[0].setpoint is None


def test_a_force_disarm_over_mavlink_stops_the_motors_at_once() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    assert client.command(400, 1) == [ACCEPTED]
    assert client.command(400, 0, 21196) == [ACCEPTED]
    assert not emu.autopilots[0].is_armed


def test_parameters_are_read_set_and_listed() -> None:
    emu = emulator()
    client = Client(emu)
    (value,) = client.send(
        "PARAM_REQUEST_READ", param_id=b"COM_OF_LOSS_T", param_index=-1, target_system=1
    )
    assert value.fields["param_value"] == 1.0
    (value,) = client.send(
        "PARAM_SET", param_id=b"COM_OF_LOSS_T", param_value=0.3, param_type=9, target_system=1
    )
    assert value.fields["param_value"] == pytest.approx(0.3)
    assert emu.autopilots[0].params["COM_OF_LOSS_T"] == pytest.approx(0.3)
    client.send("PARAM_REQUEST_LIST", target_system=1)
    listed = [
        m.fields["param_id"].rstrip(b"\0") for m in client.collect(1.0) if m.name == "PARAM_VALUE"
    ]
    assert listed == [name.encode() for name in (HASH_CHECK, *emu.autopilots[0].params.names())]


def test_integer_parameters_travel_bytewise() -> None:
    emu = emulator()
    client = Client(emu)
    wire = struct.unpack("<f", struct.pack("<i", 4))[0]
    (value,) = client.send(
        "PARAM_SET", param_id=b"COM_OBL_RC_ACT", param_value=wire, param_type=6, target_system=1
    )
    assert value.fields["param_value"] == wire
    assert emu.autopilots[0].params["COM_OBL_RC_ACT"] == 4


def test_unknown_parameters_get_no_value() -> None:
    client = Client(emulator())
    assert (
        client.send(
            "PARAM_REQUEST_READ", param_id=b"NO_SUCH_PARAM", param_index=-1, target_system=1
        )
        == []
    )
    assert (
        client.send(
            "PARAM_SET", param_id=b"NO_SUCH_PARAM", param_value=1.0, param_type=9, target_system=1
        )
        == []
    )


def test_v1_18_says_of_a_parameter_that_it_does_not_exist() -> None:
    client = Client(emulator(px4="1.18"))
    asked = client.send(
        "PARAM_REQUEST_READ", param_id=b"NO_SUCH_PARAM", param_index=-1, target_system=1
    )
    to_be_set = client.send(
        "PARAM_SET", param_id=b"NO_SUCH_PARAM", param_value=1.0, param_type=9, target_system=1
    )
    for answer in (*asked, *to_be_set):
        assert answer.name == "PARAM_ERROR"
        assert answer.fields["error"] == common.MAV_PARAM_ERROR_DOES_NOT_EXIST
        assert answer.fields["param_id"].rstrip(b"\0") == b"NO_SUCH_PARAM"
    assert (len(asked), len(to_be_set)) == (1, 1)


def test_rates_are_raised_lowered_and_reset_by_command() -> None:
    client = Client(emulator())
    assert client.command(511, 32, 10_000) == [ACCEPTED]
    assert [m.name for m in client.collect(2.0)].count("LOCAL_POSITION_NED") == pytest.approx(
        200, abs=4
    )
    assert client.command(511, 32, -1) == [ACCEPTED]
    assert "LOCAL_POSITION_NED" not in [m.name for m in client.collect(1.0)]
    assert client.command(511, 32, 0) == [ACCEPTED]
    assert [m.name for m in client.collect(2.0)].count("LOCAL_POSITION_NED") == pytest.approx(
        60, abs=3
    )
    assert client.command(511, 0, 100_000) == [FAILED]
    assert client.command(511, 999, 100_000) == [FAILED]


def test_a_requested_message_is_sent_once() -> None:
    client = Client(emulator())
    answers = client.send("COMMAND_LONG", command=512, target_system=1, param1=148.0)
    assert [m.name for m in answers] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]


def test_the_emulator_says_by_its_identity_that_it_is_simulated() -> None:
    client = Client(emulator())
    fields = client.send("COMMAND_LONG", command=512, target_system=1, param1=148.0)[-1].fields
    told = PARSERS["AUTOPILOT_VERSION"](fields, 0)
    assert told["is_simulated"]
    # of a real board
    assert not PARSERS["AUTOPILOT_VERSION"](fields | {"uid": 0x003A00263130510F}, 0)["is_simulated"]
    assert not PARSERS["AUTOPILOT_VERSION"](fields | {"uid": 0}, 0)["is_simulated"]


def test_time_synchronisation_and_ping_are_answered() -> None:
    client = Client(emulator())
    (answer,) = client.send("TIMESYNC", tc1=0, ts1=1234)
    assert answer.fields["ts1"] == 1234
    (answer,) = client.send("PING", seq=5, time_usec=7)
    assert (answer.fields["seq"], answer.fields["target_system"]) == (5, 245)


def test_texts_are_sent_only_while_a_ground_stations_heartbeat_arrives() -> None:
    emu = emulator()
    client = Client(emu)
    client.command(400, 1)
    client.send("HEARTBEAT", type=18)
    assert "STATUSTEXT" not in [m.name for m in client.collect(0.5)]
    client.send("HEARTBEAT", type=6)
    texts = [m for m in client.collect(0.5) if m.name == "STATUSTEXT"]
    assert len(texts) == 2  # over 50 characters: in two pieces
    assert b"".join(m.fields["text"].rstrip(b"\0") for m in texts).startswith(
        b"Arming denied: Resolve system health"
    )
    assert [m.fields["chunk_seq"] for m in texts] == [0, 1]
    assert texts[0].fields["id"] == texts[1].fields["id"] == 0  # the first text of a link


def test_the_heartbeat_is_sent_once_a_second_and_not_on_change() -> None:
    emu = emulator()
    client = Client(emu)
    run_for(emu, 5.0)
    client.collect(1.5)
    client.command(400, 1)
    beats = [m for m in client.collect(3.0) if m.name == "HEARTBEAT"]
    assert len(beats) == 3
    assert beats[-1].fields["base_mode"] & 128
    assert beats[-1].fields["custom_mode"] == 50593792


def test_vision_moves_the_local_frame_when_satellites_are_off() -> None:
    emu = emulator()
    client = Client(emu)
    for name, value in ((b"EKF2_GPS_CTRL", 0), (b"EKF2_HGT_REF", 3)):
        wire = struct.unpack("<f", struct.pack("<i", value))[0]
        client.send("PARAM_SET", param_id=name, param_value=wire, param_type=6, target_system=1)

    def send() -> None:
        if emu.world.vehicles.steps % 5 == 0:
            client.send("VISION_POSITION_ESTIMATE", x=3.0, y=-4.0, z=-0.1, yaw=math.pi / 2)

    run_for(emu, 4.0, send)
    local = emu.estimator.local(0)
    assert math.dist(local.position_ned_m, (3.0, -4.0, -0.1)) < 0.4
    assert abs(emu.estimator.yaw_error_rad[0]) < 1e-3


@pytest.mark.parametrize(
    ("frame", "x", "y", "z"),
    [(1, 3.0, -4.0, -0.1), (4, -4.0, 3.0, 0.1), (20, 3.0, -4.0, -0.1), (21, 3.0, 4.0, 0.1)],
)
def test_odometry_is_fused_in_each_local_frame(frame: int, x: float, y: float, z: float) -> None:
    emu = emulator()
    client = Client(emu)
    client.turn_satellites_off()

    def send() -> None:
        if emu.world.vehicles.steps % 5 == 0:
            client.send("ODOMETRY", x=x, y=y, z=z, q=[1.0, 0.0, 0.0, 0.0], frame_id=frame)

    run_for(emu, 4.0, send)
    assert math.dist(emu.estimator.local(0).position_ned_m, (3.0, -4.0, -0.1)) < 0.4


def test_another_reset_counter_in_odometry_is_followed_at_once_in_height_too() -> None:
    emu = emulator()
    client = Client(emu)
    client.turn_satellites_off()

    def send(height_m: float, resets: int) -> Callable[[], None]:
        def once() -> None:
            if emu.world.vehicles.steps % 5 == 0:
                pose = {
                    "x": 0.0,
                    "y": 0.0,
                    "z": -height_m,
                    "q": [1.0, 0.0, 0.0, 0.0],
                    "frame_id": 1,
                }
                client.send("ODOMETRY", **pose, reset_counter=resets)

        return once

    def height_m() -> float:
        return -emu.estimator.local(0).position_ned_m[2]

    run_for(emu, 4.0, send(0.0, 0))
    run_for(emu, 0.5, send(0.9, 0))
    assert height_m() < 0.2  # without a word it is refused for five seconds
    run_for(emu, 0.1, send(0.9, 1))
    assert abs(height_m() - 0.9) < 0.1
    run_for(emu, 0.5, send(0.9, 1))
    assert abs(height_m() - 0.9) < 0.1


def test_with_vision_only_hold_can_be_armed_in_once_an_origin_is_given() -> None:
    emu = emulator()
    client = Client(emu)
    client.turn_satellites_off()

    def send() -> None:
        if emu.world.vehicles.steps % 5 == 0:
            client.send("ODOMETRY", x=0.0, y=0.0, z=0.0, q=[1.0, 0.0, 0.0, 0.0], frame_id=1)

    run_for(emu, 6.0, send)
    assert client.command(400, 1) == [REJECTED]
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=0, latitude=473977420)
    run_for(emu, 0.1, send)
    assert client.command(400, 1) == [REJECTED], "PX4 takes no origin that is for all"
    client.send("SET_GPS_GLOBAL_ORIGIN", target_system=1, latitude=473977420)
    run_for(emu, 0.1, send)
    assert client.command(400, 1) == [ACCEPTED]


def test_a_stick_beyond_its_range_counts_as_centred() -> None:
    emu = emulator()
    client = Client(emu)
    client.send("MANUAL_CONTROL", target=1, x=1001, y=-200, z=-1000, r=-32768)
    assert emu.autopilots[0].sticks.positions == (0.0, -0.2, 0.5, 0.0)


@pytest.mark.parametrize(("target", "is_taken"), [(0, True), (1, True), (2, False)])
def test_sticks_are_for_one_vehicle_or_for_all(*, target: int, is_taken: bool) -> None:
    emu = emulator()
    Client(emu).send("MANUAL_CONTROL", target=target, x=300, y=0, z=500, r=0)
    pitch, _, _, _ = emu.autopilots[0].sticks.positions
    assert (pitch == 0.3) is is_taken


def test_nonsense_is_counted_and_changes_nothing() -> None:
    emu = emulator()
    client = Client(emu)
    rng = random.Random(3)
    good = Encoder(245, 190).encode_named(
        "COMMAND_LONG", command=511, target_system=1, param1=30.0, param2=1e9
    )
    for _ in range(3000):
        kind = rng.randrange(4)
        if kind == 0:
            datagram = rng.randbytes(rng.randrange(0, 300))
        elif kind == 1:
            datagram = good[: rng.randrange(len(good))]
        elif kind == 2:
            broken = bytearray(good)
            broken[rng.randrange(len(broken))] ^= 1 << rng.randrange(8)
            datagram = bytes(broken)
        else:
            # A valid frame whose content is random: every message that the emulator handles, with
            # any numbers.
            layout = LAYOUTS[rng.choice(HANDLED)]
            values = layout.packer.unpack(rng.randbytes(layout.packer.size))
            datagram = Encoder(245, 190).encode(layout.message_id, *values)
        client.send_bytes(datagram)
    assert client.link.malformed > 1000
    run_for(emu, 1.0)
    assert "HEARTBEAT" in [m.name for m in client.collect(1.2)]
    assert all(math.isfinite(c) for c in emu.world.vehicles.states.position_ned_m[0])
