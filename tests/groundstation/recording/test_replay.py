"""A replay has the same states as the flight, at any time, also of a record that breaks off."""

from __future__ import annotations

import contextlib
import json
import math
import shutil
import typing
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from groundstation.cli import main
from groundstation.fleet import state as fleet_state
from groundstation.orders.grammar import OrderError
from groundstation.recording import replay as replay_module
from groundstation.recording.channels import KINDS, from_json, rows
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.replay import REFUSAL, Replay, open_flight
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordFiles
from onboard.bus.schema import Event, Message, MocapPose, MocapPoses, Order, Telemetry
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError
from tests.groundstation.console.fake import telemetry
from tests.groundstation.recorded import FLEET, LEVEL, SECOND, ZERO, messages, record, tick


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("flights") / "whole")


def opened(folder: Path) -> Replay:
    fleet, timeline = open_flight(folder)
    return Replay(fleet, timeline)


def test_a_law_that_a_foreign_record_names_is_not_run(flight: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(flight, tmp_path / "theirs"))
    text = (folder / "fleet.toml").read_text(encoding="utf-8")
    (folder / "fleet.toml").write_text(
        text.replace('name = "covey"', 'name = "theirs:law"'), encoding="utf-8"
    )
    (folder / "theirs.py").write_text("raise SystemExit('run')\n", encoding="utf-8")
    fleet, timeline = open_flight(folder)
    timeline.close()
    assert fleet.law.name == "theirs:law"
    assert fleet.own_law is None


def test_every_kind_of_message_comes_back_from_the_record_as_it_was() -> None:
    for name in sorted(set(KINDS) - {"Message", "TickBatch"}):
        kind = KINDS[name]
        message = _any_message(kind)
        (row,) = rows(Topic.STATE, "mav0", message, 7)
        assert from_json(kind, row.data) == message, name


def test_every_field_with_a_default_may_be_missing_in_a_record_of_every_kind() -> None:
    for name in sorted(set(KINDS) - {"Message", "TickBatch"}):
        kind = KINDS[name]
        message = _any_message(kind)
        (row,) = rows(Topic.STATE, "mav0", message, 7)
        values = json.loads(row.data)

        for field in msgspec.structs.fields(kind):
            if field.required:
                continue
            default = field.default
            if field.default_factory is not msgspec.NODEFAULT:
                default = field.default_factory()
            older = {key: value for key, value in values.items() if key != field.name}
            back = from_json(kind, json.dumps(older).encode())
            whole = msgspec.structs.replace(message, **{field.name: default})
            # as texts, because some defaults are NaN
            assert repr(back) == repr(whole), (name, field.name)


def test_two_messages_without_a_field_do_not_share_its_default() -> None:
    (row,) = rows(Topic.TELEMETRY, "mav0", telemetry("mav0"), 7)
    older = json.loads(row.data)
    del older["refused_orders"]

    first, second = (from_json(Telemetry, json.dumps(older).encode()) for _ in range(2))

    assert isinstance(first, Telemetry)
    assert isinstance(second, Telemetry)
    first.refused_orders["not trusted"] = 1
    assert second.refused_orders == {}


def test_an_order_of_a_record_from_before_its_kind_was_renamed_is_read() -> None:
    order = Order(order_id="1", author="x", kind="identify", stamp_ns=1, deadline_ns=2)
    (row,) = rows(Topic.ORDER, "mav0", order, 7)
    assert from_json(Order, row.data) == order


def _any_message(kind: type[Message]) -> Message:
    """Some message of a kind, with a value in every field."""
    values = {field: _any_value(hint) for field, hint in typing.get_type_hints(kind).items()}
    return msgspec.convert(
        [{**values, "schema": 1}[field] for field in kind.__struct_fields__], kind
    )


def _any_value(hint: object) -> object:
    """Some value of a type, as JSON has it."""
    parts = typing.get_args(hint)
    if typing.get_origin(hint) is tuple:
        return [_any_value(part) for part in parts if part is not Ellipsis]
    if typing.get_origin(hint) is dict:
        return {"a": _any_value(parts[1])}
    if typing.get_origin(hint) is typing.Literal:
        return parts[0]
    if parts:  # a union
        return _any_value(parts[0])
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return [_any_value(part) for part in typing.get_type_hints(hint).values()]
    values = {bool: True, int: 3, float: 0.25, str: "text", bytes: "cGF0aA=="}
    return values[hint]  # type: ignore[index]


