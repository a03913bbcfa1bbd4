"""Records with flipped bits, absurd stamps, floods of names and control characters."""

from __future__ import annotations

import contextlib
import random
import struct
import time
from pathlib import Path

import msgspec
import pytest
from mcap.opcode import Opcode
from mcap.writer import Writer

from groundstation.client.preflight_page import PageLine, VehiclePage, as_text
from groundstation.figures.data import TOPICS, from_samples
from groundstation.flights.mission_flight import clock_say
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.flight_report import report
from groundstation.recording.summary import MAGIC
from groundstation.recording.timeline import DAMAGED_PIECE, Timeline
from groundstation.recording.writer import MAX_CHANNELS, RecordFiles, RecordWriter
from onboard.bus.schema import Event, Message, OrderReply, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError
from sitl.lockstep.lockstep_record import LockstepRecord
from tests.groundstation.recorded import SECOND, read, record, tick

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def truth(name: str, stamp_ns: int, x: float = 0.0) -> Truth:
    return Truth(
        vehicle=name,
        stamp_ns=stamp_ns,
        position_enu_m=(x, 0.0, 1.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        quaternion_enu_flu_wxyz=UPRIGHT,
        is_on_ground=False,
        is_collided=False,
    )


def write(folder: Path, messages: list[tuple[Topic, str, Message]]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    files = RecordFiles(folder, (folder / "flight.mcap").open("wb"), begin_ns=0, begin="a test")
    for topic, name, message in messages:
        files.write(topic, name, message, getattr(message, "stamp_ns", 0))
    files.finish()
    files.close()


def crossing(seconds: int = 4) -> list[tuple[Topic, str, Message]]:
    messages: list[tuple[Topic, str, Message]] = []
    for step in range(seconds * 50):
        stamp_ns = SECOND + step * SECOND // 50
        for index, name in enumerate(("mav0", "mav1")):
            messages.append((Topic.TRUTH, name, truth(name, stamp_ns, 1.0 + index)))
            messages.append((Topic.TICK, name, tick(stamp_ns)))
    return messages


def test_a_flipped_bit_never_ends_figures_or_report_with_an_exception(tmp_path: Path) -> None:
    write(tmp_path, crossing(2))
    path = tmp_path / "flight.mcap"
    whole = path.read_bytes()
    dice = random.Random(5)
    for attempt in range(60):
        damaged = bytearray(whole)
        for _ in range(1 + attempt % 3):
            damaged[dice.randrange(len(whole))] ^= 1 << dice.randrange(8)
        path.write_bytes(damaged)
        with contextlib.suppress(ConfigError):  # a sentence
            report(tmp_path)
            from_samples(read(tmp_path, TOPICS), title="x", safety_distance_m=0.8)


@pytest.mark.parametrize("is_first", [True, False])
@pytest.mark.parametrize(
    "damaged_head",
    [
        b"\x77",  # an opcode that MCAP does not have
        bytes([Opcode.MESSAGE_INDEX]),
        bytes([Opcode.DATA_END]),
        bytes([Opcode.CHUNK]) + b"\xff" * 8,  # a length beyond the file
        bytes([Opcode.CHUNK]) + struct.pack("<Q", 20),  # and one within the chunk
        bytes([Opcode.CHUNK]) + struct.pack("<Q", 5),  # too short for the times of its messages
        b"\xff" * 9,
    ],
)
def test_a_damaged_head_costs_its_own_piece_only_and_is_said(
    tmp_path: Path, damaged_head: bytes, is_first: bool
) -> None:
    path = record(tmp_path / "flight", 10.0) / "flight.mcap"
    whole = path.read_bytes()
    with contextlib.closing(Timeline(path)) as timeline:
        assert not timeline.broken
        number = 0 if is_first else timeline.chunk_count // 2
        head = timeline._chunks[number].offset - 9
        channels = timeline.raw_channels(number, timeline.topics)
        count = timeline.count_messages() - sum(len(channel.datas) for channel in channels)

    path.write_bytes(whole[:head] + damaged_head + whole[head + len(damaged_head) :])

    with contextlib.closing(Timeline(path)) as timeline:
        assert timeline.count_messages() == count
        assert timeline.broken == DAMAGED_PIECE


def test_a_message_index_that_is_too_short_ends_no_record(tmp_path: Path) -> None:
    path = record(tmp_path / "flight", 10.0) / "flight.mcap"
    whole = path.read_bytes()
    with contextlib.closing(Timeline(path)) as timeline:
        first = timeline._chunks[0]
        chunk_count = timeline.chunk_count
    index = first.offset + first.size
    assert whole[index] == Opcode.MESSAGE_INDEX

    path.write_bytes(whole[: index + 1] + struct.pack("<Q", 3) + whole[index + 9 :])
    with contextlib.closing(Timeline(path)) as timeline:
        assert timeline.chunk_count == chunk_count
        assert timeline.broken == DAMAGED_PIECE


def test_a_wrong_opcode_in_a_record_that_was_cut_off_is_said(tmp_path: Path) -> None:
    path = record(tmp_path / "flight", 10.0) / "flight.mcap"
    whole = path.read_bytes()
    with contextlib.closing(Timeline(path)) as timeline:
        second = timeline._chunks[1].offset - 9
        third = timeline._chunks[2].offset - 9

    path.write_bytes(whole[:second] + b"\x77" + whole[second + 1 : third])
    with contextlib.closing(Timeline(path)) as timeline:
        assert "cut off" in timeline.broken
        assert timeline.chunk_count == 1

    # closed, but without a summary
    path.write_bytes(whole[: second + 1] + b"\xff" * 8 + MAGIC)
    with contextlib.closing(Timeline(path)) as timeline:
        assert timeline.broken.startswith("A piece of the record is damaged, and what came after")


def test_a_stamp_beyond_64_bits_is_left_out_and_counted(tmp_path: Path) -> None:
    with (tmp_path / "flight.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("covey.TickSample", "jsonschema", b"{}")
        channel = writer.register_channel("tick/mav0", "json", schema)
        for log_time_ns in (SECOND, 2 * SECOND, 2**63):
            writer.add_message(channel, log_time_ns, b'{"period_s": 0.02}', log_time_ns)
        writer.finish()

    flight = read_flight(tmp_path)

    assert flight.vehicles["mav0"].ticks.size == 2
    assert "1 message could not be decoded and is left out." in flight.notes


def test_messages_of_another_shape_are_left_out(tmp_path: Path) -> None:
    huge = b'{"position_enu_m": [1e999, 0, 1' + b"0" * 400 + b"]}"
    mixed = b'{"position_enu_m": [[], {}, "x"], "period_s": "slow"}'
    for data in (
        b"[1]",
        b"{}",
        b"nul",
        b'{"position_enu_m": 3}',
        huge,
        mixed,
        b"[" * 100_000,
        b"\xff",
    ):
        files = RecordFiles(
            tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=0, begin="a test"
        )
        for topic, name, message in crossing(1):
            files.write(topic, name, message, 0)
        files.add_raw("truth/mav0", Truth, SECOND + 1, data)
        files.add_raw("tick/mav1", type(tick(1)), SECOND + 1, data)
        files.finish()
        files.close()
        assert report(tmp_path).pairs["mav0-mav1"].distance_m == 1.0, data[:40]
        assert from_samples(read(tmp_path, TOPICS), title="x", safety_distance_m=0.8) is not None, (
            data[:40]
        )


def test_one_absurd_stamp_does_not_stretch_the_flight(tmp_path: Path) -> None:
    for stamp_ns in (1 << 62, (1 << 63) - 1, 0):
        folder = tmp_path / str(stamp_ns)
        messages = [(topic, name, shifted(message)) for topic, name, message in crossing()]
        write(folder, [*messages, (Topic.TRUTH, "mav0", truth("mav0", stamp_ns, 1.0))])
        assert report(folder).duration_s < 10.0
        flight = from_samples(read(folder, TOPICS), title="x", safety_distance_m=0.8)
        assert flight is not None
        assert len(flight.grid_s) < 1000


def shifted(message: Message) -> Message:
    """The same message of a host that has run for ten days."""
    ten_days_ns = 10 * 86_400 * SECOND
    stamp_ns = message.stamp_ns + ten_days_ns  # type: ignore[attr-defined]
    return msgspec.structs.replace(message, stamp_ns=stamp_ns)


def test_a_flood_of_names_causes_a_warning_and_the_flight_goes_on_being_recorded(
    tmp_path: Path,
) -> None:
    sentences: list[str] = []
    writer = RecordWriter(tmp_path, on_failure=sentences.append, on_warning=sentences.append)
    writer.start()
    writer.put(Topic.TRUTH, "mav0", truth("mav0", 1), 0)
    for number in range(MAX_CHANNELS + 200):
        writer.put(Topic.TRUTH, f"false{number}", truth(f"false{number}", 1), 0)
    writer.put(Topic.TRUTH, "mav0", truth("mav0", 2), 0)
    writer.stop()
    assert writer.failure is None
    assert len(sentences) == 1
    assert f"{MAX_CHANNELS} channels" in sentences[0]
    assert [one.stamp_ns for one in read(tmp_path) if one.name == "mav0"] == [1, 2]


def test_the_record_of_a_simulated_flight_warns_of_a_flood_of_names_as_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.recording.writer.MAX_CHANNELS", 5)
    said: list[tuple[str, str]] = []
    record = LockstepRecord(
        tmp_path, 0, say=lambda severity, code, sentence: said.append((severity, code))
    )
    for number in range(20):
        record.put(Topic.TRUTH, f"false{number}", truth(f"false{number}", 1), 0)
    record.stop()
    assert said == [("warning", "record_full")]
    assert len(list(read(tmp_path))) == 5


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_writer_that_fails_by_a_mistake_of_its_own_says_so(tmp_path: Path) -> None:
    sentences: list[str] = []
    writer = RecordWriter(tmp_path, on_failure=sentences.append)
    writer.start()
    writer.put(Topic.TRUTH, "mav0", 5, 0)  # type: ignore[arg-type]
    deadline_s = time.monotonic() + 20.0
    while writer.failure is None and time.monotonic() < deadline_s:
        time.sleep(0.02)
    writer.stop()
    assert len(sentences) == 1
    assert "The record ended" in sentences[0]


def test_control_characters_of_events_and_orders_do_not_reach_the_texts(tmp_path: Path) -> None:
    nasty = "\x1b]0;owned\x07\x1b[2J\u009b31m\u202ered\r\n"
    event = Event(
        vehicle="mav0", stamp_ns=1, severity="info", code=nasty, sentence=nasty, order_id="a1"
    )
    reply = OrderReply(order_id=nasty, vehicle="mav0", is_accepted=False, reason=nasty)
    write(tmp_path, [(Topic.EVENT, "mav0", event), (Topic.ORDER, "mav0", reply)])
    for name in ("events.txt", "orders.txt"):
        lines = (tmp_path / name).read_text(encoding="utf-8").splitlines()
        assert all(line.isprintable() for line in lines), lines


def test_control_characters_of_a_vehicle_do_not_reach_the_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say = clock_say()
    say("  [mav0] critical: \x1b]0;owned\x07\x1b[2J\u009b31m")
    page = VehiclePage(
        "mav0", True, (PageLine("\x1b[2Jbattery", False, "It is \x1b[31mlow.\r", "Change it."),)
    )
    print(as_text((page,)))
    shown = capsys.readouterr().out
    assert all(line.isprintable() for line in shown.split("\n")), shown


def test_every_flush_reaches_the_disk_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr("os.fdatasync", synced.append)
    record(tmp_path / "flight", 3.0)
    assert len(synced) >= 3 * 3  # three files, once a second
