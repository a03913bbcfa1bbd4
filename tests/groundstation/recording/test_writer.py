"""The record, read back with mcap's own reader; its report; a disk that is full."""

from __future__ import annotations

import errno
import io
import json
import shutil
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from groundstation.recording import writer as record_writer
from groundstation.recording.flight_report import report
from groundstation.recording.writer import RecordWriter, write_json
from onboard.bus.schema import Event, Order, OrderReply, TickBatch, TickSample, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import ConfigError
from tests.groundstation.recorded import read

MS = 1_000_000
ZERO = (0.0, 0.0, 0.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def tick(stamp_ns: int, period_s: float = 0.02) -> TickSample:
    vectors: dict[str, Any] = {
        name: ZERO for name in TickSample.__struct_fields__ if "enu_m" in name
    }
    numbers: dict[str, Any] = {
        "yaw_rad": 0.0,
        "intervention_m_s2": 0.0,
        "slack_m_s2": float("inf"),
        "setpoint_thrust_frac": 0.5,
    }
    return TickSample(
        **vectors,
        **numbers,
        stamp_ns=stamp_ns,
        period_s=period_s,
        state="flying",
        law_status="inactive",
        active_neighbour="",
        neighbour_distances_m={"mav1": 1.5},
        neighbour_ages_s={"mav1": 0.01},
        setpoint_quaternion_enu_flu_wxyz=UPRIGHT,
        attitude_quaternion_enu_flu_wxyz=UPRIGHT,
        hover_thrust_frac=0.5,
    )


def truth(vehicle: str, stamp_ns: int, x: float, *, on_ground: bool = False) -> Truth:
    return Truth(
        vehicle=vehicle,
        stamp_ns=stamp_ns,
        position_enu_m=(x, 0.0, 1.0),
        velocity_enu_m_s=(0.5, 0.0, 0.0),
        quaternion_enu_flu_wxyz=UPRIGHT,
        is_on_ground=on_ground,
        is_collided=False,
    )


def record(folder: Path, messages: list[tuple[Topic, str, Any]]) -> None:
    writer = RecordWriter(folder)
    writer.start()
    for topic, name, message in messages:
        writer.put(topic, name, message, time.monotonic_ns())
    writer.stop()
    assert writer.failure is None
    assert writer.dropped == 0


def test_mcaps_own_reader_finds_channels_schemas_times_and_values(tmp_path: Path) -> None:
    batch = TickBatch(vehicle="mav0", boot_id=1, sequence=1, ticks=(tick(100 * MS), tick(120 * MS)))
    record(
        tmp_path, [(Topic.TRUTH, "mav0", truth("mav0", 5 * MS, 1.25)), (Topic.TICK, "mav0", batch)]
    )
    with (tmp_path / "flight.mcap").open("rb") as stream:
        found = list(make_reader(stream).iter_messages())
    assert [(channel.topic, message.log_time) for _, channel, message in found] == [
        ("truth/mav0", 5 * MS),
        ("tick/mav0", 100 * MS),
        ("tick/mav0", 120 * MS),
    ]
    schema, channel, message = found[0]
    assert schema is not None
    assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
    properties = json.loads(schema.data)["properties"]
    assert properties["position_enu_m"] == {"type": "array", "items": {"type": "number"}}
    values = json.loads(message.data)
    assert values["position_enu_m"] == [1.25, 0.0, 1.0]
    assert set(values) == set(properties)
    assert json.loads(found[1][2].data)["slack_m_s2"] is None  # JSON has no infinity


def test_orders_answers_and_events_are_readable_text_too(tmp_path: Path) -> None:
    order = Order(
        order_id="a1",
        author="eve",
        kind="move",
        stamp_ns=1,
        deadline_ns=2,
        position_enu_m=(1.0, 2.0, 1.2),
    )
    event = Event(
        vehicle="mav0",
        stamp_ns=3,
        severity="info",
        code="order",
        sentence="At\nit.",
        order_id="a1",
        order_outcome="done",
    )
    reply = OrderReply(order_id="a1", vehicle="mav0", is_accepted=True, reason="")
    record(
        tmp_path,
        [(Topic.ORDER, "mav0", order), (Topic.ORDER, "mav0", reply), (Topic.EVENT, "mav0", event)],
    )
    orders = (tmp_path / "orders.txt").read_text().splitlines()
    assert "ordered by eve: move to 1.000 2.000 1.200" in orders[1]
    assert "a1 accepted" in orders[2]
    assert "a1 done: At it." in orders[3]
    assert len((tmp_path / "events.txt").read_text().splitlines()) == 2
    assert {sample.topic for sample in read(tmp_path)} == {"order", "reply", "event"}


def test_received_messages_come_to_the_disk_while_recording_goes_on(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path)
    writer.start()
    writer.put(Topic.TRUTH, "mav0", truth("mav0", 1, 0.0), 0)
    deadline_s = time.monotonic() + 30.0
    while time.monotonic() < deadline_s and not writer.end.written:
        time.sleep(0.05)
    assert len(read(tmp_path)) == 1
    writer.stop()


@pytest.mark.parametrize("share", [0.3, 0.7, 0.95, 0.999])
def test_a_record_that_is_cut_off_reads_as_far_as_it_goes(tmp_path: Path, share: float) -> None:
    messages = [
        (Topic.TRUTH, "mav0", truth("mav0", stamp * MS, stamp * 0.1)) for stamp in range(3000)
    ]
    record(tmp_path, messages)
    path = tmp_path / "flight.mcap"
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    stamps = [sample.stamp_ns for sample in read(tmp_path)]
    assert stamps == [index * MS for index in range(len(stamps))]


class FullDisk(io.BytesIO):
    """Takes a few bytes, then there is no space left."""

    def write(self, data: Any) -> int:
        if self.tell() > 2000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


def test_a_full_disk_ends_the_record_with_one_sentence_and_hurts_nobody(tmp_path: Path) -> None:
    told: list[str] = []
    writer = RecordWriter(tmp_path, on_failure=told.append, open_file=lambda path: FullDisk())
    writer.start()
    deadline_s = time.monotonic() + 30.0
    stamp = 0
    while writer.failure is None and time.monotonic() < deadline_s:
        stamp += 1
        writer.put(Topic.TRUTH, "mav0", truth("mav0", stamp, 0.001 * stamp), 0)
        time.sleep(0.0005)
    writer.put(Topic.TRUTH, "mav0", truth("mav0", stamp + 1, 0.0), 0)
    writer.stop()
    assert len(told) == 1
    assert "No space left" in told[0]


@pytest.mark.parametrize("how", ["removed", "renamed", "made anew"])
def test_a_record_whose_folder_is_removed_ends_at_once_with_its_reason(
    tmp_path: Path, how: str
) -> None:
    folder = tmp_path / "flight"
    told: list[str] = []
    writer = RecordWriter(folder, on_failure=told.append)
    writer.start()
    writer.put(Topic.TRUTH, "mav0", truth("mav0", 1, 0.0), 0)
    assert writer.end_so_far().failure is None

    if how == "renamed":
        folder.rename(tmp_path / "another")
    else:
        shutil.rmtree(folder)
    if how == "made anew":
        folder.mkdir()
        (folder / "flight.mcap").write_bytes(b"of somebody else")
    deadline_s = time.monotonic() + 5.0
    while writer.failure is None and time.monotonic() < deadline_s:
        time.sleep(0.05)
    writer.stop()

    assert told == [writer.failure]
    assert "somebody has removed flight.mcap" in told[0]
    assert "Free some space" not in told[0]


class SlowDisk(io.BytesIO):
    """Takes long for each write, until it may go on."""

    def __init__(self, goes_on: threading.Event) -> None:
        super().__init__()
        self._goes_on = goes_on

    def write(self, data: Any) -> int:
        self._goes_on.wait(30.0)
        return super().write(data)


def test_messages_that_a_slow_disk_leaves_no_room_for_are_counted_and_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record_writer, "MAX_QUEUED", 10)
    monkeypatch.setattr(record_writer, "_CHUNK_BYTES", 100)
    goes_on = threading.Event()
    goes_on.set()
    told: list[str] = []
    writer = RecordWriter(
        tmp_path, on_warning=told.append, open_file=lambda path: SlowDisk(goes_on)
    )
    writer.start()
    goes_on.clear()
    for stamp in range(400):
        writer.put(Topic.TRUTH, "mav0", truth("mav0", stamp, 0.0), 0)
        time.sleep(0.001)
    goes_on.set()
    time.sleep(0.5)
    writer.stop()

    assert writer.end.dropped > 0
    assert writer.end.dropped + writer.end.written == 400
    assert len(told) == 1
    assert "The disk is too slow for the record" in told[0]


