"""MAVLink signing of the emulated PX4, as the real ones of each version were measured to do it."""

from __future__ import annotations

import os
from collections.abc import Iterable

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from sitl.emulator.emulator import Emulator
from sitl.mavlink.link import Link
from sitl.mavlink.streams import GCS_RATES_HZ
from tests.sitl.sitl_flying import Client, emulator, run_for

KEY = bytes(range(1, 33))
OTHER_KEY = bytes(range(2, 34))
NOW = 37_000_000_000_000
MINUTE = 60 * 100_000


class Sender:
    """A ground with pymavlink's signatures."""

    def __init__(self, key: bytes | None = None, stamp: int = NOW, link_id: int = 9) -> None:
        self.end = mavlink.MAVLink(None, 255, 190)
        self.sign(key, stamp, link_id)

    def sign(self, key: bytes | None, stamp: int = NOW, link_id: int = 9) -> None:
        signing = self.end.signing
        signing.secret_key = key
        signing.sign_outgoing = key is not None
        signing.timestamp = stamp
        signing.link_id = link_id

    def request(self) -> bytes:
        return bytes(
            mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0).pack(self.end)
        )

    def key(self, key: bytes, stamp: int = NOW, system: int = 1) -> bytes:
        return bytes(
            mavlink.MAVLink_setup_signing_message(system, 1, list(key), stamp).pack(self.end)
        )


def is_signed(frames: Iterable[bytes]) -> set[bool]:
    return {bool(frame[2] & 1) for frame in frames}


def vehicle(version: str = "1.18") -> tuple[Emulator, Link, Link]:
    emu = emulator(px4=version)
    return emu, Client(emu).link, Link(emu, 0, GCS_RATES_HZ, link_id=0)


def test_before_v1_18_a_key_is_ignored_and_signatures_are_not_looked_at() -> None:
    for version in ("1.16", "1.17"):
        _, own, _ = vehicle(version)
        own.receive(Sender().key(KEY))
        assert is_signed(own.receive(Sender().request())) == {False}
        assert own.receive(Sender(OTHER_KEY).request())


def test_any_sender_sets_the_key_of_a_px4_without_one_for_all_its_links() -> None:
    _, own, ground = vehicle()
    assert own.receive(Sender(KEY).request())  # not looked at before
    ground.receive(Sender().key(KEY, system=99))
    assert own.receive(Sender().request()) == []
    answers = own.receive(Sender(KEY, NOW + 1).request())
    assert is_signed(answers) == {True}
    theirs = Sender(KEY, NOW)
    assert all(theirs.end.parse_buffer(bytearray(answer)) for answer in answers)
    assert {answer[-13] for answer in answers} == {1}


def test_only_a_sender_with_the_key_changes_it_and_only_on_the_ground() -> None:
    emu, own, _ = vehicle()
    own.receive(Sender().key(KEY))
    own.receive(Sender().key(OTHER_KEY))
    own.receive(Sender().key(bytes(32), 0))
    emu.autopilots[0].is_armed = True
    own.receive(Sender(KEY, NOW + 10).key(OTHER_KEY, NOW + 20))
    assert (
        emu.autopilots[0].journal.texts.newest[-1].text == "MAVLink signing: rejected while armed"
    )
    emu.autopilots[0].is_armed = False
    assert own.receive(Sender(KEY, NOW + 100).request())
    own.receive(Sender(KEY, NOW + 200).key(bytes(32), 0))
    assert is_signed(own.receive(Sender().request())) == {False}


def test_replays_and_old_clocks_are_refused_until_a_restart_forgets_the_senders() -> None:
    emu, own, ground = vehicle()
    own.receive(Sender().key(KEY))
    recorded = Sender(KEY, NOW + 5, link_id=64).request()
    assert ground.receive(recorded)
    assert not ground.receive(recorded)
    assert not ground.receive(Sender(KEY, NOW + 4, link_id=64).request())
    assert own.receive(Sender(KEY, NOW + 2 * MINUTE, link_id=10).request())
    # older than a minute on this link
    assert not own.receive(Sender(KEY, NOW + MINUTE - 1, link_id=11).request())
    assert own.receive(Sender(KEY, NOW + MINUTE + 10, link_id=11).request())
    # on the other one nothing newer came
    assert ground.receive(Sender(KEY, NOW + MINUTE - 1, link_id=12).request())
    emu.reboot(0)
    assert ground.receive(recorded)
    senders = [
        Sender(KEY, NOW + 3 * MINUTE, link_id=link_id).request() for link_id in range(20, 40)
    ]
    assert [bool(ground.receive(request)) for request in senders] == [True] * 15 + [False] * 5


def test_a_timestamp_of_more_than_48_bits_leaves_with_its_lower_48_bits() -> None:
    emu, own, _ = vehicle()
    frames = own.receive(Sender().key(KEY, stamp=2**48 + 7))
    run_for(emu, 1.0)
    frames += own.poll()

    timestamps = [int.from_bytes(frame[-12:-6], "little") for frame in frames if frame[2] & 1]
    assert timestamps
    assert timestamps == list(range(7, 7 + len(timestamps)))

    # A sender has 48 bits, so PX4 takes its clock for late.
    assert own.receive(Sender(KEY, NOW).request()) == []


def test_heartbeats_are_taken_unsigned_so_that_texts_go_on() -> None:
    emu, _, ground = vehicle()
    ground.receive(Sender().key(KEY))
    ground.receive(bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(Sender().end)))
    assert emu.autopilots[0].ground_time_s == emu.clock_s(0)