def test_numbers_that_were_not_finite_come_back_as_nan_and_garbage_as_nothing() -> None:
    recorded = telemetry("mav0", battery_frac=math.nan, position_enu_m=(math.nan, math.inf, 1.0))
    (row,) = rows(Topic.TELEMETRY, "mav0", recorded, 7)
    back = from_json(type(recorded), row.data)
    assert isinstance(back, Telemetry)
    assert math.isnan(back.battery_frac)
    assert math.isnan(back.position_enu_m[0])
    assert from_json(type(recorded), b"{]") is None
    assert from_json(type(recorded), b"[1]") is None
    assert from_json(type(recorded), row.data.replace(b'"flying"', b'"upside down"')) is None


def test_a_record_of_an_older_version_without_the_newest_fields_is_read_with_their_defaults() -> (
    None
):
    recorded = telemetry("mav0")
    (row,) = rows(Topic.TELEMETRY, "mav0", recorded, 7)
    older = json.loads(row.data)
    del older["conditions"], older["action"]
    older["a_field_of_the_future"] = 1
    assert from_json(type(recorded), json.dumps(older).encode()) == recorded


async def test_the_state_at_any_time_is_what_was_folded_until_then(flight: Path) -> None:
    replay = opened(flight)
    fleet = replay.fleet
    for at_s in (3.05, 25.05, 11.3, 39.9):
        await replay.seek(at_s)
        live = fleet_state.initial(fleet)
        for at_ns, _, _, message in messages(40.0, {}):
            if at_ns <= replay.now_ns():
                live = fleet_state.fold(live, message, at_ns)
        assert {name: view.telemetry for name, view in replay.state.vehicles.items()} == {
            name: view.telemetry for name, view in live.vehicles.items()
        }
        assert replay.state.smallest_truth == live.smallest_truth
        assert [logged.event for logged in replay.state.events] == [
            logged.event for logged in live.events
        ]
        assert replay.position_s == pytest.approx(at_s, abs=1e-6)


async def test_orders_are_refused_with_a_sentence(flight: Path) -> None:
    with pytest.raises(OrderError, match="recorded flight"):
        await opened(flight).submit("land all")
    assert REFUSAL.endswith(".")