def test_an_end_that_the_disk_does_not_take_in_time_is_missing_in_the_record(
    tmp_path: Path,
) -> None:
    goes_on = threading.Event()
    goes_on.set()
    told: list[str] = []
    writer = RecordWriter(
        tmp_path, on_failure=told.append, open_file=lambda path: SlowDisk(goes_on)
    )
    writer.start()
    thread = writer._thread
    assert thread is not None
    goes_on.clear()
    for stamp in range(3):
        writer.put(Topic.TRUTH, "mav0", truth("mav0", stamp, 0.0), 0)
    assert writer.end_so_far(timeout_s=0.0).dropped == 3
    assert writer.dropped == 0

    writer.stop(timeout_s=0.01)
    assert "The end of the record was not written" in (writer.end.failure or "")
    goes_on.set()
    thread.join(30.0)
    assert told == [writer.end.failure]


def test_a_folder_that_cannot_be_written_is_a_sentence_not_an_exception(tmp_path: Path) -> None:
    assert write_json(tmp_path / "v.json", {"passed": True}) is None
    assert json.loads((tmp_path / "v.json").read_text()) == {"passed": True}
    assert "cannot be written" in (write_json(tmp_path / "absent" / "v.json", {}) or "")


def test_the_report_interpolates_between_samples_and_counts_only_flight(tmp_path: Path) -> None:
    messages: list[tuple[Topic, str, Any]] = []
    # mav0 passes x = 0 .. 4 at 20 ms; mav1 stands at x = 2.01 and is sampled 10 ms later
    for step in range(101):
        is_down = step > 90
        messages.append(
            (Topic.TRUTH, "mav0", truth("mav0", 20 * step * MS, 0.04 * step, on_ground=is_down))
        )
        messages.append(
            (Topic.TRUTH, "mav1", truth("mav1", (20 * step + 10) * MS, 2.02, on_ground=True))
        )
    for step in range(100):
        batch = TickBatch(
            vehicle="mav0",
            boot_id=1,
            sequence=step,
            ticks=(tick(step, 0.03 if step == 50 else 0.02),),
        )
        messages.append((Topic.TICK, "mav0", batch))
    record(tmp_path, messages)
    found = report(tmp_path)
    assert found.smallest is not None
    assert found.smallest.distance_m == pytest.approx(0.0, abs=1e-9)
    assert found.smallest.stamp_ns == 1010 * MS
    assert found.loops["mav0"].period_p50_ms == pytest.approx(20.0)
    assert found.loops["mav0"].period_max_ms == pytest.approx(30.0)
    assert found.loops["mav0"].ticks == 100


def test_two_vehicles_on_the_ground_have_no_separation_and_a_missing_record_is_a_sentence(
    tmp_path: Path,
) -> None:
    record(
        tmp_path,
        [(Topic.TRUTH, name, truth(name, 1, 0.0, on_ground=True)) for name in ("mav0", "mav1")],
    )
    assert report(tmp_path).smallest is None
    with pytest.raises(ConfigError, match=r"flight\.mcap"):
        report(tmp_path / "nowhere")