def test_playing_follows_the_clock_of_the_watcher_times_the_speed_and_stops_at_the_end(
    flight: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # on a busy computer a replay falls behind the clock
    monkeypatch.setattr(replay_module, "_SLICE_S", math.inf)
    replay = opened(flight)
    replay.speed = 4.0
    for _ in range(10):
        replay.play(0.1)
    assert replay.position_s == pytest.approx(4.0, abs=0.01)
    replay.is_playing = False
    replay.play(1.0)
    assert replay.position_s == pytest.approx(4.0, abs=0.01)
    replay.is_playing = True
    for _ in range(100):
        replay.play(0.5)
    assert replay.is_at_end
    assert not replay.is_playing


async def test_events_are_jumped_to_one_by_one_in_both_directions(flight: Path) -> None:
    replay = opened(flight)
    replay.is_playing = False
    await replay.seek(12.0)
    heard = []
    for direction in (1, 1, -1, -1):
        await replay.jump(direction)
        heard.append(replay.state.events[-1].event.sentence)
    assert heard == ["mav0 at 15 s", "mav1 at 15 s", "mav0 at 15 s", "mav2 at 10 s"]
    await replay.seek(39.0)
    await replay.jump(1)
    assert replay.is_at_end


async def test_going_back_gives_listeners_a_minute_of_what_was_before(flight: Path) -> None:
    replay = opened(flight)
    seen: list[int] = []
    replay.add_listener(lambda state, now_ns: seen.append(now_ns), seen.clear)
    await replay.seek(30.0)
    await replay.seek(20.0)
    assert seen == sorted(seen)
    assert len(seen) == pytest.approx(200, abs=2)


@pytest.mark.parametrize("share", [0.004, 0.3, 0.7, 0.95])
async def test_a_record_that_is_cut_off_opens_as_far_as_it_goes_and_says_so(
    flight: Path, tmp_path: Path, share: float
) -> None:
    data = (flight / "flight.mcap").read_bytes()
    (tmp_path / "flight.mcap").write_bytes(data[: int(share * len(data))])
    shutil.copy(FLEET, tmp_path / "fleet.toml")
    if share < 0.01:
        with pytest.raises(ConfigError, match="cut off"):
            Timeline(tmp_path)
        return
    replay = opened(tmp_path)
    assert "cut off" in replay.timeline.broken
    assert replay.length_s > 40.0 * share - 3.0
    await replay.seek(replay.length_s)
    assert all(view.telemetry is not None for view in replay.state.vehicles.values())


async def test_a_damaged_piece_is_jumped_over(flight: Path, tmp_path: Path) -> None:
    data = bytearray((flight / "flight.mcap").read_bytes())
    with (flight / "flight.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    middle = summary.chunk_indexes[20].chunk_start_offset + 200
    data[middle : middle + 40] = bytes(40)
    (tmp_path / "flight.mcap").write_bytes(data)
    shutil.copy(FLEET, tmp_path / "fleet.toml")
    replay = opened(tmp_path)
    await replay.seek(100.0)
    assert "damaged" in replay.timeline.broken
    assert replay.length_s == pytest.approx(39.9)
    assert replay.state.vehicles["mav0"].telemetry.sequence == 400  # type: ignore[union-attr]


@pytest.mark.long
def test_flipped_bits_anywhere_end_in_a_shorter_flight_or_in_a_sentence(
    flight: Path, tmp_path: Path
) -> None:
    whole = (flight / "flight.mcap").read_bytes()
    random = np.random.default_rng(5)
    opened_count = 0
    for position in random.integers(0, len(whole), 60).tolist():
        data = bytearray(whole)
        data[position : position + 3] = random.bytes(3)
        (tmp_path / "flight.mcap").write_bytes(data)
        try:
            timeline = Timeline(tmp_path)
        except ConfigError:
            continue
        end_ns = min(timeline.end_ns, timeline.begin_ns + 3600 * SECOND)
        count = sum(
            1 for _ in timeline.read(timeline.begin_ns - 1, frozenset(("truth",))).until(end_ns)
        )
        timeline.close()
        opened_count += count > 0
    assert opened_count > 50


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", b"PK\x03\x04" + bytes(500), b"\x89MCAP0\r\n" + b"\xff" * 900]
)
def test_a_file_that_is_no_record_is_refused_in_a_sentence(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "flight.mcap").write_bytes(content)
    with pytest.raises(ConfigError):
        Timeline(tmp_path)


async def test_vehicles_on_clocks_of_their_own_are_shown_together(tmp_path: Path) -> None:
    replay = opened(
        record(tmp_path / "hosts", 40.0, {"mav1": 86_400 * SECOND, "mav2": -3 * SECOND // 2})
    )
    assert replay.length_s == pytest.approx(41.4, abs=0.5)
    await replay.seek(10.0)
    told = {
        name: view.telemetry.sequence
        for name, view in replay.state.vehicles.items()
        if view.telemetry
    }
    assert all(sequence == pytest.approx(95, abs=22) for sequence in told.values())
    assert all(view.is_fresh(replay.now_ns()) for view in replay.state.vehicles.values())


def late_event(name: str, stamp_ns: int) -> tuple[int, Topic, str, Message]:
    """An event that comes 20 s after the flight's begin, whenever it happened."""
    event = Event(
        vehicle=name, stamp_ns=stamp_ns, severity="info", code="late", sentence=f"{name} was late"
    )
    return 25 * SECOND, Topic.EVENT, name, event


def recorded_in_order(folder: Path, told: list[tuple[int, Topic, str, Message]]) -> Path:
    """A record of these messages, with a chunk for every sixty of them or for each wait."""
    folder.mkdir()
    shutil.copy(FLEET, folder / "fleet.toml")
    files = RecordFiles(
        folder, (folder / "flight.mcap").open("wb"), begin_ns=5 * SECOND, begin="a test"
    )
    before_ns = 5 * SECOND
    for count, (at_ns, topic, name, message) in enumerate(sorted(told, key=lambda one: one[0])):
        if count % 60 == 0 or at_ns - before_ns > SECOND:
            files.flush()
        files.write(topic, name, message, at_ns)
        before_ns = at_ns
    files.finish()
    files.close()
    return folder


@pytest.mark.parametrize("name", ["mav0", "mav1", "ground"])
@pytest.mark.parametrize("age_s", [6, 19, 3_000, -30])
def test_a_late_message_with_an_old_stamp_shifts_nothing_else(
    tmp_path: Path, name: str, age_s: int
) -> None:
    told = messages(40.0, {})
    told.append(late_event(name, 25 * SECOND - age_s * SECOND))
    folder = recorded_in_order(tmp_path / "late", told)

    timeline = Timeline(folder)
    reading = timeline.read(0, frozenset(("telemetry", "truth")))
    stamps_ns = [one.stamp_ns for one in reading.until(100 * SECOND)]
    assert stamps_ns == sorted(at_ns for at_ns, topic, _, _ in told if topic != Topic.EVENT)
    assert timeline.length_s == pytest.approx(39.9, abs=35.1)  # no flight of an hour
    timeline.close()


@pytest.mark.parametrize("silence_s", [(0, 8), (20, 35), (30, 41)])
def test_a_ground_that_waits_for_silent_vehicles_is_on_no_other_clock(
    tmp_path: Path, silence_s: tuple[int, int]
) -> None:
    first_ns, last_ns = ((5 + time_s) * SECOND for time_s in silence_s)
    told = [one for one in messages(40.0, {}) if not first_ns <= one[0] < last_ns]
    expected = []
    for time_s in range(0, 40, 2):
        at_ns = (5 + time_s) * SECOND
        _, topic, name, event = late_event("ground", at_ns)
        told.append((at_ns, topic, name, event))
        expected.append(at_ns)

    folder = recorded_in_order(tmp_path / "waited", told)

    with contextlib.closing(Timeline(folder)) as timeline:
        stamps_ns = [stamp_ns for stamp_ns, event in timeline.events if event.code == "late"]
        assert stamps_ns == expected
        assert timeline.begin_ns == 5 * SECOND
        assert timeline.length_s == pytest.approx(39.9, abs=1.9)


def test_a_clock_that_was_set_back_in_flight_is_said(flight: Path, tmp_path: Path) -> None:
    told = []
    for at_ns, topic, name, message in messages(40.0, {}):
        if at_ns >= 25 * SECOND:
            stamp_ns = message.stamp_ns - 10 * SECOND  # type: ignore[attr-defined]
            message = msgspec.structs.replace(message, stamp_ns=stamp_ns)
        told.append((at_ns, topic, name, message))
    folder = recorded_in_order(tmp_path / "set_back", told)

    # by the middles of the pieces before and after
    sentence = "The clock was set back by about 9 s after 19 s of the record: "
    with contextlib.closing(Timeline(folder)) as timeline:
        assert [note[: len(sentence)] for note in timeline.notes] == [sentence]
    assert read_flight(folder).notes[0].startswith(sentence)
    with contextlib.closing(Timeline(flight)) as timeline:
        assert not timeline.notes


async def test_a_person_is_where_the_motion_capture_saw_him_at_that_time(tmp_path: Path) -> None:
    folder = tmp_path / "visited"
    folder.mkdir()
    people = "\n[people.anna]\nmocap_body = 'cap3'\n"
    (folder / "fleet.toml").write_text(FLEET.read_text("utf-8") + people, encoding="utf-8")
    stream = (folder / "flight.mcap").open("wb")
    files = RecordFiles(folder, stream, begin_ns=5 * SECOND, begin="a test")
    for at_ns, topic, name, message in messages(6.0, {}):
        files.write(topic, name, message, at_ns)
    for step in range(12):
        at_ns = 5 * SECOND + step * SECOND // 4
        pose = MocapPose(
            body="cap3",
            boot_id=1,
            sequence=step + 1,
            stamp_ns=at_ns,
            is_tracked=True,
            position_enu_m=(0.25 * step, 2.0, 1.7),
            quaternion_enu_flu_wxyz=LEVEL,
        )
        files.write(Topic.ALL_POSES, "all", MocapPoses(poses=(pose,)), at_ns)
    files.finish()
    files.close()

    replay = opened(folder)
    for time_s, east_m, is_fresh in ((1.6, 1.5, True), (5.5, 2.75, False), (0.6, 0.5, True)):
        await replay.seek(time_s)
        [person] = replay.state.people
        assert person.position_enu_m == (east_m, 2.0, 1.7)
        assert person.is_fresh(replay.now_ns()) == is_fresh


async def test_ticks_are_read_for_the_followed_vehicle_only(tmp_path: Path) -> None:
    folder = tmp_path / "ticks"
    folder.mkdir()
    shutil.copy(FLEET, folder / "fleet.toml")
    files = RecordFiles(folder, (folder / "flight.mcap").open("wb"), begin_ns=0, begin="a test")
    for step in range(500):
        for name in ("mav0", "mav1"):
            files.write(Topic.TICK, name, tick(step * SECOND // 50), step * SECOND // 50)
    files.finish()
    files.close()
    replay = opened(folder)
    await replay.seek(2.0)
    assert not replay.tick_stream.values
    replay.tick_stream.follow("mav1")
    assert len(replay.tick_stream.values) == 101  # what came before is there at once
    await replay.seek(4.0)
    assert [one.stamp_ns for one in replay.tick_stream.values] == [
        step * SECOND // 50 for step in range(201)
    ]


@pytest.mark.long
def test_memory_does_not_follow_the_length_of_the_record(tmp_path: Path) -> None:
    folder = tmp_path / "bodies"
    folder.mkdir()
    files = RecordFiles(folder, (folder / "flight.mcap").open("wb"), begin_ns=0, begin="a test")
    for step in range(60_000):
        pose = MocapPose(
            body="mav0",
            boot_id=1,
            sequence=step,
            stamp_ns=step * 1_000_000,
            is_tracked=True,
            position_enu_m=ZERO,
            quaternion_enu_flu_wxyz=LEVEL,
        )
        files.write(Topic.MOCAP, "mav0", pose, pose.stamp_ns)
    files.finish()
    files.close()
    timeline = Timeline(folder)
    reading = timeline.read(-1, frozenset(("mocap",)))
    count = 0
    most = 0
    for second in range(61):
        for _ in reading.until(second * SECOND):
            count += 1
            most = max(most, reading.pending)
    assert count == 60_000
    assert most < 2_500


def test_the_story_is_printed_for_people_and_for_programs(
    flight: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(flight), "--headless"]) == 0
    text = capsys.readouterr().out
    assert "    10.0 s  mav1 info x: mav1 at 10 s" in text
    assert "Closest: mav0 and mav1, 1.00 m, by ground truth." in text
    assert main(["replay", str(flight / "flight.mcap"), "--json"]) == 0
    story = json.loads(capsys.readouterr().out)
    assert story["is_whole"]
    assert story["smallest"]["pair"] == ["mav0", "mav1"]
    assert len(story["events"]) == 24


def test_a_story_says_how_many_messages_are_missing_because_they_could_not_be_decoded(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(flight), "--headless"]) == 0
    assert "could not be decoded" not in capsys.readouterr().out

    folder = record(tmp_path / "flight", 4.0)
    with (folder / "flight.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, kind in (("telemetry", Telemetry), ("event", Event)):
            schema = writer.register_schema(f"covey.{kind.__name__}", "jsonschema", b"{}")
            channel = writer.register_channel(f"{topic}/mav0", "json", schema)
            writer.add_message(channel, 7 * SECOND, b"{}", 7 * SECOND)
        writer.finish()
    assert main(["replay", str(folder), "--headless"]) == 0
    told = capsys.readouterr().out
    assert told.endswith("\n2 messages could not be decoded and are left out.\n")


@pytest.mark.parametrize("what", [["--headless"], ["--orders"], ["--csv", "flown"]])
@pytest.mark.parametrize("option", [["--at", "4"], ["--speed", "2"]])
def test_options_of_the_console_are_refused_without_it(
    flight: Path, capsys: pytest.CaptureFixture[str], what: list[str], option: list[str]
) -> None:
    assert main(["replay", str(flight), *what, *option]) == 2
    assert "--at and --speed are for the console" in capsys.readouterr().err


def test_a_record_without_a_whole_fleet_file_asks_for_it(
    flight: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(flight / "flight.mcap", tmp_path)
    assert main(["replay", str(tmp_path), "--headless"]) == 2
    assert "--fleet" in capsys.readouterr().err

    whole = FLEET.read_bytes()
    (tmp_path / "fleet.toml").write_bytes(whole[: len(whole) // 2 - 3])
    assert main(["replay", str(tmp_path), "--headless"]) == 2
    assert "Or give another fleet file with --fleet." in capsys.readouterr().err
    assert main(["replay", str(tmp_path), "--headless", "--fleet", str(FLEET)]) == 0
